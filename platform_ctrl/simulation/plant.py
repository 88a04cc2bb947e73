"""A Platform as the kernel wants it, and the judging of what callers hand in."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from platform_ctrl.arguments import real_array
from platform_ctrl.description import Platform
from platform_ctrl.errors import ArgumentError
from platform_ctrl.frozen import FloatArray
from platform_ctrl.mechanics.kinematics import topology


def pack(platform: Platform) -> tuple[NDArray[np.int64], FloatArray]:
    """Return (tree, body) of a platform.

    `tree` (2, n): the gimbals in an order in which parents come first; the parents' body numbers (0: root, 1 + k:
    gimbal k). `body` (1 + n, 12), a row each: the axis in the parent's axes; the inertia xx, yy, zz, xy, xz, yz of the
    carrier with its rotors (a free rotor without its axial inertia); the sum of L s of its rotors.
    """
    tree = topology(platform)
    n = len(tree.parents)
    carrier, momentum = tree.inertias.copy(), np.zeros((1 + n, 3))
    axial = np.where(tree.regulated, tree.C, 0.0)
    np.add.at(carrier, tree.carriers, axial[:, None, None] * tree.spin_axes[:, :, None] * tree.spin_axes[:, None, :])
    np.add.at(momentum, tree.carriers, tree.L[:, None] * tree.spin_axes)
    body = np.zeros((1 + n, 12))
    body[1:, :3] = tree.axes
    body[:, 3:9] = carrier[:, [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    body[:, 9:] = momentum
    return np.array([tree.order, tree.parents + 1], dtype=np.int64).reshape(2, n), body


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
