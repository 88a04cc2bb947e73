"""Random trees with everything that is nasty, and the same trees as models of MuJoCo.

It knows nothing of rotors whose speed is held: here every rotor is a body of its own on a hinge. It is imported when a
model is built.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from plant_parts import Friction, Gimbal, Rotor, Spring, Unbalance
from platform_ctrl import Platform

EPS = np.finfo(float).eps
DEPTH = 6  # longest chain of gimbals
FASTEST = 2000.0  # fastest rotor, rad/s


@dataclass(frozen=True)
class Motion:
    """A platform in motion; `rng` for whatever else a statement needs."""

    platform: Platform
    q: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    attitude: np.ndarray
    rng: np.random.Generator


def for_all(strategy: st.SearchStrategy[Any], examples: int) -> Callable[..., Any]:
    """Turn a statement about one drawn value into a test of so many examples."""
    effort = settings(max_examples=examples, deadline=None, suppress_health_check=list(HealthCheck))
    return lambda statement: effort(given(strategy)(statement))


def turn(axis: np.ndarray, angle: float) -> np.ndarray:
    """Return the rotation about a unit axis, (3, 3)."""
    matrix: np.ndarray = Rotation.from_rotvec(np.asarray(axis) * angle).as_matrix()
    return matrix


def rotation(quaternion: np.ndarray) -> np.ndarray:
    """Return the rotation of a quaternion w, x, y, z, (3, 3)."""
    matrix: np.ndarray = Rotation.from_quat(np.roll(quaternion, -1)).as_matrix()
    return matrix


@st.composite
def motions(draw, controls=("regulated", "free"), max_rotors=4, min_size=1e-6):
    """Draw a platform in motion.

    Chains to depth 6 and bushes of up to 8 gimbals, listed in any order. Axes: any, a coordinate axis, the parent's,
    its negative, nearly parallel to it, or the one that locks with the grandparent's at the parent's angle, to within
    1e-9 to 1e-2 rad. Inertias from `min_size` to 1 kg m² side by side, flat and rod-like bodies among them. Rotors on
    any body and about any axis, at rest or to 2000 rad/s, regulated or free.
    """
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n = draw(st.integers(1, 8))
    shape = draw(st.sampled_from(["chain", "bush", "any"]))
    parents, depths = [], []
    for k in range(n):
        able = [j for j in range(k) if depths[j] < DEPTH]
        if shape == "chain" and able:
            parent = max(able, key=lambda j: depths[j])
        elif shape == "bush":
            parent = draw(st.integers(-1, min(k - 1, 1)))
        else:
            parent = draw(st.sampled_from([-1, *able]))
        parents.append(parent)
        depths.append(1 + (depths[parent] if parent >= 0 else 0))
    q = rng.uniform(-np.pi, np.pi, n)
    q[[draw(st.integers(0, 3)) == 0 for _ in range(n)]] = 0.0
    axes: list[np.ndarray] = []
    for parent in parents:
        kinds = ["any", "coordinate"]
        if parent >= 0:
            kinds += ["parallel", "antiparallel", "nearly parallel"]
            kinds += ["lock"] * 2 * (parents[parent] >= 0)
        kind = draw(st.sampled_from(kinds))
        sign = 1.0 if draw(st.booleans()) else -1.0
        if kind == "any":
            axis = _unit(rng)
        elif kind == "coordinate":
            axis = sign * np.eye(3)[draw(st.integers(0, 2))]
        elif kind == "lock":
            away = sign * 10 ** rng.uniform(-9, -2)
            axis = sign * turn(axes[parent], q[parent] + away).T @ axes[parents[parent]]
        else:
            axis = {"parallel": 1.0, "antiparallel": -1.0, "nearly parallel": sign}[kind] * axes[parent]
            if kind == "nearly parallel":
                axis = axis + 10 ** rng.uniform(-9, -2) * _unit(rng)
        axes.append(axis / np.linalg.norm(axis))
    names = ["root", *(f"g{k}" for k in range(n))]

    def size() -> float:
        # The ends are the hard cases.
        low = np.log10(min_size)
        return float(10 ** draw(st.sampled_from([0.0, low, rng.uniform(low, 0.0)])))

    gimbals = [
        Gimbal(
            name=names[1 + k], parent=names[1 + parents[k]], axis=axes[k], inertia=_inertia(rng, size()), angle=f"q{k}"
        )
        for k in range(n)
    ]
    rotors = []
    for k in range(draw(st.integers(0, max_rotors))):
        carrier = draw(st.integers(-1, n - 1))
        kind = draw(st.sampled_from(["any", "coordinate", "own axis"]))
        if kind == "own axis" and carrier >= 0:
            axis = axes[carrier] * rng.choice([-1.0, 1.0])
        else:
            axis = _unit(rng) if kind == "any" else np.eye(3)[draw(st.integers(0, 2))]
        axial = 0.3 * size()
        spin = draw(st.sampled_from([0.0, FASTEST, -FASTEST, rng.uniform(-FASTEST, FASTEST), rng.normal()]))
        rotors.append(
            Rotor(
                name=f"r{k}",
                carrier=names[1 + carrier],
                axis=axis,
                axial_inertia=axial,
                transverse_inertia=float(axial * rng.uniform(0.5, 2.0)),
                angular_momentum=axial * spin,
                control=draw(st.sampled_from(controls)),
            )
        )
    order = rng.permutation(n)
    platform = Platform(
        name="random tree",
        root_name="root",
        root_inertia=_inertia(rng, size()),
        gimbals=tuple(gimbals[k] for k in order),
        rotors=tuple(rotors),
    )
    quick, hard = 10 ** rng.uniform(-3, 1, 2)
    return Motion(
        platform=platform,
        q=q[order],
        velocity=quick * rng.normal(size=3 + n),
        acceleration=hard * rng.normal(size=3 + n),
        attitude=_unit(rng, 4),
        rng=rng,
    )


def _unit(rng: np.random.Generator, size: int = 3) -> np.ndarray:
    vector = rng.normal(size=size)
    return vector / np.linalg.norm(vector)


def _inertia(rng: np.random.Generator, size: float) -> np.ndarray:
    # Principal moments from positive second moments keep the triangle inequality.
    spread = 10 ** rng.uniform(-rng.choice([0.3, 3.0]), 0, 3)
    basis, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    inertia = basis @ np.diag(spread.sum() - spread) @ basis.T * size
    return 0.5 * (inertia + inertia.T)


def unbalanced(motion: Motion) -> tuple[Platform, np.ndarray, np.ndarray, np.ndarray]:
    """Move the centres of mass: what leaves the bodies' inertia about the fixed point as it is."""
    platform, rng = motion.platform, motion.rng
    inertias = [platform.root_inertia, *(g.inertia for g in platform.gimbals)]
    offsets = rng.normal(size=(len(inertias), 3)) * 10 ** rng.uniform(-2, -1)
    # About the centre of mass there has to be a body left: m r² takes a quarter of the smallest second moment.
    least = np.array([0.5 * np.trace(inertia) - np.linalg.eigvalsh(inertia)[-1] for inertia in inertias])
    masses = 0.25 * least * rng.uniform(0.1, 1.0, len(least)) / np.sum(offsets**2, axis=1)
    gravity = rng.normal(size=3) * 9.81
    unbalances = tuple(
        Unbalance(body=name, moment=mass * offset)
        for name, mass, offset in zip((platform.root_name, *platform.gimbal_names), masses, offsets, strict=True)
    )
    return replace(platform, unbalances=unbalances), masses, offsets, gravity


