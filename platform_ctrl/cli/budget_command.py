"""``platform-ctrl budget``: what each source of a job does to the line of sight."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from platform_ctrl.analysis.system import StateSpace
from platform_ctrl.cli import job_arguments as arguments
from platform_ctrl.cli.exits import noted, print_json
from platform_ctrl.errors import ArgumentError, InputError, NotFoundError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from platform_ctrl.job.job import Job
    from platform_ctrl.verification.budget_result import LineOfSightBudget, SimulatedBudget


SIMULATE = typer.Option(
    "--simulate",
    metavar="N",
    help="Simulate N runs of the non-linear plant beside it, friction and noise included. Default: runs of [budget].",
)
SEED = typer.Option("--seed", metavar="N", help="Random seed of these runs. Default: that of the job.")


def budget(
    job: arguments.JobFile,
    controllers: arguments.Controllers = None,
    simulate: Annotated[int | None, SIMULATE] = None,
    seed: Annotated[int | None, SEED] = None,
    as_json: arguments.Json = False,
    quiet: arguments.Quiet = False,
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
        read = arguments.job_of(job)
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
        from platform_ctrl.verification.result_file import budget_record

        print_json(budget_record(read, found, runs, others))
    else:
        show_budget(read, found, runs, others)
        show_requirements(screen(), found.results)
    return 0 if found.passed else 1


def _simulated(
    job: Job, controllers: Sequence[StateSpace], runs: int | None, seed: int | None, say: Callable[[str], None]
) -> SimulatedBudget | None:
    """Return the budget from simulated runs, as many as given or as the job has; None without any."""
    runs = runs if runs is not None or job.budget is None else job.budget.runs
    if runs is None:
        if seed is not None:
            raise InputError("--seed: it is the seed of simulated runs; give --simulate N as well")
        return None
    if runs < 2 or (seed is not None and seed < 0):
        raise InputError("--simulate: give at least 2 runs, and a seed of 0 or more")
    from platform_ctrl.verification.simulated import simulated_budget

    say(f"budget: {runs} runs of the non-linear plant")
    return simulated_budget(job, controllers, runs, seed=job.seed if seed is None else seed)


def _others(
    job: Job, closed: Sequence[StateSpace], alternatives: Sequence[StateSpace], say: Callable[[str], None]
) -> dict[str, LineOfSightBudget | None]:
    """Return the budget with each alternative in the place of the design that sets the same; None: it has none.

    What is shown of them is at zero gimbal angles.
    """
    from platform_ctrl.common.values import replaced
    from platform_ctrl.verification.budget import line_of_sight_budget

    job = replaced(job, {"angles": {}})
    out: dict[str, LineOfSightBudget | None] = {}
    for one in alternatives:
        say(f"budget: {one.name}")
        outputs = set(one.output_labels)
        instead = [one if set(K.output_labels) == outputs else K for K in closed]
        try:
            out[str(one.name)] = line_of_sight_budget(job, instead)
        except (ArgumentError, NotFoundError):  # not stable, or bearings stick
            out[str(one.name)] = None
    return out


def _controllers(
    job: Job, path: Path, given: Path | None, quiet: bool, say: Callable[[str], None]
) -> tuple[list[StateSpace], list[StateSpace], str]:
    """Return the controllers of a file as check finds it, or new ones, their alternatives, and a line about them."""
    from platform_ctrl.verification.controllers import read_controllers

    if given is None and arguments.existing_controllers(None, path) is None:
        from platform_ctrl.design import loops

        made = loops(job, say)
        others = [design.controller for outcome in made for design in outcome.alternatives]
        words = f"controllers: designed for this budget and not kept; platform-ctrl design {path} keeps them"
        return [outcome.closed.controller for outcome in made], others, words
    file, used = arguments.controller_file(given, None, path, job, quiet)
    return read_controllers(file, job), read_controllers(file, job, "alternatives"), used


def show_budget(
    job: Job,
    found: LineOfSightBudget,
    runs: SimulatedBudget | None = None,
    others: Mapping[str, LineOfSightBudget | None] | None = None,
) -> None:
    """Print the tables of the report; `others` are the budgets of other designs, None where they have none."""
    from platform_ctrl.cli.terminal import screen, show_block, show_words
    from platform_ctrl.report.budget_page import runs_table, sources_table, window_table

    assert job.budget is not None
    console = screen()
    show_words(console, f"{job.name}: line of sight, {job.budget.from_hz:g} to {job.budget.to_hz:g} Hz")
    show_block(console, sources_table(found, others))
    for window in found.windows:
        console.print()
        show_block(console, window_table(window, job.budget.spatial_frequencies))
    for line in found.friction.statement:
        console.print()
        show_words(console, line)
    console.print()
    if runs is not None:
        show_words(console, f"simulated, {runs.runs} runs of seed {runs.seed}: about the mean of {runs.time:g} s")
        show_block(console, runs_table(runs))
        show_words(console, f"both axes across: simulated over linear {runs.ratio:.3f}")
        for line in runs.left_out:
            show_words(console, f"not simulated: {line}")
        console.print()
