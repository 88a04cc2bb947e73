"""What a test asserts of a job: its requirements, and that it has not become worse."""

from __future__ import annotations

import os
from pathlib import Path

from platform_ctrl.common.signatures import check_arguments, short
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.judging import CheckResult
from platform_ctrl.report.failures import against_baseline, missed_text, requirement_text
from platform_ctrl.verification import JobResult
from platform_ctrl.verification.baselines.comparison import Comparison
from platform_ctrl.verification.baselines.file import Update, plot_beside


@check_arguments
def assert_requirements(result: JobResult, *, goals: bool = False) -> None:
    """Assert that every requirement of a job is met.

    Parameters
    ----------
    result
        From the fixture ``closed_loop``, or from `verification.check_job`.
    goals
        Whether the goals of the closed designs have to be met too.

    Raises
    ------
    AssertionError
        With a table of what is missed: value, limit, margin, and where the worst value was found.
    ArgumentError
        `result` is no result of a job.
    """
    __tracebackhide__ = True
    hard = [one for one in result.requirements if one.hard]
    texts = [missed_text(hard, result.job.name)]
    if goals:
        wanted = [goal for outcome in result.loops for goal in outcome.closed.goals]
        texts.append(missed_text(wanted, result.job.name, "goal"))
    text = "\n".join(filter(None, texts))
    if text:
        raise AssertionError(text)


def assert_met(one: CheckResult) -> None:
    """Assert that one requirement is met; the message has value, limit, margin and evidence."""
    __tracebackhide__ = True
    if not one.passed:
        raise AssertionError(f"{requirement_text(one)}\n  {one.evidence}")


@check_arguments
def assert_baseline(
    result: JobResult,
    file: str | os.PathLike[str],
    *,
    update: bool = False,
    plots: str | os.PathLike[str] | None = None,
) -> Comparison | Update:
    """Assert that no figure of a job is worse than it was once accepted, by more than its tolerance.

    In a pytest run take the fixture of the same name, which obeys ``--update-baselines`` and ``--platform-plots``.

    Parameters
    ----------
    result
        From the fixture ``closed_loop``, or from `verification.check_job`.
    file
        The baseline, as `baselines.write_baseline` writes it; to be kept under version control.
    update
        Accept the figures as they are: write the file, and assert nothing.
    plots
        Folder for the plot of what has moved; None: beside `file`. It is there after a failure alone: one of an
        earlier failure is removed.

    Returns
    -------
    Comparison or Update
        What has moved; of an update, what was written.

    Raises
    ------
    AssertionError
        A figure is worse, or no longer measured, or there is no such file. The message shows each figure before and
        now, its change, tolerance and limit, which plant or controller has changed, and where the plot is.
    InputError
        The file is no baseline, or cannot be written.
    ArgumentError
        `result` is no result of a job, or `file` no path.
    """
    __tracebackhide__ = True
    path = baseline_path(file)
    accept = "pytest --update-baselines"
    if not update and not path.exists():
        raise AssertionError(f"{path}: there is no such file; {accept} writes it")
    found, text, _ = against_baseline(result, path, plot_beside(path, plots), accept, update=update)
    if text:
        raise AssertionError(text)
    return found


def baseline_path(file: object) -> Path:
    """Return the path of a baseline; ArgumentError if it is none."""
    if not isinstance(file, str | os.PathLike):
        raise ArgumentError(f"baseline: must be the path of a file, got {short(file)}")
    return Path(file)
