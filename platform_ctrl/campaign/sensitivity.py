"""Which input drives which requirement: estimated from the runs there are, none are simulated for it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from platform_ctrl.analysis.run_metrics import RUN_METRICS, over_limit
from platform_ctrl.campaign.probability import SIGNIFICANCE, holm
from platform_ctrl.campaign.table import (
    ENDED,
    MANOEUVRE,
    PASSED,
    RUN,
    Array,
    Table,
    batches,
    codes,
    column_names,
    input_names,
    was_simulated,
)
from platform_ctrl.campaign.table_statistics import Limits, in_order, limits_of
from platform_ctrl.common.arguments import real_numbers
from platform_ctrl.common.signatures import check_arguments, short
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError

# Groups of runs that are left out in turn.
_GROUPS = 20
# So few events are too few for what holds for many.
_FEW_EVENTS = 50
_PERMUTATIONS = 9999


@value
class Influence:
    """What one input does to one metric.

    Attributes
    ----------
    parameter
        Name of the input.
    index, low, high
        First-order Sobol index: the share of the metric's variance that the input explains on its own, and its 95 %
        interval (jackknife).
    rank_correlation
        Spearman's, −1 to 1, dimensionless: the direction of a monotone influence. NaN for words (which manoeuvre).
    p_value
        Probability that an input without influence looks like this, all inputs of the metric together (Holm).
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
        The metric, finite, in any unit.

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
        raise ArgumentError(f"inputs must be a dictionary of columns, got {short(inputs)}")
    yes_or_no = isinstance(output, np.ndarray) and output.dtype.kind == "b"
    y = real_numbers("output", np.asarray(output, dtype=np.float64) if yes_or_no else output)
    columns = {name: np.asarray(column) for name, column in inputs.items()}
    for name, column in columns.items():
        if column.shape != y.shape or y.ndim != 1:
            raise ArgumentError(f"input {name!r} must have the shape of the output, {y.shape}, got {column.shape}")
    if not np.isfinite(y).all():
        raise ArgumentError("output must be finite numbers, or their ranks, got one that is not finite")
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


# Runs that are looked at: the first ones of the campaign, in whatever order the table has them.
MOST_RUNS = 1 << 16
# Fewer violations than this say nothing about what causes them.
_FEWEST_EVENTS = 5
_FEWEST_RUNS = 16
# Where a hundredth of the runs has this share of the variance, the metric's ranks stand for it: what drives a few runs
# to a hundred times the limit says nothing of the others, and is seen in whether they violate anything.
_TAIL, _TAIL_SHARE = 0.01, 0.5


@value
class Sensitivity:
    """What drives one requirement.

    Attributes
    ----------
    requirement
        Name of the limit, or ``"passed"``: whether a run violates anything at all.
    manoeuvre
        Within this manoeuvre alone; None: over all, where the manoeuvre is an input like the others.
    runs
        How many were looked at.
    ranked
        Whether the metric's ranks stand for it, because some runs diverged or a few have most of its variance.
    influences
        All inputs, the strongest first.
    violations
        Likewise on whether this limit is violated; empty where fewer than five runs do, or do not. What sends a few
        runs beyond the limit may be nothing to the others.
    """

    requirement: str
    manoeuvre: str | None
    runs: int
    ranked: bool
    influences: tuple[Influence, ...]
    violations: tuple[Influence, ...] = ()


@check_arguments
def sensitivities(table: Table, limits: Limits, *, inputs: Sequence[str] | None = None) -> tuple[Sensitivity, ...]:
    """Return what drives each requirement, over all manoeuvres and within each.

    Over manoeuvres with different limits a metric counts relative to its limit. The first 65,536 runs are looked at, so
    that the memory needed does not grow with a campaign. Arguments and errors are those of `contrasts`.
    """
    names = tuple(input_names(table) if inputs is None else inputs)
    data = _first_runs(table, names)
    known: dict[str, int] = {}
    place = codes(data[MANOEUVRE], known)
    found = []
    for manoeuvre in (None, *(in_order(known, limits) if len(known) > 1 else ())):
        chosen = np.ones(len(place), dtype=bool) if manoeuvre is None else place == known[manoeuvre]
        given = [name for name in names if manoeuvre is None or name != MANOEUVRE]
        for requirement in (*RUN_METRICS, PASSED):
            if requirement in data:
                output, limited = _output(data, requirement, manoeuvre, known, place, limits)
                rows = chosen & limited
                found.append(
                    _sensitivity(requirement, manoeuvre, {name: data[name][rows] for name in given}, output[rows])
                )
    return tuple(one for one in found if one is not None)


def _first_runs(table: Table, names: Sequence[str]) -> dict[str, Array]:
    present = column_names(table)
    metrics = [name for name in RUN_METRICS if name in present]
    wanted = tuple(dict.fromkeys((RUN, MANOEUVRE, *names, *metrics, PASSED, ENDED)))
    chunks: list[dict[str, Array]] = []
    for batch in batches(table, wanted):
        rows = batch[RUN] < MOST_RUNS
        rows &= was_simulated(batch)
        if rows.any():
            chunks.append({name: column[rows] for name, column in batch.items()})
    if not chunks:
        return {name: np.zeros(0) for name in wanted}
    return {name: np.concatenate([chunk[name] for chunk in chunks]) for name in wanted}


def _output(
    data: Mapping[str, Array],
    requirement: str,
    manoeuvre: str | None,
    known: Mapping[str, int],
    place: NDArray[np.intp],
    limits: Limits,
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return the metric relative to its limit, and where there is a limit."""
    if requirement == PASSED:
        return (data[PASSED] == 0).astype(np.float64), np.asarray(data[PASSED] >= 0)
    bounds = limits_of(known, requirement, limits)[place] if known else np.zeros(0)
    limited = ~np.isnan(bounds)
    return over_limit(requirement, data[requirement], np.where(limited, bounds, 1.0)), limited


def _sensitivity(
    requirement: str, manoeuvre: str | None, inputs: Mapping[str, Array], output: FloatArray
) -> Sensitivity | None:
    """Return None where the runs are too few, or all the same."""
    violating = output > (0.0 if requirement == PASSED else 1.0)
    telling = min(violating.sum(), len(output) - violating.sum()) >= _FEWEST_EVENTS
    if len(output) < _FEWEST_RUNS or (requirement == PASSED and not telling) or (output == output[0]).all():
        return None
    from scipy import stats

    ranked = requirement != PASSED and _far_out(output)
    used = stats.rankdata(np.where(np.isfinite(output), output, np.inf)) if ranked else output
    found = influences(inputs, used)
    return Sensitivity(
        requirement=requirement,
        manoeuvre=manoeuvre,
        runs=len(output),
        ranked=ranked,
        influences=found,
        violations=influences(inputs, violating) if telling and requirement != PASSED else (),
    )


def _far_out(output: FloatArray) -> bool:
    """Whether some of the runs diverged, or a few have most of the variance."""
    if not np.isfinite(output).all():
        return True
    square = np.sort((output - output.mean()) ** 2)
    return bool(square[-max(round(_TAIL * len(square)), 1) :].sum() > _TAIL_SHARE * square.sum())
