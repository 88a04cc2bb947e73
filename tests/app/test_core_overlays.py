"""Designs of the servo laid over one another: each is what its own picture draws."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

from platform_ctrl.app.backend import Backend
from platform_ctrl.app.pictures import Drawing, Picture
from platform_ctrl.app.settings import Settings
from platform_ctrl.design.methods import read_job

SHIPPED = Path(__file__).parents[2] / "examples" / "three_gyro_platform.toml"
SERVO = "stabilisation"


@pytest.fixture(scope="module")
def bench() -> Backend:
    """The shipped job with a second, slower servo, and nothing that has to be designed first."""
    job = tomllib.loads(SHIPPED.read_text())
    for loop in job["loop"]:
        loop["design"] = [one for one in loop["design"] if one["method"] in ("classical", "platform-servo")]
        loop["use"] = loop["design"][0]["name"]
    job["loop"][-1]["design"].append({"name": "slow", "method": "platform-servo", "crossover_hz": 2.0})
    return Backend(read_job(job, folder=SHIPPED.parent))


@pytest.fixture(scope="module")
def settings(bench: Backend) -> Settings:
    """Not as the job has it: another caging loop inside, another plant, and another axis."""
    inner = bench.moved(bench.start("caging 9-10"), "crossover_hz", 61.0)
    return bench.moved(bench.chosen(inner, loop=SERVO), "position_hz", 0.8).but(
        axis=2, channel="M2", overlays=("slow",)
    )


@pytest.fixture(scope="module")
def picture(bench: Backend, settings: Settings) -> Picture:
    return bench.picture(settings)


def _expect_the_loop_of(over: Drawing, own: Picture) -> None:
    """Compare a drawing over another one with the picture of its design, at the frequencies that both have."""
    _, ours, theirs = np.intersect1d(over.bode.frequency, own.bode.frequency, return_indices=True)
    assert len(ours) > 20
    np.testing.assert_allclose(over.bode.response[ours], own.bode.response[theirs], rtol=1e-9)
    np.testing.assert_allclose(over.bode.phase[ours], own.bode.phase[theirs], atol=1e-6)
    np.testing.assert_allclose(over.Omega_frequency.gain[ours], own.Omega_frequency.gain[theirs], rtol=1e-9)
    np.testing.assert_allclose(np.sort_complex(over.poles), np.sort_complex(own.poles), rtol=1e-9)
    for one, other in ((over.step, own.step), (over.Omega_time, own.Omega_time)):
        assert (one.title, one.signals, one.units) == (other.title, other.signals, other.units)
        np.testing.assert_array_equal(one.t, other.t)
        np.testing.assert_array_equal(one.values, other.values)
        assert not one.low.size


def test_another_servo_over_the_picture_is_what_its_own_picture_draws(
    bench: Backend, settings: Settings, picture: Picture
) -> None:
    [over] = picture.overlays
    assert over.settings.design == "slow"
    own = bench.picture(bench.chosen(settings, design="slow"))
    _expect_the_loop_of(over, own)
    assert np.abs(over.poles).max() > 0.0
    assert not np.allclose(np.sort_complex(over.poles), np.sort_complex(picture.poles), rtol=1e-3)
