"""``platform-ctrl campaign``: many runs of a job, goes on where it was stopped."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from platform_ctrl.cli import job_arguments as arguments
from platform_ctrl.cli.exits import not_drawn, noted, print_json

if TYPE_CHECKING:
    from rich.console import Console

    from platform_ctrl.campaign.engine import CampaignResult
    from platform_ctrl.campaign.planning import Plan
    from platform_ctrl.campaign.store import Record
    from platform_ctrl.campaign.summary import Summary
    from platform_ctrl.job.variation import Points
    from platform_ctrl.report.campaign_tables import ProbabilityRow

PAGE = "campaign.html"
Runs = Annotated[int | None, typer.Option("--runs", metavar="N", help="Number of runs. Default: as in the job.")]
Out = Annotated[
    Path, arguments.folder_option("Folder for campaign.html, campaign.parquet and campaign.json; made if needed.")
]
Workers = Annotated[
    int | None,
    typer.Option(
        "--workers",
        metavar="N",
        help="Processes. Default: as many as there are processors. The results do not depend on it.",
    ),
]
Seed = Annotated[int | None, typer.Option("--seed", metavar="N", help="Random seed. Default: as in the job.")]
Sampling = Annotated[
    str | None,
    typer.Option(
        "--sampling",
        metavar="sobol|latin-hypercube|random",
        help="How the runs fill the space of what varies. Default: as in the job.",
    ),
]
Scheduler = Annotated[
    str | None,
    typer.Option(
        "--scheduler", metavar="ADDRESS", help="A Dask scheduler (tcp://host:8786), whose workers simulate the runs."
    ),
]
Restart = Annotated[bool, typer.Option("--restart", help="Discard the campaign in DIR and start again.")]


def campaign(
    job: arguments.JobFile,
    runs: Runs = None,
    out: Out = arguments.CAMPAIGN,
    controllers: arguments.Controllers = None,
    workers: Workers = None,
    seed: Seed = None,
    sampling: Sampling = None,
    scheduler: Scheduler = None,
    restart: Restart = False,
    as_json: arguments.Json = False,
    quiet: arguments.Quiet = False,
) -> int:
    """Simulate many runs of a job, with the variations in its [campaign].

    Uses existing controllers. Writes campaign.parquet, one row a run: inputs, values, verdicts, how it ended;
    campaign.json and the page campaign.html: the probability that a requirement is violated, its main causes, and the
    worst runs. After an interruption the same command continues; a larger --runs extends a completed campaign. A run
    that diverges or cannot be simulated has a row that says so.

    \b
    platform-ctrl campaign job.toml --runs 10000
        with the controllers of out/result.json
    platform-ctrl campaign job.toml -o night --controllers mine.json
        with others, into another folder
    platform-ctrl campaign job.toml --scheduler tcp://big:8786
        on other machines
    platform-ctrl simulate job.toml --run 4711
        one of its runs again, with a figure

    Exit code 1 if a run did not meet its limits, diverged or was not simulated.
    """  # noqa: D301
    from platform_ctrl.cli.terminal import campaign_progress, progress

    with progress(quiet or as_json, f"reading {job}"):
        read = arguments.job_of(job)
        file, used = arguments.controller_file(controllers, None, job, read, quiet or as_json)
        from platform_ctrl.campaign.engine import run_campaign
        from platform_ctrl.campaign.planning import plan
        from platform_ctrl.verification.controllers import read_controllers

        made = plan(read, read_controllers(file, read), runs=runs, seed=seed, sampling=cast("Points | None", sampling))
        if scheduler is not None:
            from platform_ctrl.campaign.engine import client_of

            client_of(scheduler).close()  # a wrong address leaves no folder behind
        arguments.prepare_folder(out, ("campaign.json", PAGE))
    try:
        with campaign_progress(quiet or as_json, made.runs) as tick:
            result = run_campaign(made, out, workers=workers, scheduler=scheduler, restart=restart, progress=tick)
    except KeyboardInterrupt:
        noted(f"stopped: what was simulated is kept in {out}; the same command continues")
        raise
    given = {"--controllers": controllers, "-o": None if out == arguments.CAMPAIGN else out}
    files = [str(word) for option, path in given.items() if path is not None for word in (option, path)]
    numbers = {"--runs": runs, "--seed": seed, "--sampling": sampling}
    words = [str(word) for option, one in numbers.items() if one is not None for word in (option, one)]
    with progress(quiet or as_json, f"reading {result.table}") as say:
        say(f"drawing the page: {out / PAGE}")
        summary, record, line = write_campaign(
            made,
            result,
            command=["platform-ctrl", "campaign", str(job), *words, *files],
            again=["platform-ctrl", "simulate", str(job), *files, "--run"],
        )
    noted(used)
    if as_json:
        print_json(record)
    else:
        show_campaign(summary)
        _show_files(result, None if line else out / PAGE)
    noted(line)
    return 0 if result.passed else 1


def _show_files(result: CampaignResult, page: Path | None) -> None:
    from platform_ctrl.job.quantities import count

    ended = ", ".join(f"{number:,} {name}" for name, number in result.counts.items() if number)
    typer.echo(f"{count(result.record['runs'], 'run')}: {ended}")
    for reason, number in result.reasons.items():
        typer.echo(f"  {number:,} x {reason}")
    for word, file in (("page", page), ("runs", result.table), ("values", result.table.with_suffix(".json"))):
        if file is not None:
            typer.echo(f"{word + ':':<7} {file}")


def write_campaign(
    plan: Plan, result: CampaignResult, *, command: list[str], again: list[str]
) -> tuple[Summary, Record, str]:
    """Write campaign.json with the statistics of the table, and the page; return both, and why the page is missing.

    `again` is the command that simulates a run again, without the run's number.
    """
    from platform_ctrl.campaign.store import write_campaign_record
    from platform_ctrl.campaign.summary import summarise, summary_record

    def page(path: Path) -> None:
        from platform_ctrl.report import write_page
        from platform_ctrl.report.campaign_page import campaign_document

        write_page(campaign_document(summary, command=shlex.join(command), again=shlex.join(again)), path)

    folder: Path = result.table.parent
    summary = summarise(plan, result.table)
    record = result.record | summary_record(summary)
    write_campaign_record(folder, record)
    return summary, record, not_drawn(folder / PAGE, page)


# Worst runs that are named; the page has more.
_WORST = 3


def show_campaign(summary: Summary) -> None:
    """Print every requirement with its probability and bounds, what drives them, the worst runs, and the verdict."""
    from platform_ctrl.cli.terminal import screen, show_verdict, show_words
    from platform_ctrl.report import campaign_tables as tables

    console = screen()
    console.print(summary.plan.job.name, style="bold", markup=False)
    _show_rows(console, tables.probability_rows(summary), summary.statistics.confidence)
    lines = [tables.driver_words(requirement, found) for requirement, found in tables.drivers(summary).items()]
    lines += [tables.cause_words(one) for one in tables.causes(summary)]
    for one, words in tables.worst_rows(summary, summary.statistics.worst[:_WORST], tables.all_drivers(summary)):
        lines.append(f"worst: run {one.run}, {one.manoeuvre}: {words[0]} {words[1]} ({words[2]})")
    for line in lines:
        show_words(console, line, indent="  ")
    show_verdict(console, summary.passed, ", ".join(filter(None, tables.verdict(summary))))
    for line in tables.verdict_lines(summary):
        show_words(console, line)


def _show_rows(console: Console, rows: tuple[ProbabilityRow, ...], confidence: float) -> None:
    """Print probabilities by manoeuvre, the likeliest first."""
    from platform_ctrl.cli.terminal import show_table
    from platform_ctrl.report.campaign_tables import ALL_MANOEUVRES

    heads = ("requirement", "limit", "violations", "probability", f"{100.0 * confidence:g} % bounds")
    cells: list[tuple[str, ...]] = []
    styles = []
    for group in dict.fromkeys(row.group for row in rows):
        cells.append(("all, over their limits" if group == ALL_MANOEUVRES else group, "", "", "", ""))
        styles.append("bold")
        for row in sorted((row for row in rows if row.group == group), key=lambda row: -row.numbers.estimate):
            cells.append((f"  {row.words[0]}", *row.words[1:5]))
            styles.append("red" if row.numbers.events else "")
    show_table(console, heads, cells, styles=styles)
