"""A process beside this one: results, time limits, deaths."""

from __future__ import annotations

import math
import os
import time

import pytest

from platform_ctrl.common.processes import ProcessDied, ProcessTimeout, TaskProcess


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
