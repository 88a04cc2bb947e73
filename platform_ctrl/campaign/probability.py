"""How often something happens: counted, with exact bounds for independent runs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from platform_ctrl.common.arguments import positive, real_numbers, whole
from platform_ctrl.common.signatures import check_arguments, short
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError

CONFIDENCE = 0.95
# An input is called a driver or a cause if chance would look like it in fewer than this share of campaigns.
SIGNIFICANCE = 0.01


@value
class Probability:
    """How often something happened: `events` of `runs`, with Clopper and Pearson's bounds (Biometrika 26, 1934).

    The share of all runs that could be drawn lies between `low` and `high` at least with probability `confidence`.
    """

    events: int
    runs: int
    low: float
    high: float
    confidence: float

    @property
    def estimate(self) -> float:
        """Share of the runs; NaN without runs."""
        return self.events / self.runs if self.runs else float("nan")


def clopper_pearson(events: int, runs: int, confidence: float = CONFIDENCE) -> Probability:
    """Return the probability of an event seen `events` times in `runs` independent runs.

    With no event the upper bound is 1 − (α/2)^(1/runs), about 3.7/runs at 95 %: two-sided throughout, also where the
    lower bound can only be zero. Exact for independent runs. Points of a Sobol sequence or a Latin hypercube fill the
    space more evenly: the estimate scatters less, the bounds are too wide as a rule, but nobody guarantees it.
    ArgumentError: more events than runs, or a confidence that is not between 0 and 1.
    """
    if whole("events", events, 0) > whole("runs", runs, 0):
        raise ArgumentError(f"events must be at most runs, got {events} of {runs}")
    if not 0.0 < positive("confidence", confidence) < 1.0:
        raise ArgumentError(f"confidence must be between 0 and 1, got {confidence}")
    low, high = 0.0, 1.0
    if runs:
        from scipy import stats

        tail = 0.5 * (1.0 - confidence)
        low = float(stats.beta.ppf(tail, events, runs - events + 1)) if events else 0.0
        high = float(stats.beta.isf(tail, events + 1, runs - events)) if events < runs else 1.0
    return Probability(events=events, runs=runs, low=low, high=high, confidence=confidence)


def holm(p_values: Sequence[float]) -> FloatArray:
    """Return p-values of several tests, each as large as it has to be for all of them together."""
    p = np.asarray(p_values, dtype=np.float64)
    order = np.argsort(p)
    adjusted = np.maximum.accumulate(np.minimum((len(p) - np.arange(len(p))) * p[order], 1.0))
    out = np.empty_like(p)
    out[order] = adjusted
    return out


# Bins of equal width in the logarithm: a quantile is right to half of `RESOLUTION` of itself.
RESOLUTION = 1e-3
_LOWEST, _HIGHEST = 1e-12, 1e9
_BINS = int(np.ceil(np.log(_HIGHEST / _LOWEST) / RESOLUTION))
_EDGES_FROM = np.log(_LOWEST)


class Distribution:
    """Counts of a metric that is not negative, in logarithmic bins; where it is not finite it counts as beyond all.

    The result is the same whether metrics are added at once or in chunks of any order.

    Attributes
    ----------
    counts : (bins,)
        Runs in each bin: the first for everything below 1e-12, the last for everything above 1e9, infinity included.
    smallest, largest
        The extremes, exactly, in the metric's unit; infinite where the largest is (a run that diverged).
    """

    __slots__ = ("counts", "largest", "smallest")

    def __init__(self) -> None:
        self.counts: NDArray[np.int64] = np.zeros(_BINS + 2, dtype=np.int64)
        self.smallest, self.largest = np.inf, -np.inf

    @property
    def runs(self) -> int:
        """How many metrics were counted."""
        return int(self.counts.sum())

    @check_arguments
    def add(self, metrics: ArrayLike) -> None:
        """Count more metrics, not negative, in one unit; what is not finite lies beyond all."""
        values = real_numbers("Distribution.add: metrics", metrics).reshape(-1)
        if not values.size:
            return
        values = np.where(np.isfinite(values), values, np.inf)
        self.counts += np.bincount(_bin(values), minlength=_BINS + 2)
        self.smallest = min(self.smallest, float(values.min()))
        self.largest = max(self.largest, float(values.max()))

    @check_arguments
    def quantile(self, share: float) -> float:
        """Return the least metric that a share (0 to 1) of the runs does not exceed; NaN without runs."""
        runs = self.runs
        if not runs:
            return float("nan")
        if share >= 1.0:
            return float(self.largest)
        rank = max(int(np.ceil(share * runs - 1e-9)), 1)
        place = int(np.searchsorted(np.cumsum(self.counts), rank))
        return float(np.clip(_middles(np.array([place]))[0], self.smallest, self.largest))

    def exceedance(self) -> tuple[FloatArray, FloatArray]:
        """Return levels (k,), increasing, in the metrics' unit, and the share of the runs above each (k,)."""
        filled = np.flatnonzero(self.counts)
        above = self.runs - np.cumsum(self.counts[filled])
        return np.clip(_middles(filled), self.smallest, self.largest), above / max(self.runs, 1)

    @check_arguments
    def histogram(self, edges: FloatArray) -> NDArray[np.int64]:
        """Return how many metrics lie between each two of the edges (k + 1,), increasing, in the metrics' unit.

        What lies beyond the last is left out; a value next to an edge may be counted on its other side.
        """
        if edges.ndim != 1 or np.any(np.diff(edges) < 0.0):
            raise ArgumentError(f"edges must be an increasing vector of numbers, got {short(edges)}")
        filled = np.flatnonzero(self.counts)
        middles = np.clip(_middles(filled), max(self.smallest, 0.0), self.largest)
        counted, _ = np.histogram(middles, bins=edges, weights=self.counts[filled].astype(np.float64))
        return np.asarray(np.rint(counted), dtype=np.int64)


def _bin(values: FloatArray) -> NDArray[np.intp]:
    with np.errstate(divide="ignore"):
        place = (np.log(np.maximum(values, 0.0)) - _EDGES_FROM) / RESOLUTION
    return np.asarray(np.clip(np.floor(np.clip(place, -1.0, _BINS)), -1, _BINS), dtype=np.intp) + 1


def _middles(bins: NDArray[np.intp]) -> FloatArray:
    middles = np.exp(_EDGES_FROM + (bins - 0.5) * RESOLUTION)
    return np.asarray(np.where(bins == 0, 0.0, np.where(bins > _BINS, np.inf, middles)))
