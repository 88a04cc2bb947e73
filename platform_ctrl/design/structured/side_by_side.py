"""Searches side by side: every start in one of several processes, or one after another where that is quicker."""

from __future__ import annotations

import inspect
import os
import queue
import threading
import time
from collections.abc import Callable, Sequence

import numpy as np

from platform_ctrl.design.lmi import worker
from platform_ctrl.design.side_process import Ended, Late, SideProcess
from platform_ctrl.design.structured.run import Limits, Outcome, Problem, searched
from platform_ctrl.frozen import FloatArray

# Work below this is done sooner here than processes start, s.
_WORTH_PROCESSES = 4.0
# Longest time beyond its deadline that a search gets before its process is killed, s.
_GRACE = 5.0
_POLL = 0.1

Report = Callable[[int, Outcome | None], None]


def side_by_side(
    problem: Problem, starts: Sequence[FloatArray], limits: Limits, processes: int | None, report: Report
) -> list[Outcome | None]:
    """Return the outcome of every start, each within `limits`; None where the deadline was over before its turn.

    What a search finds does not depend on how many processes there are, nor on the order in which they end.
    """
    count = min(processes or os.cpu_count() or 1, len(starts))
    out: list[Outcome | None] = [None] * len(starts)
    began = time.monotonic()
    k = 0
    while k < len(starts) and time.monotonic() < limits.deadline:
        out[k] = searched(problem, starts[k], limits)
        report(k, out[k])
        k += 1
        spent = time.monotonic() - began
        if count > 1 and spent / k * (len(starts) - k) > _WORTH_PROCESSES:
            break
    if k < len(starts):
        _in_processes(problem, starts, out, k, limits, count, report)
    # A process may die, as when memory is short; its start is searched from here then.
    for k in range(len(starts)):
        if out[k] is None and time.monotonic() < limits.deadline:
            out[k] = searched(problem, starts[k], limits)
            report(k, out[k])
    return out


def _in_processes(
    problem: Problem,
    starts: Sequence[FloatArray],
    out: list[Outcome | None],
    first: int,
    limits: Limits,
    count: int,
    report: Report,
) -> None:
    """Fill `out` from `first` on."""
    waiting: queue.SimpleQueue[int] = queue.SimpleQueue()
    for k in range(first, len(starts)):
        waiting.put(k)
    done: queue.SimpleQueue[tuple[int, Outcome] | None] = queue.SimpleQueue()
    running: list[SideProcess] = []
    stopped = threading.Event()

    def work() -> None:
        side: SideProcess | None = None
        try:
            while not stopped.is_set() and time.monotonic() < limits.deadline:
                try:
                    k = waiting.get_nowait()
                except queue.Empty:
                    return
                try:
                    if side is None:
                        side = SideProcess(inspect.getsource(worker), f"{searched.__module__}:answered")
                        running.append(side)
                    question = {"problem": problem, "start": np.asarray(starts[k]), "limits": limits}
                    answer = side.ask(question, limits.deadline - time.monotonic() + _GRACE)
                    if "outcome" in answer:
                        done.put((k, answer["outcome"]))
                except (Ended, Late, OSError):
                    side = None
        finally:
            done.put(None)

    for _ in range(count):
        threading.Thread(target=work, daemon=True).start()
    left = count
    try:
        while left:
            try:
                found = done.get(timeout=_POLL)
            except queue.Empty:
                continue
            if found is None:
                left -= 1
            else:
                out[found[0]] = found[1]
                report(*found)
    finally:
        # An interrupt passes through here too.
        stopped.set()
        for side in running:
            side.end()
