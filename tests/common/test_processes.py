"""A process beside this one: results, time limits, deaths."""

from __future__ import annotations

import contextlib
import math
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from platform_ctrl.common.processes import PROCESSES, ProcessDied, ProcessTimeout, SecondProcess, Task, TaskProcess


def test_tasks_are_answered_one_after_another() -> None:
    process = TaskProcess(math.pow, 2.0)
    assert [process.ask(task, 60.0) for task in (3.0, 10.0)] == [8.0, 1024.0]
    process.end()


def test_a_task_that_takes_too_long_ends_the_process() -> None:
    process = TaskProcess(time.sleep)
    with pytest.raises(ProcessTimeout):
        process.ask(600.0, 0.2)
    assert process.process.poll() is not None


@pytest.mark.parametrize(("function", "task"), [(os._exit, 3), (math.sqrt, -1.0)], ids=["it exits", "it raises"])
def test_a_process_that_dies_is_noticed(function, task) -> None:
    with pytest.raises(ProcessDied):
        TaskProcess(function).ask(task, 60.0)


def halved(k: int) -> float:
    return 1.0 / (k - 3)


def process_number(*numbers: int) -> int:
    return os.getpid()


def process_number_after(file: Path) -> int:
    """Wait until the other task has been done, which this process cannot do meanwhile."""
    while not file.exists():
        time.sleep(0.01)
    return os.getpid()


def process_number_in(file: Path) -> int:
    file.touch()
    return os.getpid()


def refused_there(home: int) -> str:
    if os.getpid() != home:
        os._exit(3)
    return "done here"


def lambda_there(home: int) -> Callable[[], int]:
    return lambda: home


@pytest.fixture
def two(monkeypatch: pytest.MonkeyPatch) -> Iterator[SecondProcess]:
    monkeypatch.setenv(PROCESSES, "2")
    with SecondProcess() as beside:
        yield beside


def test_results_come_in_the_order_of_the_tasks_whichever_process_has_them(two: SecondProcess) -> None:
    begun: list[int] = []
    assert two.results([(pow, (k, 2)) for k in range(50)], begun.append) == [k * k for k in range(50)]
    assert begun == sorted(begun, reverse=True)


def test_both_processes_work_at_once(two: SecondProcess, tmp_path: Path) -> None:
    there, here = two.results([(process_number_in, (tmp_path / "a",)), (process_number_after, (tmp_path / "a",))])
    assert here == os.getpid() != there


def test_each_process_begins_with_a_long_task(two: SecondProcess, tmp_path: Path) -> None:
    tasks: list[Task] = [(process_number, (0,)) for _ in range(6)]
    # The other process is the first to end the second long task, and waits for nothing.
    tasks[2], tasks[3] = (process_number_after, (tmp_path / "a",)), (process_number_in, (tmp_path / "a",))
    begun: list[int] = []
    found = two.results(tasks, begun.append, long=[2, 3])
    assert begun[0] == 2
    assert found[2] == os.getpid() != found[3]


def test_tasks_that_are_begun_are_done_while_this_process_goes_on_and_before_those_begun_later(
    two: SecondProcess, tmp_path: Path
) -> None:
    first = two.begin([(process_number_in, (tmp_path / "a",)), (process_number_in, (tmp_path / "b",))])
    second = two.begin([(process_number_after, (tmp_path / "b",))])
    assert process_number_after(tmp_path / "b") == os.getpid()
    first_done, second_done = two.finished(first), two.finished(second)
    assert len(first_done) == 2
    assert os.getpid() not in first_done
    assert len(second_done) == 1


def test_the_first_error_in_the_order_of_the_tasks_is_raised_as_in_one_process(two: SecondProcess) -> None:
    for tasks in ([1, 2, 3, 4, 3, 5], [3, 1], [1, 3]):
        with pytest.raises(ZeroDivisionError):
            two.results([(halved, (k,)) for k in tasks])
    assert two.results([(halved, (4,)), (halved, (5,))]) == [1.0, 0.5]


@pytest.mark.parametrize("task", [refused_there, lambda_there])
def test_what_the_other_process_cannot_do_is_done_here(task: Callable[[int], Any], two: SecondProcess) -> None:
    for _ in range(2):
        found = two.results([(task, (os.getpid(),)), (process_number, (0,)), (process_number, (0,))])
        assert (found[0] if isinstance(found[0], str) else found[0]()) in ("done here", os.getpid())


def test_one_process_is_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(PROCESSES, "1")
    with SecondProcess("no such module") as alone:
        assert alone.results([(process_number, (k,)) for k in range(3)]) == [os.getpid()] * 3


def test_a_module_that_is_not_there_leaves_the_work_to_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(PROCESSES, "2")
    with SecondProcess("no_such_module") as beside:
        assert beside.results([(pow, (k, 2)) for k in range(4)]) == [0, 1, 4, 9]


def test_no_process_is_left_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(PROCESSES, "2")
    with contextlib.suppress(KeyboardInterrupt), SecondProcess() as beside:
        assert beside._process is not None
        other = beside._process.process
        raise KeyboardInterrupt
    assert other.poll() is not None
