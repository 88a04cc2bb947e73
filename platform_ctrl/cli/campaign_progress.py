"""How far a campaign is: a bar with rate and time left on a terminal, a line now and then elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from platform_ctrl.cli.terminal import interruptible

Tick = Callable[[int, int], None]
Say = Callable[[str], None]

# Seconds between two lines where there is no terminal: at first, by which factor they grow, and at most.
_FIRST, _GROWTH, _LAST = 5.0, 1.5, 60.0


@contextmanager
def campaign_progress(quiet: bool, runs: int) -> Iterator[tuple[Tick, Say]]:
    """Yield what takes the number of runs that are kept and of those amiss, and what takes a line that is not lost.

    A Ctrl-C that a library swallowed takes effect at the next call.
    """
    with interruptible() as heed, _shown(quiet, runs) as (show, say):

        def tick(done: int, amiss: int) -> None:
            heed()
            show(done, amiss)

        yield tick, say
        heed()


class Pace:
    """How fast runs are flown, and how long the rest will take.

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
        yield (lambda done, amiss: None), (lambda line: None)
        return
    pace = Pace(runs)
    if sys.stderr.isatty():
        yield from _bar(pace, runs)
        return
    due, wait, before = time.monotonic() + _FIRST, _FIRST, ""

    def tick(done: int, amiss: int) -> None:
        nonlocal due, wait
        now = time.monotonic()
        words = pace.words(done, now)
        if now >= due or done == runs:
            wait = min(_GROWTH * wait, _LAST)
            due = now + wait
            say(f"{done:,} of {runs:,} runs{f', {words}' if words else ''}{_amiss(amiss)}")

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
        TextColumn("runs {task.fields[pace]}{task.fields[amiss]}", markup=False),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as shown:
        task = shown.add_task("", total=runs, pace="", amiss="")

        def tick(done: int, amiss: int) -> None:
            shown.update(task, completed=done, pace=pace.words(done, time.monotonic()), amiss=_amiss(amiss))

        yield tick, lambda line: shown.console.print(line, style="dim", markup=False, highlight=False)


def _amiss(number: int) -> str:
    return f", {number:,} diverged or not flown" if number else ""
