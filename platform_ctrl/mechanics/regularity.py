"""Whether a mass matrix can be solved with: gimbal lock and massless gimbals are named, not divided by."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from platform_ctrl.errors import MechanicsError
from platform_ctrl.frozen import FloatArray

# A mass matrix whose unit-diagonal form is worse conditioned than this leaves no correct digits in u̇.
_SINGULAR = 1e-13


def solved_inertia(mass: FloatArray, momenta: FloatArray, names: Sequence[str]) -> FloatArray:
    """Return M⁻¹ times a vector or the columns of a matrix.

    Parameters
    ----------
    mass : (k, k)
        A*, or the part of it that belongs to `names`.
    momenta : (k,) or (k, ...)
        What it is solved for.
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
    unit = scale[:, None] * mass * scale
    values, vectors = np.linalg.eigh(unit)
    if values.size and values[0] < _SINGULAR * values[-1]:
        # What moves in the null direction, by its share of the scaled motion.
        joint = [name for name, part in zip(names, np.abs(vectors[:, 0]), strict=True) if part > 0.3]
        raise MechanicsError(
            f"A* is singular at these angles: {', '.join(joint)} can move without moving any inertia (gimbal lock); "
            "expected other angles, or an inertia about that axis"
        )
    # Elimination keeps more digits of rows of very different size than the eigenvectors do.
    return np.asarray((scale * np.linalg.solve(unit, (scale * momenta.T).T).T).T)


def inverse_inertia(mass: FloatArray, names: Sequence[str]) -> FloatArray:
    """Return M⁻¹, symmetric.

    Raises
    ------
    MechanicsError
        As in `solved_inertia`.
    """
    inverse = solved_inertia(mass, np.eye(len(mass)), names)
    return np.asarray(0.5 * (inverse + inverse.T))
