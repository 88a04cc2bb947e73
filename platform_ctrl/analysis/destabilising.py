"""Perturbations of the channels' gains that carry a loop to the edge of stability: from disks to factors and back.

A channel's factor is f = (1 + a delta) / (1 - b delta) with a = (1 - skew)/2, b = (1 + skew)/2 and |delta| the disk's
size. A complex number delta at one frequency is run through by a stable first-order all-pass with real coefficients
(Seiler, Packard and Gahinet, IEEE Control Systems 40(5), 2020).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray, StateArrays, state_space
from platform_ctrl.errors import ArgumentError

if TYPE_CHECKING:
    import control


def disk_factors(delta: ComplexArray, skew: float) -> ComplexArray:
    """Return the factors f of perturbations delta; infinite where the disk reaches an infinite gain or delta is."""
    out = np.full(delta.shape, complex(math.inf, 0.0))
    below = 1.0 - 0.5 * (1.0 + skew) * np.where(np.isfinite(delta), delta, 0.0)
    finite = np.isfinite(delta) & (np.abs(below) > 1e-12)
    out[finite] = (1.0 + 0.5 * (1.0 - skew) * delta[finite]) / below[finite]
    return out


def worst_factors(factors: ComplexArray, frequency: float, skew: float, dt: float) -> control.StateSpace:
    """Return systems with real coefficients, one for each channel, that equal `factors` at `frequency`.

    Raises
    ------
    ArgumentError
        If a factor is not finite, or is complex at a frequency where every such system has a real response.
    """
    if not np.all(np.isfinite(factors)):
        raise ArgumentError(
            "destabilising: no factors make the loop unstable, or one of them is infinite; expected finite ones"
        )
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
    return state_space(arrays, [f"{name}_in" for name in names], [f"{name}_out" for name in names])


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
