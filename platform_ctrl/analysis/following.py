"""Controllers of two degrees of freedom: u = K y + H r, of what is measured and of its commands, in one state space."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.analysis.feedback import closed_loop
from platform_ctrl.common.values import FloatArray


def feedback_part(controller: StateArrays, measured: Sequence[int]) -> StateArrays:
    """Return K from some of a controller's inputs, without the states that only the other inputs reach."""
    A, B, C, D, dt = controller
    others = [k for k in range(B.shape[1]) if k not in measured]
    kept = np.flatnonzero(~(_reached(A, B[:, others]) & ~_reached(A, B[:, measured])))
    return StateArrays(A[np.ix_(kept, kept)], B[kept][:, measured], C[:, kept], D[:, measured], dt)


def _reached(A: FloatArray, B: FloatArray) -> NDArray[np.bool_]:
    """Return which states inputs reach, by what is zero in A and B."""
    out: NDArray[np.bool_] = np.any(B != 0.0, axis=1)
    while np.any(new := np.any(A[:, out] != 0.0, axis=1) & ~out):
        out = out | new
    return out


def with_error_alone(controller: StateArrays) -> StateArrays:
    """Return u = K (y − r) of u = K y: inputs y, then r."""
    A, B, C, D, dt = controller
    return StateArrays(A, np.hstack([B, -B]), C, np.hstack([D, -D]), dt)


def commanded_loop(
    plants: StateArrays, controller: StateArrays, torques: Sequence[int], angles: Sequence[int]
) -> StateArrays:
    """Return plants (N, ...) with u = K y + H r closed: inputs the plants', then r; outputs u, then the plants'."""
    A, B, C, D, dt = plants
    p, inputs, outputs = len(angles), B.shape[-1], C.shape[-2]
    many = A.shape[:-2]
    # The commands go through the plant as what is measured without noise.
    through = np.zeros((*many, outputs + p, inputs + p))
    through[..., :outputs, :inputs] = D
    through[..., outputs:, inputs:] = np.eye(p)
    whole = StateArrays(
        A,
        np.concatenate([B, np.zeros((*B.shape[:-1], p))], axis=-1),
        np.concatenate([C, np.zeros((*many, p, C.shape[-1]))], axis=-2),
        through,
        dt,
    )
    found = closed_loop(whole, controller, torques=torques, angles=[*angles, *range(outputs, outputs + p)])
    m, kept = len(torques), inputs + p
    rows = m + outputs
    return found._replace(B=found.B[..., :kept], C=found.C[..., :rows, :], D=found.D[..., :rows, :kept])
