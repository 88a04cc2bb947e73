"""What people see while a command works, and when it is done. Colours and a spinner on a terminal alone.

Requirements stand in aligned columns, the worst first, within the width.
"""

from __future__ import annotations

import os
import re
import sys
import textwrap
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from itertools import groupby
from typing import TYPE_CHECKING

from platform_ctrl.analysis.metrics import METRICS
from platform_ctrl.analysis.run_metrics import RUN_METRICS
from platform_ctrl.cli.interrupts import interruptible
from platform_ctrl.common.progress import spinner
from platform_ctrl.common.values import value
from platform_ctrl.job.judging import CheckResult

if TYPE_CHECKING:
    from rich.console import Console

    from platform_ctrl.campaign.summary import Summary
    from platform_ctrl.verification import JobResult
    from platform_ctrl.verification.simulated import Run

# Columns of a pipe, which has no width: a statement is one line there.
_PIPE_WIDTH = 10_000
# Seconds after which a first line is printed where there is no terminal, and the last line is printed again.
_LATE = 2.0
_AGAIN = (10.0, 30.0, 60.0)
# Of requirements: columns between columns, fewest for the name of a requirement, and by which what follows is indented.
_GAP, _NAME, _INDENT = 2, 16, 2
# From this relative distance on a value that must be small is none: +100 %.
_NOTHING = 0.995


@contextmanager
def progress(quiet: bool, first: str) -> Iterator[Callable[[str], None]]:
    """Yield what a long piece of work calls with a line before each step.

    On a terminal the line, at the start `first`, is shown with a spinner and the time since the start, and vanishes at
    the end. Elsewhere every line is printed on standard error, `first` only if it lasts: where the input turns out to
    be wrong, only the error is shown. The last line is printed again from time to time, with its time. `quiet` shows
    none. A Ctrl-C that a library swallowed takes effect at the next step.
    """
    with interruptible() as check, _shown(quiet, first) as show:

        def say(line: str) -> None:
            check()
            show(f"{line}{_compiling(line)}")

        yield say
        check()


def _compiling(line: str) -> str:
    """Say of the first run after an installation why it takes so long."""
    if not line.startswith(("simulated run", "run ")):
        return ""
    from platform_ctrl.simulation.compilation import is_compiled

    return "" if is_compiled() else " (its kernel is compiled first, once: half a minute)"


@contextmanager
def _shown(quiet: bool, first: str) -> Iterator[Callable[[str], None]]:
    if quiet:
        yield lambda line: None
        return
    if not sys.stderr.isatty():
        with _lines(first) as show:
            yield show
        return
    with spinner(first) as show:
        yield show


@contextmanager
def _lines(first: str) -> Iterator[Callable[[str], None]]:
    """Yield a function that prints a line; a thread prints the first one after a while and the last one repeatedly."""
    current, over = first, threading.Event()
    start = time.monotonic()
    due = [_LATE, *_AGAIN]
    lock = threading.Lock()

    def show(line: str) -> None:
        nonlocal current, start, due
        with lock:
            current, start, due = line, time.monotonic(), list(_AGAIN)
            print(line, file=sys.stderr, flush=True)

    def watch() -> None:
        while not over.wait(0.1):
            with lock:
                lasted = time.monotonic() - start
                if lasted >= due[0]:
                    words = current if due[0] == _LATE else f"{current} ({due[0]:g} s)"
                    due[:] = due[1:] or [due[0] + _AGAIN[-1]]
                    with suppress(OSError, ValueError):  # the reader has ended: the next print raises
                        print(words, file=sys.stderr, flush=True)

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    try:
        yield show
    finally:
        over.set()
        watcher.join()


def screen() -> Console:
    """Return the console on standard output: colours on a terminal alone and without NO_COLOR; names as they are."""
    from rich.console import Console

    fitting = sys.stdout.isatty() or "COLUMNS" in os.environ
    return Console(highlight=False, markup=False, emoji=False, width=None if fitting else _PIPE_WIDTH)


