"""A page without a browser, in whatever order things happen, and its work beside it in a process that stays."""

from __future__ import annotations

import dataclasses
import os
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

pytest.importorskip("bokeh", reason="the extra `designer` is not installed")

from bokeh.document import Document

from platform_ctrl.app import closed_loops
from platform_ctrl.app.backend import Backend
from platform_ctrl.app.background import Background, DesignPending, Requests, TaskCancelled
from platform_ctrl.app.pictures import Picture
from platform_ctrl.app.session import Pages, Session
from platform_ctrl.app.tasks import Connection
from platform_ctrl.errors import ArgumentError, DesignError
from questions import dying, refusing, sleeping, who


def _until(met: Callable[[], bool]) -> None:
    end = time.monotonic() + 60.0
    while not met():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.002)


class Driven:
    """A session whose loop the test drives, with a design that is available when the test says so."""

    def __init__(self, backend: Backend, shown: Picture, monkeypatch: pytest.MonkeyPatch) -> None:
        self.backend, self.count = backend, 0
        self.available = False
        # Called as soon as the design was found missing, still within the computation of the picture.
        self.on_missing: Callable[[], None] = lambda: None
        self._listeners: list[Callable[[], None]] = []
        self._waiting: list[Callable[[], None]] = []
        self._shown = shown
        monkeypatch.setattr(Connection, "later", lambda connection, act: self._waiting.append(act))
        monkeypatch.setattr(backend, "picture", self.picture)
        monkeypatch.setattr(
            backend.loops, "listen", lambda listener: self._listeners.append(listener) or (lambda: None)
        )
        self.session = Session(Pages(backend), Document(), "")
        self.answered = 0
        self.session.connection.model.on_change("answered", self._answered)
        self.request("ready")
        self.settle()

    def picture(self, settings: Any, on_drawn: Any = None) -> Any:
        if settings.design == "H-infinity" and not self.available:
            self.on_missing()
            raise DesignPending("H-infinity: is being designed")
        # Its curves do not matter here.
        return dataclasses.replace(self._shown, settings=settings)

    def designed(self) -> None:
        self.available = True
        for listener in self._listeners:
            listener()

    def request(self, what: str, **more: Any) -> None:
        self.count += 1
        self.session.connection.model.request = {"n": self.count, "what": what, **more}

    def _answered(self, name: str, old: object, new: list[int]) -> None:
        self.answered = new[0]

    @property
    def state(self) -> dict[str, Any]:
        """What the page shows."""
        picture = self.session.picture
        assert picture is not None
        shown = picture.settings
        return {"design": shown.design, "axis": shown.axis, "undo": self.session.history.can(-1)}

    def run_loop(self) -> None:
        while self._waiting:
            self._waiting.pop(0)()

    def work(self) -> None:
        """Wait until the thread of the page has nothing to do; the loop does not run meanwhile."""
        _until(lambda: all(thread.name != "page" for thread in threading.enumerate()))

    def settle(self) -> None:
        """Run the loop until nothing happens any more."""
        self.work()
        while self._waiting:
            self.run_loop()
            self.work()


@pytest.fixture(scope="module")
def shown(backend: Backend) -> Picture:
    return backend.picture(backend.start())


@pytest.fixture
def driven(backend: Backend, shown: Picture, monkeypatch: pytest.MonkeyPatch) -> Iterator[Driven]:
    made = Driven(backend, shown, monkeypatch)
    yield made
    made.session.close(None)


@pytest.mark.parametrize("when", ["while its picture is computed", "before the result is shown", "after it is shown"])
def test_a_selected_design_is_shown_whenever_it_becomes_available(driven: Driven, when: str) -> None:
    if when == "while its picture is computed":
        driven.on_missing = driven.designed
    driven.request("set", name="design", value="H-infinity")
    if when == "before the result is shown":
        driven.work()
        driven.designed()
    elif when == "after it is shown":
        driven.settle()
        assert driven.state["design"] == "classical"
        driven.designed()
    driven.settle()
    assert driven.state["design"] == "H-infinity"
    assert driven.state["undo"]
    assert driven.answered == driven.count


def test_a_change_at_the_moment_at_which_a_design_becomes_available_is_kept(driven: Driven) -> None:
    driven.request("set", name="design", value="H-infinity")
    driven.settle()
    # The thread is busy while both come.
    begun, go = threading.Event(), threading.Event()

    def slow(settings: Any) -> Any:
        begun.set()
        assert go.wait(60.0)
        return settings

    driven.session.change("slow", slow)
    assert begun.wait(60.0)
    driven.request("set", name="axis", value=3)
    driven.designed()
    driven.run_loop()
    go.set()
    driven.settle()
    assert driven.state["axis"] == 3
    assert driven.answered == driven.count


def test_every_request_is_answered_when_results_come_faster_than_they_are_shown(driven: Driven) -> None:
    driven.request("set", name="axis", value=2)
    driven.work()
    driven.session.change("again", lambda settings: settings)  # as a design that has become available
    driven.settle()
    assert driven.state["axis"] == 2
    assert driven.answered == driven.count


