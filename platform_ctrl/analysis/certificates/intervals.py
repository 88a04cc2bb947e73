"""Matrices of balls (midpoint and radius), and whether a symmetric one is positive definite.

A double is a dyadic rational, so a matrix of doubles enters without any rounding; what is computed from it encloses
the exact result. Whatever is decided here is therefore decided for the exact matrices. Balls are those of Arb
(python-flint) with any number of bits or, thirty times as fast, doubles with bounds of their rounding.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import flint
import numpy as np
from numpy.typing import NDArray

from platform_ctrl.common.values import FloatArray

# flint ships no types: a matrix of balls, and a ball. `Rounded` serves as a matrix of balls as well.
Balls = Any
Ball = Any
# From a matrix of doubles.
Enclosure = Callable[[FloatArray], Balls]

# What floating point may take from a figure that is reported as a lower bound.
_ROUNDING = 1.0 - 1e-9

# The largest relative error of a sum, product or quotient of doubles, and what exceeds k of them that underflow.
_UNIT = 2.0**-53
_UNDERFLOW = 1e-300

# Powers of two, from the diagonal, beyond which scaled entries might underflow.
_SMALLEST, _LARGEST = 1e-280, 1e280


class Rounded(NamedTuple):
    """A matrix of doubles and how far each entry may be from the exact one; with the operations of balls.

    A sum of k products, in any order, is wrong by at most k u / (1 − k u) times the sum of their magnitudes, u = 2^-53
    (N. J. Higham, Accuracy and Stability of Numerical Algorithms, SIAM 2002, section 3.1). Bounds are themselves
    computed with rounding, and enlarged by what that can take from them. What needs an inverse needs more bits.
    """

    middle: FloatArray
    radius: FloatArray

    def nrows(self) -> int:
        """Return the number of rows."""
        return len(self.middle)

    def ncols(self) -> int:
        """Return the number of columns."""
        return int(self.middle.shape[1])

    def transpose(self) -> Rounded:
        """Return the transposed matrix."""
        return Rounded(self.middle.T, self.radius.T)

    def inv(self) -> Rounded:
        """Raise as a matrix of balls does that is too wide to tell."""
        raise ZeroDivisionError

    def trace(self) -> Ball:
        """Return the sum of the diagonal, as a ball of Arb."""
        exact = [flint.arb(float(x), float(r)) for x, r in zip(np.diag(self.middle), np.diag(self.radius), strict=True)]
        return sum(exact, flint.arb(0))

    def __add__(self, other: Rounded) -> Rounded:  # type: ignore[override]
        middle = self.middle + other.middle
        radius = (self.radius + other.radius + _UNIT * np.abs(middle)) * (1.0 + 8.0 * _UNIT)
        return Rounded(middle, radius + _UNDERFLOW * (middle != 0.0))

    def __sub__(self, other: Rounded) -> Rounded:
        return self + Rounded(-other.middle, other.radius)

    def __mul__(self, other: Rounded) -> Rounded:  # type: ignore[override]
        k, middle = self.middle.shape[1], self.middle @ other.middle
        if not (self._any() and other._any()):
            return rounded(middle)  # exactly zero
        size, rest = np.abs(self.middle), np.abs(other.middle)
        radius = (k + 2) * _UNIT * (size @ rest) + size @ other.radius + self.radius @ (rest + other.radius)
        return Rounded(middle, radius * (1.0 + (4 * k + 16) * _UNIT) + _UNDERFLOW)

    def __rmul__(self, factor: int | Ball) -> Rounded:
        if isinstance(factor, int) and abs(factor) == 1:
            return Rounded(factor * self.middle, self.radius)
        ball = flint.arb(factor)
        about = float(ball.mid())
        error = float(abs(ball - flint.arb(about)).upper()) * (1.0 + _UNIT) + _UNDERFLOW
        middle = about * self.middle
        radius = (abs(about) + error) * self.radius + error * np.abs(self.middle) + _UNIT * np.abs(middle)
        return Rounded(middle, radius * (1.0 + 16.0 * _UNIT) + _UNDERFLOW)

    def _any(self) -> bool:
        """Return whether any entry may differ from zero."""
        return bool(np.any(self.middle) or np.any(self.radius))


def rounded(array: FloatArray) -> Rounded:
    """Return a matrix of doubles, each exact."""
    return Rounded(array, np.zeros(array.shape))


def balls(array: NDArray[Any]) -> Balls:
    """Return a matrix of doubles as balls of radius zero."""
    rows, columns = array.shape
    return flint.arb_mat(array.tolist()) if rows and columns else flint.arb_mat(rows, columns)


def identity(n: int) -> Balls:
    """Return the identity."""
    return balls(np.eye(n))


def blocks(rows: list[list[Balls]]) -> Balls:
    """Return a matrix put together from blocks."""
    if isinstance(rows[0][0], Rounded):
        return Rounded(*(np.block([[block[k] for block in row] for row in rows]) for k in range(2)))
    out: list[list[Ball]] = []
    for row in rows:
        parts = [part.tolist() for part in row]
        out += [[x for line in lines for x in line] for lines in zip(*parts, strict=True)]
    columns = sum(part.ncols() for part in rows[0])
    return flint.arb_mat(out) if out and columns else flint.arb_mat(len(out), columns)


def positive_definite(M: Balls) -> tuple[bool | None, float]:
    """Decide whether a symmetric matrix of balls is positive definite; None: the balls are too wide to tell.

    First W M W' is enclosed, W the inverse of a Cholesky factor in floating point: where that is diagonally dominant
    with positive diagonal (Gershgorin), W and M are nonsingular and M, congruent to it, is positive definite. Where
    it is not, the pivots of M = L D L' are enclosed one by one and decide by their signs (Sylvester). Of `Rounded` only
    what is positive definite is decided. The number is a lower bound of the smallest eigenvalue of a positive definite
    M scaled to a unit diagonal.
    """
    if isinstance(M, Rounded):
        return _by_cholesky(M)
    n = M.nrows()
    if n == 0:
        return True, 1.0
    diagonal = [M[i, i] for i in range(n)]
    if any(d <= 0 for d in diagonal):
        return False, 0.0
    if not all(d > 0 for d in diagonal):
        return None, 0.0
    exponents = [_exponent(d) for d in diagonal]
    scale = flint.arb_mat([[flint.arb(2) ** (-e) if i == j else 0 for j, e in enumerate(exponents)] for i in range(n)])
    M = scale * M * scale
    return _by_congruence(M) or _by_pivots(M)


def _by_cholesky(M: Rounded) -> tuple[bool | None, float]:
    """Decide by a Cholesky factor in doubles that exists.

    Of H, symmetric of order n, it exists only if no eigenvalue is below −c, c = (n + 1) u / (1 − 2 (n + 1) u) trace H
    (S. M. Rump, BIT Numerical Mathematics 46, 2006); here H is M less a share of its smallest eigenvalue, scaled, and c
    twice as large.
    """
    n, diagonal = M.nrows(), np.diag(M.middle)
    if n == 0:
        return True, 1.0
    if not (np.all(diagonal > _SMALLEST) and np.all(diagonal < _LARGEST) and np.all(np.isfinite(M.radius))):
        return None, 0.0
    scale = np.exp2(-np.round(0.5 * np.log2(diagonal)))  # exact in the products
    middle, radius = (part * scale * scale[:, None] for part in M)
    if not np.all(np.isfinite(middle)):
        return None, 0.0
    # The exact matrix is symmetric: it lies within either radius of the mean.
    middle = 0.5 * (middle + middle.T)
    wide = np.max(np.sum(radius + radius.T + 2.0 * _UNIT * np.abs(middle), axis=1)) * (1.0 + 4 * n * _UNIT)
    lost = float(wide) + 2.0 * (n + 4) * _UNIT * float(np.trace(middle)) + 1e-150
    try:
        share = 0.99 * float(np.linalg.eigvalsh(middle)[0])
        if not share > lost:
            return None, 0.0
        np.linalg.cholesky(middle - share * np.eye(n))
    except np.linalg.LinAlgError:
        return None, 0.0
    largest = float(np.max(np.diag(middle))) * (1.0 + _UNIT) + float(wide)
    return True, _ROUNDING * (share - lost) / largest


def _exponent(d: Ball) -> int:
    """Half the binary exponent of a positive ball's midpoint: 2**-e d 2**-e is about 1."""
    mantissa, exponent = d.mid().man_exp()
    return (int(mantissa).bit_length() + int(exponent)) // 2


