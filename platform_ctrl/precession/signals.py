"""The state equations of all subsystems together, in angles and momenta with names."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.arguments import distinct
from platform_ctrl.description import OMEGA_NAMES
from platform_ctrl.frozen import FloatArray
from platform_ctrl.precession.part import PrecessionPart
from platform_ctrl.precession.reduction import echelon, reduced_equations
from platform_ctrl.precession.wording import named_directions

if TYPE_CHECKING:
    import control


def system(
    parts: Sequence[PrecessionPart],
    momentum_states: bool,
    gimbals: Sequence[str],
    angles: Sequence[str],
    torquers: Sequence[str],
    torque_map: FloatArray,
) -> control.StateSpace:
    """Return the models of all parts as one system.

    `gimbals` and `angles` are those of all parts, and the rows of `torque_map`, (n, torquers); the order is the file's.
    """
    import control

    n, m = len(gimbals), len(torquers)
    states: list[str] = []
    size = sum(_states(part, momentum_states) for part in parts)
    A, B, C, D = np.zeros((size, size)), np.zeros((size, m + 3)), np.zeros((n, size)), np.zeros((n, m + 3))
    for part in parts:
        at, kept = part._reduction(momentum_states)
        of = reduced_equations(at, kept)
        T, back = at.T, at.back
        mine = [list(gimbals).index(name) for name in part.gimbals]
        inputs = np.hstack([T.T @ torque_map[mine], np.zeros((len(mine), 3))])
        rates = np.hstack([np.zeros((3, m)), np.eye(3)])
        if kept.H.shape[1]:
            # Combinations of angles that the held directions leave alone.
            rows, leading = echelon(kept.U.T @ back)
            change, to_old = rows @ T @ kept.U, kept.U.T @ back @ np.linalg.pinv(rows)
            names = [
                part.angles[k] if np.count_nonzero(row) == 1 else f"y_{part.angles[k]}"
                for row, k in zip(rows, leading, strict=True)
            ]
        else:
            _, _, leading = named_directions(at, kept.N, part.angles)
            momenta = part.momentum_directions.T @ back.T @ kept.N
            k = len(leading)
            zero = np.zeros((len(T), k))
            change = np.block([[T, zero], [zero.T, momenta]])
            to_old = np.block([[back, zero], [zero.T, np.linalg.inv(momenta)]])
            names = [*part.angles, *(f"pi_{part.angles[k]}" for k in leading)]
        here = slice(len(states), len(states) + len(names))
        A[here, here] = change @ of.A @ to_old
        B[here] = change @ (of.B @ inputs + of.E @ rates)
        C[mine, here] = T @ of.C @ to_old
        D[mine] = T @ (of.F @ inputs + of.J @ rates)
        states += names
    # Angles in the file's order, then combinations, then momenta.
    order = sorted(range(size), key=lambda k: (list(angles).index(states[k]) if states[k] in angles else n, k))
    return control.StateSpace(
        A[np.ix_(order, order)],
        B[order],
        C[:, order],
        D,
        inputs=[*torquers, *OMEGA_NAMES],
        outputs=list(angles),
        states=distinct("states", [states[k] for k in order]),
        remove_useless_states=False,
    )


def _states(part: PrecessionPart, momentum_states: bool) -> int:
    _, kept = part._reduction(momentum_states)
    return len(part.gimbals) + int(kept.N.shape[1]) - int(kept.H.shape[1])