def moments_carried(motion: Motion, masses: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """Σ m |r| of the bodies that each row carries, (3 + n,)."""
    platform = motion.platform
    moments = masses * np.linalg.norm(offsets, axis=1)
    out = np.zeros(3 + len(platform.gimbals))
    for body, moment in enumerate(moments):
        out[:3] += moment
        at = body
        while at:
            out[2 + at] += moment
            at = 1 + int(platform.parents[at - 1])
    return out


def sprung(motion: Motion) -> Motion:
    """Give every gimbal a spring (some drive it away) and viscous friction, both slow beside the motion."""
    platform, rng = motion.platform, motion.rng
    bodies = np.array([np.linalg.eigvalsh(g.inertia)[0] for g in platform.gimbals])
    rate = np.linalg.norm(motion.velocity)
    springs = tuple(
        Spring(gimbal=name, stiffness=float(size * rate**2 * rng.normal()), rest=float(rng.normal()))
        for name, size in zip(platform.gimbal_names, bodies, strict=True)
    )
    frictions = tuple(
        Friction(gimbal=name, viscous=float(size * rate * rng.uniform()))
        for name, size in zip(platform.gimbal_names, bodies, strict=True)
    )
    return replace(motion, platform=replace(platform, springs=springs, frictions=frictions))


@dataclass(frozen=True)
class Link:
    """A body of the tree as general multi-body programs see it; `rotor` says which rotor it is, or None."""

    name: str
    parent: int
    axis: np.ndarray | None
    inertia: np.ndarray
    gimbal: int | None = None
    rotor: int | None = None


def links(platform: Platform, rotors: str = "bodies") -> list[Link]:
    """Return the bodies, root first, depth first.

    `rotors`: "bodies" of their own, or "locked": regulated rotors belong to their carriers with C, free ones without.
    """
    eye = np.eye(3)
    inertias = [np.array(inertia) for inertia in (platform.root_inertia, *(g.inertia for g in platform.gimbals))]
    carriers = 1 + platform.carriers
    along = [np.outer(rotor.axis, rotor.axis) for rotor in platform.rotors]
    if rotors == "locked":
        for rotor, body, axial in zip(platform.rotors, carriers, along, strict=True):
            inertias[body] += rotor.transverse_inertia * (eye - axial)
            inertias[body] += (rotor.control != "free") * rotor.axial_inertia * axial
    out = [Link(platform.root_name, -1, None, inertias[0])]
    waiting = [(0, 0)]
    while waiting:
        body, at = waiting.pop()
        if body:
            gimbal = platform.gimbals[body - 1]
            out.append(Link(gimbal.name, at, gimbal.axis, inertias[body], gimbal=body - 1))
            at = len(out) - 1
        for k in np.flatnonzero(carriers == body) if rotors == "bodies" else ():
            rotor = platform.rotors[k]
            inertia = rotor.transverse_inertia * (eye - along[k]) + rotor.axial_inertia * along[k]
            out.append(Link(f"rotor {rotor.name}", at, rotor.axis, inertia, rotor=int(k)))
        waiting += [(1 + int(k), at) for k in np.flatnonzero(platform.parents == body - 1)]
    return out


@dataclass(frozen=True)
class Rounding:
    """What rounding may do to the rows of a platform, from bodies' sizes and rates alone.

    The moment balance of body b is J_b α_b + ω_b × J_b ω_b; its rounding is a few eps ‖J_b‖ (|α_b| + |ω_b|²) whatever
    the method, and a joint's row gathers that of all bodies that it carries. A rotor as a body has its spin in ω_b:
    with exact numbers ω × Jω contains no spin², in floating point eps C spin² is left.

    Attributes
    ----------
    torque : (3 + n + m,)
        Σ ‖J_b‖ (|α_b| + |ω_b|²) over the bodies that each row carries, those of the rotors last, N m.
    mass : (3 + n + m, 3 + n + m)
        Σ ‖J_b‖ over the bodies that both carry, kg m²: a row's own diagonal may be far less (a rotor's A does not count
        about its axis).
    energy, momentum
        Σ ‖J_b‖ |ω_b|², J; Σ ‖J_b‖ |ω_b|, N m s.
    """

    torque: np.ndarray
    mass: np.ndarray
    energy: float
    momentum: float


def rounding(motion: Motion, spin: np.ndarray | None = None, spin_acceleration: np.ndarray | float = 0.0) -> Rounding:
    """Return the sizes that eps multiplies; `spin` of the rotors relative to their carriers, default none."""
    platform, u, u_dot = motion.platform, motion.velocity, motion.acceleration
    n, m = len(platform.gimbals), len(platform.rotors)
    spin = np.zeros(m) if spin is None else spin
    on_path = np.zeros((1 + n, 3 + n), dtype=bool)
    on_path[:, :3] = True
    for body in range(1 + n):
        at = body
        while at:
            on_path[body, 2 + at] = True
            at = 1 + int(platform.parents[at - 1])
    bodies = [(platform.root_inertia, 0), *((g.inertia, 1 + k) for k, g in enumerate(platform.gimbals))]
    size = np.array([np.linalg.norm(inertia, 2) for inertia, _ in bodies])
    size = np.concatenate([size, [max(r.axial_inertia, r.transverse_inertia) for r in platform.rotors]])
    carried = np.zeros((1 + n + m, 3 + n + m), dtype=bool)
    carried[:, : 3 + n] = np.vstack([on_path, on_path[1 + platform.carriers]])
    carried[1 + n :, 3 + n :] = np.eye(m, dtype=bool)
    rate = carried @ np.abs(np.concatenate([u, spin]))
    change = carried @ np.abs(np.concatenate([u_dot, np.broadcast_to(spin_acceleration, m)]))
    moment = size * (change + rate**2)
    return Rounding(
        torque=carried.T @ moment,
        mass=carried.T @ (size[:, None] * carried),
        energy=float(size @ rate**2),
        momentum=float(size @ rate),
    )


def agree(what: str, ours: np.ndarray | float, theirs: np.ndarray | float, allowed: np.ndarray | float) -> None:
    """Assert |ours − theirs| <= allowed, entry by entry."""
    away = np.abs(np.asarray(ours) - np.asarray(theirs))
    assert np.all(away <= allowed), f"{what}: off by up to {np.max(away / allowed):.3g} times what rounding explains"


class Tree:
    """Indices of one library's velocity vector: root in ``[:3]``, `gimbals`, `rotors`."""

    def __init__(self, bodies: Sequence[Link]) -> None:
        self.bodies = bodies
        self.gimbals = self._places([body.gimbal for body in bodies])
        self.rotors = self._places([body.rotor for body in bodies])
        self.size = 2 + len(bodies)

    @staticmethod
    def _places(owners: list[int | None]) -> np.ndarray:
        # The root takes three places.
        place = {owner: 2 + k for k, owner in enumerate(owners) if owner is not None}
        return np.array([place[k] for k in range(len(place))], dtype=int)

    def spins(self, platform: Platform, carried: np.ndarray) -> np.ndarray:
        """Return φ̇, (m,), by (8) or (4); `carried`: rates that the carriers' motion adds about the rotors' axes."""
        free = [rotor.control == "free" for rotor in platform.rotors]
        return np.array([rotor.spin for rotor in platform.rotors]) - np.where(free, carried, 0.0)

    @property
    def platform_places(self) -> np.ndarray:
        """Where [Omega, q̇] of the package stands."""
        return np.concatenate([[0, 1, 2], self.gimbals])

    def vector(self, platform_part: np.ndarray, rotor_part: np.ndarray | float = 0.0) -> np.ndarray:
        """Return a velocity, acceleration or force in the library's order."""
        out = np.zeros(self.size)
        out[self.platform_places] = platform_part
        out[self.rotors] = rotor_part
        return out


def centred(body: Link, masses: np.ndarray | None, offsets: np.ndarray | None) -> tuple[float, np.ndarray, np.ndarray]:
    """Return mass, centre of mass, and inertia about it (the package's is about the fixed point)."""
    if masses is None or offsets is None:
        return 1.0, np.zeros(3), body.inertia
    if body.rotor is not None:
        # MuJoCo moves all inertias to the common centre of mass: a heavy body of little inertia would lose it in m r².
        return float(np.linalg.norm(body.inertia, 2)), np.zeros(3), body.inertia
    k = 0 if body.gimbal is None else 1 + body.gimbal
    mass, offset = masses[k], offsets[k]
    return mass, offset, body.inertia - mass * (offset @ offset * np.eye(3) - np.outer(offset, offset))


class MujocoTree(Tree):
    """The tree in MuJoCo: a ball joint and hinges; springs and viscous friction are those of `elements`."""

    def __init__(
        self,
        platform: Platform,
        rotors: str = "bodies",
        masses: np.ndarray | None = None,
        offsets: np.ndarray | None = None,
        gravity: Sequence[float] = (0.0, 0.0, 0.0),
        elements: Platform | None = None,
    ) -> None:
        import mujoco

        super().__init__(links(platform, rotors))
        springs = {spring.gimbal: spring for spring in elements.springs} if elements else {}
        frictions = {friction.gimbal: friction for friction in elements.frictions} if elements else {}
        spec = mujoco.MjSpec()
        spec.option.gravity = gravity
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
        spec.option.disableflags = mujoco.mjtDisableBit.mjDSBL_CONSTRAINT | mujoco.mjtDisableBit.mjDSBL_EULERDAMP
        spec.compiler.degree = False
        spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
        made = [spec.worldbody]
        for body in self.bodies:
            mass, offset, about_centre = centred(body, masses, offsets)
            moments, basis = np.linalg.eigh(about_centre)
            if np.linalg.det(basis) < 0.0:
                basis[:, 0] *= -1.0
            if np.abs(basis - np.eye(3)).max() < 0.1:
                # MuJoCo takes principal axes within 1e-6 of the body's own for the same: name them in another order.
                moments, basis = np.roll(moments, 1), np.roll(basis, 1, axis=1)
            # Not `fullinertia`: the principal axes that MuJoCo finds are good to 50 eps, as much as is allowed here.
            added = made[1 + body.parent].add_body(
                name=body.name,
                mass=mass,
                ipos=offset,
                inertia=moments,
                iquat=np.roll(Rotation.from_matrix(basis).as_quat(), 1),
                explicitinertial=True,
            )
            if body.axis is None:
                added.add_joint(type=mujoco.mjtJoint.mjJNT_BALL)
            else:
                joint = added.add_joint(type=mujoco.mjtJoint.mjJNT_HINGE, axis=body.axis)
                if body.name in springs:
                    joint.stiffness[0], joint.springref = springs[body.name].stiffness, springs[body.name].rest
                if body.name in frictions:
                    joint.damping[0] = frictions[body.name].viscous
            made.append(added)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)

    def set(self, q: np.ndarray, attitude: np.ndarray, velocity: np.ndarray, phi: np.ndarray | float = 0.0) -> None:
        """Set the state: quaternion w, x, y, z and angles; `velocity` in MuJoCo's order."""
        self.data.qpos[:4] = attitude
        self.data.qpos[1 + self.gimbals] = q
        self.data.qpos[1 + self.rotors] = phi
        self.data.qvel[:] = velocity
