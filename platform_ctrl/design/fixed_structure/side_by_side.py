"""Searches from many starts: which of them go on, and side by side in processes where one after another is slower."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import time
from collections import deque
from collections.abc import Callable, Sequence
from queue import SimpleQueue
from typing import Any

import numpy as np

from platform_ctrl.common.processes import ProcessTimeout, TaskProcess, next_result
from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.fixed_structure.run import Limits, Outcome, Problem, answered, divides, searched

# Work below this is done sooner here than processes start, s.
_WORTH_PROCESSES = 4.0
# Longest time beyond its deadline that a search gets before its process is killed, s.
_GRACE = 5.0

# Shares of the evaluations for the first descent of all starts, for all that have not ended by then, and for the best
# that have not ended then either; the rest is for the polish of the best. What a descent stands at says little about
# where it ends: on AC12 the best of twelve was last but one for half of its way.
_FIRST, _ON, _LAST = 0.4, 0.35, 0.1
# How many of the best descend once more, one of how many starts at least, and how many are polished.
_LEAST, _HALF, _POLISHED = 4, 3, 12
# Evaluations below which neither a descent goes on nor a polish begins: fewer starts do then.
_WORTH_ON, _WORTH_POLISH = 400, 1000
# Share of the evaluations where a search is not done in parts.
_WHOLE = 0.7
# Values that differ by no more are one minimum, relative, before the polish and after it.
_SAME, _AGREE = 1e-6, 1e-5
# Polished starts that have to come to the least value of all before the others are left.
_ENOUGH = 5

# Number of the start, what was found.
Report = Callable[[int, Outcome | None], None]


def best_found(  # noqa: PLR0915 - one loop over all starts
    problem: Problem,
    points: Sequence[FloatArray],
    limits: Limits,
    processes: int | None,
    report: Report,
) -> list[Outcome | None]:
    """Return what became of every start: all descend, the best of them go on, the best of these are polished.

    What is found depends on the evaluations alone: not on how many processes there are, nor on the order in which they
    end. None where the deadline was over before a start had its turn; those behind the first that came to
    `limits.least` are left out.
    """
    left = limits.evaluations
    found: list[Outcome | None] = [None] * len(points)

    def part(chosen: Sequence[int], most: int, polish: bool) -> None:
        nonlocal left
        own = dataclasses.replace(limits, evaluations=max(1, most // max(1, len(chosen))))
        before = {k: one.evaluations for k in chosen if (one := found[k]) is not None}
        begun = [found[k] or points[k] for k in chosen]
        for k, one in zip(chosen, _side_by_side(problem, begun, own, polish, processes), strict=False):
            if one is not None:
                found[k] = one
                left -= one.evaluations - before.get(k, 0)
            report(k, found[k])

    def share(until: float) -> int:
        return left - int((1.0 - until) * limits.evaluations)

    plain = divides(problem)
    part(range(len(points)), share(_FIRST if plain else _WHOLE), False)
    ended = next((k for k, one in enumerate(found) if one is not None and one.reached(limits.least)), None)
    if ended is not None:
        return found[: ended + 1]
    ranked = _ranked(found)
    if plain and not any(_of(found, k).stable for k in ranked):
        return found
    if plain:
        count = max(_LEAST, -(-len(points) // _HALF))
        going = [k for n, k in enumerate(ranked) if n < count or not _of(found, k).finished]
        part(going[: max(1, share(_FIRST + _ON) // _WORTH_ON)], share(_FIRST + _ON), False)
        going = [k for k in _ranked(found)[:_LEAST] if not _of(found, k).finished]
        part(going, share(_FIRST + _ON + _LAST), False)
        ranked = _ranked(found)
    chosen = _distinct(found, ranked, plain)[:_POLISHED]
    # Charts find ways to infinite gain that a descent has left: the best start is polished from where it began, too.
    # Whatever did better is done with the others.
    room = max(1, left // _WORTH_POLISH) if plain else len(chosen)
    twice = plain and room > _LEAST
    jobs = [*chosen[:twice], *chosen][:room]
    level: list[tuple[float, float]] = []
    for n, k in enumerate(jobs):
        if plain and _settled(found, level, limits.least):
            break
        known = found[k]
        afresh = twice and known is not None and (n == 1 or (n > 1 and level[1] < level[0]))
        if afresh:
            found[k] = None
        part([k], left // (len(jobs) - n), True)
        now = found[k]
        level.append(now.rank if now is not None else (np.inf, np.inf))
        if afresh:
            found[k] = _better(known, now)
    return found


def _settled(found: Sequence[Outcome | None], level: Sequence[tuple[float, float]], least: float) -> bool:
    """Whether more work is idle: nothing can be less, or several polished starts came to the least value of all."""
    best = _of(found, _ranked(found)[0])
    near = sum(one[0] == 0.0 and one[1] <= best.value * (1.0 + _AGREE) for one in level)
    return (best.rank[0] == 0.0 and near >= _ENOUGH) or best.reached(least, _AGREE)


def _better(one: Outcome | None, other: Outcome | None) -> Outcome | None:
    """Return the better of two searches from one start, with the evaluations of both."""
    if one is None or other is None:
        return one or other
    best, spent = min(one, other, key=lambda o: o.rank), one.evaluations + other.evaluations
    return dataclasses.replace(best, evaluations=spent, seconds=one.seconds + other.seconds)


def _of(found: Sequence[Outcome | None], k: int) -> Outcome:
    one = found[k]
    assert one is not None
    return one


def _ranked(found: Sequence[Outcome | None]) -> list[int]:
    return sorted((k for k, one in enumerate(found) if one is not None), key=lambda k: (*_of(found, k).rank, k))


def _distinct(found: Sequence[Outcome | None], ranked: Sequence[int], plain: bool) -> list[int]:
    """Return the starts worth a polish: of those that came to one value the first, and the finished ones not again."""
    out: list[int] = []
    for k in ranked:
        one = _of(found, k)
        if not plain and one.finished:
            continue
        near = any(
            one.rank[0] == _of(found, j).rank[0]
            and abs(one.rank[1] - _of(found, j).rank[1]) <= _SAME * abs(one.rank[1])
            for j in out
        )
        if not near:
            out.append(k)
    return out


def _side_by_side(
    problem: Problem, starts: Sequence[FloatArray | Outcome], limits: Limits, polish: bool, processes: int | None
) -> list[Outcome | None]:
    """Return the outcome of every start, each within `limits`; None where the deadline was over before its turn.

    Those behind the first that came to `limits.least` are left out, also where they were done by then.
    """
    count = min(processes or os.cpu_count() or 1, len(starts))
    out: list[Outcome | None] = [None] * len(starts)
    began = time.monotonic()
    k = 0
    while k < len(starts) and time.monotonic() < limits.deadline:
        out[k] = now = searched(problem, starts[k], limits, polish)
        k += 1
        if now.reached(limits.least):
            return out[:k]
        spent = time.monotonic() - began
        if count > 1 and spent / k * (len(starts) - k) > _WORTH_PROCESSES:
            break
    if k < len(starts):
        questions = [{"problem": problem, "start": start, "limits": limits, "polish": polish} for start in starts[k:]]
        out[k:] = _in_processes(questions, limits.deadline, count)
    # A process may die, as when memory is short; its start is searched from here then.
    for k, one in enumerate(out):
        if one is None and time.monotonic() < limits.deadline:
            out[k] = searched(problem, starts[k], limits, polish)
    last = next((k for k, one in enumerate(out) if one is not None and one.reached(limits.least)), len(out))
    return out[: last + 1]


def _in_processes(questions: Sequence[dict[str, Any]], deadline: float, count: int) -> list[Outcome | None]:
    """Return the outcome of every search; None where its process died or the deadline was over."""
    out: list[Outcome | None] = [None] * len(questions)
    waiting = deque(range(len(questions)))
    results: SimpleQueue[tuple[TaskProcess, Any]] = SimpleQueue()
    running: dict[TaskProcess, int | None] = {}
    try:
        with contextlib.suppress(OSError):
            for _ in range(count):
                running[TaskProcess(answered, results=results)] = None
        while running:
            process, result = next_result(results, deadline - time.monotonic() + _GRACE)
            if process not in running:
                continue
            done = running.pop(process)
            if done is not None:
                out[done] = result
            if result is None:
                process.end()
                # One that could not start is not replaced: the others do its work, or the caller.
                if done is not None and waiting:
                    with contextlib.suppress(OSError):
                        running[TaskProcess(answered, results=results)] = None
            elif waiting and time.monotonic() < deadline:
                running[process] = k = waiting.popleft()
                process.send(questions[k])
            else:
                process.end()
    except ProcessTimeout:
        pass
    finally:
        # An interrupt passes through here too.
        for process in running:
            process.end()
    return out
