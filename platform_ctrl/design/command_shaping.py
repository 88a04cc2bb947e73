"""Commands of a loop behind a reference filter, with feedforward of their acceleration: u = K (y − F r) + J sᵏ F r.

F = ω²/(s + ω)² does not overshoot, and J are the inertias that the loop's torquers turn: a torque shows in the
derivative k of what is measured, 1 of a rate and 2 of an angle. Both are sampled by Tustin's rule.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import block_diag

from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.partition import Channels, derived_low_pass, low_pass
from platform_ctrl.job.job import CommandShaping

# Of the reference filter: it answers a step without overshoot.
_DAMPING = 1.0


def shaped(K: StateArrays, shaping: CommandShaping, directions: Channels, sense: FloatArray) -> StateArrays:
    """Return the controller of readings and their commands, of K from the readings.

    `sense` (n, p) leads from the readings to the directions, along which the inertias are known.
    """
    p, w = len(K.B.T), 2.0 * math.pi * shaping.filter_hz
    one, derivative = low_pass(w, _DAMPING, K.dt), derived_low_pass(w, _DAMPING, directions.order, K.dt)
    A, B, C, D = (block_diag(*(part,) * p) for part in one[:4])
    torque = directions.inertias[:, None] * sense if shaping.acceleration else np.zeros_like(sense)
    C_own, D_own = (block_diag(*(part,) * p) for part in (derivative.C, derivative.D))
    return StateArrays(
        np.block([[K.A, -K.B @ C], [np.zeros((len(A), len(K.A))), A]]),
        np.block([[K.B, -K.B @ D], [np.zeros((len(A), p)), B]]),
        np.hstack([K.C, torque @ C_own - K.D @ C]),
        np.hstack([K.D, torque @ D_own - K.D @ D]),
        K.dt,
    )
