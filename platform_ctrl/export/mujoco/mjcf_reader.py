"""MJCF as a plant: bodies on hinges whose axes meet, wheels as rotors, motors as torquers."""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Mapping
from importlib import import_module
from typing import Any

import numpy as np

from platform_ctrl.common.values import FloatArray
from platform_ctrl.errors import InputError
from platform_ctrl.export.mujoco.tree import BALL, FREE, NEAR, Body, Chains, bodies_of
from platform_ctrl.plant.fields import stops_written
from platform_ctrl.plant.mistakes import given, one_line
from platform_ctrl.plant.platform import Platform
from platform_ctrl.plant.reading import read_platform
from platform_ctrl.plant.source import path_of, read_text

Tables = dict[str, Any]

# Armature over C from which on a rotor's speed counts as regulated.
_REGULATED = 1e3
# How `write_mjcf` begins the names of rotors: also of those that do not turn.
_ROTOR = "rotor "
# Rounding of inertias, relative.
_ROUNDING = 1e-9


def read_mjcf(path: str | os.PathLike[str], spins: Mapping[str, float] | None = None) -> Platform:
    """Read a plant from a MuJoCo model.

    The root is the one body on top that does not move or hangs in a ball joint, else the world. Every other body hangs
    on one hinge, or is fixed to what carries it. A hinged body is a rotor if it is round about its hinge, carries
    nothing, and turns: by `spins`, by the model's first keyframe, or by its name, which then begins with "rotor ", or
    its hinge has a speed actuator or an armature of more than 1000 C, which holds its speed. All others are gimbals.

    Parameters
    ----------
    path
        Of the file, at most 64 MiB; what it includes is read too.
    spins
        Spin of rotors relative to their carriers by the name of the hinge, rad/s; default: the first keyframe.

    Returns
    -------
    Platform
        With stops, springs, dampers, dry friction, motors, angle sensors and unbalance as far as a plant file has them.

    Raises
    ------
    InputError
        It cannot be read, is no MJCF, or has something that no platform has; also if the package
        mujoco is not installed.
    """
    file = path_of(path, "the path of an MJCF file")
    label = one_line(str(file))
    read_text(file, "an MJCF file")  # what cannot be read, or is too large
    mujoco = loaded()
    warned: list[str] = []
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(warned.append)  # else they go to a file where the user is
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # as of a nearly singular mass matrix: what matters is refused below
            model = mujoco.MjSpec.from_file(str(file)).compile()
    except Exception as error:
        raise InputError(f"{label}: is no model that MuJoCo takes: {one_line(' '.join(str(error).split()))}") from None
    finally:
        mujoco.set_mju_user_warning(before)
    if any("NaN" in words for words in warned):
        raise InputError(f"{label}: holds a number that is NaN; all numbers must be finite")
    with np.errstate(all="ignore"):  # what is not finite is refused with its place
        tables = _Model(mujoco, model, label, dict(spins or {})).tables()
    try:
        return read_platform(tables)
    except InputError as error:
        raise InputError(f"{label}: {str(error).removeprefix('plant given as a dict: ')}") from None


def loaded() -> Any:
    """Return the module mujoco."""
    try:
        return import_module("mujoco")
    except ImportError:
        raise InputError("MJCF is read by mujoco, which is not installed: pip install mujoco") from None


