"""Drives in linear plants: friction that is fed back is a slope."""

from __future__ import annotations

from typing import Any

import control
import numpy as np
import pytest

from driven_gimbal import COULOMB, FRICTION, INERTIA, RATE_HZ, VISCOUS, driven_job
from platform_ctrl import analysis, read_job
from platform_ctrl.design import loops
from platform_ctrl.simulation import simulate

ANGLES = {"Omega": [0.1, 0.1, 0.1], "angles": {"pitch": [-0.5, 1.0, 1.4]}}
TACHO = FRICTION | {"sensors": ["tacho"], "friction_rate": 0.1}


def test_friction_that_is_fed_back_is_a_slope_of_further_plants() -> None:
    job = read_job(driven_job(TACHO, operation=ANGLES))
    plants = loops(job)[0].closed.plants
    fed = [k for k, label in enumerate(plants.labels) if label.startswith("friction that is fed forward at rest")]
    assert len(fed) == 4
    assert {plants.groups[k] for k in fed} == {"friction"}
    # 2 J w' = -d w + u, with u = k w of the sample held: both bodies turn about the axis.
    period, slope = 1.0 / RATE_HZ, TACHO["friction"] / TACHO["friction_rate"]
    decay = np.exp(-VISCOUS / (2.0 * INERTIA) * period)
    for k in fed:
        poles = np.linalg.eigvals(plants.A[k])
        expected = decay + (1.0 - decay) / VISCOUS * slope
        assert np.abs(poles - expected).min() == pytest.approx(0.0, abs=1e-12)
    assert np.abs(np.linalg.eigvals(plants.A[0])).max() <= 1.0 < expected


def test_what_the_base_shows_feeds_nothing_back() -> None:
    with_drive, without = (
        loops(driven_job(*drives, operation=ANGLES))[0].closed.plants for drives in ((FRICTION,), ())
    )
    assert with_drive.labels == without.labels
    scale = np.abs(without.response).max()
    np.testing.assert_allclose(with_drive.response, without.response, rtol=0.0, atol=1e-12 * scale)
    rubbing = with_drive.labels.index("dry friction at 0.1 rad/s")
    moved, still = (from_base(plants, rubbing, 10.0) for plants in (with_drive, without))
    # All of the friction is fed forward: what is left is late by a sample, which is slow here.
    assert abs(moved) < 0.03 * abs(still)
    assert from_base(with_drive, 0, 10.0) == pytest.approx(from_base(without, 0, 10.0), rel=1e-9)


def from_base(plants: Any, k: int, w: float) -> complex:
    """Return the response of the payload's rate to the base's, both about axis 3, of plant k."""
    B, D = plants.B_Omega[k, :, 2:], plants.D_Omega[k, :1, 2:]
    system = control.ss(plants.A[k], B, plants.C[k, :1], D, plants.period)
    return complex(analysis.frequency_response(system, np.array([w]))[0, 0, 0])


@pytest.mark.parametrize("share", [0.5, 0.9, 1.2])
@pytest.mark.parametrize("late", [0, 20])
def test_what_is_left_of_friction_is_the_balance_of_harmonics_of_the_simulation(share: float, late: int) -> None:
    """A body too heavy to move takes the torque b v − c v exp(−jωT) of the first harmonic, and keeps it as momentum."""
    size, w, heavy = 0.3, 4.0 * np.pi, 1e3
    data = driven_job(FRICTION | {"friction": share * COULOMB}, operation={"Omega": [size, size, size]})
    plant = data["plant"]
    for gimbal in plant["gimbal"]:
        gimbal["inertia"] = [heavy, heavy, heavy]
    plant["friction"][0]["viscous"] = 0.0
    plant["rate_sensor"][2]["delay"] = late / RATE_HZ
    data["manoeuvre"][0]["sine"][0]["amplitude"] = size
    job = read_job(data)
    run = simulate(job.scenario(job.manoeuvres[0]), [], period=1.0 / RATE_HZ, noise=False)
    period = round(2.0 * np.pi / w * RATE_HZ)
    t, p = run.t[-period - 1 : -1], run.p[-period - 1 : -1, 0]
    # Of the base's rate, size sin(wt), the amplitude is -j size.
    kept = 2.0 / period * np.sum(p * np.exp(-1j * w * t)) * 1j * w / (-1j * size)
    whole = 4.0 * COULOMB / (np.pi * size)
    # The hold is late by half a sample.
    expected = whole * (1.0 - share * np.exp(-1j * w * (late + 0.5) / RATE_HZ))
    assert kept == pytest.approx(expected, abs=3e-3 * whole)
    plants = loops(job)[0].closed.plants
    found = from_base(plants, plants.labels.index(f"dry friction at {size} rad/s"), w) * 1j * w * 2.0 * heavy
    # There the base's rate is held as well: friction and feedforward are late by half a sample together.
    expected = whole * (1.0 - share * np.exp(-1j * w * late / RATE_HZ)) * np.exp(-0.5j * w / RATE_HZ)
    assert found == pytest.approx(expected, abs=2e-3 * whole)


@pytest.mark.parametrize(("friction_rate", "stable"), [(0.01, True), (0.001, False)])
def test_friction_that_is_fed_back_too_steeply_is_judged_unstable(friction_rate: float, stable: bool) -> None:
    (outcome,) = loops(read_job(driven_job(TACHO | {"friction_rate": friction_rate})))
    (decay,) = (one for one in outcome.closed.results if one.name == "minimum decay rate, worst case")
    assert decay.passed is stable
    assert (decay.value > 0.0) is stable
