"""What a campaign leaves behind once its runs are flown: statistics in campaign.json, and the page."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, cast

from platform_ctrl.arguments import one_of
from platform_ctrl.errors import ArgumentError, InputError

if TYPE_CHECKING:
    from platform_ctrl.campaign.engine import Campaigned
    from platform_ctrl.campaign.plan import Plan
    from platform_ctrl.campaign.rare_result import RareMethod, RareResult
    from platform_ctrl.campaign.store import Record
    from platform_ctrl.campaign.summary import Summary

PAGE = "campaign.html"
ANY = "any"
METHODS = ("splitting", "cross-entropy")


def expect_rare(plan: Plan, requirement: str | None, runs_per_level: int, method: str) -> None:
    """Judge the options of a rare event before anything is flown.

    Raises
    ------
    InputError
        No manoeuvre asks for the requirement, the method does not exist, or a level has too few runs.
    """
    from platform_ctrl.campaign.rare_events import FEWEST_SAMPLES

    asked = [ANY, *dict.fromkeys(name for one, _ in plan.job.flown for name in one.limits)]
    if requirement is not None and requirement not in asked:
        raise InputError(
            f"--rare {requirement}: no manoeuvre of the campaign has this limit; expected {', '.join(asked)}"
        )
    if runs_per_level < FEWEST_SAMPLES:
        raise InputError(f"--runs-per-level {runs_per_level}: expected at least {FEWEST_SAMPLES}")
    try:
        one_of("--rare-method", method, METHODS)
    except ArgumentError as error:
        raise InputError(str(error)) from None


def rare_found(
    plan: Plan,
    requirement: str | None,
    runs_per_level: int,
    method: str,
    *,
    workers: int | None,
    device: str,
    say: Callable[[str], None],
) -> tuple[RareResult, ...]:
    """Fly the rare event that was asked for, if one was."""
    if requirement is None:
        return ()
    from platform_ctrl.campaign.rare_flights import rare_probability
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


def delivered(
    plan: Plan, flown: Campaigned, rare: tuple[RareResult, ...], *, command: list[str], again: list[str]
) -> tuple[Summary, Record]:
    """Count the table, write campaign.json with what was counted, and the page; return both.

    Parameters
    ----------
    plan, flown, rare
        What was flown.
    command, again
        The command that did it, and the one that flies a run again, without the run's number.

    Raises
    ------
    InputError
        A file cannot be written.
    """
    from platform_ctrl.campaign.store import write_record
    from platform_ctrl.campaign.summary import summarised, summary_record
    from platform_ctrl.report.campaign_page import write_campaign_page

    folder: Path = flown.table.parent
    summary = summarised(plan, flown.table, rare=rare)
    record = flown.record | summary_record(summary)
    write_record(folder, record)
    write_campaign_page(summary, folder / PAGE, command=shlex.join(command), again=shlex.join(again))
    return summary, record
