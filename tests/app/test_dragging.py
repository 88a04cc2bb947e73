"""In a real browser: a pole of the root locus and the crossover of the Bode diagram are dragged with the mouse."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from importlib import resources
from typing import Any

import numpy as np
import pytest

pytest.importorskip("bokeh", reason="Bokeh is not installed")

from bokeh.application import Application
from bokeh.application.handlers.function import FunctionHandler
from bokeh.document import Document
from bokeh.models import Column, Row
from bokeh.server.server import Server
from tornado.ioloop import IOLoop

from browser import PLACE, Screen, screen
from designer_pictures import picture
from platform_ctrl.app.plots import Plots
from platform_ctrl.app.plots.handles import LATE, REST

HZ = 1.0 / (2.0 * np.pi)


class Page:
    """A page of two plots, and what was dragged on it."""

    def __init__(self) -> None:
        self.poles: list[tuple[complex, complex]] = []
        self.crossovers: list[float] = []
        self.gain = 4000.0
        self.plots: Plots | None = None
        self.document: Document | None = None
        self.root = Column()
        self.loop: IOLoop | None = None

    def fill(self, document: Document) -> None:
        self.gain, self.poles, self.crossovers = 4000.0, [], []
        self.plots, self.document = Plots(), document
        roots = self.plots.layout
        self.root = Column(
            Row(roots["bode"], roots["locus"], width=1000, height=420), Row(roots["nichols"], width=400, height=300)
        )
        document.add_root(self.root)
        self.plots.show(picture(self.gain))
        self.plots.on_pole_dragged(self._pole)
        self.plots.on_crossover_dragged(self._crossover)

    def at_rest(self) -> bool:
        """Return whether no drag is still coming to rest, asked between two acts of the server."""
        assert self.loop is not None
        answer: Future[bool] = Future()
        self.loop.add_callback(lambda: answer.set_result(not self.document.session_callbacks))  # type: ignore[union-attr]
        return answer.result(20.0)

    def _pole(self, pole: complex, target: complex) -> None:
        self.poles.append((pole, target))
        # The loop's poles are -10 +- j sqrt(gain - 100): the gain takes one as high as it is wanted.
        self._answer(target.imag**2 + 100.0)

    def _crossover(self, frequency: float) -> None:
        self.crossovers.append(frequency)
        self._answer(frequency * float(np.hypot(frequency, 20.0)))

    def _answer(self, gain: float) -> None:
        self.gain = gain
        assert self.plots is not None
        self.plots.show(picture(gain))


@pytest.fixture(scope="module")
def served() -> Iterator[tuple[Page, str]]:
    page, ready = Page(), threading.Event()
    found: dict[str, Any] = {}

    def run() -> None:
        asyncio.set_event_loop(asyncio.new_event_loop())
        server = Server({"/": Application(FunctionHandler(page.fill))}, port=0, address="127.0.0.1", num_procs=1)
        server.start()
        page.loop = IOLoop.current()
        found.update(port=server.port, server=server)
        ready.set()
        page.loop.start()
        server.stop()

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    assert ready.wait(20.0)
    yield page, f"http://127.0.0.1:{found['port']}/"
    assert page.loop is not None
    page.loop.add_callback(page.loop.stop)
    thread.join(10.0)


@pytest.fixture(scope="module")
def opened(browser: Any, served: tuple[Page, str]) -> Iterator[tuple[Page, Screen]]:
    page, address = served
    with screen(browser, address, width=1060, height=800) as seen:
        seen.page.wait_for_function("window.Bokeh && Bokeh.documents.length && Bokeh.documents[0].is_idle")
        yield page, seen


# A word that the browser says to the server, or waits for; whatever was sent before it has arrived with it.
SAY = "word => { Bokeh.documents[0].roots()[0].tags = [word]; }"
HEARD = "word => Bokeh.documents[0].roots()[0].tags[0] == word && Bokeh.documents[0].is_idle"


@pytest.fixture
def shown(opened: tuple[Page, Screen]) -> tuple[Page, Screen]:
    """The page with its first picture again, at rest."""
    page, seen = opened
    plots, document = page.plots, page.document
    assert plots is not None
    assert document is not None
    asked, answered = f"asked {time.monotonic()}", f"answered {time.monotonic()}"

    def again() -> None:
        page.poles.clear()
        page.crossovers.clear()
        plots.show(picture())
        page.root.tags = [answered]

    seen.page.evaluate(SAY, asked)
    until(lambda: page.root.tags == [asked])
    until(page.at_rest)
    document.add_next_tick_callback(again)
    seen.page.wait_for_function(HEARD, arg=answered)
    seen.page.wait_for_timeout(300)
    return page, seen


def until(true: Callable[[], bool]) -> None:
    end = time.monotonic() + 20.0
    while not true():
        assert time.monotonic() < end
        time.sleep(0.02)


def drag(
    seen: Screen,
    figure: str,
    start: tuple[float, float],
    end: tuple[float, float],
    *,
    held: float = 0.0,
    rests: float = 0.0,
    steps: int = 12,
) -> None:
    """Drag from a place to another; the mouse is held still for some milliseconds at first, and rests half way."""
    mouse = seen.page.mouse
    first, last = (seen.page.evaluate(PLACE, [figure, *place]) for place in (start, end))
    mouse.move(*first)
    mouse.down()
    seen.page.wait_for_timeout(held)
    if rests:
        mouse.move(*(0.5 * (a + b) for a, b in zip(first, last, strict=True)), steps=steps)
        seen.page.wait_for_timeout(rests)
    mouse.move(*last, steps=steps)
    mouse.up()


def test_a_pole_is_dragged_and_the_last_place_wins(shown: tuple[Page, Screen]) -> None:
    page, seen = shown
    high = float(np.sqrt(3900.0))
    drag(seen, "locus-figure-0", (-10.0, high), (-10.0, 90.0))
    until(lambda: bool(page.poles) and abs(page.poles[-1][1] - complex(-10.0, 90.0)) < 1.0)
    assert page.poles[0][0] == pytest.approx(complex(-10.0, high))
    assert page.gain == pytest.approx(90.0**2 + 100.0, rel=0.03)
    # The plots have followed: the cross is where the ring was let go, and its conjugate opposite.
    assert page.plots is not None
    until(lambda: len(page.plots.sources["dragged"].data["x0"]) == 0)  # type: ignore[union-attr]
    assert sorted(page.plots.sources["poles"].data["im"]) == pytest.approx([-90.0, 90.0], rel=0.02)
    assert seen.complaints == []


def test_a_pole_that_is_gripped_and_held_can_still_be_dragged_and_a_rest_half_way_is_no_second_drag(
    shown: tuple[Page, Screen],
) -> None:
    page, seen = shown
    script = resources.files("platform_ctrl.app.page") / "assets" / "dragging.js"
    seen.page.add_script_tag(content=script.read_text(encoding="utf-8"), type="module")
    assert page.plots is not None
    before = page.plots.drags
    drag(seen, "locus-figure-0", (-10.0, float(np.sqrt(3900.0))), (-10.0, 80.0), held=500.0, rests=REST + LATE + 150)
    until(lambda: bool(page.poles) and abs(page.poles[-1][1] - complex(-10.0, 80.0)) < 1.0)
    assert page.plots.drags == before + 1


def test_beside_a_handle_the_mouse_moves_the_view(shown: tuple[Page, Screen]) -> None:
    page, seen = shown
    assert page.plots is not None
    axis = page.plots.layout["locus"].select_one({"name": "locus-figure-0"}).x_range
    start = axis.start
    drag(seen, "locus-figure-0", (-60.0, 30.0), (-30.0, 30.0))
    until(lambda: abs(axis.start - (start - 30.0)) < 2.0)
    assert page.poles == []
    seen.page.get_by_role("button", name="reset").click()  # of the plot that moved alone
    until(lambda: axis.start == start)
