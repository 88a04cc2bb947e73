"""Which sliders a loop has: those that make its controller, and all of those."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from platform_ctrl.analysis.system import System
from platform_ctrl.app.backend import Backend
from platform_ctrl.app.settings import Settings, with_options
from platform_ctrl.app.tasks import decode_state, encode_state
from platform_ctrl.cli import main
from platform_ctrl.design.methods import METHODS

CLASSICAL = METHODS["classical"]
SHIPPED = Path(__file__).parents[2] / "examples" / "three_gyro_platform.toml"


@pytest.fixture(scope="module")
def shipped() -> Backend:
    return Backend(SHIPPED)


def _controller(bench: Backend, settings: Settings) -> System:
    return bench._loops.caged(settings)[0].controller


def _differ(one: System, other: System) -> bool:
    return any(a.shape != b.shape or not np.array_equal(a, b) for a, b in zip(one[:4], other[:4], strict=True))


def _every_part(bench: Backend, settings: Settings) -> Settings:
    for part in bench.parts(settings):
        settings = bench.with_part(settings, part.name, True)
    return settings


def _expect_that_sliders_are_what_acts(bench: Backend, settings: Settings) -> None:
    settings = _every_part(bench, settings)
    before = _controller(bench, settings)
    own = {slider.name: slider for slider in bench.sliders(settings) if slider.name in CLASSICAL.options}
    assert own
    for name, slider in own.items():
        assert _differ(_controller(bench, bench.moved(settings, name, 0.97 * slider.value)), before), name
    # With every part that there is, even those that are not offered, what has no slider moves nothing.
    all_on = {settings.loop: {settings.design: tuple(CLASSICAL.parts)}}
    loaded = settings.but(optional={**settings.optional, **all_on})
    off = {name for name, kind in CLASSICAL.options.items() if name not in own and kind.part != "spin_notch"}
    for name in off:
        assert not _differ(_controller(bench, with_options(loaded, {name: 3.0})), _controller(bench, loaded)), name


@pytest.mark.parametrize("kind", ["caged-gyro", "control-moment-gyro"])
def test_the_sliders_of_a_classical_loop_are_those_that_make_its_controller(kind: str, tmp_path: Path) -> None:
    assert main(["new", "mine", "--kind", kind, "-o", str(tmp_path)]) == 0
    bench = Backend(tmp_path / "mine.toml")
    for spec in bench.read.loops:
        for design in spec.designs:
            if design.method == "classical":
                _expect_that_sliders_are_what_acts(bench, bench.chosen(bench.start(spec.name), design=design.name))


def test_a_slider_that_is_fixed_and_hidden_again_stays_in_the_link(shipped: Backend) -> None:
    settings = shipped.start("caging 9-10").but(fixed=frozenset({"notch_hz", "damping_hz"}))
    hidden = shipped.with_part(settings, "notch", False)
    servo = shipped.chosen(hidden, loop="stabilisation")
    for one in (hidden, servo):
        assert decode_state(shipped, encode_state(shipped, one)).data() == one.data()
