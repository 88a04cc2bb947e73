"""The first paragraph of the report: what was designed, the verdict, and what stands nearest to a limit."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.check.proofs import PROVED
from platform_ctrl.check.verdict import JobResult
from platform_ctrl.design.jobs import LoopOutcome
from platform_ctrl.report.content import sentence
from platform_ctrl.report.price import bandwidth_hz
from platform_ctrl.report.quantities import BOUND, compared, count, disk_words, listed, percent, plain, quantity
from platform_ctrl.report.tables import verdict
from platform_ctrl.requirements import CheckResult

if TYPE_CHECKING:
    from platform_ctrl.campaign.summary import Summary

# Margins up to this share belong to what limits a loop, beside the smallest.
_NEAR = 0.05
# Requirements of a loop that are named.
_NAMED = 3
# More loops than these are not gone through one by one: the nearest to their limits stand for all.
_MOST_LOOPS = 4
# Between a number and its unit no line ends.
_UNIT = re.compile(r"(?<=\d) (?=(?:%|\u00b0|m?rad|k?Hz|m?N m|1/s|s)\b|%)|(?<=[\u2264\u2265]) ")
_NUMBERS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve")


def opening(result: JobResult, campaign: Summary | None = None) -> list[str]:
    """Return three to six sentences.

    Parameters
    ----------
    result
        From `platform_ctrl.check.checked`.
    campaign
        From `platform_ctrl.campaign.summary.summarised`, where there is one.
    """
    sentences = [_designed(result), _verdict(result), *_limits(result), _together(result), _runs(result)]
    sentences.append("" if campaign is None else _campaign(campaign))
    return [_UNIT.sub("\u00a0", one) for one in sentences if one]


def tightest(results: Sequence[CheckResult]) -> CheckResult | None:
    """Return the requirement that is missed by most, or met by least; None where nothing has a margin.

    How slow the slowest pole is, as long as it decays, is no measure of how tight a design is; nor is a proof.
    """
    telling = [one for one in results if not (one.passed and one.name.startswith(("slowest decay", PROVED.name)))]
    return min(telling, key=lambda one: (one.passed, one.margin), default=None)


def _designed(result: JobResult) -> str:
    platform, job = result.job.platform, result.job
    given = all(design.method == "given" for outcome in result.loops for design in outcome.designs)
    bodies = f"{count(len(platform.gimbals), 'gimbal')} and {count(len(platform.rotors), 'rotor')}"
    where = f"“{platform.name}” ({bodies})"
    if not result.loops:
        return f"No loop is closed on {where}."
    number = len(result.loops)
    made = f"{_number(number).capitalize()} {'loop' if number == 1 else 'loops'} {'was' if number == 1 else 'were'} "
    made += f"{'checked with given controllers' if given else 'designed'} for {where}"
    closed = [f"{outcome.spec.name} ({outcome.closed.name})" for outcome in result.loops]
    rate = float(np.linalg.norm(job.Omega, np.inf)) if job.Omega.size else 0.0
    reach = f", for platform rates up to {plain(rate, 3)} rad/s about an axis" if rate > 0.0 else ""
    sampled = f"{plain(1e-3 / job.sampling.period, 4)} kHz"
    return f"{made}{reach}, sampled at {sampled}: {listed(closed)}."


def _number(number: int) -> str:
    return _NUMBERS[number] if number < len(_NUMBERS) else str(number)


def _verdict(result: JobResult) -> str:
    worst = tightest(result.requirements)
    missed = sum(not one.passed for one in result.requirements)
    if not result.requirements:
        return "Nothing is asked of them."
    words = sentence(verdict(result)).replace("requirements met", "requirements are met")
    words = words.replace("not met", "is not met" if missed == 1 else "are not met")
    if worst is None:
        return f"{words}."
    nearest = "the one missed by most" if missed else "the tightest"
    return f"{words}; {nearest} is {worst.name} of {_whose(worst)}, {_against(worst)}."


def _whose(one: CheckResult) -> str:
    return f"“{one.subject}”"


def _against(one: CheckResult) -> str:
    """Return value, limit and margin."""
    number, limit = compared(one)
    share = percent(abs(one.margin)).removeprefix("+")
    margin = f", {'missed' if one.margin < 0.0 else 'met'} by {share}" if abs(one.margin) < 10.0 else ""
    return f"{number} where {BOUND[one.sense]} {limit} is asked{margin}"


def _limits(result: JobResult) -> list[str]:
    """Return what limits each loop."""
    found = [(outcome, nearest) for outcome in result.loops if (nearest := tightest(outcome.closed.results))]
    if len(found) > _MOST_LOOPS:
        found = sorted(found, key=lambda pair: (pair[1].passed, pair[1].margin))[:_MOST_LOOPS]
    told = [_limited(outcome, nearest) for outcome, nearest in found]
    return [f"{'; '.join(told)}."] if told else []


def _limited(outcome: LoopOutcome, nearest: CheckResult) -> str:
    results = outcome.closed.results
    own = bandwidth_hz(outcome.closed)
    name = f"“{outcome.spec.name}”"
    reaches = f"{name} reaches a bandwidth of {quantity(own, 'Hz', 3)} and" if own > 0.0 else name
    missed = [one.name for one in sorted(results, key=lambda one: one.margin) if not one.passed]
    if missed:
        others = [f"{_number(len(missed) - _NAMED)} more"] if len(missed) > _NAMED else []
        return f"{reaches} misses {listed(missed[:_NAMED] + others)}"
    near = sorted((one for one in results if one.margin <= _NEAR and tightest([one])), key=lambda one: one.margin)
    if near:
        named = [f"{one.name} ({percent(one.margin)})" for one in near[:_NAMED]]
        return f"{reaches} is held back by {listed(named)}"
    return f"{reaches} comes nearest to a limit in {nearest.name} ({percent(nearest.margin)})"


def _together(result: JobResult) -> str:
    check = result.coupled
    several = len(result.loops) > 1
    if not check.stable:
        closed = "together on the coupled platform the loops are" if several else "on the coupled platform the loop is"
        return f"Closed {closed} unstable."
    if not check.channels:
        return ""
    closed = "together on the coupled platform they stay" if several else "on the coupled platform it stays"
    return f"Closed {closed} stable while every channel changes: {disk_words(check.simultaneous.alpha)}."


def _runs(result: JobResult) -> str:
    if not result.runs:
        return ""
    lost = [run.manoeuvre.name for run in result.runs if not run.trajectory.completed]
    flown = f"Of {count(len(result.runs), 'simulated run')}" if len(result.runs) > 1 else "The simulated run"
    if lost:
        names = listed([f"“{name}”" for name in lost])
        return f"{flown} {names} did not come to {'its' if len(lost) == 1 else 'their'} end."
    worst = tightest([one for run in result.runs for one in run.results])
    if worst is None:
        return ""
    verb = "exceeds a limit by most" if not worst.passed else "comes nearest to a limit"
    return f"{flown} “{worst.subject}” {verb}: {worst.name} {_against(worst)}."


def _campaign(summary: Summary) -> str:
    from platform_ctrl.campaign.table import PASSED
    from platform_ctrl.report import campaign_tables as tables
    from platform_ctrl.report.campaign_tables import chance, chances, contrast_name, count_words, drivers_of

    found = summary.statistics
    flown = found.violation
    if not flown.runs:
        return "No run of the campaign was flown."
    sure = f"with {plain(100.0 * found.confidence, 3)} % confidence"
    bounds = chances(flown.low, flown.high)
    if not flown.events:
        return f"None of the campaign's {count_words(flown.runs)} violates a requirement: probability {bounds} {sure}."
    overall = (one for one in summary.sensitivities if one.manoeuvre is None and one.figure == PASSED)
    drivers = [f"“{name}”" for one in overall for name in drivers_of(one)[:2]]
    driven = f"; what decides it most is {listed(drivers)}" if drivers else ""
    causes = [f"“{contrast_name(one)}”" for one in tables.causes(summary) if one.in_every_violation]
    driven += f"; every violating run has {listed(causes)}" if causes else ""
    return (
        f"In a campaign of {count_words(flown.runs)} the probability of violating a requirement is "
        f"{chance(flown.estimate)} ({bounds} {sure}){driven}."
    )
