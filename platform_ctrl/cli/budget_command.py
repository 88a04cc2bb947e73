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
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

    import control

    from platform_ctrl.job.job import Job
    from platform_ctrl.verification.budget_result import LineOfSightBudget, WindowBudget
    from platform_ctrl.verification.simulated_budget import SimulatedBudget

# Columns for the name of a source; with three axes a line has 80.
_NAME, _KIND = 24, 14
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
        from platform_ctrl.verification.budget_limits import by_simulation

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
        from platform_ctrl.common.json_text import json_text
        from platform_ctrl.verification.result_file import budget_record

        typer.echo(json_text(budget_record(read, found, runs, others)))
    else:
        for line in budget_lines(read, found, runs, others):
            typer.echo(line)
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

    from platform_ctrl.verification.simulated_budget import simulated_budget

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


def budget_lines(
    job: Job,
    found: LineOfSightBudget,
    runs: SimulatedBudget | None = None,
    others: Mapping[str, LineOfSightBudget | None] | None = None,
) -> Iterator[str]:
    """Walk the lines of the tables, 80 columns wide; `others` are the budgets of other designs."""
    from platform_ctrl.verification.budget_result import TOGETHER

    assert job.budget is not None
    yield f"{job.name}: line of sight, {job.budget.from_hz:g} to {job.budget.to_hz:g} Hz, µrad rms and share"
    yield ""
    yield f"{'source':{_NAME}}{'kind':{_KIND}}" + "".join(f"{name:>14}" for name in found.axes)
    micro = _column(max(found.total, default=0.0))
    for name, kind, rms, shares in zip(found.names, found.kinds, found.rms, found.shares, strict=True):
        # Rounding shows in axes on which a source does not act.
        pairs = [(x if s > _ROUNDING else 0.0, s) for x, s in zip(rms, shares, strict=True)]
        numbers = "".join(f"{micro(x):>8}{_percent(s):>6}" for x, s in pairs)
        # A long name that says the kind stands alone.
        alone = len(name) >= _NAME and kind in name
        label = _short(name, _NAME + _KIND - 1) if alone else f"{_short(name, _NAME - 1):{_NAME}}{kind}"
        yield f"{label:{_NAME + _KIND}}{numbers}".rstrip()
    yield _row(TOGETHER, map(micro, found.total))
    yield _row("both axes across, angles zero", [micro(found.jitter)])
    for name, other in (others or {}).items():
        yield _row(
            _short(f"with {name}", _NAME + _KIND - 1), ["not stable"] if other is None else map(micro, other.total)
        )
    for window in found.windows:
        yield ""
        yield from _window(job, window)
    for line in () if found.friction is None else found.friction.statement:
        yield ""
        yield from _wrapped(line)
    if runs is not None:
        yield ""
        yield from _runs(runs)
    yield ""


def _runs(runs: SimulatedBudget) -> Iterator[str]:
    micro = _column(max(runs.linear, default=0.0))
    yield f"simulated, {runs.runs} runs of seed {runs.seed}: µrad rms about the mean of {runs.time:g} s"
    yield _row("  non-linear plant", map(micro, runs.rms))
    yield _row("  its 95 % interval, from", map(micro, runs.low))
    yield _row("  to", map(micro, runs.high))
    yield _row("  linear budget of the same", map(micro, runs.linear))
    yield from _wrapped(f"both axes across: simulated over linear {runs.ratio:.3f}")
    for line in runs.left_out:
        yield from _wrapped(f"not simulated: {line}")


def _window(job: Job, window: WindowBudget) -> Iterator[str]:
    assert job.budget is not None
    yield f"within {1e3 * window.exposure:g} ms, µrad rms"
    micro = _column(max(window.displacement, default=0.0))
    for words, rms in (
        ("displacement: the mean", window.displacement),
        ("smear: the line's extent, end to end", window.smear),
        ("jitter about the line", window.jitter),
        ("about the mean, smear included", window.about_mean),
    ):
        yield _row(f"  {words}", map(micro, rms))
    for k, nu in enumerate(job.budget.spatial_frequencies):
        yield _row(f"  contrast at {nu:g} cycles/rad", [f"{x:.4f}" for x in window.contrast[:, k]])


def _row(words: str, numbers: Iterable[str]) -> str:
    return f"{words:{_NAME + _KIND}}{''.join(f'{number:>8}      ' for number in numbers)}".rstrip()


def _column(largest: float) -> Callable[[float], str]:
    """Return what writes angles, rad, in µrad, all with as many decimals as show the largest to four digits."""
    decimals = max(3 - math.floor(math.log10(_MICRO * largest)), 0) if 0.0 < largest < math.inf else 0
    least = 10.0**-decimals

    def micro(rad: float) -> str:
        small = 0.0 < _MICRO * rad < 0.5 * least
        return f"< {least:.{decimals}f}" if small else f"{_MICRO * rad:.{decimals}f}" if rad else "0"

    return micro


def _percent(share: float) -> str:
    return f"{100.0 * share:.0f} %" if share > _ROUNDING else ""


def _short(text: str, most: int) -> str:
    return text if len(text) <= most else text[: most - 3] + "..."


def _wrapped(text: str) -> list[str]:
    import textwrap

    return textwrap.wrap(text, 80)
