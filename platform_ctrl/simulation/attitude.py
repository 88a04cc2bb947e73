"""Attitudes that callers hand in."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.arguments import real_array
from platform_ctrl.errors import ArgumentError
from platform_ctrl.frozen import FloatArray


def unit_quaternions(given: ArrayLike | None, shape: tuple[int, ...]) -> FloatArray:
    """Return unit quaternions w, x, y, z of `shape`, the identity if `given` is None."""
    if given is None:
        return np.array(np.broadcast_to([1.0, 0.0, 0.0, 0.0], shape))
    attitude = real_array("attitude", given, shape)
    norm = np.linalg.norm(attitude, axis=-1, keepdims=True)
    if np.abs(norm - 1.0).max(initial=0.0) > 1e-6:
        worst = norm.flat[np.abs(norm - 1.0).argmax()]
        raise ArgumentError(f"attitude: given a norm of {worst:.6g}; expected unit quaternions w, x, y, z")
    return np.asarray(attitude / norm)
