"""What a campaign leaves behind once its runs are simulated: statistics in campaign.json, and the page."""

from __future__ import annotations

import shlex
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, cast

from platform_ctrl.cli.interrupts import interruptible
from platform_ctrl.cli.terminal import screen
from platform_ctrl.common.arguments import one_of
from platform_ctrl.errors import ArgumentError, InputError

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from platform_ctrl.campaign.engine import CampaignResult
    from platform_ctrl.campaign.planning import Plan
    from platform_ctrl.campaign.rare_result import RareMethod, RareResult
    from platform_ctrl.campaign.store import Record
    from platform_ctrl.campaign.summary import Summary
    from platform_ctrl.report.page.campaign_tables import ProbabilityRow

PAGE = "campaign.html"
ANY = "any"
METHODS = ("splitting", "cross-entropy")


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
    try:
        one_of("--rare-method", method, METHODS)
    except ArgumentError as error:
        raise InputError(str(error)) from None


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
) -> tuple[Summary, Record]:
    """Write campaign.json with the statistics of the table, and the page; return both.

    `again` is the command that simulates a run again, without the run's number.
    """
    from platform_ctrl.campaign.store import write_record
    from platform_ctrl.campaign.summary import summarise, summary_record
    from platform_ctrl.report.page.campaign_page import write_campaign_page

    folder: Path = result.table.parent
    summary = summarise(plan, result.table, rare=rare)
    record = result.record | summary_record(summary)
    write_record(folder, record)
    write_campaign_page(summary, folder / PAGE, command=shlex.join(command), again=shlex.join(again))
    return summary, record


Tick = Callable[[int, int], None]
Say = Callable[[str], None]

# Seconds between two lines where there is no terminal: at first, by which factor they grow, and at most.
_FIRST, _GROWTH, _LAST = 5.0, 1.5, 60.0


@contextmanager
def campaign_progress(quiet: bool, runs: int) -> Iterator[tuple[Tick, Say]]:
    """Yield a function for the numbers of stored and of failed runs, and one for lines that stay on the screen.

    A Ctrl-C that a library swallowed takes effect at the next call.
    """
    with interruptible() as check, _shown(quiet, runs) as (show, say):

        def tick(done: int, failed: int) -> None:
            check()
            show(done, failed)

        yield tick, say
        check()


class Pace:
    """How fast runs are simulated, and how long the rest will take.

    What was there at the start does not count, nor does the time to the first runs: a kernel may have been compiled.
    """

    def __init__(self, runs: int) -> None:
        self._runs = runs
        self._begun: tuple[int, float] | None = None
        self._calls = 0

    def words(self, done: int, now: float) -> str:
        """Return rate and time left as far as they are known."""
        self._calls += 1
        if self._calls <= 2:
            self._begun = (done, now)
        if self._begun is None or done <= self._begun[0] or now <= self._begun[1]:
            return ""
        rate = (done - self._begun[0]) / (now - self._begun[1])
        left = "" if done >= self._runs else f", {time_words((self._runs - done) / rate)} left"
        return f"{rate:.3g} runs/s{left}" if rate < 100.0 else f"{rate:,.0f} runs/s{left}"


def time_words(seconds: float) -> str:
    """Return a length of time in the two units that say most."""
    whole = round(seconds)
    for length, one, other in ((86400, "d", "h"), (3600, "h", "min"), (60, "min", "s")):
        if whole >= length:
            smaller = {"h": 3600, "min": 60, "s": 1}[other]
            return f"{whole // length} {one} {whole % length // smaller} {other}"
    return f"{whole} s"


@contextmanager
def _shown(quiet: bool, runs: int) -> Iterator[tuple[Tick, Say]]:
    if quiet:
        yield (lambda done, failed: None), (lambda line: None)
        return
    pace = Pace(runs)
    if sys.stderr.isatty():
        yield from _bar(pace, runs)
        return
    due, wait, before = time.monotonic() + _FIRST, _FIRST, ""

    def tick(done: int, failed: int) -> None:
        nonlocal due, wait
        now = time.monotonic()
        words = pace.words(done, now)
        if now >= due or done == runs:
            wait = min(_GROWTH * wait, _LAST)
            due = now + wait
            say(f"{done:,} of {runs:,} runs{f', {words}' if words else ''}{_failed_words(failed)}")

    def say(line: str) -> None:
        nonlocal before
        if line != before:
            print(line, file=sys.stderr, flush=True)
        before = line

    yield tick, say


