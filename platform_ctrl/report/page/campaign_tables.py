"""The results of a campaign as rows of text, for its page and for the terminal."""

from __future__ import annotations

import math
from collections.abc import Sequence

from platform_ctrl.analysis.run_metrics import RUN_METRICS
from platform_ctrl.campaign.contrasts import Contrast
from platform_ctrl.campaign.planning import Plan
from platform_ctrl.campaign.probability import Probability, RareResult
from platform_ctrl.campaign.sensitivity import Influence, Sensitivity
from platform_ctrl.campaign.summary import Summary
from platform_ctrl.campaign.table import DIVERGED, MANOEUVRE, PASSED
from platform_ctrl.campaign.table_statistics import RequirementStatistics, WorstRun
from platform_ctrl.common.text import Rounding, rounded
from platform_ctrl.common.values import value
from platform_ctrl.job.quantities import (
    BOUND,
    DASH,
    MINUS,
    added_words,
    count,
    plain,
    quantity,
    simulated_words,
    times,
)
from platform_ctrl.job.variation import Vary

ALL_MANOEUVRES = "all manoeuvres, values relative to their limits"
# Inputs that a table names for a requirement, and a line.
_MOST_DRIVERS, _STRONGEST = 8, 3


@value
class ProbabilityRow:
    """One requirement of a campaign as the tables show it."""

    # The manoeuvre, the requirement and its limit
    group: str
    requirement: str
    limit: str
    # How often it is violated
    violations: str
    probability: str
    bounds: str
    # The value that is not exceeded in half of the runs, in 99 % of them, in all
    median: str
    high_quantile: str
    largest: str
    worst: int | None  # Number of the worst run; None if none was simulated
    numbers: Probability  # Estimate and bounds as numbers


def probability_rows(summary: Summary) -> tuple[ProbabilityRow, ...]:
    """Return every requirement, over all manoeuvres first; with one manoeuvre there is no such group."""
    found = summary.statistics.requirements
    manoeuvres = {one.manoeuvre for one in found if one.manoeuvre is not None}
    return tuple(_row(one) for one in found if one.manoeuvre is not None or len(manoeuvres) > 1)


def _row(one: RequirementStatistics) -> ProbabilityRow:
    unit = "" if one.manoeuvre is None or one.requirement == PASSED else RUN_METRICS[one.requirement].unit
    shown = {share: figure_words(figure, unit, one.limit) for share, figure in one.quantiles.items()}
    return ProbabilityRow(
        group=one.manoeuvre or ALL_MANOEUVRES,
        requirement=requirement_name(one.requirement).removeprefix("largest "),
        limit=DASH if one.limit is None else limit_words(one.requirement, one.limit, relative=one.manoeuvre is None),
        violations=f"{one.violation.events:,} of {one.violation.runs:,}",
        probability=chance(one.violation.estimate),
        bounds=chances(one.violation.low, one.violation.high),
        median=shown.get(0.5, ""),
        high_quantile=shown.get(0.99, ""),
        largest="" if one.distribution is None else figure_words(one.largest, unit, one.limit),
        worst=one.worst[0].run if one.worst else None,
        numbers=one.violation,
    )


def limit_words(figure: str, limit: float, *, relative: bool = False) -> str:
    """Return a limit with its sense; `relative`: of ratios of values to their limits, which are to be at most one."""
    if relative:
        return f"{BOUND['at most']} {plain(limit)}"
    return f"{BOUND[RUN_METRICS[figure].sense]} {quantity(limit, RUN_METRICS[figure].unit, 4, limit)}"


def requirement_name(figure: str | None) -> str:
    """Return the name of a requirement."""
    return "any requirement" if figure in (None, PASSED) else RUN_METRICS[figure].name


def figure_words(figure: float, unit: str, like: float | None) -> str:
    """Return a value with its unit, in the unit that suits the limit."""
    return DIVERGED if math.isinf(figure) else quantity(figure, unit, 3, like)


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


def verdict(summary: Summary) -> str:
    """Return the verdict in a few words, with what it rests on."""
    job = summary.plan.job
    rests_on = simulated_words(job, [one for one, _ in job.campaign_manoeuvres])
    return f"{violation_words(summary)}{added_words(job.platform)}{rests_on}"


def violation_words(summary: Summary) -> str:
    """Return how many runs violate a requirement."""
    violation = summary.statistics.violation
    if violation.events:
        verb = "violates" if violation.events == 1 else "violate"
        words = f"{violation.events:,} of {count_words(violation.runs)} {verb} a requirement"
    elif violation.runs > 1:
        words = f"none of {count_words(violation.runs)} violates a requirement"
    else:
        words = "the run violates no requirement" if violation.runs else "no run was simulated"
    lost = summary.statistics.not_simulated
    return f"{words}, {count_words(lost)} could not be simulated" if lost and violation.runs else words