class _Model:
    """A compiled model on its way to the tables of a plant file."""

    def __init__(self, mujoco: Any, model: Any, label: str, spins: dict[str, float]) -> None:
        self.mujoco, self.model, self.label = mujoco, model, label
        self.data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, self.data)
        mujoco.mj_comPos(model, self.data)
        self.bodies, self.root_joint, self.size = bodies_of(model, self.data, label)
        self.spins = self._spins(spins)
        self.servos = self._servos()
        self.rotors = [k for k, body in enumerate(self.bodies) if self._is_rotor(k, body)]
        self.gimbals = [k for k in range(1, len(self.bodies)) if k not in self.rotors]
        if not self.gimbals and not self.rotors:
            raise InputError(f"{label}: has no body on a hinge; a platform needs at least one gimbal or rotor")

    def tables(self) -> Tables:
        """Return the plant."""
        model, root = self.model, self.bodies[0]
        rotors = [self._rotor(k) for k in self.rotors]
        inertias, moments = self._about_centres()
        gravity = (
            np.zeros(3) if model.opt.disableflags & int(self.mujoco.mjtDisableBit.mjDSBL_GRAVITY) else model.opt.gravity
        )
        up = -self.data.xmat[root.number].reshape(3, 3).T @ gravity
        out: Tables = {
            "schema": 1,
            "name": one_line(self._title()),
            "root": {"name": root.name, "inertia": _matrix(inertias[0]), "specific_force": _clean(up)},
            "gimbal": [self._gimbal(k, inertias[k]) for k in self.gimbals],
            "rotor": rotors,
            "spring": [],
            "friction": [],
            "unbalance": [],
        }
        for k in self.gimbals:
            self._bearing(k, out)
        for k, moment in moments.items():
            if np.linalg.norm(moment) > NEAR * self.size * self.bodies[k].mass:
                out["unbalance"].append({"body": self.bodies[k].name, "moment": _clean(moment)})
        self._actuators(out)
        self._sensors(out)
        return out

    def _title(self) -> str:
        return str(self.model.names[: self.model.names.index(b"\0")].decode("utf-8", "replace")) or "model"

    def _wrong(self, k: int, words: str) -> InputError:
        return InputError(f"{self.label}: body {given(self.bodies[k].name)} {words}")

    def _hinge(self, k: int) -> str:
        joint = self.bodies[k].joint
        return one_line(self.model.joint(joint).name) or f"joint{joint}"

    def _spins(self, given_spins: dict[str, float]) -> dict[int, float]:
        """Spins of hinges by their number in the model."""
        names = {self._hinge(k): body.joint for k, body in enumerate(self.bodies) if body.joint >= 0}
        for name, spin in given_spins.items():
            if name not in names or not isinstance(spin, int | float) or not math.isfinite(spin):
                raise InputError(
                    f"{self.label}: spins: {given(name)} = {given(spin)} must be a hinge and a finite rate, rad/s"
                )
        if given_spins:
            return {names[name]: float(spin) for name, spin in given_spins.items()}
        if not self.model.nkey:
            return {}
        rates = self.model.key_qvel[0]
        found = {joint: float(rates[self.model.jnt_dofadr[joint]]) for joint in names.values()}
        return {joint: rate for joint, rate in found.items() if rate}

    def _actuators_on(self, joint: int) -> list[int]:
        model = self.model
        kinds = self.mujoco.mjtTrn
        return [
            k
            for k in range(model.nu)
            if model.actuator_trntype[k] in (int(kinds.mjTRN_JOINT), int(kinds.mjTRN_JOINTINPARENT))
            and model.actuator_trnid[k, 0] == joint
        ]

    def _servos(self) -> dict[int, tuple[float, float]]:
        """Gains of speed loops, proportional and integral, by hinge."""
        model, out = self.model, {}
        for joint in range(model.njnt):
            gain, integral = 0.0, 0.0
            for k in self._actuators_on(joint):
                kv, (_, position, rate) = model.actuator_gainprm[k, 0], model.actuator_biasprm[k, :3]
                integrates = model.actuator_dyntype[k] == int(self.mujoco.mjtDyn.mjDYN_INTEGRATOR)
                if kv > 0.0 and rate == -kv and position == 0.0:
                    gain += kv
                elif kv > 0.0 and position == -kv and rate == 0.0 and integrates:
                    integral += kv
            if gain:
                out[joint] = (float(gain), float(integral))
        return out

    def _is_rotor(self, k: int, body: Body) -> bool:
        if body.joint < 0 or any(other.parent == k for other in self.bodies):
            return False
        turns = bool(self.spins.get(body.joint)) or body.joint in self.servos or self._regulated(body)
        turns = turns or body.name.startswith(_ROTOR)
        return turns and self._round(body)

    def _regulated(self, body: Body) -> bool:
        armature = self.model.dof_armature[self.model.jnt_dofadr[body.joint]]
        return bool(armature > _REGULATED * (body.axis @ body.about(body.anchor)[1] @ body.axis))

    def _round(self, body: Body) -> bool:
        """Whether a body is symmetric about its hinge, with its centre of mass on it."""
        centre = body.moment / body.mass
        inertia = body.about(centre)[1]
        C = float(body.axis @ inertia @ body.axis)
        A = 0.5 * (np.trace(inertia) - C)
        own = A * np.eye(3) + (C - A) * np.outer(body.axis, body.axis)
        off = np.cross(body.axis, centre - body.anchor)
        round_ = np.abs(inertia - own).max() <= 1e-6 * np.trace(inertia)
        return bool(round_ and np.linalg.norm(off) <= NEAR * self.size)

    def _rotor(self, k: int) -> Tables:
        """Return a rotor's table, and leave its mass with its carrier."""
        body, model = self.bodies[k], self.model
        dof = int(model.jnt_dofadr[body.joint])
        if model.dof_damping[dof] or model.dof_frictionloss[dof] or model.jnt_stiffness[body.joint]:
            raise self._wrong(k, "is a rotor with friction or a spring on its hinge; remove it")
        if model.jnt_limited[body.joint]:
            raise self._wrong(k, "is a rotor with a limited angle; remove the limit")
        centre = body.moment / body.mass
        inertia = body.about(centre)[1]
        C = float(body.axis @ inertia @ body.axis)
        self.bodies[body.parent].take(body.mass, centre)
        name = body.name.removeprefix(_ROTOR)
        out: Tables = {
            "name": name,
            "carrier": self.bodies[body.parent].name,
            "axis": _clean(body.axis),
            "axial_inertia": C,
            "transverse_inertia": 0.5 * (float(np.trace(inertia)) - C),
            "spin": self.spins.get(body.joint, 0.0),
            "control": "regulated" if self._regulated(body) else "free",
        }
        if body.joint in self.servos:
            gain, integral = self.servos[body.joint]
            out |= {"control": "servo", "speed_gain": gain, "speed_integral": integral}
        return out

    def _about_centres(self) -> tuple[dict[int, FloatArray], dict[int, FloatArray]]:
        joint, anchor = self.root_joint, None
        chain = Chains(self.bodies, self.gimbals, self.size, self.label)
        if joint >= 0 and self.model.jnt_type[joint] == FREE:
            anchor = chain.whole_centre()
        elif joint >= 0:
            number, data = int(self.model.jnt_bodyid[joint]), self.data
            anchor = data.xmat[number].reshape(3, 3).T @ (data.xanchor[joint] - data.xpos[number])
        return chain.about_centres(chain.root_centre() if anchor is None else anchor)

    def _gimbal(self, k: int, inertia: FloatArray) -> Tables:
        body, model, joint = self.bodies[k], self.model, self.bodies[k].joint
        if model.dof_armature[model.jnt_dofadr[joint]]:
            raise self._wrong(k, "has an armature on its hinge; add it to the inertia of the body")
        out: Tables = {
            "name": body.name,
            "parent": self.bodies[body.parent].name,
            "axis": _clean(body.axis),
            "inertia": _matrix(inertia),
        }
        if model.joint(joint).name:
            out["angle"] = one_line(model.joint(joint).name)
        if model.jnt_limited[joint]:
            out |= stops_written((model.jnt_range[joint] - self._reference(joint)).tolist())
            wait, ratio = model.jnt_solref[joint]
            if wait > 0.0 and 0.0 < ratio < 1.0:
                out["restitution"] = math.exp(-math.pi * ratio / math.sqrt(1.0 - ratio * ratio))
        return out

    def _reference(self, joint: int) -> float:
        return float(self.model.qpos0[self.model.jnt_qposadr[joint]])

    def _bearing(self, k: int, out: Tables) -> None:
        """Add spring and friction of a gimbal's hinge."""
        model, joint = self.model, self.bodies[k].joint
        dof, name = int(model.jnt_dofadr[joint]), self.bodies[k].name
        if np.any(model.jnt_stiffnesspoly[joint]) or np.any(model.dof_dampingpoly[dof]):
            raise self._wrong(k, "has a spring or damper that is not linear; a platform has only linear ones")
        if stiffness := float(model.jnt_stiffness[joint]):
            rest = float(model.qpos_spring[model.jnt_qposadr[joint]]) - self._reference(joint)
            out["spring"].append({"gimbal": name, "stiffness": stiffness, "rest": rest})
        viscous, dry = float(model.dof_damping[dof]), float(model.dof_frictionloss[dof])
        if viscous or dry:
            out["friction"].append({"gimbal": name, "viscous": viscous, "coulomb": dry})

    def _actuators(self, out: Tables) -> None:
        torquers: list[Tables] = []
        of = {self.bodies[k].joint: k for k in self.gimbals}
        wheels = {self.bodies[k].joint for k in self.rotors}
        armature = 0.0
        if self.root_joint >= 0:
            armature = float(self.model.dof_armature[self.model.jnt_dofadr[self.root_joint]])
        for k in range(self.model.nu):
            joint = int(self.model.actuator_trnid[k, 0])
            where = f"{self.label}: actuator {given(self.model.actuator(k).name or str(k))}"
            on_joint = k in self._actuators_on(joint)
            if on_joint and joint in of:
                torquers += self._torquer(k, where, {"gimbal": self.bodies[of[joint]].name}, 0, out)
            elif on_joint and joint == self.root_joint:
                if not armature:  # else they prescribe its rate
                    torquers += self._root_torquer(k, where, out)
            elif not (on_joint and joint in wheels and joint in self.servos):
                raise InputError(
                    f"{where} acts on no gimbal; motors must act on hinges of gimbals or on the root's joint"
                )
        out["torquer"] = torquers

    def _root_torquer(self, k: int, where: str, out: Tables) -> list[Tables]:
        gear = self.model.actuator_gear[k]
        turning = gear[3:] if self.model.jnt_type[self.root_joint] == FREE else gear[:3]
        axes = np.flatnonzero(turning)
        if len(axes) != 1 or self.model.jnt_type[self.root_joint] not in (BALL, FREE):
            raise InputError(f"{where} must turn the root about one of its three axes; set one of them in gear")
        first = 3 if self.model.jnt_type[self.root_joint] == FREE else 0
        return self._torquer(k, where, {"root_axis": int(axes[0]) + 1}, first + int(axes[0]), out)

    def _torquer(self, k: int, where: str, acts: Tables, axis: int, out: Tables) -> list[Tables]:
        """Return the torquer that an actuator is; a bias of position alone is a spring."""
        model, dyn = self.model, self.mujoco.mjtDyn
        scale = float(model.actuator_gear[k, axis] * model.actuator_gainprm[k, 0])
        bias = model.actuator_biasprm[k, :3] * (model.actuator_biastype[k] != 0)
        if scale == 0.0 and "gimbal" in acts and bias[1] and not bias[2]:
            out["spring"].append({**acts, "stiffness": -float(bias[1]), "rest": -float(bias[0] / bias[1])})
            return []
        if np.any(bias) or scale == 0.0 or model.actuator_gaintype[k] != 0:
            raise InputError(f"{where} is no motor; its torque must depend on its control alone")
        table = dict(acts)
        if model.actuator(k).name:
            table["name"] = one_line(model.actuator(k).name)
        kind = int(model.actuator_dyntype[k])
        if kind in (int(dyn.mjDYN_FILTER), int(dyn.mjDYN_FILTEREXACT)):
            table["lag"] = float(model.actuator_dynprm[k, 0])
        elif kind != int(dyn.mjDYN_NONE):
            raise InputError(f"{where} has dynamics other than a first-order filter, which a torquer cannot have")
        limits = []
        for limited, ends, size in (
            (model.actuator_ctrllimited[k], model.actuator_ctrlrange[k], abs(scale)),
            (model.actuator_forcelimited[k], model.actuator_forcerange[k], abs(float(model.actuator_gear[k, axis]))),
        ):
            if limited:
                if not math.isclose(-ends[0], ends[1], rel_tol=1e-9):
                    raise InputError(
                        f"{where} has the limits {ends[0]:g} and {ends[1]:g}, which must be equal to both sides"
                    )
                limits.append(size * float(ends[1]))
        if limits:
            table["limit"] = min(limits)
        return [table]

    def _sensors(self, out: Tables) -> None:
        model, kinds = self.model, self.mujoco.mjtSensor
        of = {self.bodies[k].joint: self.bodies[k].name for k in self.gimbals}
        found: dict[str, list[Tables]] = {"pickoff": [], "rate_sensor": [], "angle_sensor": []}
        for k in range(model.nsensor):
            joint = int(model.sensor_objid[k])
            key = {int(kinds.mjSENS_JOINTPOS): "pickoff", int(kinds.mjSENS_JOINTVEL): "rate_sensor"}
            table = key.get(int(model.sensor_type[k]))
            if table is None or joint not in of:
                continue
            own: Tables = {"gimbal": of[joint], "noise_rms": float(model.sensor_noise[k])}
            if not any(one["gimbal"] == of[joint] for one in found[table]):
                found[table].append(own)
            elif table == "pickoff":
                found["angle_sensor"].append({"name": model.sensor(k).name, **own})
        out |= found


def _matrix(inertia: FloatArray) -> list[list[float]]:
    """Take what is rounding of the sum of many bodies for zero, and make it symmetric."""
    out = 0.5 * (inertia + inertia.T)
    out[np.abs(out) < _ROUNDING * np.trace(out)] = 0.0
    return [_clean(row) for row in out]


def _clean(vector: FloatArray) -> list[float]:
    """Take digits that are rounding for zero."""
    largest = np.abs(vector).max(initial=0.0)
    return [float(x) if abs(x) > 1e-12 * largest else 0.0 for x in vector]
