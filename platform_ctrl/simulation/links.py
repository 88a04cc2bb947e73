"""How the bodies of a platform hang together, in the form of the kernel."""

from __future__ import annotations

import numpy as np

from platform_ctrl.common.values import FloatArray
from platform_ctrl.simulation.kernel.arrays import Links


def joint_frame(axis: FloatArray) -> FloatArray:
    """Return the rotation from a body's axes in the file to those of the kernel, whose z is the joint's axis."""
    # An axis that is 1e-9 rad off has a 1 too.
    if axis.max() == 1.0 and np.count_nonzero(axis) == 1:
        return np.asarray(np.roll(np.eye(3), -1 - int(axis.argmax()), axis=0))
    across = np.cross(axis, np.eye(3)[int(np.abs(axis).argmin())])
    across /= np.linalg.norm(across)
    return np.array([across, np.cross(axis, across), axis])


def tree_links(
    parents: list[int],
    order: tuple[int, ...],
    frames: FloatArray,
    drives: tuple[tuple[int, int], ...],
    erections: list[tuple[int, int]],
    carriers: list[int],
) -> Links:
    """Return how bodies hang together: parents in the file's order, joints' frames, gimbals of drives, erections."""
    n = len(parents)
    rows = np.zeros((n, 13), dtype=np.int64)
    turns = np.zeros((n, 3, 3))
    slot = {(0, 1): 3, (0, 2): 4, (1, 2): 5}
    for m, k in enumerate(order):
        parent = parents[k] + 1
        turn = frames[k + 1] @ frames[parent].T
        renamed = bool(np.isin(turn, (0.0, 1.0)).all())
        x, y, z = (int(row.argmax()) for row in turn) if renamed else (0, 1, 2)
        mixed = [slot[min(i, j), max(i, j)] for i, j in ((x, y), (x, z), (y, z))]
        rows[m] = (k, parent, x, y, z, x, y, z, *mixed, not renamed, order.index(parent - 1) if parent else -1)
        turns[m] = turn
    # Not read-only: to numba these would be arrays of another type, and the kernel would be compiled once more.
    return Links(
        tree=rows,
        turn=turns,
        servo_carrier=np.array(carriers, dtype=np.int64),
        drive=np.array(drives, dtype=np.int64).reshape(-1, 2),
        erection=np.array(erections, dtype=np.int64).reshape(-1, 2),
    )
