"""Work beside the designer: the newest request wins; one process that stays, and none that is left behind."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator

import pytest

from platform_ctrl.app.background import Background, Requests, TaskCancelled
from platform_ctrl.errors import ArgumentError, DesignError
from questions import Dying, Sleeping, Who


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

    def until(met: Callable[[], bool]) -> None:
        end = time.monotonic() + 30.0
        while not met():
            assert time.monotonic() < end, "it did not come"
            time.sleep(0.001)

    first = requests.add("design", work("first"), content=1)
    until(lambda: begun == ["first"])
    assert requests.add("design", work("the same"), content=1) is first
    requests.add("other", work("other"))
    requests.add("other", work("newer"))
    requests.add("design", work("second"), content=2)
    until(lambda: begun == ["first", "newer"])
    requests.add("urgent", work("urgent"), urgent=True)
    until(lambda: begun == ["first", "newer", "urgent"])
    go.set()
    until(lambda: len(done) == 5)
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
    first = resident.run(Who(), silent, never)
    assert first != os.getpid()
    with pytest.raises(ArgumentError, match="expected sense"):
        resident.run(Who(wrong=True), silent, never)
    assert resident.run(Who(), silent, never) == first


def test_a_cancelled_task_ends_the_process_and_the_next_task_starts_another(
    resident: Background,
) -> None:
    first = resident.run(Who(), silent, never)
    lines: list[str] = []
    with pytest.raises(TaskCancelled):
        resident.run(Sleeping(), lines.append, lambda: lines == ["asleep"])
    assert gone(first)
    with pytest.raises(DesignError, match="died"):
        resident.run(Dying(), silent, never)
    assert resident.run(Who(), silent, never) not in (first, os.getpid())


def test_ending_the_runner_ends_its_process_and_refuses_tasks(resident: Background) -> None:
    process = resident.run(Who(), silent, never)
    asleep, ended = threading.Event(), []

    def ask() -> None:
        try:
            resident.run(Sleeping(), lambda line: asleep.set(), never)
        except TaskCancelled:
            ended.append(time.monotonic())

    asking = threading.Thread(target=ask)
    asking.start()
    assert asleep.wait(30.0)
    resident.end()
    asking.join(10.0)
    assert ended
    assert gone(process)
    with pytest.raises(TaskCancelled):
        resident.run(Who(), silent, never)
