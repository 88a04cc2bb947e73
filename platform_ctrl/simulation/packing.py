"""A Platform in the form of the kernel: which slot of the memory holds what, and the numbers that go there.

The layout that plants of the same parts share is worked out once (`skeleton`), their numbers for all of them at a time
(`numbers`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError
from platform_ctrl.mechanics.kinematics import Topology, topology
from platform_ctrl.plant.gimbals import Body
from platform_ctrl.plant.platform import OMEGA_NAMES, Platform
from platform_ctrl.plant.sensors import body_rates, body_rotations, gimbal_rate
from platform_ctrl.simulation.kernel import arrays
from platform_ctrl.simulation.kernel.arrays import At, Links, PlacedLinks


def joint_frame(axis: FloatArray) -> FloatArray:
    """Return the rotation from a body's axes in the file to those of the kernel, whose z is the joint's axis."""
    # An axis that is 1e-9 rad off has a 1 too.
    if axis.max() == 1.0 and np.count_nonzero(axis) == 1:
        return np.asarray(np.roll(np.eye(3), -1 - int(axis.argmax()), axis=0))
    across = np.cross(axis, np.eye(3)[int(np.abs(axis).argmin())])
    across /= np.linalg.norm(across)
    return np.array([across, np.cross(axis, across), axis])


# Laws of dry friction by the names of `Friction.law`; a viscous one is a smooth one without a dry part.
_LAWS = {
    "viscous": arrays.SMOOTH,
    "smooth": arrays.SMOOTH,
    "sticking": arrays.STICKING,
    "bristles": arrays.BRISTLES,
    "elastoplastic": arrays.ELASTOPLASTIC,
}
_SIX = ([0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2])


Terms = tuple[tuple[int, float], ...]
Pairs = Sequence[tuple[int, int]]


@value
class Skeleton:
    """The layout of plants that are made of the same parts in the same places.

    Attributes
    ----------
    links, at
        How the kernel finds its way.
    frames : (1 + n, 3, 3)
        Rotations from the bodies' axes in the file to those of the kernel.
    carriers : (m,), spin_axes : (m, 3)
        Body that each rotor spins in, and its axis there.
    controls, servos
        The rotors' kinds; places of servo rotors among them.
    unbalances, springs, frictions, cages
        Bodies, and gimbals, that they belong to.
    sensors, sight
        Of each sensor, and each output of the line of sight, the terms: index into [q, Omega, rates, rates of the
        bodies, their rotations], those of a body three numbers in the kernel's axes, and weight.
    turned
        Whether any of them is a rotation.
    targets : (nu,)
        As in `kernel.arrays.Shared`.
    stops
        Whether any gimbal has stops.
    """

    links: Links
    at: At
    frames: FloatArray
    carriers: tuple[int, ...]
    spin_axes: FloatArray
    controls: tuple[str, ...]
    servos: tuple[int, ...]
    unbalances: tuple[int, ...]
    springs: tuple[int, ...]
    frictions: tuple[int, ...]
    cages: tuple[int, ...]
    sensors: tuple[Terms, ...]
    sight: tuple[Terms, ...]
    turned: bool
    targets: tuple[int, ...]
    stops: bool


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
    """Return a platform in the form of the kernel."""
    constants, around = numbers(shape := skeleton(platform), [platform])
    return Packed(shape.links, shape.at, constants[0], around[0])


class _Parts:
    """A platform that equals all those made of the same parts in the same places."""

    __slots__ = ("_key", "platform")

    def __init__(self, platform: Platform) -> None:
        self.platform = p = platform
        self._key = (
            p.root_name,
            tuple([(g.name, g.parent, _bytes(g.axis), g.stops is None) for g in p.gimbals]),
            tuple([(r.name, r.carrier, _bytes(r.axis), r.control) for r in p.rotors]),
            tuple([(t.name, t.gimbal, t.root_axis) for t in p.torquers]),
            tuple([s.place for s in p.sensors]),
            sight_of(p),
            tuple([s.gimbal for s in p.held_by]),
            tuple([c.gimbal for c in p.compliances]),
            tuple([(f.gimbal, f.law) for f in p.frictions]),
            tuple([c.gimbal for c in p.cages]),
            tuple([u.body for u in p.unbalances]),
            tuple([(e.gimbal, e.senses, _bytes(e.axis)) for e in p.erections]),
            # How a sensor sees a mode is part of what it reads.
            tuple([(m.name, *(m.participation.get(name, 0.0) for name in p.outputs)) for m in p.modes]),
            tuple([one.gimbal for one in p.motors]),
            tuple([k for k, _ in (*p.windings, *p.cogging)]),
            (len(p.windings), len(p.cogging), tuple([(k, m) for k, m, _ in p.ripples])),
            (_placed(p), p.mode == "floating", bool(p.gravity.any())),
        )

    def __hash__(self) -> int:
        return hash(self._key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Parts) and self._key == other._key


def _placed(platform: Platform) -> bool:
    """Return whether masses and joints lie anywhere, motors have gears, or modes an inertia in common with bodies."""
    masses = [*(body.mass for body in platform.bodies), *(rotor.mass for rotor in platform.rotors)]
    masses += [share for mode in platform.modes for share in mode.inertial(platform.gimbal_names)]
    return any(masses) or bool(platform.motors) or any(g.origin.any() for g in platform.gimbals)


def sight_of(platform: Platform) -> tuple[str, bytes] | None:
    """Return the line of sight in a form that can be compared."""
    sight = platform.line_of_sight
    return None if sight is None else (sight.body, _bytes(sight.direction))


def _bytes(axis: FloatArray) -> bytes:
    return np.asarray(axis, dtype=np.float64).tobytes()


def skeleton(platform: Platform) -> Skeleton:
    """Return what a platform has in common with all that are made of the same parts in the same places."""
    return _skeleton(_Parts(platform))


@lru_cache(maxsize=256)
def _skeleton(parts: _Parts) -> Skeleton:
    platform = parts.platform
    gimbal, body = platform.gimbal, platform.body
    tree = topology(platform)
    frames = np.array([np.eye(3), *(joint_frame(axis) for axis in tree.axes)])
    for kind, elements in (("friction", platform.frictions), ("cage", platform.cages)):
        names = [element.gimbal for element in elements]
        twice = [name for name in names if names.count(name) > 1]
        if twice:
            raise ArgumentError(
                f"platform {platform.name!r}: gimbal {twice[0]!r} has more than one {kind}; combine them"
            )
    terms = [_terms(platform, frames, signals) for signals in platform.outputs.values()]
    many, turns = len(platform.sensors), 5 * len(tree.parents) + 6
    modes = turns + 3 * len(tree.parents) + 3
    controls = tuple(r.control for r in platform.rotors)
    servos = tuple(k for k, control in enumerate(controls) if control == "servo")
    erections = [(gimbal(one.gimbal), body(one.senses)) for one in platform.erections]
    drives = (*platform.sides, *((k, k) for k, _ in (*platform.windings, *platform.cogging)))
    drives += tuple((k, m) for k, m, _ in platform.ripples)
    links = _links(tree, frames, drives, erections, list(servos))
    return Skeleton(
        links=PlacedLinks(*links) if _placed(platform) else links,
        at=_at(platform, len(tree.parents), len(servos)),
        frames=frames,
        carriers=tuple(tree.carriers.tolist()),
        spin_axes=tree.spin_axes,
        controls=controls,
        servos=servos,
        unbalances=tuple(body(one.body) for one in platform.unbalances),
        springs=tuple(gimbal(one.gimbal) for one in platform.held_by),
        frictions=tuple(gimbal(one.gimbal) for one in platform.frictions),
        cages=tuple(gimbal(one.gimbal) for one in platform.cages),
        sensors=tuple(terms[:many]),
        sight=tuple(terms[many:]),
        turned=any(turns <= index < modes for one in terms for index, _ in one),
        targets=platform.targets,
        stops=any(g.stops is not None for g in platform.gimbals),
    )


def _links(tree: Topology, frames: FloatArray, drives: Pairs, erections: Pairs, servos: list[int]) -> Links:
    """Return how bodies hang together: joints' frames, gimbals of drives, erections, which rotors are servos."""
    n = len(tree.parents)
    rows = np.zeros((n, 13), dtype=np.int64)
    turns = np.zeros((n, 3, 3))
    slot = {(0, 1): 3, (0, 2): 4, (1, 2): 5}
    for m, k in enumerate(tree.order):
        parent = int(tree.parents[k]) + 1
        turn = frames[k + 1] @ frames[parent].T
        renamed = bool(np.isin(turn, (0.0, 1.0)).all())
        x, y, z = (int(row.argmax()) for row in turn) if renamed else (0, 1, 2)
        mixed = [slot[min(i, j), max(i, j)] for i, j in ((x, y), (x, z), (y, z))]
        rows[m] = (k, parent, x, y, z, x, y, z, *mixed, not renamed, tree.order.index(parent - 1) if parent else -1)
        turns[m] = turn
    # Not read-only: to numba these would be arrays of another type, and the kernel would be compiled once more.
    return Links(
        tree=rows,
        turn=turns,
        servo_carrier=np.array(tree.carriers[servos], dtype=np.int64),
        drive=np.array(drives, dtype=np.int64).reshape(-1, 2),
        erection=np.array(erections, dtype=np.int64).reshape(-1, 2),
    )


