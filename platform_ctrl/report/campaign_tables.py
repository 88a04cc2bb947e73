"""The results of a campaign as rows of text, for its page and for the terminal."""

from __future__ import annotations

import math
from collections.abc import Sequence

from platform_ctrl.analysis.metrics import RUN_METRICS
from platform_ctrl.campaign.statistics import Probability, RequirementStatistics, WorstRun
from platform_ctrl.campaign.store import DIVERGED, MANOEUVRE, PASSED
from platform_ctrl.campaign.summary import Influence, Summary
from platform_ctrl.common.text import Rounding, rounded
from platform_ctrl.common.values import value
from platform_ctrl.job.quantities import BOUND, DASH, MINUS, added_words, count, plain, quantity, simulated_words, times
from platform_ctrl.job.variation import Vary

ALL_MANOEUVRES = "all manoeuvres, values relative to their limits"
# Inputs that a line names for a requirement.
_STRONGEST = 3


@value
class ProbabilityRow:
    """One requirement of a campaign as the tables show it."""

    group: str  # The manoeuvre
    # Requirement, limit, number of violations, probability and its bounds; the value that is not exceeded in half of
    # the runs, in 99 % of them, in all; number of the worst run
    words: tuple[str, ...]
    numbers: Probability  # Estimate and bounds as numbers


def probability_rows(summary: Summary) -> tuple[ProbabilityRow, ...]:
    """Return every requirement, over all manoeuvres first; with one manoeuvre there is no such group."""
    found = summary.statistics.requirements
    manoeuvres = {one.manoeuvre for one in found if one.manoeuvre is not None}
    return tuple(_row(one) for one in found if one.manoeuvre is not None or len(manoeuvres) > 1)


def _row(one: RequirementStatistics) -> ProbabilityRow:
    unit = "" if one.manoeuvre is None or one.requirement == PASSED else RUN_METRICS[one.requirement].unit
    shown = {share: value_words(number, unit, one.limit) for share, number in one.quantiles.items()}
    words = (
        requirement_name(one.requirement).removeprefix("largest "),
        DASH if one.limit is None else limit_words(one.requirement, one.limit, relative=one.manoeuvre is None),
        f"{one.violation.events:,} of {one.violation.runs:,}",
        chance(one.violation.estimate),
        chances(one.violation.low, one.violation.high),
        shown.get(0.5, ""),
        shown.get(0.99, ""),
        "" if not one.values.size else value_words(one.largest, unit, one.limit),
        str(one.worst[0].run) if one.worst else "",
    )
    return ProbabilityRow(group=one.manoeuvre or ALL_MANOEUVRES, words=words, numbers=one.violation)


def limit_words(metric: str, limit: float, *, relative: bool = False) -> str:
    """Return a limit with its sense; `relative`: of ratios of values to their limits, which are to be at most one."""
    if relative:
        return f"{BOUND['at most']} {plain(limit)}"
    return f"{BOUND[RUN_METRICS[metric].sense]} {quantity(limit, RUN_METRICS[metric].unit, 4, limit)}"


def requirement_name(metric: str) -> str:
    """Return the name of a requirement."""
    return "any requirement" if metric == PASSED else RUN_METRICS[metric].name


def value_words(number: float, unit: str, like: float | None) -> str:
    """Return a value with its unit, in the unit that suits the limit."""
    return DIVERGED if math.isinf(number) else quantity(number, unit, 3, like)


def chance(probability: float, rounding: Rounding = "nearest") -> str:
    """Return a probability: in per cent down to a hundredth of one, below that as a power of ten."""
    if not math.isfinite(probability):
        return DASH
    if probability == 0.0:
        return "0"
    return f"{_percent(probability, rounding)} %" if probability >= 1e-4 else plain(probability, 2, rounding)


