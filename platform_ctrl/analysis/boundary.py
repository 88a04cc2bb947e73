"""Poles next to the stability boundary: computed in as many digits as it takes, and judged by the digits that A has.

The eigenvalues of a matrix of doubles are wrong by about rounding of its norm. Where poles from 1e-3 to 1e9 rad/s
stand in one system this is more than the damping of a slow mode: which side of the axis a pole lies on is then worked
out in more digits. On the boundary counts a pole that one rounding of every entry of A could put there.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis.arrays import ComplexArray
from platform_ctrl.analysis.poles import continuous_poles
from platform_ctrl.frozen import FloatArray

EPSILON = 2.0**-52
# Distance from the boundary, in roundings of |A|, up to which a computed pole is not trusted.
DOUBTFUL = 1e4
# Roundings of each entry that A is granted: a few, since it is the result of some computation.
GRANTED = 8.0
BITS = 192


def boundary_poles(A: FloatArray, dt: float) -> tuple[ComplexArray, NDArray[np.bool_]]:
    """Return the continuous(-equivalent) poles of one balanced system, and which of them lie on the boundary, (n,)."""
    poles = np.asarray(np.linalg.eigvals(A), dtype=np.complex128)
    distance = 1.0 - np.abs(poles) if dt else -poles.real
    if not np.any(np.abs(distance) <= DOUBTFUL * EPSILON * np.linalg.norm(A)):
        return continuous_poles(poles, dt) if dt else poles, np.zeros(len(poles), dtype=np.bool_)
    return _precise_poles(A, dt)


def _precise_poles(A: FloatArray, dt: float) -> tuple[ComplexArray, NDArray[np.bool_]]:
    from flint import acb, acb_mat, ctx

    before = ctx.prec
    ctx.prec = BITS
    try:
        values, left, right = acb_mat(A.tolist()).eig(algorithm="approx", left=True, right=True)
        # Next to the unit circle |z| - 1 = (|z|^2 - 1)/2.
        distance = np.array([float(((z.real**2 + z.imag**2 - 1) / 2 if dt else z.real).mid()) for z in values])
        n = len(values)
        X = np.array([_direction([right[i, k] for i in range(n)]) for k in range(n)])
        Y = np.array([_direction([left[k, i] for i in range(n)]) for k in range(n)])
        s = np.array([complex((acb(z).log() / dt).mid() if dt and z != 0 else z.mid()) for z in values])
    finally:
        ctx.prec = before
    if dt:
        s[~np.isfinite(s) | (np.array([abs(complex(z.mid())) for z in values]) == 0.0)] = complex(-math.inf, 0.0)
    moved = np.einsum("ki,ij,kj->k", np.abs(Y), np.abs(A), np.abs(X))
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = GRANTED * EPSILON * moved / np.abs(np.einsum("ki,ki->k", Y, X))
    on = np.abs(distance) <= np.where(np.isnan(reach), math.inf, reach)
    # A pole at rest, zero in A's own digits.
    return s, np.asarray(on | (distance == 0.0), dtype=np.bool_)


def _direction(vector: list[Any]) -> list[complex]:
    """Return an acb vector as complex numbers, the largest of them of size 1."""
    sizes = [abs(x) for x in vector]
    largest = max(sizes, key=lambda size: size.mid())
    return [complex((x / largest).mid()) for x in vector] if largest != 0 else [0j] * len(vector)