def _terms(platform: Platform, frames: FloatArray, signals: Mapping[str, float]) -> Terms:
    """Terms of a sum of signals; vectors of a body are turned into the kernel's axes."""
    angles = platform.angle_names
    place = {name: k for k, name in enumerate((*angles, *OMEGA_NAMES, *map(gimbal_rate, angles)))}
    first = 8 * len(angles) + 9
    place |= {name: first + k for k, name in enumerate(name for m in platform.modes for name in (m.name, m.rate))}
    weights: dict[int, float] = {}
    for name, weight in signals.items():
        if name in place:
            weights[place[name]] = weight
            continue
        bodies = range(len(frames))
        vectors = [*(body_rates(platform, b) for b in bodies), *(body_rotations(platform, b) for b in bodies)]
        k, i = next((k, names.index(name)) for k, names in enumerate(vectors) if name in names)
        first = 2 * len(angles) + 3 + 3 * k
        for j, turned in enumerate(weight * frames[k % len(frames)][:, i]):
            weights[first + j] = weights.get(first + j, 0.0) + float(turned)
    return tuple((index, weight) for index, weight in weights.items() if weight != 0.0)


def _at(platform: Platform, n: int, servos: int) -> At:
    laws = sum({1 << _LAWS[friction.law] for friction in platform.dry_frictions})
    modes, torquers, placed = len(platform.modes), len(platform.torquers), _placed(platform)
    windings, teeth, ripples = len(platform.windings), len(platform.cogging), len(platform.ripples)
    swings = 2 * n + 7 + 2 * servos
    currents = swings + 2 * modes
    bare = currents + 3 * windings
    keeps = bare if laws > 1 << arrays.SMOOTH else 0
    size = bare + (n * arrays.FRICTION if keeps else 0)
    # A block of the surroundings: [M, Q], Omega, specific force, of every body its rotors' momentum and how fast that
    # changes, the torques wanted of currents, and what the torquers excite the modes with.
    shape, block = arrays.INERTIAL + 3 + n, 7 * n + 15 + windings + modes
    take = arrays.Slots()
    return At(
        yes=True,
        no=False,
        n=n,
        servos=servos,
        size=size,
        joints=bool(platform.held_by or platform.frictions or platform.cages),
        modes=modes,
        torquers=torquers,
        shape=shape,
        dry=laws,
        cages=bool(platform.cages),
        weight=bool(platform.unbalances or platform.erections),
        field=bool(platform.gravity.any()),
        placed=placed,
        floating=platform.mode == "floating",
        course=False,
        windings=windings,
        teeth=teeth,
        ripples=ripples,
        currents=currents,
        wanted=block - modes - windings,
        swings=swings,
        keeps=keeps,
        block=block,
        body=take((1 + n) * arrays.BODY),
        joint=take(n * arrays.JOINT),
        servo=take(servos * arrays.SERVO),
        erection=take(len(platform.erections) * arrays.ERECTION),
        drive=take(3 * len(platform.compliances)),
        winding=take(windings * arrays.WINDING + 3 * (teeth + ripples)),
        mode=take(modes * (shape + torquers)),
        gravity=take(3),
        place=take((1 + n) * arrays.PLACE * placed),
        work=take((1 + n) * arrays.WORK),
        swing=take(modes),
        moving=take((1 + n) * arrays.MOVING * placed),
        matrix=take((3 + n) ** 2 * placed),
        push=take(3 * (3 + n) * placed),
        scratch=take(3 * placed),
        during=take(1 + n * arrays.DURING if keeps else 0),
        stages=take(3 * size),
        state=take(size),
        surroundings=take(3 * block),
        spare_state=take(size),
        spare_block=take(block),
        end=take.end,
    )


