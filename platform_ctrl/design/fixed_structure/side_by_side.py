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
# that have not ended then either; the rest is for the polish of the best. The value of a descent on its way says little
# about where it ends: on AC12 the best of twelve was last but one for half of its way.
_FIRST, _SECOND, _THIRD = 0.4, 0.35, 0.1
# How many of the best go on, one of how many starts at least, and how many are polished.
_LEAST, _ONE_OF, _POLISHED = 4, 3, 12
# Starts that go on both ways, by a descent and by a polish: the others go on by the way that led lower.
_TRIED = 2
# Evaluations for which a start goes on, at least, those of a polish, and those left with which no further one begins.
_WORTH_ON, _WORTH_POLISH, _NO_POLISH = 200, 1000, 200
# Share of the evaluations where a search is not done in parts.
_WHOLE = 0.7
# Values that differ by no more are one minimum, relative, before the polish and after it.
_SAME, _AGREE = 1e-6, 1e-5
# Polished starts that have to come to the least value of all before the others are left.
_ENOUGH = 5

# Number of the start, what was found.
Report = Callable[[int, Outcome | None], None]


def best_found(
    problem: Problem,
    points: Sequence[FloatArray],
    limits: Limits,
    processes: int | None,
    report: Report,
) -> list[Outcome | None]:
    """Return what became of every start: all descend, the best of them go on, the best of these are polished.

    What is found depends on the evaluations alone: not on how many processes there are, nor on the order in which they
    end. None where the deadline was over before a start had its turn.
    """
    starts = _Starts(problem, points, limits, processes, report)
    parted = divides(problem)
    starts.search(range(len(points)), starts.until(_FIRST if parted else _WHOLE), False)
    if not parted:
        chosen = [k for k in starts.distinct() if not starts[k].finished][:_POLISHED]
        for n, k in enumerate(chosen):
            starts.search([k], starts.left // (len(chosen) - n), True)
    elif any(starts[k].stable for k in starts.ranked()):
        starts.go_on()
        starts.polish()
    return starts.found


class _Starts:
    """The starts of one problem: what has become of each, and the evaluations left."""

    def __init__(
        self,
        problem: Problem,
        points: Sequence[FloatArray],
        limits: Limits,
        processes: int | None,
        report: Report,
    ) -> None:
        self.problem, self.points, self.limits = problem, points, limits
        self.processes, self.report = processes, report
        self.left = limits.evaluations
        self.found: list[Outcome | None] = [None] * len(points)
        self.at_minimum: set[int] = set()

    def __getitem__(self, k: int) -> Outcome:
        one = self.found[k]
        assert one is not None
        return one

    def until(self, share: float) -> int:
        """Return the evaluations until a share of all is spent."""
        return self.left - int((1.0 - share) * self.limits.evaluations)

    def ranked(self) -> list[int]:
        """Return the starts, the best first, without those that had no turn."""
        return sorted((k for k, one in enumerate(self.found) if one is not None), key=lambda k: (*self[k].rank, k))

    def search(self, chosen: Sequence[int], most: int, polish: bool) -> None:
        """Search from some starts, or go on from where they are, with so many evaluations together."""
        limits = dataclasses.replace(self.limits, evaluations=max(1, most // max(1, len(chosen))))
        before = {k: one.evaluations for k in chosen if (one := self.found[k]) is not None}
        begun = [self.found[k] or self.points[k] for k in chosen]
        for k, one in zip(chosen, _side_by_side(self.problem, begun, limits, polish, self.processes), strict=False):
            if one is not None:
                self.found[k] = one
                self.left -= one.evaluations - before.get(k, 0)
                if polish and one.finished:
                    self.at_minimum.add(k)
            self.report(k, self.found[k])

    def go_on(self) -> None:
        """Go on from the best and from all that have not ended, by descents or by polishes."""
        ranked = self.ranked()
        least = max(_LEAST, -(-len(ranked) // _ONE_OF))
        going = [k for n, k in enumerate(ranked) if n < least or not self[k].finished]
        most = self.until(_FIRST + _SECOND)
        going = going[: max(1, most // _WORTH_ON - _TRIED)]
        worth = most >= _WORTH_ON * (len(going) + _TRIED)
        tried = [k for k in going if not self[k].finished][: _TRIED * worth]
        own = most // (len(going) + len(tried))
        polish = self._lower_by_polish(tried, own)
        rest = [k for k in going if k not in tried]
        self.search(rest, own * len(rest), polish)
        going = [k for k in self.ranked()[:_LEAST] if not self[k].finished]
        self.search(going, self.until(_FIRST + _SECOND + _THIRD), polish)

    def _lower_by_polish(self, tried: Sequence[int], own: int) -> bool:
        """Go on from some starts both ways, keep the better of each; return whether the polish led lower.

        At kinks and towards infinite gain a polish goes further, along curved valleys a descent.
        """
        before = list(self.found)
        self.search(tried, own * len(tried), False)
        descended = list(self.found)
        self.found = list(before)
        self.search(tried, own * len(tried), True)
        polished = list(self.found)
        lowest = [
            min((one.rank for k in tried if (one := way[k])), default=(np.inf, 0.0)) for way in (descended, polished)
        ]
        for k in tried:
            self.found[k] = _better(descended[k], polished[k], before[k])
        return lowest[1] < lowest[0]

    def distinct(self) -> list[int]:
        """Return the starts, the best first; of those that came to one value the first."""
        out: list[int] = []
        for k in self.ranked():
            rank = self[k].rank
            others = [self[j].rank for j in out]
            if not any(rank[0] == one[0] and abs(rank[1] - one[1]) <= _SAME * abs(rank[1]) for one in others):
                out.append(k)
        return out

    def polish(self) -> None:
        """Polish the best.

        Charts find ways to infinite gain that a descent has left: the best start is polished from where it began, too.
        If that did better, the others are as well.
        """
        chosen = [k for k in self.distinct() if k not in self.at_minimum][:_POLISHED]
        room = max(1, self.left // _WORTH_POLISH)
        twice = room > _LEAST
        jobs = [*chosen[:twice], *chosen]
        ranks: list[tuple[float, float]] = []
        for n, k in enumerate(jobs):
            if self._settled(ranks) or (n >= room and self.left < _NO_POLISH):
                break
            known = self.found[k]
            afresh = twice and (n == 1 or (n > 1 and ranks[1] < ranks[0]))
            if afresh:
                self.found[k] = None
            self.search([k], self.left // max(1, min(room, len(jobs)) - n), True)
            now = self.found[k]
            ranks.append(now.rank if now is not None else (np.inf, np.inf))
            if afresh:
                self.found[k] = _better(known, now)

    def _settled(self, ranks: Sequence[tuple[float, float]]) -> bool:
        """Whether several polished starts came to the least value of all."""
        best = self[self.ranked()[0]]
        near = sum(one[0] == 0.0 and one[1] <= best.value * (1.0 + _AGREE) for one in ranks)
        return best.rank[0] == 0.0 and near >= _ENOUGH


def _better(one: Outcome | None, other: Outcome | None, before: Outcome | None = None) -> Outcome | None:
    """Return the better of two searches from one start, with the work of both; `before` is what they have in common."""
    if one is None or other is None:
        return one or other
    both = [before] if before is not None else []
    return dataclasses.replace(
        min(one, other, key=lambda o: o.rank),
        evaluations=one.evaluations + other.evaluations - sum(o.evaluations for o in both),
        seconds=one.seconds + other.seconds - sum(o.seconds for o in both),
    )


def _side_by_side(
    problem: Problem, starts: Sequence[FloatArray | Outcome], limits: Limits, polish: bool, processes: int | None
) -> list[Outcome | None]:
    """Return the outcome of every start, each within `limits`; None where the deadline was over before its turn."""
    count = min(processes or os.cpu_count() or 1, len(starts))
    out: list[Outcome | None] = [None] * len(starts)
    began = time.monotonic()
    k = 0
    while k < len(starts) and time.monotonic() < limits.deadline:
        out[k] = searched(problem, starts[k], limits, polish)
        k += 1
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
    return out


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
