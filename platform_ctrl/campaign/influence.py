"""What inputs do to an output, from runs that are there: first-order indices, and whether it may be chance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from platform_ctrl.arguments import real_numbers
from platform_ctrl.campaign.table import Array
from platform_ctrl.errors import ArgumentError
from platform_ctrl.frozen import FloatArray, value
from platform_ctrl.signatures import short

# An input is called a driver if noise would look like it in fewer than this share of campaigns, over all inputs.
SIGNIFICANCE = 0.01
# Groups of runs that are left out in turn.
_GROUPS = 20
# So few events are too few for what holds for many.
_FEW_EVENTS = 50
_PERMUTATIONS = 9999


@value
class Influence:
    """What one input does to one figure.

    Attributes
    ----------
    parameter
        Name of the input.
    index, low, high
        First-order Sobol index: the share of the figure's variance that the input explains on its own, and its 95 %
        interval (jackknife).
    rank_correlation
        Spearman's, −1 to 1, dimensionless: the direction of a monotone influence. NaN for words (which manoeuvre).
    p_value
        Probability that an input without influence looks like this, all inputs of the figure together (Holm).

    References
    ----------
    As `influences`.
    """

    parameter: str
    index: float
    low: float
    high: float
    rank_correlation: float
    p_value: float

    @property
    def driver(self) -> bool:
        """Whether chance alone is no explanation."""
        return bool(self.p_value < SIGNIFICANCE)


def influences(inputs: Mapping[str, ArrayLike], output: ArrayLike) -> tuple[Influence, ...]:
    """Return what each input does to `output`, the strongest first.

    Parameters
    ----------
    inputs
        Columns (N,) of numbers in any unit, of yes and no, or of words; independent of each other, drawn as the
        campaign draws them.
    output : (N,)
        The figure, finite, in any unit.

    Returns
    -------
    tuple of Influence
        The strongest first.

    Raises
    ------
    ArgumentError
        The columns do not have one length, or the output is not finite.

    Notes
    -----
    The index: the variance of the output's means over classes of equal numbers of runs along the input, with the share
    that classes of noise would have taken off (the ε² of an analysis of variance), over the whole variance; its
    interval by leaving out one of 20 groups of runs at a time. Significance: Kruskal and Wallis's test over the same
    classes and Spearman's, the smaller of the two doubled, then Holm's rule over the inputs; both tests go by ranks and
    need no normal output. Of an output that has two values, one of them seldom, both are made by permutation.

    References
    ----------
    I. M. Sobol, Mathematics and Computers in Simulation 55, 2001.

    T. L. Kelley, Proceedings of the National Academy of Sciences 21, 1935.

    W. H. Kruskal, W. A. Wallis, Journal of the American Statistical Association 47, 1952.

    S. Holm, Scandinavian Journal of Statistics 6, 1979.
    """
    if not isinstance(inputs, Mapping):
        raise ArgumentError(f"inputs: given {short(inputs)}; expected a dictionary of columns")
    yes_or_no = isinstance(output, np.ndarray) and output.dtype.kind == "b"
    y = real_numbers("output", np.asarray(output, dtype=np.float64) if yes_or_no else output)
    columns = {name: np.asarray(column) for name, column in inputs.items()}
    for name, column in columns.items():
        if column.shape != y.shape or y.ndim != 1:
            raise ArgumentError(f"input {name!r}: given shape {column.shape}; expected that of the output, {y.shape}")
    if not np.isfinite(y).all():
        raise ArgumentError("output: given a number that is not finite; expected finite ones, or their ranks")
    from scipy import stats

    ranks = stats.rankdata(y)
    events = _events(y)
    singles = []
    for name, column in columns.items():
        kind, numeric = _classes(column, len(events) or len(y))
        if kind.max(initial=0) == 0:
            continue  # the same in every run
        own = stats.rankdata(column.astype(np.float64)) if numeric else None
        correlation = np.nan if own is None else _correlation(own, ranks)
        few = 0 < len(events) <= _FEW_EVENTS
        p = _permuted_p_value(kind, own, events) if few else _p_value(kind, ranks, correlation)
        singles.append((name, kind, correlation, p))
    adjusted = holm([p for *_, p in singles])
    out = []
    for (name, kind, correlation, _), p in zip(singles, adjusted, strict=True):
        index, low, high = _first_order(kind, y)
        out.append(
            Influence(parameter=name, index=index, low=low, high=high, rank_correlation=correlation, p_value=float(p))
        )
    return tuple(sorted(out, key=lambda one: (-one.index, one.parameter)))


def _classes(column: Array, events: int) -> tuple[NDArray[np.intp], bool]:
    """Return each run's class along an input, and whether the input has an order.

    Few different values are a class each. Otherwise classes of equal size: enough to follow the input, few enough
    that each has runs to average over (and rare events to count).
    """
    if column.dtype.kind not in "biuf":
        return np.unique(column.astype(str), return_inverse=True)[1].astype(np.intp), False
    values, place = np.unique(column, return_inverse=True)
    number = int(np.clip(min(np.sqrt(len(column)) / 2.0, events / 5.0), 2, 50))
    if len(values) <= number:
        return place.astype(np.intp), True
    # Equal values stay together: a class ends where a value does.
    return np.asarray(
        (number * np.searchsorted(np.sort(column), column, side="left")) // len(column), dtype=np.intp
    ), True


def _first_order(kind: NDArray[np.intp], y: FloatArray) -> tuple[float, float, float]:
    classes, N = int(kind.max()) + 1, len(y)
    group = np.arange(N) * _GROUPS // N if N >= 2 * _GROUPS else np.arange(N)
    groups = int(group.max()) + 1
    y = y - y.mean()
    place = group * classes + kind
    number = np.bincount(place, minlength=groups * classes).reshape(groups, classes).astype(np.float64)
    total = np.bincount(place, y, minlength=groups * classes).reshape(groups, classes)
    square = np.bincount(group, y * y, minlength=groups)
    whole = _corrected(number.sum(axis=0), total.sum(axis=0), square.sum())
    without = np.array(
        [
            _corrected(number.sum(axis=0) - number[g], total.sum(axis=0) - total[g], square.sum() - square[g])
            for g in range(groups)
        ]
    )
    error = float(np.sqrt((groups - 1) / groups * ((without - without.mean()) ** 2).sum()))
    return float(np.clip(whole, 0.0, 1.0)), max(whole - 1.96 * error, 0.0), min(max(whole + 1.96 * error, 0.0), 1.0)


def _corrected(number: FloatArray, total: FloatArray, square: float) -> float:
    """Return the share of variance between classes, less what classes of noise would have."""
    N, classes = number.sum(), int((number > 0).sum())
    variance = square - total.sum() ** 2 / N
    if variance <= 0.0 or classes >= N:
        return 0.0
    between = float((total[number > 0] ** 2 / number[number > 0]).sum() - total.sum() ** 2 / N)
    return float(1.0 - (1.0 - between / variance) * (N - 1.0) / (N - classes))


def _correlation(own: FloatArray, ranks: FloatArray) -> float:
    """Return the correlation of ranks; 0 with an output that is the same in every run."""
    if (ranks == ranks[0]).all():
        return 0.0
    return float(np.corrcoef(own, ranks)[0, 1])


def _p_value(kind: NDArray[np.intp], ranks: FloatArray, correlation: float) -> float:
    """Return the smaller p of both tests, doubled where there are two."""
    from scipy import stats

    N = len(ranks)
    number = np.bincount(kind).astype(np.float64)
    total = np.bincount(kind, ranks - ranks.mean())
    scatter = float(((ranks - ranks.mean()) ** 2).sum())
    if scatter == 0.0:
        return 1.0
    filled = number > 0
    statistic = (N - 1.0) * float((total[filled] ** 2 / number[filled]).sum()) / scatter
    by_class = float(stats.chi2.sf(statistic, int(filled.sum()) - 1))
    if np.isnan(correlation) or N < 3:
        return by_class
    monotone = float(2.0 * stats.norm.sf(abs(correlation) * np.sqrt(N - 1.0)))
    return min(1.0, 2.0 * min(by_class, monotone))


def _events(y: FloatArray) -> NDArray[np.intp]:
    """Return which runs have the rarer of two values; none where there are more values."""
    values, number = np.unique(y, return_counts=True)
    return np.flatnonzero(y == values[number.argmin()]) if len(values) == 2 else np.zeros(0, dtype=np.intp)


def _permuted_p_value(kind: NDArray[np.intp], ranks: FloatArray | None, events: NDArray[np.intp]) -> float:
    """Return the same for few events, against as many runs drawn at random."""
    N, m = len(kind), len(events)
    drawn = np.vstack([events, np.random.default_rng(0).integers(0, N, (_PERMUTATIONS, m))])
    classes = int(kind.max()) + 1
    place = kind[drawn] + classes * np.arange(len(drawn))[:, None]
    number = np.bincount(place.ravel(), minlength=classes * len(drawn)).reshape(len(drawn), classes)
    expected = m * np.bincount(kind, minlength=classes) / N
    found = [((number - expected) ** 2 / np.maximum(expected, 1e-300)).sum(axis=1)]
    if ranks is not None:
        found.append(np.abs((ranks - ranks.mean())[drawn].sum(axis=1)))
    p = min(float((one >= one[0] * (1.0 - 1e-9)).mean()) for one in found)
    return min(1.0, len(found) * p)


def holm(p_values: Sequence[float]) -> FloatArray:
    """Return p-values of several tests, each as large as it has to be for all of them together."""
    p = np.asarray(p_values, dtype=np.float64)
    order = np.argsort(p)
    adjusted = np.maximum.accumulate(np.minimum((len(p) - np.arange(len(p))) * p[order], 1.0))
    out = np.empty_like(p)
    out[order] = adjusted
    return out
