"""Currents of motors in linear models: windings between the loops that set them and the joints."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from platform_ctrl.common.values import FloatArray
from platform_ctrl.mechanics.linearisation import LinearModel

Parts = tuple[FloatArray, FloatArray, FloatArray, list[str]]


def with_currents(parts: Parts, inputs: Sequence[str], model: LinearModel) -> Parts:
    """Return A, B, C and states of a system that torques act on with currents of motors and loops as last states."""
    A, B, C, states = parts
    for torquer in model.platform.torquers:
        winding = torquer.winding
        if winding is None or torquer.name not in inputs:
            continue
        own, driven = winding.matrices
        column, n = inputs.index(torquer.name), len(A)
        rate = states.index(model.angle_names[model.platform.gimbal(str(torquer.gimbal))])
        torque = np.outer(B[:, column], [winding.swell * winding.per_ampere, 0.0, 0.0])
        B = B.copy()
        B[:, column] = 0.0
        A = np.block([[A, torque], [np.outer(driven[:, 1], A[rate]), own]])
        B = np.vstack([B, np.outer(driven[:, 1], B[rate])])
        B[n:, column] = driven[:, 0] / winding.per_ampere
        C = np.pad(C, ((0, 0), (0, 3)))
        states = [*states, *(f"{part}_{torquer.name}" for part in ("current", "integral", "voltage"))]
    return A, B, C, states