def chances(low: float, high: float) -> str:
    """Return an interval of probabilities, rounded outwards."""
    if low == 0.0:
        return f"below {chance(high, 'up')}"
    if high == 1.0:
        return f"above {chance(low, 'down')}"
    if high >= 1e-4 and low >= 1e-6:
        return f"{_percent(low, 'down')} to {_percent(high, 'up')} %"
    return f"{chance(low, 'down')} to {chance(high, 'up')}"


def _percent(probability: float, rounding: Rounding) -> str:
    """Return per cent with two significant digits; near 100 with enough digits to differ from 100."""
    if probability >= 1.0:
        return "100"
    shown = times(100.0, probability)
    place = math.floor(math.log10(shown))
    decimals = max(0, 1 - place) if shown <= 99.0 else min(4, -math.floor(math.log10(100.0 - shown + 1e-9)))
    text = f"{rounded(shown, decimals + place + 1, rounding):.{decimals}f}"
    return text if float(text) < 100.0 else "100" if rounding == "up" else "99.9999"


def verdict(summary: Summary) -> tuple[str, str]:
    """Return the verdict in a few words, and what it rests on."""
    job = summary.plan.job
    words = f"{violation_words(summary)}{added_words(job.platform)}"
    return words, simulated_words(job, [one for one, _ in job.campaign_manoeuvres])


def violation_words(summary: Summary) -> str:
    """Return how many runs violate a requirement."""
    violation = summary.statistics.violation
    if violation.events:
        verb = "violates" if violation.events == 1 else "violate"
        words = f"{violation.events:,} of {count(violation.runs, 'run')} {verb} a requirement"
    elif violation.runs > 1:
        words = f"none of {count(violation.runs, 'run')} violates a requirement"
    else:
        words = "the run violates no requirement" if violation.runs else "no run was simulated"
    lost = summary.statistics.not_simulated
    return f"{words}, {count(lost, 'run')} could not be simulated" if lost and violation.runs else words


def campaign_words(summary: Summary) -> str:
    """Return what a campaign adds to the verdict on a job."""
    return f"campaign: {violation_words(summary)}"


def verdict_lines(summary: Summary) -> list[str]:
    """Return the probability of a violation with its bounds, and how many runs diverged or were not simulated."""
    found = summary.statistics
    sure = f"with {plain(100.0 * found.confidence, 3)} % confidence"
    lines = []
    if found.violation.runs:
        estimate = f"{chance(found.violation.estimate)}, " if found.violation.events else ""
        bounds = chances(found.violation.low, found.violation.high)
        lines.append(f"probability that a run violates a requirement: {estimate}{bounds} {sure}")
    if found.violation.events == 1:
        lines.append("one run violates it: no cause can be told")
    if found.diverged:
        lines.append(f"{count(found.diverged, 'run')} diverged, counted as violating every requirement")
    if found.not_simulated:
        verb = "is" if found.not_simulated == 1 else "are"
        lines.append(f"{count(found.not_simulated, 'run')} could not be simulated and {verb} not counted")
    return lines


def signed(correlation: float) -> str:
    """Return a rank correlation with its sign; a dash where there is none."""
    return DASH if math.isnan(correlation) else f"{correlation:+.2f}".replace("-", MINUS)


def influence_groups(summary: Summary) -> dict[str, list[Influence]]:
    """Return every requirement over all manoeuvres, and all together within each, with the inputs that matter."""
    groups: dict[str, list[Influence]] = {}
    for one in summary.influences:
        if one.manoeuvre is None or one.requirement == PASSED:
            name = requirement_name(one.requirement)
            found = groups.setdefault(name if one.manoeuvre is None else f"{name} in {one.manoeuvre}", [])
            found += [one] if one.driver or one.cause else []
    return groups


def value_name(one: Influence) -> str:
    """Return the value of an input whose runs are compared with the others."""
    if one.parameter == MANOEUVRE:
        return f"manoeuvre: {one.level}"
    if isinstance(one.level, bool):
        return one.parameter.replace("fault.", "fault: ", 1)
    return f"{one.parameter} {one.level}" if isinstance(one.level, str) else f"{one.parameter} = {plain(one.level, 3)}"


