"""Designs of several problems, side by side in processes: one that fails, or whose process is killed, says so."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Sequence
from concurrent.futures import BrokenExecutor, as_completed

from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.common.processes import processes
from platform_ctrl.common.progress import Progress
from platform_ctrl.design.loop import Design, with_largest_rates
from platform_ctrl.design.method import LoopProblem, evaluated
from platform_ctrl.errors import DesignError, began_with_interrupt

Made = Design | Exception

# A process that is forked has all that is loaded and known here; elsewhere it would have to load it for seconds.
_FORKS = sys.platform == "linux"
_problems: Sequence[LoopProblem] = ()


def made_of(problems: Sequence[LoopProblem], workers: int, progress: Progress) -> list[Made]:
    """Return the design of each problem, or why there is none."""
    if not (_FORKS and workers > 1 and len(problems) > 1):
        return [_made(problem) for problem in problems]
    found = _in_processes(problems, workers, progress)
    for k, problem in enumerate(problems):
        # All that was under way is lost with a process: each by itself shows which one it was.
        if found[k] is None:
            found[k] = _in_processes([problem], 1, progress)[0]
    return [_killed(problem) if one is None else one for problem, one in zip(problems, found, strict=True)]


def _in_processes(problems: Sequence[LoopProblem], workers: int, progress: Progress) -> list[Made | None]:
    """Return the designs; None of those that were under way when a process was killed."""
    # What the designs need is loaded once, before the processes are forked.
    import control  # noqa: F401

    out: list[Made | None] = [None] * len(problems)
    with processes(min(workers, len(problems)), "fork", _begin, problems) as executor:
        progress(f"{len(problems)} designs side by side; {problems[0].spec.name}: {problems[0].design.name}")
        under_way = {executor.submit(_made_in_process, k): k for k in range(len(problems))}
        for count, future in enumerate(as_completed(under_way)):
            left = [problems[k] for one, k in under_way.items() if not one.done()]
            if left:
                progress(f"{count + 1} of {len(problems)} designs; {left[0].spec.name}: {left[0].design.name}")
            try:
                made = future.result()
            except BrokenExecutor:
                continue
            k = under_way[future]
            known = isinstance(made, Design) and made.plants is None
            out[k] = _with_plants(made, problems[k].plant_set) if known else made
    return out


def _begin(problems: Sequence[LoopProblem]) -> None:
    global _problems
    _problems = problems


def _made_in_process(k: int) -> Made:
    # A thread of the other process may have held what a progress display waits for when this one was forked.
    made = _made(dataclasses.replace(_problems[k], progress=lambda line: None))
    # The plants are known where it goes.
    known = isinstance(made, Design) and made.plants is _problems[k].plant_set
    return _with_plants(made, None) if known else made


def _with_plants(made: Made, plants: PlantSet | None) -> Made:
    return dataclasses.replace(made, plants=plants) if isinstance(made, Design) else made


def _made(problem: LoopProblem) -> Made:
    spec, design = problem.spec, problem.design
    problem.progress(f"{spec.name}: {design.name}")
    try:
        made = evaluated(problem)
        return with_largest_rates(made) if spec.kind == "caging" and spec.use else made
    except Exception as error:
        if began_with_interrupt(error):
            raise
        if not isinstance(error, DesignError) or problem.plant_set is None or str(error).startswith(f"{spec.name}, "):
            return error
        return type(error)(f"{spec.name}, {design.name}: {error}", error.problem)


def _killed(problem: LoopProblem) -> DesignError:
    return DesignError(
        f"{problem.spec.name}, {problem.design.name}: the process that designed it was killed, perhaps because memory "
        "ran out; try fewer plants (uncertainty, angles) or a design of lower order"
    )