def campaign_words(summary: Summary | None) -> str:
    """Return what a campaign adds to the verdict on a job; nothing without one."""
    return "" if summary is None else f"campaign: {violation_words(summary)}"


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
    for rare in summary.rare:
        lines.append(f"{rare_words(rare)}, from rare events")
    if found.diverged:
        lines.append(f"{count_words(found.diverged)} diverged, counted as violating every requirement")
    if found.not_simulated:
        lines.append(f"{count_words(found.not_simulated)} could not be simulated and are not counted")
    return lines


def count_words(runs: int) -> str:
    """Return ``1 run``, ``10,000 runs``."""
    return f"{runs:,} {'run' if runs == 1 else 'runs'}"


def rare_words(rare: RareResult) -> str:
    """Return a rare event's probability in words."""
    name = requirement_name(rare.requirement)
    if not rare.reached:
        return f"{name}: never violated, probability below about {chance(rare.high)}"
    return f"{name}: violated with probability {chance(rare.probability)}, {chances(rare.low, rare.high)}"


def influence_rows(summary: Summary, one: Sensitivity) -> tuple[list[tuple[Influence, str, str, str]], list[str]]:
    """Return the influential inputs of a requirement with index, interval and rank correlation; and the other inputs.

    An input that sets the violating runs apart is not among the others, however little of the variance it explains.
    """
    drivers = [single for single in one.influences if single.driver][:_MOST_DRIVERS]
    rows = [(x, share(x.index), f"{share(x.low)} to {share(x.high)}", signed(x)) for x in drivers]
    violating = {single.parameter for single in one.violations if single.driver}
    violating |= {
        single.parameter
        for single in summary.contrasts
        if single.requirement == one.requirement and significant(single)
    }
    quiet = [single.parameter for single in one.influences if not single.driver]
    return rows, [name for name in quiet if name not in violating]


def share(index: float) -> str:
    """Return a share of variance in whole per cent, or less."""
    return f"{100.0 * index:.0f} %" if index >= 0.0095 or index == 0.0 else "< 1 %"


def signed(one: Influence) -> str:
    """Return a rank correlation with its sign; a dash for words."""
    if math.isnan(one.rank_correlation):
        return DASH
    return f"{one.rank_correlation:+.2f}".replace("-", MINUS)


def significant(one: Contrast) -> bool:
    """Return whether the counts show that a value sets the violating runs apart: of one run nothing does."""
    return one.driver and one.present.events + one.absent.events > 1


def shared_by_all(one: Contrast) -> bool:
    """Return whether a value that sets violating runs apart is that of every run that violates anything."""
    return significant(one) and one.requirement == PASSED and one.manoeuvre is None and one.in_every_violation


def contrast_groups(summary: Summary) -> list[tuple[str, list[Contrast]]]:
    """Return all contrasts over all manoeuvres, and the significant ones within a manoeuvre, of any requirement."""
    groups: dict[str | None, list[Contrast]] = {}
    for one in summary.contrasts:
        violated = one.present.events + one.absent.events > 0
        if one.requirement == PASSED and violated and (one.manoeuvre is None or significant(one)):
            groups.setdefault(one.manoeuvre, []).append(one)
    names = {one.name for one, _ in summary.plan.job.campaign_manoeuvres}
    overall = "All manoeuvres" if len(names) > 1 else "".join(names)
    return [(manoeuvre or overall, found) for manoeuvre, found in groups.items()]


def contrast_name(one: Contrast) -> str:
    """Return the value of an input whose runs are compared with the others."""
    if one.parameter == MANOEUVRE:
        return f"manoeuvre: {one.level}"
    if isinstance(one.level, bool):
        return one.parameter.replace("fault.", "fault: ", 1)
    return f"{one.parameter} = {input_words(one.level)}"


def contrast_words(one: Contrast) -> str:
    """Return a contrast in a line."""
    shown = [
        f"{side.events:,} of {side.runs:,} {words} ({chances(side.low, side.high)})"
        for side, words in ((one.present, "runs with it violate a limit"), (one.absent, "without"))
    ]
    every = "; every violating run has it" if one.in_every_violation else ""
    return f"{contrast_name(one)}: {', '.join(shown)}{every}"


def causes(summary: Summary, figure: str = PASSED) -> list[Contrast]:
    """Return the values that set violating runs apart significantly, over all manoeuvres."""
    return [
        one for one in summary.contrasts if one.requirement == figure and one.manoeuvre is None and significant(one)
    ]


def short_drivers(one: Sensitivity) -> str:
    """Return the strongest drivers in a line."""
    return _strongest(one.influences) or "no significant input"


def violation_drivers(one: Sensitivity) -> str:
    """Return the strongest drivers of a limit's violations in a line; empty where they are not known."""
    return _strongest(one.violations)


def drivers_of(one: Sensitivity) -> list[str]:
    """Return the influential inputs of a requirement, the strongest first."""
    return [single.parameter for single in _driving(one.influences)]


def _strongest(found: Sequence[Influence]) -> str:
    return ", ".join(f"{single.parameter} {share(single.index)}" for single in _driving(found)[:_STRONGEST])


