"""A Platform as the kernel wants it, and the judging of what callers hand in."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from platform_ctrl.arguments import real_array
from platform_ctrl.description import Platform
from platform_ctrl.errors import ArgumentError
from platform_ctrl.frozen import FloatArray


def pack(platform: Platform) -> tuple[NDArray[np.int64], FloatArray]:
    """Return (tree, body) of a platform.

    `tree` (2, n): the gimbals in an order in which parents come first; the parents' body numbers (0: root, 1 + k:
    gimbal k). `body` (1 + n, 12), a row each: the axis in the parent's axes; the inertia xx, yy, zz, xy, xz, yz of the
    carrier with its rotors (a free rotor without its axial inertia); the sum of L s of its rotors.
    """
    n = len(platform.gimbals)
    parent = platform.parents + 1
    order: list[int] = []
    ready = {0}
    while len(order) < n:
        found = [k for k in range(n) if k + 1 not in ready and int(parent[k]) in ready]
        if not found:
            raise ArgumentError(f"platform {platform.name!r}: the gimbals' parents form a ring; expected a tree")
        order += found
        ready |= {k + 1 for k in found}
    carrier = [platform.root_inertia.copy(), *(g.inertia.copy() for g in platform.gimbals)]
    momentum = np.zeros((n + 1, 3))
    for rotor, k in zip(platform.rotors, platform.carriers, strict=True):
        along = np.outer(rotor.axis, rotor.axis)
        carrier[k + 1] += rotor.transverse_inertia * (np.eye(3) - along)
        if rotor.control == "regulated":
            carrier[k + 1] += rotor.axial_inertia * along
        momentum[k + 1] += rotor.angular_momentum * rotor.axis
    body = np.zeros((n + 1, 12))
    for k, inertia in enumerate(carrier):
        body[k, 3:9] = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    body[1:, :3] = [g.axis for g in platform.gimbals] or np.zeros((0, 3))
    body[:, 9:] = momentum
    return np.array([order, parent], dtype=np.int64).reshape(2, n), body


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


def positive(what: str, given: float, zero: bool = False) -> float:
    """Return a finite float above zero (or, with `zero`, not below it)."""
    try:
        number = float(given)
    except (TypeError, ValueError):
        raise ArgumentError(f"{what}: given {given!r}; expected a number") from None
    if not np.isfinite(number) or number < 0.0 or (number == 0.0 and not zero):
        raise ArgumentError(f"{what}: given {given!r}; expected a finite number {'>=' if zero else '>'} 0")
    return number
