"""What goes to a page for a move: the drawing before the measures, and all that changes together as one message."""

from __future__ import annotations

import dataclasses

import pytest

pytest.importorskip("bokeh", reason="the extra `designer` is not installed")


from platform_ctrl.app.backend import Backend
from platform_ctrl.app.pictures import Drawing


@pytest.mark.parametrize("loop", ["caging 9-10", "stabilisation"])
def test_what_is_drawn_is_the_pictures_and_comes_before_it_is_measured(
    loop: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = Backend("examples/three_gyro_platform.toml")
    settings = bench.start(loop)
    drawings: list[Drawing] = []
    picture = bench.picture(settings, drawings.append)
    (drawing,) = drawings
    assert type(drawing) is Drawing
    for one in dataclasses.fields(Drawing):
        assert getattr(drawing, one.name) is getattr(picture, one.name)
    assert drawing.crossover == picture.margins.crossover
    assert {r.limit for r in picture.requirements if r.name == "bandwidth"} <= {drawing.bandwidth}

    class Stopped(Exception):
        pass

    def stop(drawing: Drawing) -> None:
        raise Stopped

    def measured(*arguments: object) -> None:
        raise AssertionError("measured before it was drawn")

    monkeypatch.setattr("platform_ctrl.app.caged.measure", measured)
    monkeypatch.setattr("platform_ctrl.app.closed_loops.coupled_check", measured)
    with pytest.raises(Stopped):
        bench.picture(settings, stop)
