"""Designs of a rate loop: with sensors and feedforward of their own beside a plain one, and moved by two sliders."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("bokeh", reason="the extra `designer` is not installed")

from camera_job import camera_job, camera_loop, camera_plant
from platform_ctrl import design, read_job
from platform_ctrl.app.backend import Backend
from platform_ctrl.app.settings import Settings, Slider
from platform_ctrl.common.files import toml
from platform_ctrl.design.loop import LoopOutcome
from platform_ctrl.errors import ArgumentError
from platform_ctrl.verification.controllers import outcomes_from, read_controllers

BASE = ["Omega1", "Omega2", "Omega3"]
PI = {"method": "pi", "crossover_hz": 30, "integral_hz": 3}
DESIGNS = [
    PI | {"name": "direct"},
    PI | {"name": "fed", "feedforward": {"sensors": BASE, "bandwidth_hz": 500}},
    PI | {"name": "indirect", "sensors": ["rate_az", "rate_el"], "feedforward": {"sensors": BASE, "into": "reading"}},
]


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    data = camera_job(operation={"Omega": [0.2, 0.2, 0.2], "angles": {"q_el": [0.6]}})
    relative = [
        {"name": f"rate_{name}", "body": name, "axis": axis, "frame": "parent"}
        for name, axis in (("az", [0, 0, 1]), ("el", [0, 1, 0]))
    ]
    friction = [{"gimbal": name, "coulomb": 0.01, "viscous": 0.01} for name in ("az", "el")]
    root = [{"root_axis": axis} for axis in (1, 2, 3)]
    data["plant"] = camera_plant(friction=friction, rate_sensor=[*data["plant"]["rate_sensor"], *relative, *root])
    limits = {"disk_margin": 0.5, "torque_noise": 0.5, "attenuation_db": 10, "attenuation_hz": 5}
    data["loop"][0] |= {"use": "fed", "design": DESIGNS, "limits": limits}
    path = tmp_path_factory.mktemp("job") / "job.toml"
    path.write_text(toml(data), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def outcome(file: Path) -> LoopOutcome:
    return design.loops(file)[0]


@pytest.fixture
def page(file: Path) -> Iterator[Backend]:
    backend = Backend(file)
    yield backend
    backend.close()


def test_every_design_has_the_values_that_it_was_designed_with(page: Backend, outcome: LoopOutcome) -> None:
    assert page.start().design == "fed"
    for one in outcome.designs:
        shown = {r.name: r.value for r in page.picture(page.chosen(page.start(), design=one.name)).requirements}
        for result in one.results:
            assert shown[result.name] == pytest.approx(result.value, rel=1e-3), (one.name, result.name)


def test_designs_are_compared_by_the_line_of_sight_that_the_base_turns(page: Backend) -> None:
    """Whatever a design reads, its overlay has the curves of its own picture."""
    start = page.chosen(page.start(), design="direct")
    shown = page.picture(start.but(overlays=("fed", "indirect")))
    direct = shown.Omega_time
    assert direct.signals[:2] == ("los_rate1", "los_rate2")
    for over in shown.overlays:
        own = page.picture(page.chosen(start, design=over.settings.design))
        assert over.Omega_time.signals == direct.signals
        np.testing.assert_allclose(over.Omega_time.values, own.Omega_time.values, rtol=1e-9, atol=1e-12)
    fed = shown.overlays[0]
    # What friction brings in is fed forward: poles and loop transfer stay what they are.
    _, ours, theirs = np.intersect1d(fed.bode.frequency, shown.bode.frequency, return_indices=True)
    assert len(ours) > 20
    np.testing.assert_allclose(fed.bode.response[ours], shown.bode.response[theirs], rtol=1e-6)
    assert np.abs(fed.Omega_time.values[:2]).max() < 0.5 * np.abs(direct.values[:2]).max()


def test_sliders_move_a_design_with_feedforward_and_it_is_saved_with_it(page: Backend, tmp_path: Path) -> None:
    start = page.start()
    moved = page.moved(start, "crossover_hz", 25.0)
    assert page.picture(moved).measured.margins.crossover < page.picture(start).measured.margins.crossover
    saved = page.save(moved, tmp_path / "saved.toml").job
    (again,) = outcomes_from(read_job(saved), read_controllers(tmp_path / "saved.controllers.json", read_job(saved)))
    assert (again.use, again.closed.controller.input_labels[-3:]) == ("fed", BASE)
    (designed,) = (one for one in design.loops(saved)[0].designs if one.name == "fed")
    np.testing.assert_allclose(again.closed.controller.D, designed.controller.D, rtol=1e-9, atol=1e-12)


INSTANT = ("speed", "robustness")


@pytest.fixture(scope="module")
def camera() -> Iterator[Backend]:
    loop = camera_loop("rate", "pi", use="pi", limits={"disk_margin": 0.3})
    made = Backend(read_job(camera_job(loop=loop)))
    yield made
    made.close()


def _sliders(backend: Backend, settings: Settings) -> dict[str, Slider]:
    return {one.name: one for one in backend.sliders(settings)}


def _options(settings: Settings) -> dict[str, float]:
    return dict(settings.options[settings.loop][settings.design])


def test_speed_scales_time_and_robustness_gives_margin_at_the_same_crossover(camera: Backend) -> None:
    settings = camera.start()
    before = camera.picture(settings)
    speed = _sliders(camera, settings)["speed"]
    assert speed.value == pytest.approx(_options(settings)["crossover_hz"], rel=1e-12)
    slower = camera.moved(settings, "speed", 0.5 * speed.value)
    for name in ("crossover_hz", "integral_hz"):
        assert _options(slower)[name] == pytest.approx(0.5 * _options(settings)[name], rel=1e-9)
    robust = camera.moved(settings, "robustness", 2.0)
    assert _options(robust)["crossover_hz"] == _options(settings)["crossover_hz"]
    assert _options(robust)["integral_hz"] == pytest.approx(0.5 * _options(settings)["integral_hz"], rel=1e-9)
    slow, wide = camera.picture(slower), camera.picture(robust)
    # The delay takes half the phase at half the crossover.
    assert slow.measured.margins.bandwidth < before.measured.margins.bandwidth
    assert slow.measured.margins.worst_disk > before.measured.margins.worst_disk
    assert wide.measured.margins.worst_disk > before.measured.margins.worst_disk
    assert wide.measured.margins.bandwidth == pytest.approx(before.measured.margins.bandwidth, rel=0.1)


def test_the_two_sliders_say_where_the_options_are_and_lead_back_to_the_digit(camera: Backend) -> None:
    settings = camera.start()
    there = camera.moved(camera.moved(settings, "speed", 40.0), "robustness", 1.7)
    at = _sliders(camera, there)
    assert [at[name].value for name in INSTANT] == pytest.approx([40.0, 1.7], rel=1e-9)
    back = camera.moved(camera.moved(there, "robustness", 1.0), "speed", _sliders(camera, settings)["speed"].value)
    assert back.data() == settings.data()
    # An option that was moved by itself moves on in proportion; one that is fixed does not move.
    own = camera.moved(settings, "integral_hz", 2.0 * _options(settings)["integral_hz"])
    assert _sliders(camera, own)["robustness"].value == pytest.approx(0.5, rel=1e-9)
    fixed = own.but(fixed=frozenset({"integral_hz"}))
    moved = camera.moved(fixed, "speed", 0.5 * _sliders(camera, fixed)["speed"].value)
    assert _options(moved)["integral_hz"] == _options(own)["integral_hz"]
    assert _options(moved)["crossover_hz"] < _options(own)["crossover_hz"]
    with pytest.raises(ArgumentError, match="speed must be from"):
        camera.moved(settings, "speed", 0.0)
