"""Whether a mass matrix can be solved with: gimbal lock and massless gimbals are named, not divided by."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from platform_ctrl.errors import MechanicsError
from platform_ctrl.frozen import FloatArray

# A mass matrix whose unit-diagonal form is worse conditioned than this leaves no correct digits in u̇.
_SINGULAR = 1e-13


def inverse_inertia(mass: FloatArray, names: Sequence[str]) -> FloatArray:
    """Return the inverse of a mass matrix, from its scaled eigenvalues.

    Parameters
    ----------
    mass : (k, k)
        A*, or the part of it that belongs to `names`.
    names
        Its coordinates, for the message.

    Raises
    ------
    MechanicsError
        It is singular: which coordinates can move without moving any inertia.
    """
    diagonal = np.diag(mass)
    if np.any(diagonal <= 0.0):
        still = names[int(np.argmin(diagonal))]
        raise MechanicsError(
            f"A* is singular: {still} moves no inertia; expected some in its body or in what it carries"
        )
    scale = 1.0 / np.sqrt(diagonal)
    values, vectors = np.linalg.eigh(scale[:, None] * mass * scale)
    if values.size and values[0] < _SINGULAR * values[-1]:
        # What moves in the null direction, by its share of the scaled motion.
        joint = [name for name, part in zip(names, np.abs(vectors[:, 0]), strict=True) if part > 0.3]
        raise MechanicsError(
            f"A* is singular at these angles: {', '.join(joint)} can move without moving any inertia (gimbal lock); "
            "expected other angles, or an inertia about that axis"
        )
    out: FloatArray = scale[:, None] * (vectors / values @ vectors.T) * scale
    return out
