"""``platform-ctrl budget``: what each source of a job does to the line of sight."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from platform_ctrl.cli.error_lines import noted
from platform_ctrl.cli.job_arguments import (
    Controllers,
    JobFile,
    Json,
    Quiet,
    controller_file,
    existing_controllers,
    job_of,
    option,
)
from platform_ctrl.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    import control

    from platform_ctrl.job.job import Job
    from platform_ctrl.verification.budget_result import LineOfSightBudget, SimulatedBudget

_MICRO = 1e6
# Shares of the mean square that are none.
_ROUNDING = 1e-12


SIMULATE = option(
    "--simulate",
    metavar="N",
    help="Simulate N runs of the non-linear plant beside it, friction and noise included. Default: runs of [budget].",
)
SEED = option("--seed", metavar="N", help="Random seed of these runs. Default: that of the job.")


def budget(
    job: JobFile,
    controllers: Controllers = None,
    simulate: Annotated[int | None, SIMULATE] = None,
    seed: Annotated[int | None, SEED] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> int:
    """Print how much the line of sight shakes, and from what.

    Closes existing controllers around the coupled sampled model at rest, or designs them where there are none, and
    gives the rms of the line of sight from each source of the job's [budget] and from the noise of the sensors, by
    axis; displacement, smear and jitter within the exposures; and the contrast that is left. Exit code 1 if a limit of
    the budget is not kept.

    \b
    platform-ctrl budget job.toml
        with the controllers of out/result.json
    platform-ctrl budget job.toml --controllers mine.json
        with others
    platform-ctrl budget job.toml --simulate 200
        what the non-linear plant does beside it
    platform-ctrl budget job.toml --json | jq .total
        to compute with
    """  # noqa: D301
    from platform_ctrl.cli.terminal import progress, screen, show_requirements

    with progress(quiet or as_json, f"reading {job}") as say:
        read = job_of(job)
        from platform_ctrl.common.values import replaced
        from platform_ctrl.verification.budget import expect_budget, line_of_sight_budget
        from platform_ctrl.verification.budget_result import by_simulation

        expect_budget(read)
        closed, alternatives, used = _controllers(read, job, controllers, quiet or as_json, say)
        say("budget: every source through the coupled sampled model")
        found = line_of_sight_budget(read, closed)
        others = _others(read, closed, alternatives, say)
        runs = _simulated(read, closed, simulate, seed, say)
        if runs is not None:
            found = replaced(found, {"results": by_simulation(found.results, runs)})
    noted(used)
    if as_json:
        from platform_ctrl.common.files import json_text
        from platform_ctrl.verification.result_file import budget_record

        typer.echo(json_text(budget_record(read, found, runs, others)))
    else:
        show_budget(read, found, runs, others)
        show_requirements(screen(), found.results)
    return 0 if found.passed else 1


def _simulated(
    job: Job, controllers: Sequence[control.StateSpace], runs: int | None, seed: int | None, say: Callable[[str], None]
) -> SimulatedBudget | None:
    """Return what runs show, None where none are wanted; those of the job unless others are."""
    runs = runs if runs is not None or job.budget is None else job.budget.runs
    if runs is None:
        if seed is not None:
            raise InputError("--seed: it is the seed of simulated runs; give --simulate N as well")
        return None
    if runs < 2 or (seed is not None and seed < 0):
        raise InputError("--simulate: give at least 2 runs, and a seed of 0 or more")
    import os

    from platform_ctrl.verification.simulated import simulated_budget

    say(f"budget: {runs} runs of the non-linear plant")
    return simulated_budget(
        job, controllers, runs, seed=job.seed if seed is None else seed, threads=os.cpu_count() or 1
    )


def _others(
    job: Job,
    closed: Sequence[control.StateSpace],
    alternatives: Sequence[control.StateSpace],
    say: Callable[[str], None],
) -> dict[str, LineOfSightBudget | None]:
    """Return the budget with each alternative in the place of the design that sets the same; None: not stable."""
    from platform_ctrl.errors import ArgumentError
    from platform_ctrl.verification.budget import line_of_sight_budget

    out: dict[str, LineOfSightBudget | None] = {}
    for one in alternatives:
        say(f"budget: {one.name}")
        outputs = set(one.output_labels)
        instead = [one if set(K.output_labels) == outputs else K for K in closed]
        try:
            out[str(one.name)] = line_of_sight_budget(job, instead)
        except ArgumentError:
            out[str(one.name)] = None
    return out


def _controllers(
    job: Job, path: Path, given: Path | None, quiet: bool, say: Callable[[str], None]
) -> tuple[list[control.StateSpace], list[control.StateSpace], str]:
    """Return the controllers of a file as check finds it, or new ones, their alternatives, and a line about them."""
    from platform_ctrl.verification.controllers import read_controllers

    if given is None and existing_controllers(None, path) is None:
        from platform_ctrl.design import loops

        made = loops(job, say)
        others = [design.controller for outcome in made for design in outcome.alternatives]
        words = f"controllers: designed for this budget and not kept; platform-ctrl design {path} keeps them"
        return [outcome.closed.controller for outcome in made], others, words
    file, used = controller_file(given, None, path, job, quiet)
    return read_controllers(file, job), read_controllers(file, job, "alternatives"), used


def show_budget(
    job: Job,
    found: LineOfSightBudget,
    runs: SimulatedBudget | None = None,
    others: Mapping[str, LineOfSightBudget | None] | None = None,
) -> None:
    """Print the tables; `others` are the budgets of other designs, None where they are not stable."""
    from platform_ctrl.cli.terminal import screen, show_table, show_words
    from platform_ctrl.verification.budget_result import TOGETHER

    assert job.budget is not None
    console, axes, largest = screen(), found.axes, max(found.total, default=0.0)
    show_words(
        console, f"{job.name}: line of sight, {job.budget.from_hz:g} to {job.budget.to_hz:g} Hz, µrad rms and share"
    )
    rows = []
    for name, kind, rms, shares in zip(found.names, found.kinds, found.rms, found.shares, strict=True):
        # Rounding shows in axes on which a source does not act.
        acting = [float(x) if share > _ROUNDING else 0.0 for x, share in zip(rms, shares, strict=True)]
        rows.append(
            (
                name,
                kind,
                *(x for pair in zip(_micro(acting, largest), map(_percent, shares), strict=True) for x in pair),
            )
        )
    totals = {TOGETHER: _micro(found.total, largest), "both axes across, angles zero": _micro([found.jitter], largest)}
    totals |= {
        f"with {name}": ["not stable"] if one is None else _micro(one.total, largest)
        for name, one in (others or {}).items()
    }
    rows += [(name, "", *(x for one in numbers for x in (one, ""))) for name, numbers in totals.items()]
    show_table(console, ("source", "kind", *(x for name in axes for x in (name, ""))), rows, words=2)
    for window in found.windows:
        most = max(window.displacement, default=0.0)
        named = {
            "displacement: the mean": _micro(window.displacement, most),
            "smear: the line's extent, end to end": _micro(window.smear, most),
            "jitter about the line": _micro(window.jitter, most),
            "about the mean, smear included": _micro(window.about_mean, most),
        }
        for k, nu in enumerate(job.budget.spatial_frequencies):
            named[f"contrast at {nu:g} cycles/rad"] = [f"{x:.4f}" for x in window.contrast[:, k]]
        rows = [(name, *numbers) for name, numbers in named.items()]
        console.print()
        show_table(console, (f"within {1e3 * window.exposure:g} ms, µrad rms", *axes), rows)
    for line in () if found.friction is None else found.friction.statement:
        console.print()
        show_words(console, line)
    console.print()
    if runs is None:
        return
    show_words(console, f"simulated, {runs.runs} runs of seed {runs.seed}: µrad rms about the mean of {runs.time:g} s")
    most = max(runs.linear, default=0.0)
    of_runs = {
        "non-linear plant": runs.rms,
        "its 95 % interval, from": runs.low,
        "to": runs.high,
        "linear budget of the same": runs.linear,
    }
    show_table(console, ("", *axes), [(name, *_micro(rms, most)) for name, rms in of_runs.items()])
    show_words(console, f"both axes across: simulated over linear {runs.ratio:.3f}")
    for line in runs.left_out:
        show_words(console, f"not simulated: {line}")
    console.print()


def _micro(rms: Iterable[float], largest: float) -> list[str]:
    """Return angles, rad, in µrad, all with as many decimals as show the largest to four digits."""
    decimals = max(3 - math.floor(math.log10(_MICRO * largest)), 0) if 0.0 < largest < math.inf else 0
    least = 10.0**-decimals
    return [
        f"< {least:.{decimals}f}" if 0.0 < _MICRO * x < 0.5 * least else f"{_MICRO * x:.{decimals}f}" if x else "0"
        for x in rms
    ]


def _percent(share: float) -> str:
    return f"{100.0 * share:.0f} %" if share > _ROUNDING else ""