def show_result(result: JobResult, campaign: Summary | None = None) -> None:
    """Print all requirements, the worst first, and the verdict, with that on a campaign."""
    from platform_ctrl.job.quantities import added_words

    console = screen()
    console.print(result.job.name, style="bold", markup=False)
    goals = [goal for outcome in result.loops for goal in outcome.closed.goals]
    show_requirements(console, [*result.requirements, *goals], result)
    _show_alternatives(console, result)
    _show_verdict(console, result.requirements, added_words(result.job.platform) + result.assumptions, campaign)


def show_run(run: Run, largest: dict[str, tuple[float, str]]) -> None:
    """Print the largest angles and torque of a run, saturated torquers, stops that were touched, and its limits."""
    trajectory, console = run.trajectory, screen()
    saturated = {name: int(n) for name, n in zip(trajectory.torquer_names, trajectory.saturated, strict=True) if n}
    touched = {name: int(n) for name, n in zip(trajectory.angle_names, trajectory.stop_contacts, strict=True) if n}
    rows = {
        "ended": f"completed, {run.lost}" if trajectory.completed and run.lost else trajectory.ended,
        **{RUN_METRICS[key].name: _measured(key, *found) for key, found in largest.items()},
        "saturated samples": ", ".join(f"{name} {n}" for name, n in saturated.items()) or "none",
        "stops touched": ", ".join(f"{name} {n}" for name, n in touched.items()) or "none",
    }
    console.print(run.manoeuvre.name, style="bold", markup=False)
    show_pairs(console, list(rows.items()))
    show_requirements(console, run.results, titles=False)


def _measured(key: str, number: float, signal: str) -> str:
    return " ".join(filter(None, (f"{number:.4g}", RUN_METRICS[key].unit, f"({signal})")))


def show_inputs(title: str, inputs: Mapping[str, object], unusual: Mapping[str, str]) -> None:
    """Print what was drawn for a run, first what is `unusual` with why."""
    console = screen()
    console.print(title, style="bold", markup=False)
    shown = {
        name: f"{item:.6g}" if isinstance(item, float) else {True: "yes", False: "no"}.get(item, item)  # type: ignore[call-overload]
        for name, item in inputs.items()
    }
    order = [*unusual, *(name for name in shown if name not in unusual)]
    noted = {name: f" ({words})" for name, words in unusual.items()}
    show_pairs(console, [(name, f"{shown[name]}{noted.get(name, '')}") for name in order])


def show_pairs(console: Console, pairs: Sequence[tuple[str, str]], indent: str = "") -> None:
    """Print names and what they are, aligned; what does not fit goes on below itself, or below its name."""
    widest = len(indent) + max((len(name) for name, _ in pairs), default=0) + 2
    if widest > console.width // 2:
        for name, words in pairs:
            show_words(console, f"{indent}{name}: {words}", indent=f"{indent}  ")
        return
    for name, words in pairs:
        show_words(console, f"{indent}{name}".ljust(widest) + words, indent=" " * widest)


def show_words(console: Console, words: str, style: str = "", indent: str = "") -> None:
    """Print a statement, wrapped between words; a number keeps its unit."""
    together = re.sub(r"(?<=\d) (?=[^\W\d]|[%°/])", "\N{NO-BREAK SPACE}", words)
    wrapper = textwrap.TextWrapper(
        console.width, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )
    for line in wrapper.wrap(together):
        shown = line.replace("\N{NO-BREAK SPACE}", " ")
        console.print(shown, style=style, markup=False, highlight=False, soft_wrap=True)


_STYLES = {"title": "bold", "missed": "bold red", "met": "", "goal": "dim", "plain": ""}


def show_requirements(
    console: Console, results: Sequence[CheckResult], of: JobResult | None = None, titles: bool = True
) -> None:
    """Print requirements and goals in aligned columns, the worst first; `of` has the proofs."""
    from rich.text import Text

    for line in requirement_lines(results, console.width, of, titles):
        text = Text(line.text, _STYLES[line.kind])
        if line.kind == "met":
            text.stylize("green", 0, len("met"))
        console.print(text, soft_wrap=True)


