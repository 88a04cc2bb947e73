"""Sensitivities of many loops, compiled: Gauss-Jordan elimination of small matrices with pivots from the column."""

from __future__ import annotations

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray
from platform_ctrl.lanes import compiled, inlined


@inlined
def _eliminate(W: ComplexArray) -> bool:
    """Turn [X, I] into [I, X^-1]; return whether X has no inverse."""
    m = W.shape[0]
    for c in range(m):
        best, at = 0.0, c
        for i in range(c, m):
            size = abs(W[i, c].real) + abs(W[i, c].imag)
            if size > best:
                best, at = size, i
        if best == 0.0:  # nor is a pivot found among what is no number
            return True
        factor = 1.0 / W[at, c]
        for j in range(c, 2 * m):
            W[at, j], W[c, j] = W[c, j], W[at, j] * factor
        for i in range(m):
            if i != c:
                other = W[i, c]
                for j in range(c, 2 * m):
                    W[i, j] -= other * W[c, j]
    return False


@compiled
def invert(X: ComplexArray) -> None:
    """Put the inverse in the place of each of the matrices (N, m, m); inf all over where one is singular."""
    N, m = X.shape[:2]
    W = np.empty((m, 2 * m), dtype=np.complex128)
    for k in range(N):
        for i in range(m):
            for j in range(m):
                W[i, j], W[i, m + j] = X[k, i, j], 1.0 if i == j else 0.0
        singular = _eliminate(W)
        for i in range(m):
            for j in range(m):
                X[k, i, j] = np.inf if singular else W[i, m + j]


@compiled
def close(P: ComplexArray, K: ComplexArray, S_output: ComplexArray, S_input: ComplexArray) -> None:
    """Write both sensitivities of plants (N, F, p, m) with one controller (F, m, p); inf where I - P K is singular."""
    N, F, p, m = P.shape
    W, KS = np.empty((p, 2 * p), dtype=np.complex128), np.empty((m, p), dtype=np.complex128)
    for n in range(N):
        for f in range(F):
            for i in range(p):
                for j in range(p):
                    loop = 0j
                    for r in range(m):
                        loop += P[n, f, i, r] * K[f, r, j]
                    one = 1.0 if i == j else 0.0
                    W[i, j], W[i, p + j] = one - loop, one
            singular = _eliminate(W)
            for i in range(p):
                for j in range(p):
                    S_output[n, f, i, j] = np.inf if singular else W[i, p + j]
            for i in range(m):
                for j in range(p):
                    KS[i, j] = 0j
                    for r in range(p):
                        KS[i, j] += K[f, i, r] * S_output[n, f, r, j]
                for j in range(m):
                    through = 0j
                    for r in range(p):
                        through += KS[i, r] * P[n, f, r, j]
                    S_input[n, f, i, j] = np.inf if singular else through + (1.0 if i == j else 0.0)
