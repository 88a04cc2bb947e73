"""What people see while a command works, and when it is done. Colours, spinner and boxes only on a terminal."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

from platform_ctrl.requirements import CheckResult

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    from platform_ctrl.check import Run

# Columns that a pipe is given, which has no width of its own; narrower terminals get lines instead of a table.
_PIPE_WIDTH = 120
_NARROW = 76


@contextmanager
def progress(quiet: bool, first: str) -> Iterator[Callable[[str], None]]:
    """Yield what a long piece of work calls with a line before each step.

    On a terminal the line, at the start `first`, stands beside a spinner and the time since the start, and vanishes at
    the end. Elsewhere every line but `first` is printed on standard error: where the input turns out to be wrong, the
    error stands there alone. `quiet` shows none.
    """
    if quiet:
        yield lambda line: None
        return
    if not sys.stderr.isatty():
        yield lambda line: print(line, file=sys.stderr, flush=True)
        return
    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
    from rich.table import Column

    text = TextColumn("{task.description}", markup=False, table_column=Column(no_wrap=True, overflow="ellipsis"))
    columns = (SpinnerColumn("line"), TimeElapsedColumn(), text)
    with Progress(*columns, console=Console(stderr=True), transient=True) as shown:
        task = shown.add_task(first, total=None)
        yield lambda line: shown.update(task, description=line)


def screen() -> Console:
    """Return the console on standard output: colours on a terminal alone, and none where NO_COLOR is set."""
    from rich.console import Console

    fitting = sys.stdout.isatty() or "COLUMNS" in os.environ
    return Console(highlight=False, width=None if fitting else _PIPE_WIDTH)


def show_requirements(results: Sequence[CheckResult], title: str = "") -> None:
    """Print the requirements with what was found: as a table, or as lines where it would not fit."""
    from rich.text import Text

    console = screen()
    if console.width >= _NARROW:
        console.print(_requirement_table(results, title))
        return
    if title:
        console.print(title, markup=False)
    for one in results:
        console.print(Text.assemble(_mark(one), f" {_subject(one)}: {one.name} {_figure(one)} ({_limit(one)})"))


def show_run(run: Run, figures: dict[str, tuple[float, str]]) -> None:
    """Print how a simulated run went: its largest figures, saturated torquers, stops that were touched, its limits."""
    from rich.table import Table

    trajectory, console = run.trajectory, screen()
    saturated = {name: int(n) for name, n in zip(trajectory.torquer_names, trajectory.saturated, strict=True) if n}
    touched = {name: int(n) for name, n in zip(trajectory.angle_names, trajectory.stop_contacts, strict=True) if n}
    rows = {
        "ended": trajectory.ended,
        "largest gimbal angle": "{:.4g} rad ({})".format(*figures["angle"]),
        "largest platform angle": "{:.4g} rad ({})".format(*figures["attitude"]),
        "largest torque over its limit": "{:.4g} ({})".format(*figures["torque_share"]),
        "saturated samples": ", ".join(f"{name} {n}" for name, n in saturated.items()) or "none",
        "stops touched": ", ".join(f"{name} {n}" for name, n in touched.items()) or "none",
    }
    table = Table.grid(padding=(0, 2))
    for name, words in rows.items():
        table.add_row(name, words)
    console.print(run.manoeuvre.name, style="bold", markup=False)
    console.print(table)
    if run.results:
        show_requirements(run.results)


def show_verdict(results: Sequence[CheckResult]) -> None:
    """Print whether every requirement is met, and which is nearest to its limit."""
    met = sum(one.passed for one in results)
    passed = met == len(results)
    count = len(results)
    words = f"every requirement met ({count})" if passed else f"{count - met} of {count} requirements not met"
    if results:
        nearest = min(results, key=lambda one: one.margin if one.margin == one.margin else float("-inf"))
        words += f"; nearest to its limit or beyond: {_subject(nearest)}, {nearest.name}"
    verdict, style = ("PASSED", "green") if passed else ("FAILED", "bold red")
    screen().print(f"{verdict}: {words}", style=style, markup=False)


def _requirement_table(results: Sequence[CheckResult], title: str) -> Table:
    from rich import box
    from rich.table import Table
    from rich.text import Text

    table = Table(title=Text(title) if title else None, title_justify="left", box=box.SIMPLE, pad_edge=False)
    table.add_column("", no_wrap=True)
    table.add_column("of", overflow="fold")
    table.add_column("requirement", overflow="fold")
    table.add_column("found", justify="right", no_wrap=True)
    table.add_column("limit", no_wrap=True)
    table.add_column("margin", justify="right", no_wrap=True)
    table.add_column("seen in", no_wrap=True)
    for one in results:
        margin = f"{one.margin:+.0%}" if abs(one.margin) < 100.0 else ""
        table.add_row(_mark(one), Text(_subject(one)), one.name, _figure(one), _limit(one), margin, one.stage)
    return table


def _mark(one: CheckResult) -> Text:
    from rich.text import Text

    return Text("met", "green") if one.passed else Text("NOT MET", "bold red")


def _subject(one: CheckResult) -> str:
    return f"{one.subject}, {one.design}" if one.design else one.subject


def _figure(one: CheckResult) -> str:
    return f"{one.value:.4g} {one.unit}".rstrip()


def _limit(one: CheckResult) -> str:
    # The limit of a pole radius is just below 1: four digits would show it as 1.
    return f"{one.sense} {one.limit:.6g} {one.unit}".rstrip()
