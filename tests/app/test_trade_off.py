"""Optimised designs are shaped along precomputed ones from robust to fast; nothing invites a drag that cannot act."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("bokeh", reason="the extra `designer` is not installed")

from app.test_page import JOB
from platform_ctrl.app.backend import Backend
from platform_ctrl.app.background import Made
from platform_ctrl.app.trade_off import TradeOffPoint, chosen_point, front, trade_off_data
from platform_ctrl.errors import ArgumentError

LOOP = "caging 9-10"
SHIPPED = Path(__file__).parents[2] / "examples" / "three_gyro_platform.toml"


@pytest.fixture
def backend(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Backend]:
    path = tmp_path_factory.mktemp("trade-off") / "gyros.toml"
    path.write_text(JOB, encoding="utf-8")
    made = Backend(path)
    yield made
    made.close()


def test_points_that_are_available_are_chosen_at_once_and_others_are_requested(
    backend: Backend, monkeypatch: pytest.MonkeyPatch
) -> None:
    trade_off = backend.trade_off
    classical = backend.start(LOOP)
    assert trade_off.points(classical) == ()
    settings = backend.chosen(classical, design="H-infinity")
    points = trade_off.points(settings)
    bandwidths = [one.settings.options[LOOP]["H-infinity"]["bandwidth_hz"] for one in points]
    assert bandwidths == sorted(bandwidths)
    assert settings.options[LOOP]["H-infinity"]["bandwidth_hz"] in bandwidths
    assert {one.state for one in points} == {"missing"}
    assert front(points) == ()
    with pytest.raises(ArgumentError, match="not available yet"):
        chosen_point(points, 0)
    queue: dict[object, object] = {}
    monkeypatch.setattr(backend._designs.queue, "request", lambda *request: queue.update({request[:3]: request[3]}))
    monkeypatch.setattr(backend._designs.queue, "is_requested", lambda *request: request in queue)
    # What the method would make, here loops of the sliders: a slower integral takes margin and leaves bandwidth.
    _keep(backend, points[1], crossover_hz=60.0, integral_hz=10.0)
    _keep(backend, points[3], crossover_hz=60.0)
    points = trade_off.points(settings)
    assert [one.state for one in points] == ["missing", "ready", "missing", "ready", "missing"]
    assert points[1].bandwidth < points[3].bandwidth
    assert points[1].disk > points[3].disk
    assert trade_off.prepare(settings) == len(queue) == 3
    assert [one.state for one in trade_off.points(settings)] == ["pending", "ready", "pending", "ready", "pending"]
    for stop, k in enumerate((1, 3)):
        chosen = chosen_point(points, k).settings
        picture = backend.picture(chosen)
        assert picture.margins.worst_disk == pytest.approx(points[k].disk, rel=1e-9)
        [bandwidth] = [one.value for one in picture.requirements if one.name == "bandwidth"]
        assert bandwidth == pytest.approx(points[k].bandwidth, rel=1e-9)
        data = trade_off_data(trade_off.points(chosen), chosen)
        assert data is not None
        assert ([one["k"] for one in data["stops"]], data["at"], data["missing"]) == ([1, 3], stop, False)
        assert data["line"] == "2 of 5 designed; the next is being designed"
        assert f"{points[k].disk:.2f}" in data["words"]
    # Another plant has a trade-off of its own; the points of this one stay.
    other = backend.moved(settings, "delay", 2.0 * settings.delay + 1e-4)
    assert "ready" not in {one.state for one in trade_off.points(other)}
    back = trade_off.points(backend.moved(other, "delay", settings.delay))
    assert [one.settings.data() for one in back] == [one.settings.data() for one in points]
    assert [(one.bandwidth, one.disk) for one in back] == [(one.bandwidth, one.disk) for one in points]


def test_a_slower_and_less_robust_design_is_left_out_of_the_front(backend: Backend) -> None:
    settings = backend.chosen(backend.start(LOOP), design="H-infinity")
    points = backend.trade_off.points(settings)
    for point, options in (
        (points[0], {"crossover_hz": 60.0, "integral_hz": 10.0}),
        (points[1], {"crossover_hz": 30.0}),
        (points[4], {"crossover_hz": 60.0}),
    ):
        _keep(backend, point, **options)
    points = backend.trade_off.points(settings)
    assert points[1].bandwidth < points[0].bandwidth
    assert points[1].disk < points[0].disk
    assert [k for k, one in enumerate(points) if one.dominated] == [1]
    assert front(points) == (0, 4)
    data = trade_off_data(points, points[1].settings)
    assert data is not None
    assert data["at"] == -1
    assert "another one is faster and more robust" in data["words"]
    assert "1 left out" in data["line"]


def _keep(backend: Backend, point: TradeOffPoint, **options: float) -> None:
    """Keep a loop of the sliders as the design of a point."""
    loops, there = backend._loops, backend.start(LOOP)
    for name, number in options.items():
        there = backend.moved(there, name, number)
    spec, design = loops.design(point.settings)
    made = Made(controller=loops.caged(there)[0].controller, options={}, claims={})
    loops.keep(LOOP, design.name, loops.conditions(point.settings, spec, design), made)


def test_a_page_opens_on_a_loop_that_sliders_shape_at_once(tmp_path: Path) -> None:
    by_hand = Backend(SHIPPED)
    saved = by_hand.save(by_hand.start(), tmp_path / "by_hand.toml")
    text = saved.controllers.read_text(encoding="utf-8")
    assert text.count('"classical"') == 4
    # The same controllers as if the structured method had made them.
    saved.controllers.write_text(text.replace('"classical"', '"structured"'), encoding="utf-8")
    given = Backend(SHIPPED, saved.controllers)
    assert given.start().loop == "stabilisation"
    assert [given.start().closed[loop] for loop in given.choices().loops] == ["structured", "structured", "servo"]
    assert by_hand.start().loop == by_hand.choices().loops[0]
