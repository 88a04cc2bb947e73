"""``platform-ctrl campaign``: many runs of a job, goes on where it was stopped."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from platform_ctrl.cli import completion
from platform_ctrl.cli.error_lines import not_drawn, noted
from platform_ctrl.cli.job_arguments import (
    CAMPAIGN,
    Controllers,
    JobFile,
    Json,
    Quiet,
    controller_file,
    job_of,
    one_of,
    option,
    prepare_folder,
)
from platform_ctrl.errors import InputError

if TYPE_CHECKING:
    from rich.console import Console

    from platform_ctrl.campaign.engine import CampaignResult
    from platform_ctrl.campaign.planning import Plan
    from platform_ctrl.campaign.probability import RareMethod, RareResult
    from platform_ctrl.campaign.store import Record
    from platform_ctrl.campaign.summary import Summary
    from platform_ctrl.job.variation import Points
    from platform_ctrl.report.page.campaign_tables import ProbabilityRow

PAGE = "campaign.html"
ANY = "any"
METHODS = ("splitting", "cross-entropy")
# Groups of options in the help.
WHAT, WHERE, RARE = "Runs", "Where they are simulated", "Rare events"


def campaign(
    job: JobFile,
    runs: Annotated[
        int | None, option("--runs", metavar="N", help="Number of runs. Default: as in the job.", panel=WHAT)
    ] = None,
    out: Annotated[
        Path,
        option(
            "--out",
            "-o",
            metavar="DIR",
            help="Folder for campaign.html, campaign.parquet and campaign.json; made if needed.",
            default=True,
            words=completion.campaign_folders,
        ),
    ] = CAMPAIGN,
    controllers: Controllers = None,
    workers: Annotated[
        int | None,
        option(
            "--workers",
            metavar="N",
            help="Processes. Default: as many as there are processors. The results do not depend on it.",
            panel=WHERE,
        ),
    ] = None,
    seed: Annotated[
        int | None, option("--seed", metavar="N", help="Random seed. Default: as in the job.", panel=WHAT)
    ] = None,
    sampling: Annotated[
        str | None,
        option(
            "--sampling",
            metavar="sobol|latin-hypercube|random",
            help="How the runs fill the space of what varies. Default: as in the job.",
            panel=WHAT,
        ),
    ] = None,
    device: Annotated[
        str, option("--device", metavar="cpu|cuda", help="What simulates the runs.", panel=WHERE, default=True)
    ] = "cpu",
    scheduler: Annotated[
        str | None,
        option(
            "--scheduler",
            metavar="ADDRESS",
            help="A Dask scheduler (tcp://host:8786), whose workers simulate the runs.",
            panel=WHERE,
        ),
    ] = None,
    restart: Annotated[
        bool, option("--restart", help="Discard the campaign in DIR and start again.", default=True)
    ] = False,
    rare: Annotated[
        str | None,
        option(
            "--rare",
            metavar="LIMIT",
            help="After the campaign, estimate the probability that this limit of the manoeuvres (angle, attitude, "
            "torque_share, ...; or any) is violated by importance splitting, for probabilities too small to count.",
            words=completion.words(
                "any",
                "angle",
                "attitude",
                "torque_share",
                "gimbal_rate",
                "angle_following_error",
                "rate_following_error",
                "los_angle_rms",
                "los_rate_rms",
                "attenuation_db",
            ),
            panel=RARE,
        ),
    ] = None,
    runs_per_level: Annotated[
        int,
        option(
            "--runs-per-level",
            metavar="N",
            help="Of --rare: a level takes a tenth of the probability.",
            panel=RARE,
            default=True,
        ),
    ] = 1000,
    rare_method: Annotated[
        str,
        option(
            "--rare-method",
            metavar="splitting|cross-entropy",
            help="cross-entropy: splitting, then weighted runs; surer where ten inputs or fewer vary.",
            panel=RARE,
            default=True,
        ),
    ] = "splitting",
    as_json: Json = False,
    quiet: Quiet = False,
) -> int:
    """Simulate many runs of a job, with the variations in its [campaign].

    Uses existing controllers. Writes campaign.parquet, one row a run: inputs, values, verdicts, how it ended;
    campaign.json and the page campaign.html: the probability that a requirement is violated, its main causes, and the
    worst runs. After an interruption the same command continues; a larger --runs extends a completed campaign. A run
    that diverges or cannot be simulated has a row that says so.

    \b
    platform-ctrl campaign job.toml --runs 10000                with the controllers of out/result.json
    platform-ctrl campaign job.toml -o night --controllers mine.json  with others, into another folder
    platform-ctrl campaign job.toml --rare angle                a probability too small to count
    platform-ctrl campaign job.toml --scheduler tcp://big:8786  on other machines
    platform-ctrl simulate job.toml --run 4711                  one of its runs again, with a figure

    Exit code 1 if a run did not meet its limits, diverged or was not simulated.
    """  # noqa: D301
    from platform_ctrl.cli.terminal import campaign_progress, progress

    with progress(quiet or as_json, f"reading {job}"):
        read = job_of(job)
        file, used = controller_file(controllers, None, job, read, quiet or as_json)
        from platform_ctrl.campaign.engine import run_campaign
        from platform_ctrl.campaign.planning import plan
        from platform_ctrl.verification.controllers import read_controllers

        made = plan(read, read_controllers(file, read), runs=runs, seed=seed, sampling=cast("Points | None", sampling))
        expect_rare(made, rare, runs_per_level, rare_method)
        prepare_folder(out, ("campaign.parquet", "campaign.json", PAGE))
    done: int | None = None

    def count(kept: int, failed: int) -> None:
        nonlocal done
        done = kept
        tick(kept, failed)

    try:
        with campaign_progress(quiet or as_json, made.runs) as (tick, say):
            result = run_campaign(
                made, out, workers=workers, scheduler=scheduler, device=device, restart=restart, progress=count, say=say
            )
    except KeyboardInterrupt:
        kept = "what was simulated is kept" if done is None else f"{done:,} of {made.runs:,} runs are kept"
        typer.echo(f"stopped: {kept} in {out}; the same command continues", err=True)
        raise
    given = {"--controllers": controllers, "-o": None if out == CAMPAIGN else out}
    files = [str(word) for option, path in given.items() if path is not None for word in (option, path)]
    numbers = {"--runs": runs, "--seed": seed, "--sampling": sampling, "--rare": rare}
    words = [str(word) for option, one in numbers.items() if one is not None for word in (option, one)]
    with progress(quiet or as_json, f"reading {result.table}") as say:
        found = rare_result(made, rare, runs_per_level, rare_method, workers=workers, device=device, say=say)
        say(f"drawing the page: {out / PAGE}")
        summary, record, line = write_campaign(
            made,
            result,
            found,
            command=["platform-ctrl", "campaign", str(job), *words, *files],
            again=["platform-ctrl", "simulate", str(job), *files, "--run"],
        )
    noted(used)
    if as_json:
        from platform_ctrl.common.json_text import json_text

        typer.echo(json_text(record))
    else:
        show_campaign(summary)
        _show_files(result, None if line else out / PAGE)
    if line:
        noted(line)
    return 0 if result.passed else 1


def _show_files(result: CampaignResult, page: Path | None) -> None:
    from platform_ctrl.report.page.campaign_tables import count_words

    counts: dict[str, Any] = result.counts
    typer.echo(f"{count_words(result.record['runs'])}: {', '.join(f'{n:,} {name}' for name, n in counts.items() if n)}")
    for reason, number in result.reasons.items():
        typer.echo(f"  {number:,} x {reason}")
    for word, file in (("page", page), ("runs", result.table), ("values", result.table.with_suffix(".json"))):
        if file is not None:
            typer.echo(f"{word + ':':<7} {file}")


def expect_rare(plan: Plan, requirement: str | None, runs_per_level: int, method: str) -> None:
    """Judge the options of a rare event before anything is simulated."""
    from platform_ctrl.campaign.rare_events import FEWEST_SAMPLES

    known = [ANY, *dict.fromkeys(name for one, _ in plan.job.campaign_manoeuvres for name in one.limits)]
    if requirement is not None and requirement not in known:
        raise InputError(
            f"--rare {requirement}: no manoeuvre of the campaign has this limit; choose one of {', '.join(known)}"
        )
    if runs_per_level < FEWEST_SAMPLES:
        raise InputError(f"--runs-per-level {runs_per_level}: must be at least {FEWEST_SAMPLES}")
    one_of("--rare-method", method, METHODS)


def rare_result(
    plan: Plan,
    requirement: str | None,
    runs_per_level: int,
    method: str,
    *,
    workers: int | None,
    device: str,
    say: Callable[[str], None],
) -> tuple[RareResult, ...]:
    """Simulate the rare event that was requested, if any."""
    if requirement is None:
        return ()
    from platform_ctrl.campaign.rare_runs import rare_probability
    from platform_ctrl.simulation.device import processors

    return (
        rare_probability(
            plan,
            None if requirement == ANY else requirement,
            samples=runs_per_level,
            method=cast("RareMethod", method),
            threads=workers or processors(),
            device=device,
            say=say,
        ),
    )


def write_campaign(
    plan: Plan, result: CampaignResult, rare: tuple[RareResult, ...], *, command: list[str], again: list[str]
) -> tuple[Summary, Record, str]:
    """Write campaign.json with the statistics of the table, and the page; return both, and why the page is missing.

    `again` is the command that simulates a run again, without the run's number.
    """
    from platform_ctrl.campaign.store import write_record
    from platform_ctrl.campaign.summary import summarise, summary_record

    def page(path: Path) -> None:
        from platform_ctrl.report.page.campaign_page import write_campaign_page

        write_campaign_page(summary, path, command=shlex.join(command), again=shlex.join(again))

    folder: Path = result.table.parent
    summary = summarise(plan, result.table, rare=rare)
    record = result.record | summary_record(summary)
    write_record(folder, record)
    return summary, record, not_drawn(folder / PAGE, page)


# Worst runs that are named; the page has more.
_WORST = 3


def show_campaign(summary: Summary) -> None:
    """Print every requirement with its probability and bounds, what drives them, the worst runs, and the verdict."""
    from platform_ctrl.cli.terminal import screen, show_words
    from platform_ctrl.report.page import campaign_tables as tables

    console = screen()
    console.print(summary.plan.job.name, style="bold", markup=False)
    _show_rows(console, tables.probability_rows(summary), summary.statistics.confidence)
    _show_drivers(console, summary)
    _show_worst(console, summary)
    for rare in summary.rare:
        show_rare(summary, rare)
    first, *more = tables.verdict(summary), *tables.verdict_lines(summary)
    word, style = ("PASSED", "green") if summary.passed else ("FAILED", "bold red")
    show_words(console, f"{word}: {first}", style)
    for line in more:
        show_words(console, line)


def show_rare(summary: Summary, rare: RareResult) -> None:
    """Print a rare event: its probability with its interval, what it took, and what has to come together."""
    from platform_ctrl.cli.terminal import screen, show_pairs, show_words
    from platform_ctrl.report.page import campaign_tables as tables

    console = screen()
    show_words(console, f"rare event: {tables.rare_words(rare)}", "bold")
    moved = tables.moved_words(summary.plan, rare)
    together = [("what moves together", moved)] if moved else []
    show_pairs(console, [*tables.rare_rows(rare), *together], indent="  ")


def _show_rows(console: Console, rows: tuple[ProbabilityRow, ...], confidence: float) -> None:
    """Print probabilities by manoeuvre, the likeliest first, in columns or in lines where these do not fit."""
    from rich.text import Text

    from platform_ctrl.cli.terminal import show_words

    heads = ("requirement", "limit", "violations", "probability", f"{100.0 * confidence:g} % bounds")
    cells = [(f"  {row.requirement}", row.limit, row.violations, row.probability, row.bounds) for row in rows]
    widths = [max(map(len, column)) for column in zip(heads, *cells, strict=True)]

    def aligned(line: tuple[str, ...]) -> str:
        return "  ".join([f"{line[0]:<{widths[0]}}", *map("{:>{}}".format, line[1:], widths[1:])]).rstrip()

    wide = sum(widths) + 2 * (len(widths) - 1) <= console.width
    if wide and rows:
        console.print(Text(aligned(heads), "dim"), soft_wrap=True)
    groups = list(dict.fromkeys(row.group for row in rows))
    order = sorted(range(len(rows)), key=lambda k: (groups.index(rows[k].group), -rows[k].numbers.estimate))
    before = ""
    for k in order:
        if rows[k].group != before:
            show_words(console, _named(rows[k]), "bold")
        before = rows[k].group
        style = "red" if rows[k].numbers.events else ""
        if wide:
            console.print(Text(aligned(cells[k]), style), soft_wrap=True)
        else:
            show_words(console, _line(rows[k]), style, indent="    ")


def _named(row: ProbabilityRow) -> str:
    from platform_ctrl.report.page.campaign_tables import ALL_MANOEUVRES

    return "all, over their limits" if row.group == ALL_MANOEUVRES else row.group


def _line(row: ProbabilityRow) -> str:
    limit = f" ({row.limit})" if row.limit not in ("", "–") else ""
    return f"  {row.requirement}{limit}: {row.violations}, {row.probability} ({row.bounds})"


def _show_drivers(console: Console, summary: Summary) -> None:
    from platform_ctrl.cli.terminal import show_words
    from platform_ctrl.report.page import campaign_tables as tables

    for one in summary.sensitivities:
        if one.manoeuvre is None:
            name = tables.requirement_name(one.requirement)
            violating = tables.violation_drivers(one)
            more = f"; its violations by {violating}" if violating else ""
            show_words(console, f"{name} is driven by {tables.short_drivers(one)}{more}", indent="  ")
    for found in tables.causes(summary):
        show_words(console, tables.contrast_words(found), indent="  ")


def _show_worst(console: Console, summary: Summary) -> None:
    from platform_ctrl.cli.terminal import show_words
    from platform_ctrl.report.page import campaign_tables as tables

    for one, words in tables.worst_rows(summary, summary.statistics.worst[:_WORST], tables.all_drivers(summary)):
        shown = f"{words[0]} {words[1]} ({words[2]})"
        show_words(console, f"worst: run {one.run}, {one.manoeuvre}: {shown}", indent="  ")
