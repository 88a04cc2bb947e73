"""Matrices of balls (midpoint and radius, Arb by python-flint), and whether a symmetric one is positive definite.

A double is a dyadic rational, so a matrix of doubles enters without any rounding; what is computed from it encloses
the exact result. Whatever is decided here is therefore decided for the exact matrices.
"""

from __future__ import annotations

import math
from typing import Any

import flint
import numpy as np
from numpy.typing import NDArray

# flint ships no types: a matrix of balls, and a ball.
Balls = Any
Ball = Any

# What floating point may take from a figure that is reported as a lower bound.
_ROUNDING = 1.0 - 1e-9


def balls(array: NDArray[Any]) -> Balls:
    """Return a matrix of doubles as balls of radius zero."""
    rows, columns = array.shape
    return flint.arb_mat(array.tolist()) if rows and columns else flint.arb_mat(rows, columns)


def identity(n: int) -> Balls:
    """Return the identity."""
    return balls(np.eye(n))


def blocks(rows: list[list[Balls]]) -> Balls:
    """Return a matrix put together from blocks."""
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
    it is not, the pivots of M = L D L' are enclosed one by one and decide by their signs (Sylvester). The number is a
    lower bound of the smallest eigenvalue of a positive definite M scaled to a unit diagonal.
    """
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
