"""Plants with masses and offsets as models of MuJoCo and of Pinocchio: every rotor, geared ones too, is a body there.

What belongs to a carrier's numbers in the plant (the mass of a rotor without its own, a motor's mass and transverse
inertia) is taken out of them at the carrier's centre of mass, where it changes nothing else.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from platform_ctrl import Platform

# Share of a carrier's mass that a rotor without its own has.
SHARE = 0.05


class Part(NamedTuple):
    """A rigid body on a hinge (the root: free): everything in its own axes, from its joint."""

    name: str
    parent: str
    axis: np.ndarray
    origin: np.ndarray
    mass: float
    centre: np.ndarray
    inertia: np.ndarray


def parts(platform: Platform) -> list[Part]:
    """Return all bodies, parents first: the root, gimbals, rotors (``rotor:`` + name), motors (``motor:`` + number)."""
    zero = np.zeros(3)
    own = {platform.root_name: Part(platform.root_name, "", zero, zero, *platform.bodies[0])}
    for gimbal, body in zip(platform.gimbals, platform.bodies[1:], strict=True):
        own[gimbal.name] = Part(gimbal.name, gimbal.parent, gimbal.axis, gimbal.origin, *body)
    spinning = []
    for rotor in platform.rotors:
        inertia = rotor.body.inertia + rotor.axial_inertia * np.outer(rotor.axis, rotor.axis)
        carrier, mass, origin = own[rotor.carrier], rotor.mass, rotor.origin
        if not mass:
            mass, origin = SHARE * carrier.mass, carrier.centre
            own[rotor.carrier] = carrier._replace(mass=carrier.mass - mass)
        spinning.append(Part(f"rotor:{rotor.name}", rotor.carrier, rotor.axis, origin, mass, zero, inertia))
    for k, motor in enumerate(platform.motors):
        gimbal = platform.gimbals[platform.gimbal(motor.gimbal)]
        carrier, J = own[gimbal.parent], motor.rotor_inertia
        mass, across = SHARE * carrier.mass, J * (np.eye(3) - np.outer(gimbal.axis, gimbal.axis))
        own[gimbal.parent] = carrier._replace(mass=carrier.mass - mass, inertia=carrier.inertia - across)
        part = Part(f"motor:{k}", gimbal.parent, gimbal.axis, carrier.centre, mass, zero, J * np.eye(3))
        spinning.append(part)
    ordered, left = [own.pop(platform.root_name)], list(own.values())
    while left:
        there = {part.name for part in ordered}
        ordered += [part for part in left if part.parent in there]
        left = [part for part in left if part.parent not in there]
    return ordered + spinning


@dataclass(frozen=True)
class Motion:
    """A state of the plant and its change; `f` is the specific force of the root's origin in root axes."""

    q: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    f: np.ndarray
    attitude: np.ndarray