def _bar(pace: Pace, runs: int) -> Iterator[tuple[Tick, Say]]:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (
        TimeElapsedColumn(),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("runs {task.fields[pace]}{task.fields[failed]}", markup=False),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as shown:
        task = shown.add_task("", total=runs, pace="", failed="")

        def tick(done: int, failed: int) -> None:
            shown.update(task, completed=done, pace=pace.words(done, time.monotonic()), failed=_failed_words(failed))

        yield tick, lambda line: shown.console.print(line, style="dim", markup=False, highlight=False)


def _failed_words(number: int) -> str:
    return f", {number:,} diverged or not simulated" if number else ""


# Narrower terminals get lines instead of a table.
_NARROW = 100
# Worst runs that are named; the page has more.
_WORST = 3


def show_campaign(summary: Summary) -> None:
    """Print every requirement with its probability and bounds, what drives them, the worst runs, and the verdict."""
    from platform_ctrl.report.page import campaign_tables as tables

    console = screen()
    rows = tables.probability_rows(summary)
    if console.width >= _NARROW:
        console.print(_table(summary, rows))
    else:
        console.print(summary.plan.job.name, style="bold", markup=False)
        for row in rows:
            console.print(_line(row), markup=False)
    _show_drivers(console, summary)
    _show_worst(console, summary)
    for rare in summary.rare:
        show_rare(summary, rare)
    first, *more = tables.verdict(summary), *tables.verdict_lines(summary)
    word, style = ("PASSED", "green") if summary.passed else ("FAILED", "bold red")
    console.print(f"{word}: {first}", style=style, markup=False)
    for line in more:
        console.print(line, markup=False)


def show_rare(summary: Summary, rare: RareResult) -> None:
    """Print a rare event: its probability with its interval, what it took, and what has to come together."""
    from rich.table import Table

    from platform_ctrl.report.page import campaign_tables as tables

    console = screen()
    console.print(f"rare event: {tables.rare_words(rare)}", style="bold", markup=False)
    grid = Table.grid(padding=(0, 2))
    for name, words in tables.rare_rows(rare):
        grid.add_row(f"  {name}", words)
    moved = tables.moved_words(summary.plan, rare)
    if moved:
        grid.add_row("  what moves together", moved)
    console.print(grid)


def _table(summary: Summary, rows: tuple[ProbabilityRow, ...]) -> Table:
    from rich.table import Table
    from rich.text import Text

    confidence = f"{100.0 * summary.statistics.confidence:g} % bounds"
    name = summary.plan.job.name
    table = Table(title=Text(name), title_justify="left", title_style="bold", header_style="bold", expand=False)
    table.add_column("manoeuvre", overflow="fold")
    table.add_column("requirement", no_wrap=True)
    for heading in ("limit", "violations", "probability", confidence, "99 %"):
        table.add_column(heading, justify="right", no_wrap=True)
    before = ""
    for row in rows:
        if row.group != before:
            table.add_section()
        style = "red" if row.numbers.events else ""
        table.add_row(
            Text("" if row.group == before else _named(row)),
            Text(row.requirement),
            Text(row.limit),
            Text(row.violations, style=style),
            Text(row.probability, style=style),
            Text(row.bounds),
            Text(row.high_quantile),
        )
        before = row.group
    return table


def _named(row: ProbabilityRow) -> str:
    from platform_ctrl.report.page.campaign_tables import ALL_MANOEUVRES

    return "all, over their limits" if row.group == ALL_MANOEUVRES else row.group


def _line(row: ProbabilityRow) -> str:
    limit = f" (at most {row.limit})" if row.limit not in ("", "–") else ""
    return f"{_named(row)}: {row.requirement}{limit}: {row.violations}, {row.probability} ({row.bounds})"


def _show_drivers(console: Console, summary: Summary) -> None:
    from platform_ctrl.report.page import campaign_tables as tables

    for one in summary.sensitivities:
        if one.manoeuvre is None:
            name = tables.requirement_name(one.requirement)
            violating = tables.violation_drivers(one)
            more = f"; its violations by {violating}" if violating else ""
            console.print(f"{name} is driven by {tables.short_drivers(one)}{more}", markup=False)
    for found in tables.causes(summary):
        console.print(tables.contrast_words(found), markup=False)


def _show_worst(console: Console, summary: Summary) -> None:
    from platform_ctrl.report.page import campaign_tables as tables

    for one, words in tables.worst_rows(summary, summary.statistics.worst[:_WORST], tables.all_drivers(summary)):
        shown = f"{words[0]} {words[1]} (at most {words[2]})"
        console.print(f"worst: run {one.run}, {one.manoeuvre}: {shown}", markup=False)
