"""A Platform as the kernel wants it, and the judging of what callers hand in."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from platform_ctrl.arguments import real_array
from platform_ctrl.description import Platform
from platform_ctrl.errors import ArgumentError
from platform_ctrl.frozen import FloatArray
from platform_ctrl.mechanics.kinematics import topology
from platform_ctrl.simulation.servo_rotors import servo_rotors

Plant = tuple[NDArray[np.int64], FloatArray]


def pack(platform: Platform) -> Plant:
    """Return (tree, body) of a platform.

    `tree` (2, n): the gimbals in an order in which parents come first; the parents' body numbers (0: root, 1 + k:
    gimbal k).

    `body`: a row for each body, then one for each servo rotor, then one for each erection. 12 columns, or 25 if any
    force element acts.

    * Body: the axis in the parent's axes, in row 0 instead the specific force in root axes; the inertia xx, yy, zz, xy,
      xz, yz of the carrier with its rotors (without the axial inertia of those that are not regulated); the sum of L s
      of its rotors but for servo rotors. Where force elements act also the unbalance m r, and of the joint the springs'
      stiffness and their torque at q = 0, viscous friction, dry friction against negative and against positive rates,
      1/coulomb_rate, the cage's stiffness, damping, clearance (infinite for no cage) and angle.
    * Servo rotor: spin axis in the carrier's axes, the carrier's body number, C, spin, speed_gain, speed_integral,
      torque_limit (infinite for none).
    * Erection: sensing axis, body number of the torqued gimbal and of the sensing body, gain, limit.
    """
    tree = topology(platform)
    n = len(tree.parents)
    regulated = np.array([r.control == "regulated" for r in platform.rotors], dtype=bool)
    momenta = np.where([r.control == "servo" for r in platform.rotors], 0.0, tree.L)
    carrier, momentum = tree.inertias.copy(), np.zeros((1 + n, 3))
    axial = np.where(regulated, tree.C, 0.0)
    np.add.at(carrier, tree.carriers, axial[:, None, None] * tree.spin_axes[:, :, None] * tree.spin_axes[:, None, :])
    np.add.at(momentum, tree.carriers, momenta[:, None] * tree.spin_axes)
    servos = servo_rotors(platform)
    acting = any((platform.springs, platform.frictions, platform.cages, platform.unbalances, platform.erections))
    body = np.zeros((1 + n + len(servos) + len(platform.erections), 25 if acting else 12))
    body[0, :3] = platform.specific_force
    body[1 : 1 + n, :3] = tree.axes
    body[: 1 + n, 3:9] = carrier[:, [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    body[: 1 + n, 9:12] = momentum
    for row, r in enumerate(servos, 1 + n):
        loop = (r.axial_inertia, r.spin, r.speed_gain, r.speed_integral, _or_infinite(r.torque_limit))
        body[row, :9] = (*r.axis, platform.body(r.carrier), *loop)
    if acting:
        _pack_elements(platform, body)
    return np.array([tree.order, tree.parents + 1], dtype=np.int64).reshape(2, n), body


def _pack_elements(platform: Platform, body: FloatArray) -> None:
    body[: 1 + len(platform.gimbals), 23] = math.inf
    for unbalance in platform.unbalances:
        body[platform.body(unbalance.body), 12:15] += unbalance.moment
    for spring in platform.springs:
        body[1 + platform.gimbal(spring.gimbal), 15:17] += (spring.stiffness, spring.stiffness * spring.rest)
    for kind, elements in (("friction", platform.frictions), ("cage", platform.cages)):
        names = [element.gimbal for element in elements]
        twice = [name for name in names if names.count(name) > 1]
        if twice:
            raise ArgumentError(
                f"platform {platform.name!r}: gimbal {twice[0]!r} has more than one {kind}; expected one"
            )
    for friction in platform.frictions:
        row = 1 + platform.gimbal(friction.gimbal)
        body[row, 17:21] = (friction.viscous, *friction.coulomb, 1.0 / friction.coulomb_rate)
    for cage in platform.cages:
        body[1 + platform.gimbal(cage.gimbal), 21:25] = (cage.stiffness, cage.damping, cage.clearance, cage.angle)
    for row, device in enumerate(platform.erections, len(body) - len(platform.erections)):
        bodies = (1 + platform.gimbal(device.gimbal), platform.body(device.senses))
        body[row, :7] = (*device.axis, *bodies, device.gain, _or_infinite(device.limit))


def _or_infinite(limit: float | None) -> float:
    return math.inf if limit is None else limit


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