def test_what_sliders_do_is_given_up_when_one_moves_and_computed_at_the_next_rest(
    driven: Driven, monkeypatch: pytest.MonkeyPatch
) -> None:
    at_rest: list[Callable[[], None]] = []
    monkeypatch.setattr(Document, "add_timeout_callback", lambda document, act, wait: at_rest.append(act) or act)
    monkeypatch.setattr(
        Document, "remove_timeout_callback", lambda document, act: at_rest.remove(act) if act in at_rest else None
    )
    axes, go, given_up = [], threading.Event(), threading.Event()

    def influence(settings: Any, before_each: Callable[[], None]) -> Any:
        axes.append(settings.axis)
        assert go.wait(60.0)
        try:
            before_each()
        except TaskCancelled:
            given_up.set()
        raise DesignError("only whether it goes on matters")

    monkeypatch.setattr(driven.backend, "influence", influence)
    for axis in (2, 3):
        driven.request("set", name="axis", value=axis)
        driven.settle()
        at_rest.pop()()
        assert not at_rest
        _until(lambda: bool(axes))
    assert axes == [2], "one at a time"
    go.set()
    _until(lambda: axes == [2, 3])
    assert given_up.is_set()
    _until(lambda: all(thread.name != "page task" for thread in threading.enumerate()))


def test_designs_that_fail_on_two_pages_are_not_tried_again_and_again(
    backend: Backend, monkeypatch: pytest.MonkeyPatch
) -> None:
    tried: list[float] = []

    def failing(task: Any, cancelled: Any) -> None:
        tried.append(task.args[0].loops[0].designs[2].options["bandwidth_hz"])
        raise DesignError(f"{tried[-1]:g} Hz is infeasible")

    monkeypatch.setattr(closed_loops, "PAUSE", 0.0)
    monkeypatch.setattr(backend.loops.background, "run", failing)
    start = backend.chosen(backend.start(), design="H-infinity")
    pages = [backend.moved(start, "bandwidth_hz", number) for number in (21.0, 22.0)]
    for told, page in enumerate(pages, 1):
        with pytest.raises(DesignPending):
            backend.picture(page)
        _until(lambda told=told: len(tried) == told)  # type: ignore[misc]
    for page, number in zip(pages, (21, 22), strict=True):
        _until(lambda page=page: backend.loops._failed.found(backend.loops.design_key(page, page.loop, page.design)))  # type: ignore[misc]
        with pytest.raises(DesignError, match=f"{number} Hz is infeasible"):
            backend.picture(page)
    assert tried == [21.0, 22.0]


def silent(line: str) -> None:
    del line


def never() -> bool:
    return False


def gone(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return True
    return False


def test_the_newest_request_of_a_key_wins_and_an_urgent_one_interrupts() -> None:
    requests, done, begun, go = Requests("test"), list[str](), list[str](), threading.Event()

    def work(name: str) -> Callable[[threading.Event], None]:
        def run(over: threading.Event) -> None:
            begun.append(name)
            while not (go.is_set() or over.wait(0.001)):
                pass
            done.append(f"{name} over" if over.is_set() else name)

        return run

    first = requests.add("design", work("first"), content=1)
    _until(lambda: begun == ["first"])
    assert requests.add("design", work("the same"), content=1) is first
    requests.add("other", work("other"))
    requests.add("other", work("newer"))
    requests.add("design", work("second"), content=2)
    _until(lambda: begun == ["first", "newer"])
    requests.add("urgent", work("urgent"), urgent=True)
    _until(lambda: begun == ["first", "newer", "urgent"])
    go.set()
    _until(lambda: len(done) == 5)
    assert done == ["first over", "newer over", "urgent", "second", "newer"]
    requests.end()
    assert requests.add("design", work("late")).is_set()
    assert "late" not in begun


@pytest.fixture(scope="module")
def resident() -> Iterator[Background]:
    made = Background()
    yield made
    made.end()


def test_the_process_stays_for_the_next_task_also_after_an_error(resident: Background) -> None:
    first = resident.run(who, silent, never)
    assert first != os.getpid()
    with pytest.raises(ArgumentError, match="expected sense"):
        resident.run(refusing, silent, never)
    assert resident.run(who, silent, never) == first


def test_a_cancelled_task_ends_the_process_and_the_next_task_starts_another(
    resident: Background,
) -> None:
    first = resident.run(who, silent, never)
    lines: list[str] = []
    with pytest.raises(TaskCancelled):
        resident.run(sleeping, lines.append, lambda: lines == ["asleep"])
    assert gone(first)
    with pytest.raises(DesignError, match="died"):
        resident.run(dying, silent, never)
    assert resident.run(who, silent, never) not in (first, os.getpid())


def test_ending_the_runner_ends_its_process_and_refuses_tasks() -> None:
    runner = Background()
    process = runner.run(who, silent, never)
    asleep, ended = threading.Event(), []

    def ask() -> None:
        try:
            runner.run(sleeping, lambda line: asleep.set(), never)
        except TaskCancelled:
            ended.append(time.monotonic())

    asking = threading.Thread(target=ask)
    asking.start()
    assert asleep.wait(60.0)
    runner.end()
    asking.join(60.0)
    assert ended
    assert gone(process)
    with pytest.raises(TaskCancelled):
        runner.run(who, silent, never)
