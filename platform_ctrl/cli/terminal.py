"""Output of commands: progress while they work, and results. Colours and a spinner on a terminal alone.

Tables of what is missed, and of what has become worse than in an accepted result, are plain text for tests too.
"""

from __future__ import annotations

import math
import os
import sys
import textwrap
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from typing import TYPE_CHECKING

from platform_ctrl.analysis.metrics import RUN_METRICS
from platform_ctrl.cli.exits import interruptible, noted
from platform_ctrl.common.progress import run_words, shown_runs, spinner
from platform_ctrl.job import quantities
from platform_ctrl.job.judging import CheckResult, severity, tells_nothing, tightest

if TYPE_CHECKING:
    from rich.console import Console
    from rich.text import Text

    from platform_ctrl.campaign.summary import Summary
    from platform_ctrl.report.blocks import Table
    from platform_ctrl.verification.comparison import Compared, Comparison
    from platform_ctrl.verification.simulated import Run
    from platform_ctrl.verification.verdict import JobResult

# Columns of a pipe, which has no width: a statement is one line there.
_PIPE_WIDTH = 10_000
# From this relative distance on a value that must be small counts as zero: +100 %.
_NOTHING = 0.995


@contextmanager
def progress(quiet: bool, first: str) -> Iterator[Callable[[str], None]]:
    """Yield a function that long work calls with a line before each step.

    On a terminal the line, at the start `first`, is shown with a spinner and the time since the start, and vanishes at
    the end; elsewhere every line but `first` is printed on standard error. `quiet` shows none. A Ctrl-C that a library
    swallowed takes effect at the next step.
    """
    shown = nullcontext(lambda line: None if quiet else noted(line))
    with interruptible() as check, spinner(first) if sys.stderr.isatty() and not quiet else shown as show:

        def say(line: str) -> None:
            check()
            show(f"{line}{_compiling(line)}")

        yield say
        check()


def _compiling(line: str) -> str:
    """Print why the first run after an installation takes so long."""
    if not line.startswith(("simulated run", "run ")):
        return ""
    from platform_ctrl.simulation.batch import is_compiled

    return "" if is_compiled() else " (its kernel is compiled first, once: half a minute)"


def screen() -> Console:
    """Return the console on standard output: colours on a terminal alone and without NO_COLOR; names as they are."""
    from rich.console import Console

    fitting = sys.stdout.isatty() or "COLUMNS" in os.environ
    return Console(highlight=False, markup=False, emoji=False, width=None if fitting else _PIPE_WIDTH)


def show_result(result: JobResult, campaign: Summary | None = None) -> None:
    """Print all requirements, the worst first, and the verdict, with that on a campaign."""
    console = screen()
    console.print(result.job.name, style="bold", markup=False)
    goals = [goal for outcome in result.loops for goal in outcome.closed.goals]
    show_requirements(console, [*result.requirements, *goals], result)
    _show_alternatives(console, result)
    assumed = f", {result.assumptions}" if result.assumptions else ""
    words = summary_words(result.requirements, quantities.added_words(result.job.platform) + assumed)
    passed = result.passed
    if campaign is not None:
        from platform_ctrl.report.campaign_tables import campaign_words

        words, passed = f"{words}; {campaign_words(campaign)}", passed and campaign.passed
    show_verdict(console, passed, words)


def show_run(run: Run) -> None:
    """Print the largest angles and torque of a run, saturated torquers, stops that were touched, and its limits."""
    trajectory, console = run.trajectory, screen()
    saturated = {name: int(n) for name, n in zip(trajectory.torquer_names, trajectory.saturated, strict=True) if n}
    touched = {name: int(n) for name, n in zip(trajectory.angle_names, trajectory.stop_contacts, strict=True) if n}
    rows = {
        "ended": f"completed, {run.lost}" if trajectory.completed and run.lost else trajectory.ended,
        **{RUN_METRICS[key].name: _measured(key, *found) for key, found in run.largest.items()},
        "saturated samples": ", ".join(f"{name} {n}" for name, n in saturated.items()) or "none",
        "stops touched": ", ".join(f"{name} {n}" for name, n in touched.items()) or "none",
    }
    console.print(run.manoeuvre.name, style="bold", markup=False)
    show_pairs(console, list(rows.items()))
    show_requirements(console, run.results, titles=False)


def _measured(key: str, number: float, signal: str) -> str:
    return f"{quantities.quantity(number, RUN_METRICS[key].unit)} ({signal})"


def show_inputs(title: str, inputs: Mapping[str, object]) -> None:
    """Print what was drawn for a run."""
    console = screen()
    console.print(title, style="bold", markup=False)
    words: dict[object, object] = {True: "yes", False: "no"}
    pairs = [(k, f"{x:.6g}" if isinstance(x, float) else str(words.get(x, x))) for k, x in inputs.items()]
    show_pairs(console, pairs)


