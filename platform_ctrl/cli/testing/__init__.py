"""Regression tests of control loops: what tests assert, beside the fixture ``closed_loop``.

With the package installed pytest finds the fixture by itself. See docs/how-to/regression-tests.md.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from platform_ctrl.verification.verdict import JobResult

__all__ = ["assert_requirements"]


def assert_requirements(result: JobResult) -> None:
    """Assert that every requirement of a job is met.

    Parameters
    ----------
    result
        From the fixture ``closed_loop``, or from `verification.check_job`.

    Raises
    ------
    AssertionError
        With a table of what is missed: value, limit, margin, and where the worst value was found.
    """
    __tracebackhide__ = True
    from platform_ctrl.cli.terminal import missed_text

    if text := missed_text([one for one in result.requirements if one.hard], result.job.name):
        raise AssertionError(text)
