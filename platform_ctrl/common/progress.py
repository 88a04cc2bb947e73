"""Progress of long work, line by line: to a function of the caller, on a terminal, or in a cell of a notebook."""

from __future__ import annotations

import html
import importlib
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

# Called with a line before each step.
Progress = Callable[[str], None]


class Local:
    """A progress function that is called in this process, and does nothing in another one that it is sent to."""

    def __init__(self, say: Progress) -> None:
        self.say = say

    def __call__(self, line: str) -> None:
        """Say a line."""
        self.say(line)

    def __reduce__(self) -> tuple[type[Local], tuple[Progress]]:
        return Local, (_unsaid,)


def _unsaid(line: str) -> None:
    pass


@contextmanager
def shown(progress: Progress | bool | None) -> Iterator[Progress]:
    """Yield what is called with a line before each step: True shows the present one, with the time since the start."""
    if callable(progress):
        yield progress
    elif not progress:
        yield lambda line: None
    elif (cell := _cell()) is not None:
        yield lambda line: cell(f"<progress></progress> {html.escape(line)}")
        cell("")
    else:
        with spinner("") as show:
            yield show


def run_words(done: int, failed: int, runs: int) -> str:
    """Return how far a campaign is."""
    return f"{done:,} of {runs:,} runs" + (f", {failed:,} diverged or not simulated" if failed else "")


@contextmanager
def shown_runs(progress: Callable[[int, int], None] | bool | None, runs: int) -> Iterator[Callable[[int, int], None]]:
    """Yield what is called with the numbers of runs that are done and that failed: True shows a bar."""
    if callable(progress):
        yield progress
    elif not progress:
        yield lambda done, failed: None
    elif (cell := _cell()) is not None:
        yield lambda done, failed: cell(
            f'<progress max="{runs}" value="{done}"></progress> {run_words(done, failed, runs)}'
        )
    else:
        from rich.console import Console
        from rich.progress import BarColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
        from rich.progress import Progress as Shown

        text = TextColumn("{task.description}", markup=False)
        columns = (TimeElapsedColumn(), BarColumn(), text, TimeRemainingColumn())
        with Shown(*columns, console=Console(stderr=True), transient=True) as shown:
            task = shown.add_task(run_words(0, 0, runs), total=runs)
            yield lambda done, failed: shown.update(task, completed=done, description=run_words(done, failed, runs))


@contextmanager
def spinner(first: str) -> Iterator[Progress]:
    """Yield what shows a line on standard error, `first` at the start, with the time; it vanishes at the end."""
    from rich.console import Console
    from rich.progress import Progress as Shown
    from rich.progress import SpinnerColumn, TextColumn, TimeElapsedColumn
    from rich.table import Column

    text = TextColumn("{task.description}", markup=False, table_column=Column(no_wrap=True, overflow="ellipsis"))
    columns = (SpinnerColumn("line"), TimeElapsedColumn(), text)
    with Shown(*columns, console=Console(stderr=True), transient=True) as shown:
        task = shown.add_task(first, total=None)
        yield lambda line: shown.update(task, description=line)


def _cell() -> Progress | None:
    """Return a function that replaces the output of a notebook's cell by HTML; None outside of a notebook."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    if getattr(shell, "kernel", None) is None:
        return None
    notebook: Any = importlib.import_module("IPython.display")
    handle = notebook.display(notebook.HTML(""), display_id=True)
    return lambda text: handle.update(notebook.HTML(text))