def numbers(shape: Skeleton, platforms: Sequence[Platform]) -> tuple[FloatArray, FloatArray]:
    """Return the constants (N, at.work) and surroundings (N, at.block) of plants of one skeleton, as in `Packed`.

    The numbers of a plant do not depend on the other plants.
    """
    at, frames = shape.at, shape.frames
    N, n, m = len(platforms), at.n, len(shape.carriers)
    constants, around = np.zeros((N, at.work)), np.zeros((N, at.block))
    around[:, n + 6 : n + 9] = [p.specific_force for p in platforms]

    rotors = np.array(
        [[(r.axial_inertia, r.angular_momentum) for r in p.rotors] for p in platforms], dtype=np.float64
    ).reshape(N, m, 2)
    carriers, momentum = np.array([_inertias(topology(p)) for p in platforms]), np.zeros((N, 1 + n, 3))
    for k, (b, axis, control) in enumerate(zip(shape.carriers, shape.spin_axes, shape.controls, strict=True)):
        axial, L = rotors[:, k].T
        if control == "regulated":
            carriers[:, b] += axial[:, None, None] * axis[:, None] * axis
        if control != "servo":
            momentum[:, b] += L[:, None] * axis
    around[:, n + 9 : 4 * n + 12] = np.einsum("bij,nbj->nbi", frames, momentum).reshape(N, -1)

    bodies = constants[:, at.body : at.joint].reshape(N, 1 + n, arrays.BODY)
    bodies[:, :, :6] = (frames @ carriers @ frames.transpose(0, 2, 1))[:, :, *_SIX]
    for k, b in enumerate(shape.unbalances):
        moments = np.array([p.unbalances[k].moment for p in platforms])
        bodies[:, b, arrays.UNBALANCE : arrays.UNBALANCE + 3] += (frames[b] @ moments[:, :, None])[:, :, 0]
    _pack_joints(shape, platforms, constants[:, at.joint : at.servo].reshape(N, n, arrays.JOINT))
    servos = constants[:, at.servo : at.erection].reshape(N, -1, arrays.SERVO)
    for j, k in enumerate(shape.servos):
        servos[:, j, :3] = frames[shape.carriers[k]] @ shape.spin_axes[k]
        servos[:, j, 3:] = [
            (r.axial_inertia, r.spin, r.speed_gain, r.speed_integral, r.most) for r in (p.rotors[k] for p in platforms)
        ]
    modes = constants[:, at.mode : at.gravity].reshape(N, at.modes, at.shape + at.torquers)
    torquers, names = [torquer.name for torquer in platforms[0].torquers], platforms[0].gimbal_names
    for j in range(at.modes):
        modes[:, j] = [
            (m.frequency**2, 2.0 * m.damping * m.frequency, *m.base_force, *m.inertial(names), *m.of(torquers))
            for m in (p.modes[j] for p in platforms)
        ]
    constants[:, at.drive : at.mode] = [
        [
            *(number for c in p.compliances for number in (c.strength, c.damping, 0.5 * c.play)),
            *(number for _, one in p.windings for number in (*one[:7], 2.0 / one.delay)),
            *(number for row in [row for _, row in p.cogging] + [row for _, _, row in p.ripples] for number in row),
        ]
        for p in platforms
    ]
    erections = constants[:, at.erection : at.drive].reshape(N, len(platforms[0].erections), arrays.ERECTION)
    for j, device in enumerate(platforms[0].erections):
        erections[:, j, :3] = frames[shape.links.erection[j, 1]] @ device.axis
        erections[:, j, 3:] = [(one.gain, one.most) for one in (p.erections[j] for p in platforms)]
    constants[:, at.gravity : at.gravity + 3] = [p.gravity for p in platforms]
    if at.placed:
        _pack_places(shape, platforms, constants[:, at.place : at.work].reshape(N, 1 + n, arrays.PLACE))
    return constants, around