def cause_words(one: Influence) -> str:
    """Return what the counts show in a line."""
    shown = [
        f"{side.events:,} of {side.runs:,} {words} ({chances(side.low, side.high)})"
        for side, words in ((one.present, "runs with it violate a limit"), (one.absent, "without"))
    ]
    every = "; every violating run has it" if one.in_every_violation else ""
    return f"{value_name(one)}: {', '.join(shown)}{every}"


def causes(summary: Summary) -> list[Influence]:
    """Return the values that set violating runs apart, over all manoeuvres and requirements."""
    return [one for one in summary.influences if one.requirement == PASSED and one.manoeuvre is None and one.cause]


def drivers(summary: Summary) -> dict[str, list[Influence]]:
    """Return the inputs that the metrics follow over all manoeuvres, by requirement, the strongest first."""
    found: dict[str, list[Influence]] = {}
    for one in sorted(summary.influences, key=lambda one: -abs(one.correlation)):
        if one.manoeuvre is None and one.driver:
            found.setdefault(one.requirement, []).append(one)
    return found


def driver_words(requirement: str, found: Sequence[Influence]) -> str:
    """Return what drives a requirement in a line."""
    named = ", ".join(f"{one.parameter} ({signed(one.correlation)})" for one in found[:_STRONGEST])
    metric = "largest value over its limit" if requirement == PASSED else requirement_name(requirement)
    return f"{metric} is driven by {named}, rank correlations"


def worst_rows(summary: Summary, runs: Sequence[WorstRun], named: Sequence[str]) -> list[tuple[WorstRun, list[str]]]:
    """Return runs with their values and the inputs that matter, in words."""
    rows = []
    for one in runs:
        inputs = {name: item for name, item in summary.inputs_of(one.run).items() if item is not False}
        shown = [
            f"{name} {'yes' if item is True else item if isinstance(item, str) else plain(item, 3)}"
            for name in named
            if (item := inputs.get(name)) is not None
        ]
        unit = RUN_METRICS[one.requirement].unit
        words = [
            requirement_name(one.requirement).removeprefix("largest "),
            value_words(one.value, unit, one.limit),
            limit_words(one.requirement, one.limit),
            DIVERGED if math.isinf(one.ratio) else plain(one.ratio, 3),
            ", ".join(shown),
        ]
        rows.append((one, words))
    return rows


def all_drivers(summary: Summary) -> list[str]:
    """Return causes and drivers over all manoeuvres, the strongest first, the manoeuvre itself left out."""
    driving = sorted(
        (one for found in drivers(summary).values() for one in found), key=lambda one: -abs(one.correlation)
    )
    named = dict.fromkeys(one.parameter for one in (*causes(summary), *driving) if one.parameter != MANOEUVRE)
    return list(named)[:4]


def input_rows(summary: Summary) -> list[tuple[str, str]]:
    """Return the inputs that vary from run to run, in words."""
    plan = summary.plan
    total = sum(plan.weights)
    rows = [
        (f"manoeuvre: {manoeuvre.name}", f"{chance(weight / total)} of the runs")
        for manoeuvre, weight in plan.job.campaign_manoeuvres
    ]
    rows += [(one.parameter, distribution_words(one)) for one in plan.campaign.vary]
    rows += [(f"fault: {one.fault}", f"in {chance(one.probability)} of the runs") for one in plan.campaign.faults]
    return rows


def distribution_words(one: Vary) -> str:
    """Return a distribution in words."""
    parts = [f"{name} {plain(number, 6)}" for name, number in one.numbers.items()]
    parts += [" or ".join(plain(number, 6) for number in one.values)] if one.values else []
    parts += ["weights " + ", ".join(plain(number, 6) for number in one.weights)] if one.weights else []
    return f"{one.distribution}: {', '.join(parts)}{', times the nominal value' if one.relative else ''}"
