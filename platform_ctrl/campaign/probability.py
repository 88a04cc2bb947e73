"""How often something happens: counted, with exact bounds for independent runs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from platform_ctrl.common.arguments import positive, whole
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