# Forces and mass matrix of [acceleration less gravity of the root's origin and Omega, in root axes, joints' rates]:
# called with the bodies, the joints' angles, all rates and accelerations, and the attitude.
Solver = Callable[[list[Part], np.ndarray, np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


def by_bodies(platform: Platform, motion: Motion, solver: Solver) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return [M, Q], the force on the root, and A* (without PᵀP/m where the root floats) of a motion by an oracle."""
    bodies = parts(platform)
    joints = [part.name for part in bodies[1:]]
    n = len(platform.gimbals)
    place = {name: 6 + k for k, name in enumerate(joints)}
    E = np.zeros((6 + len(joints), 3 + n))
    E[3:6, :3] = np.eye(3)
    for k, name in enumerate(platform.gimbal_names):
        E[place[name], 3 + k] = 1.0
    for k, motor in enumerate(platform.motors):
        E[place[f"motor:{k}"], 3 + platform.gimbal(motor.gimbal)] = motor.gear
    rate, change = E @ motion.velocity, E @ motion.acceleration
    angle = np.zeros(len(joints))
    angle[[place[name] - 6 for name in platform.gimbal_names]] = motion.q
    change[:3] = 0.0 if platform.mode == "floating" else motion.f
    rotors = [place[f"rotor:{rotor.name}"] for rotor in platform.rotors]
    free = [place[f"rotor:{rotor.name}"] for rotor in platform.rotors if rotor.control == "free"]
    _, M = solver(bodies, angle, rate, change, motion.attitude)
    for rotor, at in zip(platform.rotors, rotors, strict=True):
        carried = M[at] @ rate / rotor.axial_inertia
        rate[at] = rotor.spin - (carried if rotor.control == "free" else 0.0)
    force, M = solver(bodies, angle, rate, change, motion.attitude)
    # What is left to itself, a floating root's place and free rotors, moves so that no force is on it.
    loose = [*(range(3) if platform.mode == "floating" else ()), *free]
    if loose:
        change[loose] -= np.linalg.solve(M[np.ix_(loose, loose)], force[loose])
        force, M = solver(bodies, angle, rate, change, motion.attitude)
    A = E.T @ M @ E
    if loose:
        across = E.T @ M[:, loose]
        A -= across @ np.linalg.solve(M[np.ix_(loose, loose)], across.T)
    return E.T @ force, force[:3], A


def mujoco_model(bodies: list[Part]) -> Any:
    """Return the model of bodies, without gravity."""
    import mujoco

    def numbers(values: Any) -> str:
        return " ".join(repr(float(x)) for x in np.ravel(values))

    def written(part: Part) -> str:
        joint = (
            f'<joint name="{part.name}" type="hinge" axis="{numbers(part.axis)}"/>' if part.parent else "<freejoint/>"
        )
        moments, axes = np.linalg.eigh(part.inertia)
        axes[:, 0] *= np.sign(np.linalg.det(axes))
        turn = Rotation.from_matrix(axes).as_quat(scalar_first=True)
        own = f'mass="{part.mass!r}" diaginertia="{numbers(moments)}" quat="{numbers(turn)}"'
        inner = "".join(written(child) for child in bodies if child.parent == part.name)
        place = f'<inertial pos="{numbers(part.centre)}" {own}/>'
        return f'<body name="{part.name}" pos="{numbers(part.origin)}">{joint}{place}{inner}</body>'

    option = '<option gravity="0 0 0"><flag contact="disable"/></option><compiler inertiafromgeom="false"/>'
    text = f"<mujoco>{option}<worldbody>{written(bodies[0])}</worldbody></mujoco>"
    return mujoco.MjModel.from_xml_string(text)


def by_mujoco(
    bodies: list[Part], angle: np.ndarray, rate: np.ndarray, change: np.ndarray, attitude: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return forces and mass matrix by MuJoCo: in world axes, which `attitude` turns."""
    import mujoco

    model = mujoco_model(bodies)
    data = mujoco.MjData(model)
    R = np.eye(len(rate))
    R[:3, :3] = Rotation.from_quat(attitude, scalar_first=True).as_matrix()
    order = [*range(6), *(int(model.joint(part.name).dofadr[0]) for part in bodies[1:])]
    data.qpos[3:7] = attitude
    for part, q in zip(bodies[1:], angle, strict=True):
        data.qpos[model.joint(part.name).qposadr[0]] = q
    data.qvel[order], data.qacc[order] = R @ rate, R @ change
    mujoco.mj_inverse(model, data)
    M = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, M)
    return R.T @ data.qfrc_inverse[order], R.T @ M[np.ix_(order, order)] @ R


def by_pinocchio(
    bodies: list[Part], angle: np.ndarray, rate: np.ndarray, change: np.ndarray, attitude: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return forces and mass matrix by Pinocchio, whose free joint moves in its own axes."""
    import pinocchio as pin

    model, joints = pin.Model(), {"": 0}
    model.gravity = pin.Motion.Zero()

    def add(part: Part) -> None:  # the composite inertias need every subtree in one piece
        kind = pin.JointModelRevoluteUnaligned(part.axis) if part.parent else pin.JointModelFreeFlyer()
        place, inertia = pin.SE3(np.eye(3), part.origin), pin.Inertia(part.mass, part.centre, part.inertia)
        joints[part.name] = model.addJoint(joints[part.parent], kind, place, part.name)
        model.appendBodyToJoint(joints[part.name], inertia, pin.SE3.Identity())
        for child in bodies:
            if child.parent == part.name:
                add(child)

    add(bodies[0])
    data = model.createData()
    order = [*range(6), *(model.joints[joints[part.name]].idx_v for part in bodies[1:])]
    q, v, a = pin.neutral(model), np.zeros(model.nv), np.zeros(model.nv)
    for part, one in zip(bodies[1:], angle, strict=True):
        q[model.joints[joints[part.name]].idx_q] = one
    v[order], a[order] = rate, change
    # The root's acceleration counts in its turning axes there, as it is: its origin has no velocity.
    force = pin.rnea(model, data, q, v, a)
    M = pin.crba(model, data, q)
    M = np.triu(M) + np.triu(M, 1).T
    return force[order], M[np.ix_(order, order)]