def _show_verdict(
    console: Console, results: Sequence[CheckResult], added: str, campaign: Summary | None = None
) -> None:
    passed, words = all(one.passed for one in results), summary_words(results, added)
    if campaign is not None:
        from platform_ctrl.report.page.campaign_tables import campaign_words

        passed, words = passed and campaign.passed, f"{words}; {campaign_words(campaign)}"
    verdict, style = ("PASSED", "green") if passed else ("FAILED", "bold red")
    show_words(console, f"{verdict}: {words}", style)


def _show_alternatives(console: Console, result: JobResult) -> None:
    """Print a line for every design that is compared with the one that is closed, and for those that failed."""
    for outcome in result.loops:
        for design in outcome.alternatives:
            words = f"not closed: {outcome.spec.name}, {design.name}: {summary_words(design.results)}"
            show_words(console, words, "dim", indent="  ")
    for one in result.failed:
        show_words(console, f"failed: {one.loop}, {one.name}: {one.sentence}", "red", indent="  ")


Tick = Callable[[int, int], None]
Say = Callable[[str], None]
# Seconds between two lines where there is no terminal: at first, by which factor they grow, and at most.
_FIRST, _GROWTH, _LAST = 5.0, 1.5, 60.0


@contextmanager
def campaign_progress(quiet: bool, runs: int) -> Iterator[Tick]:
    """Yield a function for the numbers of stored and of failed runs.

    A Ctrl-C that a library swallowed takes effect at the next call.
    """
    with interruptible() as check, _campaign_shown(quiet, runs) as show:

        def tick(done: int, failed: int) -> None:
            check()
            show(done, failed)

        yield tick
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
def _campaign_shown(quiet: bool, runs: int) -> Iterator[Tick]:
    if quiet:
        yield lambda done, failed: None
        return
    pace = Pace(runs)
    if sys.stderr.isatty():
        yield from _bar(pace, runs)
        return
    due, wait = time.monotonic() + _FIRST, _FIRST

    def tick(done: int, failed: int) -> None:
        nonlocal due, wait
        now = time.monotonic()
        words = pace.words(done, now)
        if now >= due or done == runs:
            wait = min(_GROWTH * wait, _LAST)
            due = now + wait
            words = f", {words}" if words else ""
            print(f"{done:,} of {runs:,} runs{words}{_failed_words(failed)}", file=sys.stderr, flush=True)

    yield tick


def _bar(pace: Pace, runs: int) -> Iterator[Tick]:
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

        yield tick


def _failed_words(number: int) -> str:
    return f", {number:,} diverged or not simulated" if number else ""


@value
class Line:
    """A line and what it shows."""

    text: str
    # "title", "missed", "met", "goal" or "plain"
    kind: str = "plain"