def _pack_places(shape: Skeleton, platforms: Sequence[Platform], rows: FloatArray) -> None:
    for row, tree in zip(rows, map(topology, platforms), strict=True):
        row[:, arrays.MASS] = tree.masses
        moments = tree.masses[:, None] * tree.centres
        row[:, arrays.FIRST_MOMENT : arrays.ARM] = np.einsum("bij,bj->bi", shape.frames, moments)
        row[1:, arrays.ARM : arrays.GEARED] = np.einsum("kij,kj->ki", shape.frames[1 + tree.parents], tree.joints)
        drives = tree.gears * tree.gear_inertias
        np.add.at(row[:, arrays.GEARED :], 1 + tree.geared, np.stack([drives, tree.gears * drives], axis=1))


def _inertias(tree: Topology) -> FloatArray:
    """Return the bodies' inertias about their joints, (1 + n, 3, 3), those of geared rotors in their parents."""
    bodies = zip(tree.masses.tolist(), tree.centres, tree.inertias, strict=True)
    out = np.array([Body(*one).inertia_about_origin for one in bodies])
    axes = tree.axes[tree.geared]
    turned = tree.gear_inertias[:, None, None] * axes[:, :, None] * axes[:, None, :]
    np.add.at(out, 1 + tree.parents[tree.geared], turned)
    return out


def _pack_joints(shape: Skeleton, platforms: Sequence[Platform], rows: FloatArray) -> None:
    rows[:, :, arrays.CAGE + 2] = math.inf
    for j, k in enumerate(shape.frictions):
        frictions = [p.frictions[j] for p in platforms]
        rows[:, k, arrays.VISCOUS : arrays.CAGE] = [
            (f.viscous, *f.coulomb, *f.breakaway, 1.0 / (f.coulomb_rate or math.inf), 1.0 / f.stribeck_rate)
            for f in frictions
        ]
        rows[:, k, arrays.LAW : arrays.JOINT] = [
            (_LAWS[f.law], f.bristle_stiffness, f.bristle_damping) for f in frictions
        ]
    for j, k in enumerate(shape.springs):
        springs = [p.held_by[j] for p in platforms]
        rows[:, k, : arrays.COULOMB] += [(one.stiffness, one.stiffness * one.rest, one.damping) for one in springs]
    for j, k in enumerate(shape.cages):
        cages = [p.cages[j] for p in platforms]
        rows[:, k, arrays.CAGE : arrays.LAW] = [
            (cage.stiffness, cage.damping, cage.clearance, cage.angle) for cage in cages
        ]
