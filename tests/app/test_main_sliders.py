"""Two sliders move all numbers of a classical or PI loop along its rules of thumb: speed and robustness."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("bokeh", reason="the extra `designer` is not installed")

from playwright.sync_api import Browser

from browser import screen, served
from platform_ctrl.app.backend import Backend
from platform_ctrl.app.settings import Settings, Slider
from platform_ctrl.cli.serve_command import _prepared
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.reading import read_job

# A plant alone, without torquers: the loop's are added.
PLANT = """schema = 1
name = "mirror"
source = "all numbers assumed"
[root]
name = "case"
inertia = [0.1, 0.1, 0.1]
[[gimbal]]
name = "tip"
parent = "case"
axis = [1, 0, 0]
inertia = [1e-3, 1e-3, 1e-3]
angle = "t"
"""
INSTANT = ("speed", "robustness")


@pytest.fixture(scope="module")
def camera(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Backend]:
    made = _backend(Path("camera_gimbal"), tmp_path_factory.mktemp("camera"))
    yield made
    made.close()


def _backend(plant: Path, folder: Path) -> Backend:
    make, _ = _prepared(plant, None, folder, lambda line: None)
    made = make()
    assert isinstance(made, Backend)
    return made


def _sliders(backend: Backend, settings: Settings) -> dict[str, Slider]:
    return {one.name: one for one in backend.sliders(settings)}


def _options(settings: Settings) -> dict[str, float]:
    return dict(settings.options[settings.loop][settings.design])


def test_a_plant_alone_gives_a_loop_that_meets_its_limits_from_rules_of_thumb(camera: Backend) -> None:
    settings = camera.start()
    assert [one.name for one in camera.sliders(settings)][:2] == list(INSTANT)
    assert camera.folded
    picture = camera.picture(settings)
    assert picture.requirements
    assert all(one.passed for one in picture.requirements)


def test_speed_scales_time_and_robustness_gives_margin_at_the_same_crossover(camera: Backend) -> None:
    settings = camera.start()
    before = camera.picture(settings)
    speed = _sliders(camera, settings)["speed"]
    assert speed.value == _options(settings)["crossover_hz"]
    slower = camera.moved(settings, "speed", 0.5 * speed.value)
    for name in ("crossover_hz", "integral_hz"):
        assert _options(slower)[name] == pytest.approx(0.5 * _options(settings)[name], rel=1e-9)
    robust = camera.moved(settings, "robustness", 2.0)
    assert _options(robust)["crossover_hz"] == _options(settings)["crossover_hz"]
    assert _options(robust)["integral_hz"] == pytest.approx(0.5 * _options(settings)["integral_hz"], rel=1e-9)
    slow, wide = camera.picture(slower), camera.picture(robust)
    # The delay takes half the phase at half the crossover.
    assert slow.margins.bandwidth < before.margins.bandwidth
    assert slow.margins.worst_disk > before.margins.worst_disk
    assert wide.margins.worst_disk > before.margins.worst_disk
    assert wide.margins.bandwidth == pytest.approx(before.margins.bandwidth, rel=0.1)


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


def test_the_ranges_of_typed_numbers_are_those_of_the_loop(camera: Backend) -> None:
    settings = camera.start()
    nyquist = 0.5 * settings.rate_hz
    for name, number in (("crossover_hz", 0.0), ("crossover_hz", 1e9), ("crossover_hz", 1.01 * nyquist)):
        with pytest.raises(ArgumentError, match=rf"{name} must be from 0\.\d+ to {nyquist:g} Hz, got") as caught:
            camera.moved(settings, name, number)
        assert "e-" not in str(caught.value).partition(", got")[0]
    assert _options(camera.moved(settings, "crossover_hz", 0.5 * nyquist))["crossover_hz"] == 0.5 * nyquist
    with pytest.raises(ArgumentError, match=r"rate_hz must be from 0\.1 to 500000 Hz"):
        camera.moved(settings, "rate_hz", 1e9)


def test_a_job_that_a_plant_gave_is_saved_beside_the_plant_with_what_was_added_to_it(tmp_path: Path) -> None:
    plant, folder = tmp_path / "mirror.toml", tmp_path / "made"
    plant.write_text(PLANT, encoding="utf-8")
    folder.mkdir()
    backend = _backend(plant, folder)
    try:
        settings = backend.moved(backend.start(), "speed", 20.0)
        assert backend.folder == tmp_path
        saved = backend.save(settings, backend.folder / "mirror-tuned.toml")
        read = read_job(saved.job)
        assert read.loops[0].designs[0].options["inertial_crossover_hz"] == 20.0
        assert [one.gimbal for one in read.platform.torquers] == ["tip"]
        assert plant.read_text(encoding="utf-8") == PLANT
    finally:
        backend.close()


def test_other_sliders_are_folded_until_they_are_wanted(camera: Backend, browser: Browser) -> None:
    with served(camera) as server, screen(browser, server.address) as shown:
        page = shown.page
        sliders = page.locator("#sliders [data-slider]")
        page.locator('#sliders [data-slider="speed"]').wait_for()
        assert [one.get_attribute("data-slider") for one in sliders.all() if one.is_visible()] == list(INSTANT)
        page.locator("#sliders summary", has_text="All options").click()
        assert page.locator('#sliders [data-slider="integral_hz"]').is_visible()
