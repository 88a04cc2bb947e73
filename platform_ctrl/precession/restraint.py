"""What opposes a motion whose inertia is dropped: momentum, dampers and springs."""

from __future__ import annotations

import numpy as np

from platform_ctrl.frozen import FloatArray
from platform_ctrl.precession.reduction import Reduction, Scaled

# Of a frequency against the largest there is: 0, but for rounding.
NOTHING = 1e-9


def slowest(D: FloatArray) -> float:
    """Smallest |s| of s + D, rad/s: how fast a motion gives in to D alone; infinite where there is none."""
    return float(np.abs(np.linalg.eigvals(D)).min()) if len(D) else np.inf


def least_opposed_first(at: Scaled, null: FloatArray) -> FloatArray:
    """Return an orthogonal (n, n) that begins with the null directions; then D grows from column to column."""
    rest = Reduction(N=null, H=null[:, :0]).U
    _, _, right = np.linalg.svd(rest.T @ at.D @ rest)
    return np.hstack([null, rest @ right[::-1].T])


def is_regular(at: Scaled, U: FloatArray) -> bool:
    """Whether D alone decides the motion in the directions U: one of a gyroscopic pair alone is not enough."""
    return slowest(U.T @ at.D @ U) > NOTHING * at.size


def holds(at: Scaled, H: FloatArray, U: FloatArray, fast: float) -> bool:
    """Whether springs hold the directions H, each at a frequency above `fast`, and D the directions U."""
    if H.shape[1] == 0:
        return True
    stiffness = np.linalg.eigvals(H.T @ at.S @ H)
    if np.any(stiffness.real <= 0.0) or np.sqrt(np.abs(stiffness).min()) < fast:
        return False
    # D on U as the held directions, which give way, leave it.
    give = H @ np.linalg.solve(H.T @ at.S @ H, H.T)
    return slowest(U.T @ (np.eye(len(U)) - at.S @ give) @ at.D @ U) > max(fast, NOTHING * at.size)
