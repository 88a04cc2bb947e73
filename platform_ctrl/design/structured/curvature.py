"""The curvature that both searches learn on the way."""

from __future__ import annotations

import numpy as np

from platform_ctrl.frozen import FloatArray


def damped_update(H: FloatArray, move: FloatArray, change: FloatArray) -> FloatArray:
    """Return the BFGS update of H for a move that changed the gradient by `change`, damped so that H > 0 (Powell 1978).

    H is returned as it is where it does not curve upwards along the move or `change` is not finite.
    """
    curved = H @ move
    bend, slope = float(move @ curved), float(move @ change)
    if not bend > 0.0 or not np.all(np.isfinite(change)):
        return H
    if slope < 0.2 * bend:
        share = 0.8 * bend / (bend - slope)
        change = share * change + (1.0 - share) * curved
        slope = float(move @ change)
    return np.asarray(H - np.outer(curved, curved) / bend + np.outer(change, change) / slope)
