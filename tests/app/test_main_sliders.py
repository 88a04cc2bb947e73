"""Two sliders move all numbers of a classical or PI loop along its rules of thumb: speed and robustness."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

pytest.importorskip("bokeh", reason="the extra `designer` is not installed")


from camera_job import camera_job, camera_loop
from platform_ctrl.app.backend import Backend
from platform_ctrl.app.settings import Settings, Slider
from platform_ctrl.design.methods import read_job
from platform_ctrl.errors import ArgumentError

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