def _by_congruence(M: Balls) -> tuple[bool, float] | None:
    middle = np.array([[float(x.mid()) for x in row] for row in M.tolist()])
    if not np.all(np.isfinite(middle)):
        return None
    root = np.sqrt([float(M[i, i].upper()) for i in range(M.nrows())])
    try:
        factor = np.linalg.cholesky(middle)
        W = np.linalg.inv(factor)
    except np.linalg.LinAlgError:
        return None
    if not np.all(np.isfinite(W)):
        return None
    inner = balls(W)
    G = (inner * M * inner.transpose()).tolist()
    low = None
    for i, row in enumerate(G):
        rest = row[i] - sum((abs(x) for j, x in enumerate(row) if j != i), flint.arb(0))
        if not rest > 0:
            return None
        bound = float(rest.lower())
        low = bound if low is None else min(low, bound)
    # W M W' >= low I, so with U = diag(root): U^-1 M U^-1 >= low (W U)^-1 (W U)^-T >= low / |W U|^2.
    assert low is not None
    return True, _ROUNDING * low / float(np.linalg.norm(W * root)) ** 2


def _by_pivots(M: Balls) -> tuple[bool | None, float]:
    rows = M.tolist()
    n = len(rows)
    share = flint.arb(1)
    for k in range(n):
        pivot = rows[k][k]
        if pivot <= 0:
            return False, 0.0
        if not pivot > 0:
            return None, 0.0
        share *= pivot / M[k, k]
        for i in range(k + 1, n):
            factor = rows[i][k] / pivot
            for j in range(k + 1, i + 1):
                rows[i][j] -= factor * rows[j][k]
    # Scaled to a unit diagonal the trace is n, and the smallest eigenvalue exceeds the determinant over e.
    return True, max(_ROUNDING * float(share.lower()) / math.e, 0.0)
