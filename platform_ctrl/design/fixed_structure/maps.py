"""Smooth pieces of the largest singular values of a closed loop's maps, and of other measures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis.system import ComplexArray
from platform_ctrl.common.values import FloatArray, value

# A second singular value above this share of the first counts as near it.
_CLOSE = 0.9
# Directions in the plane of two singular vectors: an icosahedron on the sphere of their mixtures, less the first.
_DIRECTIONS = [np.array([0.0, 1.0], dtype=np.complex128)] + [
    np.array([np.sqrt(0.5 + 0.5 * height), np.sqrt(0.5 - 0.5 * height) * np.exp(1j * np.pi * (2 * k + shift) / 5.0)])
    for height, shift in ((np.sqrt(0.2), 0), (-np.sqrt(0.2), 1))
    for k in range(5)
]


class Singular(NamedTuple):
    """Singular values, or mixtures of two: sizes (k,), at which points (k,), left vectors conjugated, right vectors."""

    size: FloatArray
    at: NDArray[np.intp]
    u: ComplexArray
    v: ComplexArray


def singular(X: ComplexArray) -> Singular:
    """Return the largest singular value of every matrix of a stack as smooth pieces.

    Where the second one comes near, no single one is smooth: their vectors turn within a plane. With X = U Σ Vᴴ all of
    Re((U c)ᴴ X V c), |c| = 1, are smooth, lie below the largest singular value and reach it; twelve directions c stand
    for them.
    """
    U, s, V = np.linalg.svd(X)
    close = np.flatnonzero(s[:, 1] > _CLOSE * s[:, 0]) if s.shape[1] > 1 else np.zeros(0, dtype=np.intp)
    u, v, size = [U[:, :, 0]], [V[:, 0, :].conj()], [s[:, 0]]
    at = [np.arange(len(s))]
    for c in _DIRECTIONS if len(close) else ():
        u.append(U[close, :, :2] @ c)
        v.append(V[close, :2, :].conj().swapaxes(-1, -2) @ c)
        size.append(s[close, :2] @ np.abs(c) ** 2)
        at.append(close)
    return Singular(size=np.concatenate(size), at=np.concatenate(at), u=np.concatenate(u).conj(), v=np.concatenate(v))


Numbers = NDArray[np.intp]

# Share of a limit below which a measure that should be at least that counts along the tangent.
_LEAST = 0.01


@value
class Pieces:
    """Smooth pieces."""

    ratio: FloatArray  # (k,): values; as ratios of a requirement at most 1 when it is met
    gradient: FloatArray  # (k, n_K + m, n_K + p): with respect to [[A_K, B_K], [C_K, D_K]]
    plant: Numbers  # (k,): number of the plant in the set

    def times(self, factor: float) -> Pieces:
        """Return the pieces in another unit."""
        return Pieces(ratio=factor * self.ratio, gradient=factor * self.gradient, plant=self.plant)

    def raised(self, by: float) -> Pieces:
        """Return the pieces with a larger ratio."""
        return Pieces(ratio=self.ratio + by, gradient=self.gradient, plant=self.plant)


def joined(parts: Sequence[Pieces]) -> Pieces:
    """Return all pieces of several lists."""
    return Pieces(
        ratio=np.concatenate([part.ratio for part in parts]),
        gradient=np.concatenate([part.gradient for part in parts]),
        plant=np.concatenate([part.plant for part in parts]),
    )


def at_least(measured: FloatArray, limit: float) -> tuple[FloatArray, FloatArray]:
    """Return limit/measured and its slope; near zero along the tangent, so that negative values count as worse."""
    low = _LEAST * limit
    inside = np.maximum(measured, low)
    slope = -limit / inside**2
    return limit / inside + np.minimum(measured - low, 0.0) * slope, slope


def reaching(ratio: FloatArray, counts: NDArray[np.bool_], floor: float) -> tuple[Numbers, Numbers]:
    """Return the places that count and reach `floor`, and the worst that counts."""
    masked = np.where(counts, ratio, -np.inf)
    chosen = masked >= floor
    if np.any(counts):
        chosen[np.unravel_index(int(np.argmax(masked)), masked.shape)] = True
    row, k = np.nonzero(chosen)
    return row, k


def tops(x: FloatArray, y: FloatArray, row: Numbers, k: Numbers) -> tuple[FloatArray, FloatArray]:
    """Return the tops of the parabolas through points `k` of rows of `y` and their neighbours, and the smaller spacing.

    At the ends of the grid the point itself, with a spacing of zero.
    """
    if len(x) < 3:
        return x[k], np.zeros(len(k))
    inside = (k > 0) & (k < len(x) - 1)
    j = np.clip(k, 1, len(x) - 2)
    left, right = x[j - 1] - x[j], x[j + 1] - x[j]
    fall, rise = y[row, j - 1] - y[row, j], y[row, j + 1] - y[row, j]
    # y ≈ y_j + b t + c t² through both neighbours.
    c = (fall / left - rise / right) / (left - right)
    b = fall / left - c * left
    t = np.clip(-b / np.where(c < 0.0, 2.0 * c, -np.inf), left, right)
    return np.where(inside, x[j] + t, x[k]), np.where(inside, np.minimum(right, -left), 0.0)
