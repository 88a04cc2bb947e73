"""How often something happens, with bounds that are exact for independent runs."""

from __future__ import annotations

from platform_ctrl.arguments import positive, whole
from platform_ctrl.errors import ArgumentError
from platform_ctrl.frozen import value

CONFIDENCE = 0.95


@value
class Probability:
    """How often something happened, with exact bounds.

    Attributes
    ----------
    events, runs
        How many runs of how many.
    low, high
        Clopper and Pearson's bounds of the share of all runs that could be drawn: it lies between them, both together,
        at least with probability `confidence`.
    confidence
        Two-sided probability.

    References
    ----------
    C. J. Clopper, E. S. Pearson, Biometrika 26, 1934.
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
    lower bound can only be zero.

    Parameters
    ----------
    events, runs
        Whole numbers, 0 ≤ events ≤ runs.
    confidence
        Two-sided probability, between 0 and 1.

    Returns
    -------
    Probability
        With both bounds.

    Raises
    ------
    ArgumentError
        More events than runs, or a confidence that is none.

    Notes
    -----
    Exact for independent runs (Clopper and Pearson, Biometrika 26, 1934). Points of a Sobol sequence or a Latin
    hypercube fill the space more evenly than that: the estimate scatters less, the bounds err on the safe side as a
    rule, but nobody guarantees it.

    References
    ----------
    C. J. Clopper, E. S. Pearson, Biometrika 26, 1934.

    Examples
    --------
    >>> from platform_ctrl import campaign
    >>> round(campaign.clopper_pearson(0, 10_000).high, 6)
    0.000369
    """
    if whole("events", events, 0) > whole("runs", runs, 0):
        raise ArgumentError(f"events: given {events} of {runs} runs; expected 0 <= events <= runs")
    if not 0.0 < positive("confidence", confidence) < 1.0:
        raise ArgumentError(f"confidence: given {confidence}; expected a number between 0 and 1")
    low, high = 0.0, 1.0
    if runs:
        from scipy import stats

        tail = 0.5 * (1.0 - confidence)
        low = float(stats.beta.ppf(tail, events, runs - events + 1)) if events else 0.0
        high = float(stats.beta.isf(tail, events + 1, runs - events)) if events < runs else 1.0
    return Probability(events=events, runs=runs, low=low, high=high, confidence=confidence)
