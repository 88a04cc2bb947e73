"""Least squares within linear limits."""

from __future__ import annotations

import numpy as np

from platform_ctrl.common.values import FloatArray


def constrained_least_squares(A: FloatArray, b: FloatArray, G: FloatArray, h: FloatArray) -> FloatArray:
    """Return the x (n,) of least |A x - b| with G x <= h, h >= 0; A has full column rank.

    With A = Q R and z = R x - Qᵀ b it is the least z within other half spaces, which non-negative least squares finds.

    References
    ----------
    C. L. Lawson, R. J. Hanson, Solving Least Squares Problems, 1974, ch. 23.
    """
    from scipy.linalg import solve_triangular
    from scipy.optimize import nnls

    Q, R = np.linalg.qr(A)
    u = Q.T @ b
    M = solve_triangular(R, G.T, trans="T").T
    rhs = M @ u - h
    E = np.vstack([-M.T, rhs])
    target = np.zeros(len(E))
    target[-1] = 1.0
    y, rest = nnls(E, target)
    away = E @ y - target
    z = -away[:-1] / away[-1] if rest > 1e-12 else np.zeros(len(u))
    return np.asarray(solve_triangular(R, z + u))
