"""Controllers of lower order for searches to begin with: balanced truncation."""

from __future__ import annotations

import numpy as np

from platform_ctrl.analysis.norms import stationary_covariance
from platform_ctrl.design.blocks import Block
from platform_ctrl.frozen import FloatArray

# Hankel singular values below this share of the largest say nothing.
_NEGLIGIBLE = 1e-7


def balanced_truncation(block: Block, order: int, sampled: bool, negligible: float = _NEGLIGIBLE) -> Block:
    """Return the balanced truncation of a stable block, by square roots (Tombs and Postlethwaite 1987).

    Parameters
    ----------
    block
        Stable.
    order
        Most states that are kept: fewer where the others are negligible.
    sampled
        Whether it is a sampled one.
    negligible
        Share of the largest Hankel singular value below which a state is left out.

    Raises
    ------
    numpy.linalg.LinAlgError
        The gramians have no singular values.
    """
    A, B, C, D = block
    if not len(A):
        return block
    reach, show = (_root(_gramian(a, b, sampled)) for a, b in ((A, B), (A.T, C.T)))
    U, s, V = np.linalg.svd(show.T @ reach)
    order = min(order, int(np.sum(s > negligible * s[0])))
    scale = 1.0 / np.sqrt(s[:order])
    right, left = reach @ V[:order].T * scale, (show @ U[:, :order] * scale).T
    first, into, out = (np.asarray(item, dtype=np.float64) for item in (left @ A @ right, left @ B, C @ right))
    return first, into, out, D


def _gramian(A: FloatArray, B: FloatArray, sampled: bool) -> FloatArray:
    """Return X = A X A' + B B', or A X + X A' + B B' = 0."""
    if sampled:
        return stationary_covariance(A, B)
    from scipy.linalg import solve_continuous_lyapunov

    return np.asarray(solve_continuous_lyapunov(A, -B @ B.T), dtype=np.float64)


def _root(gramian: FloatArray) -> FloatArray:
    values, vectors = np.linalg.eigh(0.5 * (gramian + gramian.T))
    out: FloatArray = vectors * np.sqrt(np.maximum(values, 0.0))
    return out
