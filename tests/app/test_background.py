"""Processes beside the designer: one that stays, and none that is left behind."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator

import pytest

from platform_ctrl.app.background import Abandoned, Resident
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


@pytest.fixture(scope="module")
def resident() -> Iterator[Resident]:
    made = Resident()
    yield made
    made.end()


def test_the_process_stays_for_the_next_question_also_after_a_refusal(resident: Resident) -> None:
    first = resident.worked_out(Who(), silent, never)
    assert first != os.getpid()
    with pytest.raises(ArgumentError, match="expected sense"):
        resident.worked_out(Who(wrong=True), silent, never)
    assert resident.worked_out(Who(), silent, never) == first


def test_a_question_that_is_cancelled_ends_the_process_and_the_next_one_has_another(resident: Resident) -> None:
    first = resident.worked_out(Who(), silent, never)
    told: list[str] = []
    with pytest.raises(Abandoned):
        resident.worked_out(Sleeping(), told.append, lambda: told == ["asleep"])
    assert gone(first)
    assert not resident.there
    with pytest.raises(DesignError, match="died"):
        resident.worked_out(Dying(), silent, never)
    assert resident.worked_out(Who(), silent, never) not in (first, os.getpid())


def test_nothing_is_left_once_nobody_asks_any_more(resident: Resident) -> None:
    process = resident.worked_out(Who(), silent, never)
    asleep, ended = threading.Event(), []

    def ask() -> None:
        try:
            resident.worked_out(Sleeping(), lambda line: asleep.set(), never)
        except Abandoned:
            ended.append(time.monotonic())

    asking = threading.Thread(target=ask)
    asking.start()
    assert asleep.wait(30.0)
    resident.end()
    asking.join(10.0)
    assert ended
    assert gone(process)
    with pytest.raises(Abandoned):
        resident.worked_out(Who(), silent, never)


def test_a_process_ends_with_whom_it_works_for() -> None:
    resident = Resident()
    process = resident.worked_out(Who(), silent, never)
    del resident
    assert gone(process)
