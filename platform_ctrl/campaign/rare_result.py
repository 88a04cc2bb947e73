"""What is known of a probability that is too small to be counted."""

from __future__ import annotations

from typing import Literal

import numpy as np

from platform_ctrl.common.values import FloatArray, value

RareMethod = Literal["splitting", "cross-entropy"]

# Fewer realisations of the noise among the violating runs of a repetition say that noise decides.
_FEWEST_NOISES = 10


@value
class RarePoint:
    """Inputs that violate a requirement."""

    u: FloatArray  # (d,): The point of the unit cube, probabilities: the inputs through their distributions
    run: int  # Number of the noise
    ratio: float  # Of the metric to its limit, above 1; infinite if it diverged
    distance: float  # From the most probable inputs, in standard deviations


@value
class Repetition:
    """One estimate of the probability, independent of the others."""

    probability: float  # 0 where the limit was not reached
    # The same; where the limit was not reached, an upper bound of the probability of what lies beyond the last level
    below: float
    levels: FloatArray  # (k,): Ratios of metric to limit of the levels
    variation: float  # Coefficient of variation (relative standard deviation), estimated from this repetition alone
    evaluations: int  # Runs simulated
    noises: int  # How many realisations of the noise there are among its violating runs


@value
class RareResult:
    """A probability that is too small to be counted.

    Attributes
    ----------
    requirement
        ``"angle"``, ``"attitude"``, ``"torque_share"``; None: any of them.
    method
        ``"splitting"`` or ``"cross-entropy"``.
    probability, low, high, confidence
        The mean of all repetitions, and its interval by their scatter. With probability 0, `high` is what the last
        level reached allows.
    variation
        Coefficient of variation (relative standard deviation) of the mean.
    repetitions
        The single estimates.
    evaluations
        Runs that were simulated for it.
    violations
        The most probable inputs that violate it, the nearest first: where to look.
    shift : (d,)
        Mean of the violating inputs, each in units of its standard deviation.
    """

    requirement: str | None = None
    method: RareMethod
    probability: float
    low: float
    high: float
    confidence: float
    variation: float
    repetitions: tuple[Repetition, ...]
    evaluations: int
    violations: tuple[RarePoint, ...]
    shift: FloatArray

    @property
    def reached(self) -> int:
        """How many repetitions reached the limit."""
        return sum(one.probability > 0.0 for one in self.repetitions)

    @property
    def noise_decides(self) -> bool:
        """Whether the violating runs rest on so few realisations of the noise that the interval is too narrow.

        Then noise matters more than all inputs, and chains cannot lead it step by step.
        """
        noises = [one.noises for one in self.repetitions if one.probability > 0.0]
        return bool(noises) and bool(np.median(noises) < _FEWEST_NOISES)