def show_pairs(console: Console, pairs: Sequence[tuple[str, str]], indent: str = "") -> None:
    """Print names and what they are, aligned; what does not fit goes on below itself, or below its name."""
    widest = len(indent) + max((len(name) for name, _ in pairs), default=0) + 2
    if widest > console.width // 2:
        for name, words in pairs:
            show_words(console, f"{indent}{name}: {words}", indent=f"{indent}  ")
        return
    for name, words in pairs:
        show_words(console, f"{indent}{name}".ljust(widest) + words, indent=" " * widest)


def show_table(
    console: Console,
    heads: Sequence[str],
    rows: Sequence[Sequence[str | Text]],
    words: int = 1,
    styles: Sequence[str] | None = None,
) -> None:
    """Print a table whose first `words` columns hold words, the others numbers; `styles` are of its rows."""
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="dim")
    for k, head in enumerate(heads):
        table.add_column(head, justify="left" if k < words else "right", no_wrap=k >= words)
    for row, style in zip(rows, styles or [""] * len(rows), strict=True):
        table.add_row(*row, style=style)
    console.print(table)


def show_block(console: Console, block: Table) -> None:
    """Print a table of a report."""
    rows = [[cell.text for cell in row.cells] for group in block.groups for row in group.rows]
    show_table(console, [one.title for one in block.columns], rows, sum(not one.number for one in block.columns))


def show_words(console: Console, words: str, style: str = "", indent: str = "") -> None:
    """Print a statement, wrapped between words; a number keeps its unit."""
    wrapper = textwrap.TextWrapper(
        console.width, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )
    for line in wrapper.wrap(quantities.tied(words)):
        shown = line.replace("\N{NO-BREAK SPACE}", " ")
        console.print(shown, style=style, markup=False, highlight=False, soft_wrap=True)


def show_requirements(
    console: Console, results: Sequence[CheckResult], of: JobResult | None = None, titles: bool = True
) -> None:
    """Print requirements and goals in a table by subject, the worst first; `of` has the proofs.

    Of what is met by as much as it can be the names alone are printed, below the table. Without `titles` the subjects
    are not named.
    """
    from rich.text import Text

    from platform_ctrl.report.tables import requirement_row

    order = sorted((one for one in results if not _as_good_as_can_be(one)), key=severity)
    subjects = sorted({one.title: severity(one) for one in reversed(order)}.items(), key=lambda item: item[::-1])
    cells: list[tuple[str | Text, ...]] = []
    styles = []
    for subject, _ in subjects:
        if titles:
            cells.append(("", subject, "", "", ""))
            styles.append("bold")
        for one in (one for one in order if one.title == subject):
            row = requirement_row(one, of)
            mark = "met" if one.passed else "NOT MET" if one.hard else "not met"
            colour = "green" if one.hard and one.passed else ""
            cells.append((Text(mark, colour), one.name, row.value, row.limit, row.margin))
            styles.append("dim" if not one.hard else "" if one.passed else "bold red")
    if cells:
        show_table(console, ("", "", "value", "limit", "margin"), cells, words=2, styles=styles)
    for one in order:
        if one.reason and not one.passed:
            show_words(console, f"  {one.name}: {one.reason}", "bold red" if one.hard else "dim", indent="    ")
    quiet = Counter(one.name for one in results if _as_good_as_can_be(one))
    if quiet:
        names = [name if number == 1 else f"{name} ({number} times)" for name, number in quiet.items()]
        show_words(console, f"also met, by 100 % or more: {'; '.join(names)}", "dim", indent="  ")


def show_verdict(console: Console, passed: bool, words: str) -> None:
    """Print whether all is met, and what says so."""
    show_words(console, f"{'PASSED' if passed else 'FAILED'}: {words}", "green" if passed else "bold red")


def _show_alternatives(console: Console, result: JobResult) -> None:
    """Print a line for every design that is compared with the one that is closed, and for those that failed."""
    for outcome in result.loops:
        for design in outcome.alternatives:
            words = f"not closed: {outcome.spec.name}, {design.name}: {summary_words(design.results)}"
            show_words(console, words, "dim", indent="  ")
    for one in result.failed:
        show_words(console, f"failed: {one.loop}, {one.name}: {one.sentence}", "red", indent="  ")


@contextmanager
def campaign_progress(quiet: bool, runs: int) -> Iterator[Callable[[int, int], None]]:
    """Yield a function for the numbers of stored and of failed runs: a bar on a terminal, elsewhere a line each tenth.

    A Ctrl-C that a library swallowed takes effect at the next call.
    """
    bar, tenth = sys.stderr.isatty() and not quiet, 0
    with interruptible() as check, shown_runs(bar, runs) as show:

        def tick(done: int, failed: int) -> None:
            nonlocal tenth
            check()
            show(done, failed)
            if not (quiet or bar) and 10 * done // runs > tenth:
                tenth = 10 * done // runs
                noted(run_words(done, failed, runs))

        yield tick
        check()


