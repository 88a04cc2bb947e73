"""The result of a line of sight's budget, its limits, and its steps from the largest source to the total."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from platform_ctrl.analysis.dry_friction import FrictionBalance
from platform_ctrl.analysis.metrics import BUDGET_METRICS
from platform_ctrl.common.values import FloatArray, replaced, value
from platform_ctrl.job.budget import BudgetSpec
from platform_ctrl.job.job import Job
from platform_ctrl.job.judging import CheckResult, Requirement
from platform_ctrl.plant.sensors import LOS_ANGLES

# A step that is smaller than this share of the total is added to those of the others, so are those beyond so many.
_SMALL, _STEPS = 1e-3, 8
# Shares that count as zero: rounding, and what is left of two budgets that were integrated apart.
_ROUNDING, _COMMON = 1e-12, 1e-4
# Names of limits that runs of the budget judge where the linear one cannot.
_OF_RUNS = (BUDGET_METRICS["jitter"].name, BUDGET_METRICS["jitter_per_axis"].name)
# Of a picture: a limit whose mean square is more than so many times the total is left out; room at the right, and
# between the numbers of the axis, in its length.
_FAR, _BEYOND, _APART = 4.0, 1.06, 0.15


@value
class WindowBudget:
    """The line of sight within an exposure; rows are the two axes across it and the rotation about it, rad.

    Attributes
    ----------
    exposure
        s.
    displacement, smear, jitter : (3,)
        Rms of the mean, of the extent of the fitted line from end to end, and of what is left about that line, rad.
    about_mean : (3,)
        Rms about the mean, smear included, rad.
    contrast : (2, f)
        Modulation transfer function of the motion across at the budget's spatial frequencies, dimensionless.
    """

    exposure: float
    displacement: FloatArray
    smear: FloatArray
    jitter: FloatArray
    about_mean: FloatArray
    contrast: FloatArray


# What the totals of its tables and plots are called: limits are judged at the worst of the job's angles.
TOGETHER = "all together, angles zero"


@value
class LineOfSightBudget:
    """What each source does to the line of sight.

    Attributes
    ----------
    names, kinds
        Of the sources: those of the job, then the noise and quantisation of sensors.
    axes
        Names of the outputs: the two angles across the line of sight, and the rotation about it.
    rms : (sources, 3)
        In the band of the budget, rad.
    total : (3,)
        Of all sources together, correlations included, rad.
    windows
        One for each exposure.
    frequencies_hz : (k,)
        Up to which `cumulative` sums, Hz.
    cumulative : (sources, 3, k)
        Mean square of each source up to these frequencies, in rad · rad.
    total_cumulative : (3, k)
        The same of all sources together, in rad · rad.
    friction
        Rates and equivalent dampings of the bearings with dry friction.
    results
        The budget's limits compared with these.
    """

    names: tuple[str, ...]
    kinds: tuple[str, ...]
    axes: tuple[str, ...]
    rms: FloatArray
    total: FloatArray
    windows: tuple[WindowBudget, ...]
    frequencies_hz: FloatArray
    cumulative: FloatArray
    total_cumulative: FloatArray
    friction: FrictionBalance
    results: tuple[CheckResult, ...]

    @property
    def jitter(self) -> float:
        """Rms of both axes across the line of sight together, rad."""
        return across(self.total)

    @property
    def shares(self) -> FloatArray:
        """Mean square of each source over that of all (sources, 3), dimensionless; zero where nothing moves."""
        every = self.total**2
        return np.asarray(np.divide(self.rms**2, every, out=np.zeros_like(self.rms), where=every > 0.0))

    @property
    def ranking(self) -> tuple[int, ...]:
        """Places of the sources that move the line of sight, the largest across it first."""
        size = np.hypot(self.rms[:, 0], self.rms[:, 1])
        return tuple(int(k) for k in np.argsort(-size, kind="stable") if size[k] > 0.0)

    @property
    def passed(self) -> bool:
        """Whether every limit is kept."""
        return all(one.passed for one in self.results)


@value
class SimulatedBudget:
    """Jitter of the line of sight in runs of the non-linear plant, and the linear budget of the same sources.

    Attributes
    ----------
    runs, seed
        Number of runs; they are numbered from 0, and their noise and phases are drawn from the seed and the number.
    time, settle
        Length over which the line of sight is observed, after `settle`, s.
    rms, low, high : (3,)
        Rms about the mean within that time, by axis, and its 95 % interval by the spread of the runs, rad.
    linear : (3,)
        The same by the linear budget, rad.
    left_out
        A line for everything that the runs do not have.
    """

    runs: int
    seed: int
    time: float
    settle: float
    rms: FloatArray
    low: FloatArray
    high: FloatArray
    linear: FloatArray
    left_out: tuple[str, ...]

    @property
    def ratio(self) -> float:
        """Simulated over linear rms of both axes across the line of sight together, dimensionless."""
        return across(self.rms) / across(self.linear)


@value
class Waterfall:
    """Mean squares that add up to a total, the largest first.

    Attributes
    ----------
    axis
        Name of the axis, or ``"both axes"`` across the line of sight.
    names : k texts
        Of the sources; last what is left: the smallest sources together, and what correlated ones have in common.
    places : k integers
        Of the sources in the budget; None for what is left.
    low, high : (k,)
        Sum before and after each source, rad · rad; `high` is smaller where sources cancel each other.
    total
        Rms of all, rad.
    limit
        The job's, rad; None: no limit.
    """

    axis: str
    names: tuple[str, ...]
    places: tuple[int | None, ...]
    low: FloatArray
    high: FloatArray
    total: float
    limit: float | None

    @property
    def rms(self) -> FloatArray:
        """Rms of each step (k,), rad; negative where sources cancel each other."""
        step = self.high - self.low
        return np.asarray(np.sign(step) * np.sqrt(np.abs(step)))

    @property
    def shares(self) -> FloatArray:
        """Each step over the total (k,), dimensionless; zero where nothing moves."""
        return (self.high - self.low) / self.total**2 if self.total > 0.0 else np.zeros(len(self.names))

    @property
    def end(self) -> float:
        """Mean square at the right end of a picture, rad · rad: the limit is inside where the sources would be seen."""
        size = max(float(self.high.max(initial=0.0)), self.total**2) or 1e-24
        near = self.limit is not None and self.limit**2 < _FAR * size
        return _BEYOND * max(size, self.limit**2 if near and self.limit is not None else 0.0)

    @property
    def limit_inside(self) -> bool:
        """Whether the limit lies in the picture."""
        return self.limit is not None and self.limit**2 < self.end


def rms_ticks(end: float) -> FloatArray:
    """Return round rms for an axis of mean squares from 0 to `end`, whose unit is squared, with room for numbers."""
    most = math.sqrt(end)
    decade = 10.0 ** math.floor(math.log10(most / 4.0))
    step = next(k * decade for k in (1.0, 2.0, 5.0, 10.0) if k * decade >= most / 8.0)
    kept: list[float] = []
    for one in np.arange(math.floor(most / step), 0, -1) * step:
        if not kept or kept[-1] ** 2 - one**2 > _APART * end:
            kept.append(float(one))
    return np.array([0.0, *(one for one in kept[::-1] if one**2 > _APART * end)])


def waterfall(budget: BudgetSpec, found: LineOfSightBudget, axis: int | None = None) -> Waterfall:
    """Return how the sources add up to the motion of the line of sight.

    Parameters
    ----------
    budget
        The job's, for its limits.
    found
        What the sources do.
    axis
        Place in its `axes`; None: both axes across the line of sight together.

    Returns
    -------
    Waterfall
        Its last sum is the total.
    """
    axes = [0, 1] if axis is None else [axis]
    each = np.sum(found.rms[:, axes] ** 2, axis=1)
    total = float(np.sum(found.total[axes] ** 2))
    order = np.argsort(-each, kind="stable")
    shown = [int(k) for k in order if each[k] > _SMALL * total]
    if len(shown) > _STEPS:
        shown = shown[: _STEPS - 1]
    steps: list[tuple[str, int | None, float]] = [(found.names[k], k, float(each[k])) for k in shown]
    others = [int(k) for k in order if k not in shown and each[k] > 0.0]
    rest = float(each[others].sum())
    if rest > _ROUNDING * total:
        one = (found.names[others[0]], others[0]) if len(others) == 1 else (f"{len(others)} others", None)
        steps.append((*one, rest))
    common = total - float(each.sum())
    if abs(common) > _COMMON * total:
        steps.append(("correlation", None, common))
    sums = np.cumsum([0.0, *(step for _, _, step in steps)])
    return Waterfall(
        axis="both axes" if axis is None else found.axes[axis],
        names=tuple(name for name, _, _ in steps),
        places=tuple(place for _, place, _ in steps),
        low=sums[:-1],
        high=sums[1:],
        total=math.sqrt(total),
        limit=budget.limits.jitter if axis is None else budget.limits.jitter_per_axis,
    )


def waterfalls(budget: BudgetSpec, found: LineOfSightBudget) -> tuple[Waterfall, ...]:
    """Return those of both axes across the line of sight, and of both together, as plots show them."""
    return tuple(waterfall(budget, found, axis) for axis in (0, 1, None))


_GAUSSIAN = "sines count as Gaussian"
LINE_OF_SIGHT = "line of sight"  # subject of what is required of it


def across(rms: FloatArray) -> float:
    """Return the rms of both axes across the line of sight together, rad."""
    return float(math.hypot(rms[0], rms[1]))


def assumption(friction: FrictionBalance, where: str, sines: bool = False) -> str:
    """Return what verdicts rest on, in words; `sines`: whether the budget has some."""
    fed = " less what is fed forward" if any(one is not None for one in friction.drives) else ""
    unsure = [words for words, holds in zip(friction.statement, friction.valid, strict=True) if not holds]
    dry = f", with dry friction{fed}" if friction.frictions else ""
    if np.any((friction.bristles[1] > 0.0) & (friction.resting == 0.0)):
        dry += " of bristles that give way, with which runs show up to a quarter more"
    unsure += [_GAUSSIAN] if sines and friction.frictions else []
    return "; ".join([f"linear budget{f' at {where}' if where else ''}{dry}", *unsure])


def judged(
    budget: BudgetSpec,
    rms: FloatArray,
    total: FloatArray,
    windows: Sequence[WindowBudget],
    linear: str,
    valid: bool = True,
) -> tuple[CheckResult, ...]:
    """Return the limits compared with the budget; `linear` is what the values rest on.

    Of a budget that is not `valid` none is met: see `by_simulation`.
    """
    worst = int(np.argmax(total[:2]))
    measured: dict[tuple[str, str], tuple[float, str]] = {
        ("jitter", ""): (across(total), f"both axes, {linear}"),
        ("jitter_per_axis", ""): (float(total[worst]), f"{LOS_ANGLES[worst]}, {linear}"),
    }
    for key, of in (("windowed_jitter", "about_mean"), ("smear", "smear")):
        if windows:
            found, exposure = max((across(getattr(one, of)), one.exposure) for one in windows)
            measured[key, ""] = (found, f"exposure {exposure:g} s, both axes, {linear}")
    if windows and budget.spatial_frequencies:
        found, exposure, axis, nu = min(
            (float(one.contrast[k, j]), one.exposure, LOS_ANGLES[k], nu)
            for one in windows
            for k in (0, 1)
            for j, nu in enumerate(budget.spatial_frequencies)
        )
        # The MTF of a large sine alone is less.
        of = f"{linear}; {_GAUSSIAN}" if budget.has_sines and _GAUSSIAN not in linear else linear
        measured["contrast", ""] = (found, f"{nu:g} cycles/rad, exposure {exposure:g} s, {axis}, {of}")
    for source, own in zip(budget.sources, rms, strict=False):
        measured["limit", source.name] = (across(own), f"both axes, {linear}")
    judgements = [
        one.judge(measured[key][0], subject=LINE_OF_SIGHT, stage="coupled", evidence=measured[key][1], method="exact")
        for key, one in budget_requirements(budget)
    ]
    return tuple(judgements) if valid else tuple(_not_valid(one) for one in judgements)


def _not_valid(one: CheckResult) -> CheckResult:
    cure = "feed the friction forward, or limit the jitter, which runs of [budget] show"
    if one.name in _OF_RUNS:
        cure = "state runs in [budget], or a limit of a manoeuvre"
    return replaced(
        one,
        {
            "valid": False,
            "ratio": math.inf,
            "passed": False,
            "evidence": f"{one.evidence}; not met by a value that does not hold: {cure}",
            "reason": f"with this dry friction the linear budget does not hold: {cure}",
        },
    )


def left_to_runs(one: CheckResult, budget: BudgetSpec | None) -> bool:
    """Return whether `check` judges a limit by the runs of the budget, as the linear budget cannot: `by_simulation`."""
    return budget is not None and bool(budget.runs) and one.name in _OF_RUNS and not one.valid


def by_simulation(results: Sequence[CheckResult], simulated: SimulatedBudget) -> tuple[CheckResult, ...]:
    """Return limits that a linear budget cannot decide, judged by runs where these show them."""
    axis = int(np.argmax(simulated.rms[:2]))
    both, single = BUDGET_METRICS["jitter"], BUDGET_METRICS["jitter_per_axis"]
    found = {
        both.name: (both, across(simulated.rms), across(simulated.high), "both axes"),
        single.name: (single, float(simulated.rms[axis]), float(simulated.high[axis]), LOS_ANGLES[axis]),
    }
    out = []
    for one in results:
        if one.valid or one.name not in found:
            out.append(one)
            continue
        metric, rms, high, axes = found[one.name]
        evidence = (
            f"{axes}, {simulated.runs} runs of {simulated.time:g} s, at most {high:.4g} {one.unit} with 95 %, about "
            f"the mean; the linear budget, {one.value:.4g} {one.unit}, does not hold"
        )
        limit = Requirement.of(metric, one.limit)
        out.append(limit.judge(rms, subject=one.subject, stage="simulated", evidence=evidence, method="simulated"))
    return tuple(out)


def budget_requirements(budget: BudgetSpec | None) -> list[tuple[tuple[str, str], Requirement]]:
    """Return the limits with their keys and the names of the sources that they are of, if they are of one."""
    out: list[tuple[tuple[str, str], Requirement]] = []
    if budget is None:
        return out
    for key, metric in BUDGET_METRICS.items():
        of = [("", "", getattr(budget.limits, key, None))]
        if key == "limit":
            of = [(one.name, f"{metric.name} from {one.name}", one.limit) for one in budget.sources]
        out += [((key, source), Requirement.of(metric, limit, name)) for source, name, limit in of if limit is not None]
    return out


def unstable_results(job: Job, reason: str = "the loop is not stable") -> tuple[CheckResult, ...]:
    """Return the limits of a job's budget, not met for a reason that leaves no budget; none where none are stated."""
    return tuple(
        replaced(
            one.judge(
                BUDGET_METRICS[key].worst,
                subject=LINE_OF_SIGHT,
                stage="coupled",
                evidence=reason,
                method="exact",
            ),
            {"reason": reason},
        )
        for (key, _), one in budget_requirements(job.budget)
    )
