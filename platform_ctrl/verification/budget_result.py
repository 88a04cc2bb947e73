"""The result of a line of sight's budget, and its steps from the largest source to the total."""

from __future__ import annotations

import math

import numpy as np

from platform_ctrl.analysis.budget_result import variance_shares
from platform_ctrl.analysis.dry_friction import FrictionBalance
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.job.budget import Budget
from platform_ctrl.job.judging import CheckResult
from platform_ctrl.verification.budget_limits import across

# A step that is smaller than this share of the total is added to those of the others, so are those beyond so many.
_SMALL, _STEPS = 1e-3, 8
# Shares that are none: rounding, and what is left of two budgets that were integrated apart.
_ROUNDING, _COMMON = 1e-12, 1e-4
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
        Rates and equivalent dampings of bearings with dry friction; None where there is none.
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
    friction: FrictionBalance | None
    results: tuple[CheckResult, ...]

    @property
    def jitter(self) -> float:
        """Rms of both axes across the line of sight together, rad."""
        return across(self.total)

    @property
    def shares(self) -> FloatArray:
        """Mean square of each source over that of all (sources, 3), dimensionless; zero where nothing moves."""
        return variance_shares(self.rms, self.total)

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


def waterfall(budget: Budget, found: LineOfSightBudget, axis: int | None = None) -> Waterfall:
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


def waterfalls(budget: Budget, found: LineOfSightBudget) -> tuple[Waterfall, ...]:
    """Return those of both axes across the line of sight, and of both together, as plots show them."""
    return tuple(waterfall(budget, found, axis) for axis in (0, 1, None))
