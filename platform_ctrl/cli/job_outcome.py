"""What a job came to, as the commands design and check leave it: the result's file, the report, and the exit code."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from platform_ctrl.cli.inputs import RESULT

if TYPE_CHECKING:
    from platform_ctrl.check import JobResult

REPORT = "report.html"

Shown = Callable[[], int]


def delivered(
    result: JobResult,
    folder: Path,
    as_json: bool,
    say: Callable[[str], None],
    command: list[str],
    more: Mapping[str, object] | None = None,
) -> Shown:
    """Write both files; return what shows the result and gives the exit code, for when the spinner has gone.

    `more` is printed beside what the result's file holds, as JSON alone.
    """
    from platform_ctrl.check.records import laid_out, plain, result_record, write_record
    from platform_ctrl.cli.terminal import show_result
    from platform_ctrl.report import write_page

    say(f"drawing the report: {folder / REPORT}")
    write_page(result, folder / REPORT, command=shlex.join(["platform-ctrl", *command]))
    record = result_record(result)
    write_record(record, folder / RESULT)

    def show() -> int:
        if as_json:
            typer.echo(laid_out(record | plain(more or {})))
        else:
            show_result(result)
            typer.echo(f"report: {folder / REPORT}, figures: {folder / RESULT}")
        return 0 if result.passed else 1

    return show
