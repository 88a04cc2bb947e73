"""Mass matrices of many plants with all gimbals at zero: what steps of integration are judged by."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from platform_ctrl.description import Platform
from platform_ctrl.frozen import FloatArray
from platform_ctrl.mechanics.kinematics import Kinematics
from platform_ctrl.simulation.packing import Skeleton, inertias


def masses(shape: Skeleton, platforms: Sequence[Platform], at: Kinematics, locked: Collection[str]) -> FloatArray:
    """Return the mass matrices (N, 3 + n, 3 + n) of plants of one skeleton; rotors of the kinds `locked` add C."""
    bodies = inertias(shape, platforms)
    for k, (b, axis, control) in enumerate(zip(shape.carriers, shape.spin_axes, shape.controls, strict=True)):
        if control in locked:
            axial = np.array([p.rotors[k].axial_inertia for p in platforms])
            bodies[:, b] += axial[:, None, None] * (axis[:, None] * axis)
    out: FloatArray = np.einsum("bij,nbik->njk", at.jacobians, bodies @ at.jacobians)
    return 0.5 * (out + out.transpose(0, 2, 1))