def summary_words(results: Sequence[CheckResult], more: str = "") -> str:
    """Return how many requirements are met, `more`, and which one is the worst or the tightest."""
    words = quantities.met_words(results) + more
    if (worst := tightest(results)) is not None:
        words += f"; {'tightest' if worst.passed else 'worst'}: {worst.title}, {worst.name}"
        words += f" ({quantities.percent(worst.margin)})" if abs(worst.margin) < 10.0 else ""
    return words


def _as_good_as_can_be(one: CheckResult) -> bool:
    return one.hard and (tells_nothing(one) or (one.passed and one.sense == "at most" and one.margin >= _NOTHING))


# Most lines for better, new or missing values: a result of another job has nothing else.
_LINES = 8


def missed_text(requirements: Sequence[CheckResult], title: str) -> str:
    """Return a table of those `requirements` that are not met, the worst first; empty where all are."""
    missed = sorted((one for one in requirements if not one.passed), key=lambda one: one.margin)
    if not missed:
        return ""
    rows = [("", "value", "limit", "margin", "")]
    for one in missed:
        shown = quantities.compared(one)
        name, limit = f"{one.title}: {one.name}", f"{one.sense} {shown[1]}"
        rows.append((name, shown[0], limit, quantities.percent(one.margin), one.evidence))
    head = f"{title}: {len(missed)} of {quantities.count(len(requirements), 'requirement')} not met"
    return "\n".join([head, *_table(rows)])


def changes_text(comparison: Comparison, name: str) -> str:
    """Return the values that are worse than in the accepted result `name` as text: `changed` with a table."""
    head, rows, notes = changed(comparison, name)
    return "\n".join([head, *(_table(rows) if len(rows) > 1 else ()), *notes])


def changed(comparison: Comparison, name: str) -> tuple[str, list[tuple[str, ...]], list[str]]:
    """Return a line, the rows of a table of the values that are worse than in the accepted result `name`, and notes.

    The first row has the heads; then the worst first. The notes are causes, and what is better or new, in a few lines.
    """
    worse = sorted(comparison.of("worse"), key=lambda change: -abs(change.share))
    notes = _others("not measured any more", comparison.of("missing"))
    notes += [f"  made with {quantities.listed(comparison.differing)}"] if comparison.differing else []
    notes += _others("better by more than its tolerance", comparison.of("better"))
    notes += _others("not in the accepted result", comparison.of("new"))
    heads = ("", "before", "now", "change", "tolerance", "limit")
    return _head(comparison, name), [heads, *map(_row, worse)], notes


def _head(comparison: Comparison, name: str) -> str:
    worse, missing = len(comparison.of("worse")), len(comparison.of("missing"))
    compared = len(comparison.changes) - len(comparison.of("new"))
    if not worse and not missing:
        return f"{name}: none of {quantities.count(compared, 'value')} is worse by more than its tolerance"
    parts = [f"{worse} worse by more than {'its' if worse == 1 else 'their'} tolerance"] if worse else []
    parts += [f"{missing} not measured any more"] if missing else []
    return f"{name}: of {quantities.count(compared, 'value')} {quantities.listed(parts)}"


def _row(change: Compared) -> tuple[str, ...]:
    before, now, allowed, limit = _numbers(change, change.before, change.now, change.allowed, change.limit)
    limit = f"{change.sense} {limit}" if change.limit is not None else ""
    return _named(change), before, now, quantities.percent(change.share), allowed, limit


def _numbers(change: Compared, *numbers: float | None) -> list[str]:
    """Return numbers in one unit, rounded to the worse side, with digits enough to tell the first two apart."""
    size = max((abs(x) for x in numbers if x is not None and math.isfinite(x)), default=1.0)
    rounding, texts = quantities.pessimistic_rounding(change.sense), [""]
    for digits in (4, 6, 9):
        texts = ["" if x is None else quantities.quantity(x, change.unit, digits, size, rounding) for x in numbers]
        if numbers[0] == numbers[1] or texts[0] != texts[1]:
            break
    return texts


def _named(change: Compared) -> str:
    return f"{change.subject}: {change.name}"


def _others(words: str, changes: Sequence[Compared]) -> list[str]:
    """Return a few lines for changes that are no failures."""
    shown = []
    for change in changes[:_LINES]:
        numbers = " -> ".join(filter(None, _numbers(change, change.before, change.now)))
        shown.append(f"{_named(change)}, {numbers}")
    more = len(changes) - len(shown)
    return [f"  {words}: {line}" for line in shown] + ([f"  {words}: and {more} more"] if more > 0 else [])


def _table(rows: Sequence[tuple[str, ...]]) -> list[str]:
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return [
        "  " + "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
    ]
