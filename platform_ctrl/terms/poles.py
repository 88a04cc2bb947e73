"""What becomes of poles when a term is dropped, also where the mass matrix becomes singular by it."""

from __future__ import annotations

import numpy as np

from platform_ctrl.frozen import FloatArray

# Against matrices that are scaled to ones.
_ZERO = 1e-12


def poles(M: FloatArray, G: FloatArray, K: FloatArray) -> FloatArray:
    """Return the finite s for which s² M + s G + K is singular, complex; none where it is singular for every s.

    Dropping an inertia leaves constraints, whose infinite poles are defective and come out of a solver as merely
    large. So they are taken out first, by rank.
    """
    k = len(M)
    diagonal = np.abs(np.diag(M))
    scale = 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, diagonal.max(initial=0.0) or 1.0))
    M, G, K = (scale[:, None] * matrix * scale for matrix in (M, G, K))
    fast = max(np.abs(G).max(initial=0.0), np.sqrt(np.abs(K).max(initial=0.0))) or 1.0
    A = np.block([[np.zeros((k, k)), np.eye(k)], [-K / fast**2, -G / fast]])
    E = np.block([[np.eye(k), np.zeros((k, k))], [np.zeros((k, k)), M]])
    while len(E):
        left, sizes, _ = np.linalg.svd(E)
        rank = int(np.sum(sizes > _ZERO * max(1.0, sizes[0])))
        if rank == len(E):
            return np.asarray(fast * np.linalg.eigvals(np.linalg.solve(E, A)))
        A, E = left.T @ A, left.T @ E
        # The rows without E say A_low x = 0: what is left of x moves in their null space.
        length = np.linalg.norm(A[rank:], axis=1)
        if length.min() < _ZERO:
            break
        _, independent, right = np.linalg.svd(A[rank:] / length[:, None])
        if independent[-1] < _ZERO:
            break
        free = right[len(A) - rank :].T
        A, E = A[:rank] @ free, E[:rank] @ free
    return np.zeros(0, dtype=np.complex128)


def pole_change(before: FloatArray, after: FloatArray, slowest: float) -> tuple[float, int]:
    """Return the largest relative change of the poles that remain, and how many are lost.

    Poles are matched so that the relative changes add up to the least. Relative to a pole's size, or to `slowest`,
    rad/s, where it is less: poles at the origin have no size.
    """
    from scipy.optimize import linear_sum_assignment

    lost = len(before) - len(after)
    if not len(after) or not len(before):
        return 0.0, max(lost, 0)
    size = np.maximum(np.abs(before), slowest)[:, None]
    change = np.abs(before[:, None] - after[None, :]) / size
    rows, columns = linear_sum_assignment(change)
    return float(change[rows, columns].max()), max(lost, 0)
