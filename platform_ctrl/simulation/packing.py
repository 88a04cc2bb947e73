"""A Platform as the kernel wants it: which slot of the memory holds what, and the numbers that go there."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from platform_ctrl.description import Platform
from platform_ctrl.errors import ArgumentError
from platform_ctrl.frozen import FloatArray, read_only
from platform_ctrl.mechanics.kinematics import Topology, topology
from platform_ctrl.simulation.kernel import body as layout
from platform_ctrl.simulation.kernel.body import At, Links
from platform_ctrl.simulation.servo_rotors import servo_rotors

_SIX = ([0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2])


class Packed(NamedTuple):
    """A plant for the kernel.

    `constants` are the first slots of the memory, the same for all scenarios of this plant; `around` the surroundings
    in which nothing acts but the platform's own specific force and its rotors' momenta.
    """

    links: Links
    at: At
    constants: FloatArray
    around: FloatArray


def pack(platform: Platform) -> Packed:
    """Return a platform as the kernel wants it."""
    tree = topology(platform)
    n = len(tree.parents)
    frames = frames_of(platform)
    links = _links(platform, tree)
    at = _at(platform, n)
    constants = np.zeros(at.work)
    around = np.zeros(at.block)
    around[n + 6 : n + 9] = platform.specific_force

    regulated = np.array([r.control == "regulated" for r in platform.rotors], dtype=bool)
    momenta = np.where([r.control == "servo" for r in platform.rotors], 0.0, tree.L)
    carriers, momentum = tree.inertias.copy(), np.zeros((1 + n, 3))
    axial = np.where(regulated, tree.C, 0.0)
    np.add.at(carriers, tree.carriers, axial[:, None, None] * tree.spin_axes[:, :, None] * tree.spin_axes[:, None, :])
    np.add.at(momentum, tree.carriers, momenta[:, None] * tree.spin_axes)
    around[n + 9 : 4 * n + 12] = np.einsum("bij,bj->bi", frames, momentum).ravel()
    bodies = constants[at.body : at.joint].reshape(1 + n, layout.BODY)
    bodies[:, :6] = (frames @ carriers @ frames.transpose(0, 2, 1))[:, *_SIX]
    for unbalance in platform.unbalances:
        b = platform.body(unbalance.body)
        bodies[b, layout.UNBALANCE : layout.UNBALANCE + 3] += frames[b] @ unbalance.moment
    _pack_joints(platform, constants[at.joint : at.servo].reshape(n, layout.JOINT))
    for row, r in zip(constants[at.servo : at.erection].reshape(-1, layout.SERVO), servo_rotors(platform), strict=True):
        loop = (r.axial_inertia, r.spin, r.speed_gain, r.speed_integral, _or_infinite(r.torque_limit))
        row[:] = (*(frames[platform.body(r.carrier)] @ r.axis), *loop)
    for row, device in zip(
        constants[at.erection : at.work].reshape(-1, layout.ERECTION), platform.erections, strict=True
    ):
        row[:] = (*(frames[platform.body(device.senses)] @ device.axis), device.gain, _or_infinite(device.limit))
    return Packed(links, at, constants, around)


def frames_of(platform: Platform) -> FloatArray:
    """Return the rotations (1 + n, 3, 3) from the bodies' axes in the file to those of the kernel."""
    return _frames(_axes(platform))


def _axes(platform: Platform) -> bytes:
    """Return the gimbals' axes as something that a cache can look up."""
    return b"".join(np.asarray(gimbal.axis, dtype=np.float64).tobytes() for gimbal in platform.gimbals)


# What depends on the tree alone is worked out once for all the plants of a campaign.
@lru_cache(maxsize=256)
def _frames(axes: bytes) -> FloatArray:
    return read_only([np.eye(3), *(_frame(axis) for axis in np.frombuffer(axes).reshape(-1, 3))])


def _frame(axis: FloatArray) -> FloatArray:
    """Rotation from a body's axes in the file to those of the kernel, whose z is the joint's axis."""
    along = np.flatnonzero(axis == 1.0)
    if len(along):
        return np.asarray(np.roll(np.eye(3), -1 - int(along[0]), axis=0))
    across = np.cross(axis, np.eye(3)[int(np.abs(axis).argmin())])
    across /= np.linalg.norm(across)
    return np.array([across, np.cross(axis, across), axis])


