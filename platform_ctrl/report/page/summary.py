"""The first paragraph of the report: what was designed, the verdict, and what is nearest to its limit."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from platform_ctrl.analysis.metrics import METRICS
from platform_ctrl.campaign.summary import Summary
from platform_ctrl.campaign.table import PASSED
from platform_ctrl.common.text import Rounding
from platform_ctrl.design.jobs import LoopOutcome
from platform_ctrl.design.loop import LoopDesign
from platform_ctrl.job.judging import STABLE, CheckResult
from platform_ctrl.report.page.blocks import sentence
from platform_ctrl.report.page.campaign_tables import (
    causes,
    chance,
    chances,
    contrast_name,
    count_words,
    drivers_of,
)
from platform_ctrl.report.page.tables import verdict
from platform_ctrl.report.quantities import BOUND, compared, count, disk_words, listed, percent, plain, quantity
from platform_ctrl.verification.verdict import PROVED, JobResult

# Of two ratios to a limit; a smaller difference is not mentioned.
_NOTABLE = 1.05
# Not mentioned as a loss: bandwidth has its own sentence, and the decay rate means little for a stable loop.
_UNCOUNTED = (METRICS["bandwidth"].name, STABLE.name)


def compared_with_alternatives(outcome: LoopOutcome) -> list[str]:
    """Return sentences: order and bandwidth compared with the best alternative, and with claimed bounds."""
    return [*_against_others(outcome), *_against_bounds(outcome.closed)]


def bandwidth_hz(design: LoopDesign) -> float:
    """Return the bandwidth of the nominal loop in Hz; 0 where the loop is unstable or has no plants of its own."""
    measures = design.measures
    if measures is None or not measures.decay[0] > 0.0 or not np.isfinite(measures.bandwidth):
        return 0.0
    return measures.bandwidth / (2.0 * np.pi)


def _against_others(outcome: LoopOutcome) -> list[str]:
    """Compare with the widest of the alternatives that meet their limits; of all, where none does."""
    closed = outcome.closed
    own = bandwidth_hz(closed)
    others = [design for design in outcome.alternatives if bandwidth_hz(design) > 0.0]
    if not others or own == 0.0:
        return []
    best = max(others, key=lambda design: (design.passed, bandwidth_hz(design)))
    its = bandwidth_hz(best)
    if not best.passed:
        kept = "but misses limits"
    elif closed.passed:
        kept = "and meets every limit too"
    else:
        kept = "and meets every limit"
    text = (
        f"With {_states(closed)} “{closed.name}” reaches {quantity(own, 'Hz', 3)}; “{best.name}”, the best of the "
        f"others, reaches {quantity(its, 'Hz', 3)} with {_states(best)} {kept}"
    )
    fewer = best.controller.nstates - closed.controller.nstates
    loss, gain = _percent(1.0 - own / its), _percent(own / its - 1.0)
    if fewer > 0 and own < its:
        difference = f"{loss} of bandwidth is the price of {count(fewer, 'state')} fewer"
    elif fewer > 0:
        difference = f"{gain} more bandwidth with {count(fewer, 'state')} fewer"
    elif own < its:
        difference = f"{loss} of bandwidth is lost without a saving of states"
    else:
        difference = f"{gain} more bandwidth with {count(-fewer, 'state')} more" if fewer else f"{gain} more bandwidth"
    return [f"{text}: {difference}.", *_largest_cost(closed, best)]


def _largest_cost(closed: LoopDesign, best: LoopDesign) -> list[str]:
    """Name the limit, bandwidth apart, to which `closed` is nearer than `best` by most; nothing below 5 %."""
    theirs = {one.name: one for one in best.results}
    apart = [
        (one.ratio / theirs[one.name].ratio, one)
        for one in closed.results
        if one.name in theirs and theirs[one.name].ratio > 0.0 and not one.name.startswith(_UNCOUNTED)
    ]
    worse, cost = max(apart, key=lambda pair: pair[0], default=(1.0, None))
    if cost is None or not worse > _NOTABLE:
        return []
    other = theirs[cost.name].value
    shown = [quantity(number, cost.unit, 3, like=cost.limit) for number in (cost.value, other)]
    return [f"The largest loss is in {cost.name}: {shown[0]} compared with {shown[1]}."]


def _against_bounds(design: LoopDesign) -> list[str]:
    out = []
    own, claims = bandwidth_hz(design), design.claims
    bound = claims.get("bandwidth_bound_hz", np.nan)
    if np.isfinite(bound) and own > 0.0:
        most = quantity(bound, "Hz", 3, rounding="up")
        share = f": at most {_percent(bound / own - 1.0, 'up')} could be gained" if own < bound else ""
        out.append(f"No controller within these limits reaches more than {most}{share}.")
    gamma, least = claims.get("gamma", np.nan), claims.get("gamma_optimal", np.nan)
    price = claims.get("price", gamma / least - 1.0 if least > 0.0 else np.nan)
    if np.isfinite(price) and np.isfinite(gamma) and np.isfinite(least):
        out.append(
            f"On its weights the norm is {plain(gamma, rounding='up')}, {_percent(price)} above "
            f"{plain(least, rounding='down')}, a lower bound for controllers of any order."
        )
    elif np.isfinite(price):
        out.append(f"Its simplicity costs at most {_percent(price, 'up')} compared with the best of any order.")
    return out


def _states(design: LoopDesign) -> str:
    return count(design.controller.nstates, "state")


def _percent(share: float, rounding: Rounding = "nearest") -> str:
    return f"{plain(100.0 * share, 2, rounding)}\u00a0%"


# Requirements with margins up to this share limit a loop, beside the one with the smallest.
_NEAR = 0.05
# Requirements of a loop that are named.
_NAMED = 3
# Of more loops than these only the nearest to their limits are described.
_MOST_LOOPS = 4
# No line break between a number and its unit.
_UNIT = re.compile(r"(?<=\d) (?=(?:%|\u00b0|m?rad|k?Hz|m?N m|1/s|s)\b|%)|(?<=[\u2264\u2265]) ")
_NUMBERS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve")


def opening(result: JobResult, campaign: Summary | None = None) -> list[str]:
    """Return three to six sentences.

    Parameters
    ----------
    result
        From `platform_ctrl.verification.check_job`.
    campaign
        From `platform_ctrl.campaign.summary.summarise`, where there is one.
    """
    sentences = [_designed(result), _verdict(result), *_limits(result), _together(result), _runs(result)]
    sentences.append("" if campaign is None else _campaign(campaign))
    return [_UNIT.sub("\u00a0", one) for one in sentences if one]


def tightest(results: Sequence[CheckResult]) -> CheckResult | None:
    """Return the requirement that is missed by most, or met by least; None where nothing has a margin.

    Stability and proofs that are met are no measure of how tight a design is.
    """
    counted = [one for one in results if not (one.passed and one.name.startswith((STABLE.name, PROVED.name)))]
    return min(counted, key=lambda one: (one.passed, one.margin), default=None)


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
        return "There are no requirements."
    words = sentence(verdict(result)).replace("requirements met", "requirements are met")
    words = words.replace("not met", "is not met" if missed == 1 else "are not met")
    if worst is None:
        return f"{words}."
    nearest = "the one missed by most" if missed else "the tightest"
    return f"{words}; {nearest} is {worst.name} of “{worst.subject}”, {_against(worst)}."


def _against(one: CheckResult) -> str:
    """Return value, limit and margin."""
    number, limit = compared(one)
    share = percent(abs(one.margin)).removeprefix("+")
    margin = f", {'missed' if one.margin < 0.0 else 'met'} by {share}" if abs(one.margin) < 10.0 else ""
    return f"{number} with a limit of {BOUND[one.sense]} {limit}{margin}"


def _limits(result: JobResult) -> list[str]:
    """Return what limits each loop."""
    found = [(outcome, nearest) for outcome in result.loops if (nearest := tightest(outcome.closed.results))]
    if len(found) > _MOST_LOOPS:
        found = sorted(found, key=lambda pair: (pair[1].passed, pair[1].margin))[:_MOST_LOOPS]
    return [f"{'; '.join(_limited(outcome, nearest) for outcome, nearest in found)}."] if found else []


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
        return f"{reaches} is limited by {listed(named)}"
    return f"{reaches} is nearest to a limit in {nearest.name} ({percent(nearest.margin)})"


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
    runs = f"Of {count(len(result.runs), 'simulated run')}" if len(result.runs) > 1 else "The simulated run"
    if lost:
        names = listed([f"“{name}”" for name in lost])
        return f"{runs} {names} ended early."
    worst = tightest([one for run in result.runs for one in run.results])
    if worst is None:
        return ""
    verb = "exceeds a limit by most" if not worst.passed else "comes nearest to a limit"
    return f"{runs} “{worst.subject}” {verb}: {worst.name} {_against(worst)}."


def _campaign(summary: Summary) -> str:
    found = summary.statistics
    violation = found.violation
    if not violation.runs:
        return "No run of the campaign was simulated."
    sure = f"with {plain(100.0 * found.confidence, 3)} % confidence"
    bounds = chances(violation.low, violation.high)
    if not violation.events:
        return (
            f"None of the campaign's {count_words(violation.runs)} violates a requirement: probability {bounds} {sure}."
        )
    overall = (one for one in summary.sensitivities if one.manoeuvre is None and one.requirement == PASSED)
    drivers = [f"“{name}”" for one in overall for name in drivers_of(one)[:2]]
    driven = f"; the most influential inputs are {listed(drivers)}" if drivers else ""
    shared = [f"“{contrast_name(one)}”" for one in causes(summary) if one.in_every_violation]
    driven += f"; every violating run has {listed(shared)}" if shared else ""
    return (
        f"In a campaign of {count_words(violation.runs)} the probability of violating a requirement is "
        f"{chance(violation.estimate)} ({bounds} {sure}){driven}."
    )
