"""Disks of perturbations: the gains and phases that one contains."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.analysis.system import ComplexArray
from platform_ctrl.common.arguments import number, positive, real_numbers
from platform_ctrl.common.values import FloatArray


def disk_to_gain_phase(alpha: float, skew: float = 0.0) -> tuple[float, float, float]:
    """Return the lowest and highest gain factor and the phase in rad that a disk of size `alpha` contains.

    The highest factor is infinite and the phase pi where the disk does not bound them (Seiler, Packard and Gahinet
    2020).
    """
    alpha = positive("disk_to_gain_phase: alpha", alpha, zero=True)
    skew = number("disk_to_gain_phase: skew", skew)
    low = (2.0 - alpha * (1.0 - skew)) / (2.0 + alpha * (1.0 + skew))
    denominator = 2.0 - alpha * (1.0 + skew)
    if denominator == 0.0:
        return low, math.inf, math.acos(min(1.0, max(-1.0, low)))
    high = (2.0 + alpha * (1.0 - skew)) / denominator
    cosine = (1.0 + low * high) / (low + high) if low + high != 0.0 else math.inf
    phase = math.acos(cosine) if abs(cosine) <= 1.0 else math.pi
    return low, high if high > 0.0 else math.inf, phase


def disk_phase(gain: ArrayLike, alpha: float, skew: float = 0.0) -> FloatArray:
    """Return the phase, rad, up to which a loop may turn while its gain changes by a factor, both inside one disk.

    Factors f = gain exp(±j phase) with |f - 1| < alpha/2 |1 - skew + (1 + skew) f| make up the disk. With skew 0 its
    edge is at cos phase = (gain + 1/gain)/2 (4 - alpha²)/(4 + alpha²): the highest and lowest gain leave no phase, and
    the largest phase of all is that at gain 1. NaN where the gain alone leaves the disk.
    """
    gain, alpha = real_numbers("disk_phase: gain", gain), min(alpha, 1e9)
    a, b = 0.5 * alpha * (1.0 - skew), 0.5 * alpha * (1.0 + skew)
    # |f - 1| < |a + b f| leaves 2 gain (1 + a b) cos(phase) > need.
    need, weight = gain**2 * (1.0 - b**2) + 1.0 - a**2, 2.0 * gain * (1.0 + a * b)
    with np.errstate(divide="ignore", invalid="ignore"):
        cosine = np.where(weight != 0.0, need / weight, np.where(need < 0.0, -1.0, 2.0))
    if 1.0 + a * b < 0.0:
        # The disk's outside: turned the other way round.
        return np.where(cosine < -1.0, math.nan, math.pi)[()]
    # The ends themselves, but for rounding, are on the edge.
    return np.where(cosine > 1.0 + 1e-12, math.nan, np.arccos(np.clip(cosine, -1.0, 1.0)))[()]


def disk_factors(delta: ComplexArray, skew: float) -> ComplexArray:
    """Return the factors f of perturbations delta; infinite where the disk reaches an infinite gain or delta is."""
    out = np.full(delta.shape, complex(math.inf, 0.0))
    below = 1.0 - 0.5 * (1.0 + skew) * np.where(np.isfinite(delta), delta, 0.0)
    finite = np.isfinite(delta) & (np.abs(below) > 1e-12)
    out[finite] = (1.0 + 0.5 * (1.0 - skew) * delta[finite]) / below[finite]
    return out
