"""Poles over a parameter as continuous branches, and the values of the parameter that show them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray
from platform_ctrl.common.values import FloatArray

# The poles (k, n) at k values of the parameter.
Poles = Callable[[FloatArray], ComplexArray]

# Halvings of a step, and values altogether, at most: a pole that leaps cannot be followed however short the steps.
_MOST_HALVINGS, _MOST_VALUES = 14, 3000


def pole_branches(z: ComplexArray) -> ComplexArray:
    """Return the poles (k, n) with each row sorted so that every column moves as little as possible."""
    from scipy.optimize import linear_sum_assignment

    out = z.copy()
    for k in range(1, len(z)):
        distance = np.abs(out[k - 1][:, None] - z[k][None, :])
        nearest = distance.argmin(axis=1)
        # Mostly each has its own nearest, and no assignment has to be solved.
        own = len(set(nearest.tolist())) == len(nearest)
        out[k] = z[k][nearest if own else linear_sum_assignment(distance)[1]]
    return out


def values_at_breakaways(values: FloatArray, poles: Poles) -> FloatArray:
    """Return more values around those where poles leave the real axis: there they move fastest."""

    def real(z: ComplexArray) -> FloatArray:
        return np.asarray((z.imag == 0.0).sum(axis=-1), dtype=np.float64)

    counts = real(poles(values))
    at = np.flatnonzero(np.diff(counts))
    low, high, left = values[at].copy(), values[at + 1].copy(), counts[at]
    for _ in range(24 if at.size else 0):
        middle = 0.5 * (low + high)
        before = real(poles(middle)) == left
        low, high = np.where(before, middle, low), np.where(before, high, middle)
    steps = (values[1] - values[0]) * (np.arange(-8, 9) / 8.0) ** 2 * np.sign(np.arange(-8, 9))
    more = (high[:, None] + steps).ravel()
    return np.asarray(more[(more >= values[0]) & (more <= values[-1])])


def refined_values(
    values: FloatArray, poles: Poles, shown: Callable[[ComplexArray], ComplexArray], step: float
) -> FloatArray:
    """Return rising `values` (N,) with more between them, until no pole moves further than `step` from one to the next.

    `shown` says where a pole is drawn: steps are measured there, and poles that are not finite there do not count.
    """
    values = np.union1d(values, values_at_breakaways(values, poles))
    z = poles(values)
    for _ in range(_MOST_HALVINGS):
        with np.errstate(invalid="ignore"):
            moved = np.abs(np.diff(shown(pole_branches(z)), axis=0))
        long = np.flatnonzero(np.nan_to_num(moved, nan=0.0, posinf=0.0).max(axis=1, initial=0.0) > step)
        if not long.size or len(values) + long.size > _MOST_VALUES:
            break
        between = 0.5 * (values[long] + values[long + 1])
        values, z = np.insert(values, long + 1, between), np.insert(z, long + 1, poles(between), axis=0)
    return values
