"""Disks of perturbations: the gains and phases that one contains, and systems on its edge."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.analysis.arrays import ComplexArray, StateArrays, named_system
from platform_ctrl.common.arguments import number, positive, real_numbers
from platform_ctrl.common.values import FloatArray
from platform_ctrl.errors import ArgumentError

if TYPE_CHECKING:
    import control


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


def worst_factors(factors: ComplexArray, frequency: float, skew: float, dt: float) -> control.StateSpace:
    """Return systems with real coefficients, one for each channel, that equal `factors` at `frequency`."""
    if not np.all(np.isfinite(factors)):
        raise ArgumentError("destabilising: no finite factors make the loop unstable")
    delta = (factors - 1.0) / (0.5 * (1.0 - skew) + 0.5 * (1.0 + skew) * factors)
    sizes = np.abs(delta)
    real = np.abs(delta.imag) <= 1e-12 * sizes
    # The axis, or the circle seen from w = (z - 1)/(z + 1).
    at = math.tan(0.5 * frequency * dt) if dt else frequency
    if not np.all(real) and not 0.0 < at < 1e15 * (1.0 if dt else math.inf):
        raise ArgumentError(
            f"destabilising: the factors {np.array2string(factors, precision=4)} at {frequency:g} rad/s are complex, "
            "where a system with real coefficients has a real response; they stand for factors at frequencies nearby"
        )
    one = [_all_pass(complex(d), bool(r), at, dt) for d, r in zip(delta, real, strict=True)]
    A, B, C, D = (np.array(column) for column in zip(*one, strict=True))
    # f = 1 + delta / (1 - b delta).
    b = 0.5 * (1.0 + skew)
    open_loop = 1.0 - b * D
    dynamic = ~real
    eye = np.eye(len(delta))
    arrays = StateArrays(
        np.diag((A + B * b * C / open_loop)[dynamic]),
        (eye * (B / open_loop))[dynamic],
        (eye * (C / open_loop))[:, dynamic],
        np.diag(1.0 + D / open_loop),
        dt,
    )
    names = [f"f{i + 1}" for i in range(len(delta))]
    return named_system(arrays, [f"{name}_in" for name in names], [f"{name}_out" for name in names])


def _all_pass(delta: complex, real: bool, at: float, dt: float) -> tuple[float, float, float, float]:
    """Return A, B, C, D of r (s - c)/(s + c), or of the same in w, that equals delta at `at`; of a gain if `real`."""
    if real:
        return 0.0, 0.0, 0.0, delta.real
    r = math.copysign(abs(delta), delta.imag)
    phase = math.atan2(delta.imag, delta.real)
    phase = phase if delta.imag > 0.0 else phase + math.pi
    c = at / math.tan(0.5 * (math.pi - phase))
    if dt == 0.0:
        return -c, 1.0, -2.0 * c * r, r
    q = (1.0 - c) / (1.0 + c)
    return q, 1.0, r * (q * q - 1.0), r * q