def _links(platform: Platform, tree: Topology) -> Links:
    erections = tuple((platform.gimbal(one.gimbal), platform.body(one.senses)) for one in platform.erections)
    carriers = tuple(platform.body(r.carrier) for r in servo_rotors(platform))
    return _links_of(tuple(tree.parents.tolist()), tree.order, _axes(platform), erections, carriers)


@lru_cache(maxsize=256)
def _links_of(
    parents: tuple[int, ...],
    order: tuple[int, ...],
    axes: bytes,
    erections: tuple[tuple[int, int], ...],
    carriers: tuple[int, ...],
) -> Links:
    n, frames = len(parents), _frames(axes)
    rows = np.zeros((n, 12), dtype=np.int64)
    turns = np.zeros((n, 3, 3))
    slot = {(0, 1): 3, (0, 2): 4, (1, 2): 5}
    for m, k in enumerate(order):
        parent = parents[k] + 1
        turn = frames[k + 1] @ frames[parent].T
        renamed = bool(np.isin(turn, (0.0, 1.0)).all())
        x, y, z = (int(row.argmax()) for row in turn) if renamed else (0, 1, 2)
        mixed = [slot[min(i, j), max(i, j)] for i, j in ((x, y), (x, z), (y, z))]
        rows[m] = (k, parent, x, y, z, x, y, z, *mixed, not renamed)
        turns[m] = turn
    # Not read-only: to numba these would be arrays of another type, and the kernel would be compiled once more.
    return Links(
        tree=rows,
        turn=turns,
        servo_carrier=np.array(carriers, dtype=np.int64),
        erection=np.array(erections, dtype=np.int64).reshape(-1, 2),
    )


def _at(platform: Platform, n: int) -> At:
    servos = len(servo_rotors(platform))
    size = 2 * n + 7 + 2 * servos
    body = 0
    joint = body + (1 + n) * layout.BODY
    servo = joint + n * layout.JOINT
    erection = servo + servos * layout.SERVO
    work = erection + len(platform.erections) * layout.ERECTION
    stages = work + (1 + n) * layout.WORK
    state = stages + 3 * size
    surroundings = state + size
    return At(
        yes=True,
        no=False,
        n=n,
        servos=servos,
        size=size,
        joints=bool(platform.springs or platform.frictions or platform.cages),
        dry=any(max(f.breakaway) > 0.0 for f in platform.frictions),
        cages=bool(platform.cages),
        weight=bool(platform.unbalances or platform.erections),
        course=False,
        body=body,
        joint=joint,
        servo=servo,
        erection=erection,
        work=work,
        stages=stages,
        state=state,
        surroundings=surroundings,
        block=layout.slots_of_block(n),
        end=surroundings + 3 * layout.slots_of_block(n),
    )


def _pack_joints(platform: Platform, rows: FloatArray) -> None:
    rows[:, layout.CAGE + 2] = math.inf
    for spring in platform.springs:
        rows[platform.gimbal(spring.gimbal), :2] += (spring.stiffness, spring.stiffness * spring.rest)
    for kind, elements in (("friction", platform.frictions), ("cage", platform.cages)):
        names = [element.gimbal for element in elements]
        twice = [name for name in names if names.count(name) > 1]
        if twice:
            raise ArgumentError(
                f"platform {platform.name!r}: gimbal {twice[0]!r} has more than one {kind}; expected one"
            )
    for friction in platform.frictions:
        k = platform.gimbal(friction.gimbal)
        rows[k, layout.VISCOUS : layout.CAGE] = (
            friction.viscous,
            *friction.coulomb,
            *friction.breakaway,
            1.0 / friction.coulomb_rate,
            1.0 / friction.stribeck_rate,
        )
    for cage in platform.cages:
        k = platform.gimbal(cage.gimbal)
        rows[k, layout.CAGE :] = (cage.stiffness, cage.damping, cage.clearance, cage.angle)


def _or_infinite(limit: float | None) -> float:
    return math.inf if limit is None else limit