def _driving(found: Sequence[Influence]) -> list[Influence]:
    return [single for single in found if single.driver and single.index >= 0.005]


def worst_rows(summary: Summary, runs: Sequence[WorstRun], drivers: Sequence[str]) -> list[tuple[WorstRun, list[str]]]:
    """Return runs with their values and the inputs that matter, in words."""
    rows = []
    for one in runs:
        inputs = summary.inputs_of(one.run)
        shown = [
            f"{name} {input_words(inputs[name])}" for name in drivers if name in inputs and inputs[name] is not False
        ]
        unit = RUN_METRICS[one.requirement].unit
        words = [
            requirement_name(one.requirement).removeprefix("largest "),
            figure_words(one.value, unit, one.limit),
            limit_words(one.requirement, one.limit),
            DIVERGED if math.isinf(one.ratio) else plain(one.ratio, 3),
            ", ".join(shown),
        ]
        rows.append((one, words))
    return rows


def input_words(item: float | bool | str) -> str:
    """Return one input of a run."""
    if isinstance(item, bool):
        return "yes" if item else "no"
    return item if isinstance(item, str) else plain(item, 3)


def all_drivers(summary: Summary) -> list[str]:
    """Return the inputs that drive anything over all manoeuvres, the strongest first, the manoeuvre itself left out."""
    strongest: dict[str, float] = {}
    for one in summary.sensitivities:
        for single in (*one.influences, *one.violations):
            if one.manoeuvre is None and single.driver and single.parameter != MANOEUVRE:
                strongest[single.parameter] = max(strongest.get(single.parameter, 0.0), single.index)
    rare = dict.fromkeys(one.parameter for one in causes(summary) if one.parameter != MANOEUVRE)
    return list(dict.fromkeys([*rare, *sorted(strongest, key=lambda name: -strongest[name])]))[:4]


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


_DISTRIBUTIONS = {
    "uniform": "uniform, {low} to {high}",
    "log-uniform": "log-uniform, {low} to {high}",
    "normal": "normal, {mean} with deviation {deviation}",
    "truncated-normal": "normal, {mean} with deviation {deviation}, within {low} to {high}",
    "log-normal": "log-normal, median {median}, deviation of the logarithm {deviation}",
    "triangular": "triangular, {low} to {high}, peak at {peak}",
}


def distribution_words(one: Vary) -> str:
    """Return a distribution in words."""
    words = _DISTRIBUTIONS.get(one.distribution, "one of {values}").format(
        **{name: plain(number, 6) for name, number in one.numbers.items()},
        values=", ".join(plain(number, 6) for number in one.values),
    )
    if one.weights:
        words += ", weights " + ", ".join(plain(number, 6) for number in one.weights)
    return f"{words}, times the nominal value" if one.relative else words


def ending_rows(summary: Summary) -> list[tuple[str, str, str]]:
    """Return how runs ended: words, number, share."""
    found = summary.statistics
    return [(words, f"{runs:,}", chance(runs / found.runs)) for words, runs in found.endings.items()]


def moved(plan: Plan, rare: RareResult, most: int = 8) -> list[tuple[str, float]]:
    """Return the inputs whose means differ most in violating runs, in standard deviations; faults towards occurrence.

    Manoeuvres have no order and are left out.
    """
    faults = {f"fault.{one.fault}" for one in plan.campaign.faults}
    named = zip(plan.input_names, rare.shift.tolist(), strict=True)
    shifts = [(name, -shift if name in faults else shift) for name, shift in named if name != MANOEUVRE]
    return sorted(shifts, key=lambda item: -abs(item[1]))[:most] if rare.violations else []


def moved_words(plan: Plan, rare: RareResult) -> str:
    """Return those that differ by half a standard deviation or more, in a line."""
    shown = [(name, shift) for name, shift in moved(plan, rare, 4) if abs(shift) >= 0.5]
    return ", ".join(f"{name} {shift:+.1f} σ".replace("-", MINUS) for name, shift in shown)


def rare_rows(rare: RareResult) -> list[tuple[str, str]]:
    """Return the results of the search for a rare event: name and words."""
    rows = [
        ("probability", chance(rare.probability) if rare.reached else "not reached"),
        (f"{plain(100.0 * rare.confidence, 3)} % interval", chances(rare.low, rare.high)),
    ]
    if math.isfinite(rare.variation):
        rows.append(("coefficient of variation", plain(rare.variation, 2)))
    rows += [
        ("method", "importance splitting" + (" and weighted runs" if rare.method == "cross-entropy" else "")),
        ("repetitions", f"{count(len(rare.repetitions), 'repetition')}, {rare.reached} reached the limit"),
        ("runs simulated", f"{rare.evaluations:,}"),
    ]
    if rare.noise_decides:
        few = sorted(one.noises for one in rare.repetitions)[len(rare.repetitions) // 2]
        words = f"violating runs share {count(few, 'realisation')} of it, so that the interval is too narrow"
        rows.append(("noise", f"{words}; simulate more runs per level"))
    return rows