def requirement_lines(
    results: Sequence[CheckResult], width: int, result: JobResult | None = None, titles: bool = True
) -> Iterator[Line]:
    """Walk the lines for requirements and goals by subject, the worst first.

    `result` has the proofs; without `titles` the subjects are not named.

    A line has whether it is met, the name, the value, the limit and the relative distance to the limit, all of them at
    any width: names are wrapped. Of what is met by as much as it can be only the names are told, in the last line.
    """
    from platform_ctrl.report.page.tables import requirement_row

    told = [one for one in results if not _as_good_as_can_be(one)]
    rows = [(one, requirement_row(one, result)) for one in told]
    cells = [(_mark(one), row.requirement, row.value, row.limit, row.margin) for one, row in rows]
    heads = ("", "", "value", "limit", "margin") if cells else ("",) * 5
    widths = [max(map(len, column)) for column in zip(heads, *cells, strict=True)]
    numbers = sum(widths[2:]) + 3 * _GAP
    name = max(min(widths[1], width - widths[0] - _GAP - numbers), _NAME)
    if cells:
        yield Line(text=_row(("", "", *heads[2:]), name, widths), kind="goal")
    order = sorted(range(len(rows)), key=lambda k: (_group_severity(rows[k][0], told), severity(told[k])))
    for subject, places in groupby(order, key=lambda k: subject_of(told[k])):
        yield from (Line(text=line, kind="title") for line in textwrap.wrap(subject, width) if titles)
        for k in places:
            kind = "goal" if not told[k].hard else "met" if told[k].passed else "missed"
            first, *more = textwrap.wrap(cells[k][1], name, break_long_words=False, break_on_hyphens=False)
            yield Line(text=_row((cells[k][0], first, *cells[k][2:]), name, widths), kind=kind)
            why = [] if told[k].passed else textwrap.wrap(told[k].reason, max(width - widths[0] - 2 * _GAP, _NAME))
            for line in (*more, *(f"{'':{_GAP}}{words}" for words in why)):
                yield Line(text=f"{'':{widths[0] + _GAP}}{line}", kind=kind)
    yield from _folded([one for one in results if _as_good_as_can_be(one)], width)


def _row(cells: tuple[str, ...], name: int, widths: Sequence[int]) -> str:
    numbers = "".join(f"{'':{_GAP}}{cell:>{size}}" for cell, size in zip(cells[2:], widths[2:], strict=True))
    return f"{cells[0]:{widths[0]}}{'':{_GAP}}{cells[1]:{name}}{numbers}".rstrip()


def severity(one: CheckResult) -> tuple[bool, bool, float]:
    """Return by what results are sorted: missed requirements, then met ones by their distance, then goals."""
    return not one.hard, one.passed, one.margin


def subject_of(one: CheckResult) -> str:
    """Return the loop or manoeuvre that a result is about, and its design."""
    return f"{one.subject}, {one.design}" if one.design else one.subject


def _group_severity(one: CheckResult, results: Sequence[CheckResult]) -> tuple[tuple[bool, bool, float], str]:
    subject = subject_of(one)
    return min(severity(other) for other in results if subject_of(other) == subject), subject


def _mark(one: CheckResult) -> str:
    return "met" if one.passed else "NOT MET" if one.hard else "not met"


def tells_nothing(one: CheckResult) -> bool:
    """Whether a requirement that is met says nothing of how tight a design is.

    That is how slow the slowest pole is, if it decays at all, and that everything is proved.
    """
    return one.passed and one.name.startswith((METRICS["stability"].name, "certified properties"))


def summary_words(results: Sequence[CheckResult], more: str = "") -> str:
    """Return how many requirements are met, `more`, and which one is the worst or the tightest."""
    from platform_ctrl.job.quantities import percent

    missed = sum(not one.passed for one in results)
    words = f"{missed} of {len(results)} requirements not met" if missed else f"all {len(results)} requirements met"
    words += more
    telling = [one for one in results if not tells_nothing(one)]
    if telling:
        worst = min(telling, key=severity)
        words += f"; {'worst' if missed else 'tightest'}: {subject_of(worst)}, {worst.name}"
        words += f" ({percent(worst.margin)})" if abs(worst.margin) < 10.0 else ""
    return words


def _as_good_as_can_be(one: CheckResult) -> bool:
    return one.hard and (tells_nothing(one) or (one.passed and one.sense == "at most" and one.margin >= _NOTHING))


def _folded(results: Sequence[CheckResult], width: int) -> Iterator[Line]:
    if not results:
        return
    counts = {name: sum(one.name == name for one in results) for name in dict.fromkeys(one.name for one in results)}
    names = [name if number == 1 else f"{name} ({number} times)" for name, number in counts.items()]
    text = f"also met, by 100 % or more: {'; '.join(names)}"
    for line in textwrap.wrap(text, width, subsequent_indent=" " * _INDENT, break_on_hyphens=False):
        yield Line(text=line, kind="goal")
