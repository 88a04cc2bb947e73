"""URDF and MJCF as a robot, read by `mujoco.MjSpec` and not compiled; what MuJoCo drops is read from the XML."""

from __future__ import annotations

import math
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, fromstring

import numpy as np
from scipy.spatial.transform import Rotation

from platform_ctrl.common.values import FloatArray, replaced
from platform_ctrl.errors import InputError
from platform_ctrl.export.robots import sdf
from platform_ctrl.export.robots.robot import (
    ASSUMED_GRAVITY,
    GRAVITY,
    NO_BODY,
    ROTOR,
    WORLD,
    Joint,
    Link,
    Part,
    Pose,
    Robot,
    bearing,
    drive,
    gyro,
    hinge_axis,
    no_counterpart,
    numbers,
    ordered,
    plain,
    stops,
    unread,
)
from platform_ctrl.plant.gimbals import Body
from platform_ctrl.plant.mistakes import given, one_line
from platform_ctrl.plant.source import read_text

_READ_OF_URDF = """robot name version link joint transmission gazebo inertial origin xyz rpy mass value inertia ixx iyy izz ixy ixz
    iyz type parent child axis limit lower upper effort velocity dynamics damping friction mimic multiplier
    offset actuator mechanicalReduction reference"""
_READ_OF_MJCF = """mujoco model compiler default worldbody actuator sensor equality include file class childclass name pos quat
    euler axisangle xyaxes zaxis angle eulerseq autolimits inertiafromgeom body frame inertial mass diaginertia
    fullinertia joint freejoint type axis range limited ref stiffness springref damping frictionloss armature
    actuatorfrcrange actuatorfrclimited solreflimit site camera motor position velocity intvelocity general
    jointinparent gear ctrllimited ctrlrange forcelimited forcerange kp kv dampratio dyntype dynprm gaintype
    gainprm biastype biasprm timeconst gyro jointpos jointvel noise connect weld active"""
_SHOWN = f"""{sdf.SHOWN} hardwareInterface sensor mujoco option size statistic asset contact keyframe custom geom mesh pair
    group user solimplimit solreffriction solimpfriction margin meshdir texturedir assetdir strippath
    discardvisual fusestatic coordinate convexhull usethread saveinertial alignfree fitaabb align rgba fovy ipd
    resolution focal sensorsize principal mode fromto inheritrange actrange actlimited anchor relpose body1
    body2 joint1 joint2 polycoef solref solimp"""


def read_spec(file: Path, label: str, top: Element) -> Robot:
    """Return the robot that a URDF or MJCF file describes."""
    reader: type[_Spec] = _Urdf if top.tag == "robot" else _Mjcf
    try:
        mujoco = import_module("mujoco")
    except ImportError:
        words = "is read by the package mujoco, which is not installed: pip install platform_ctrl[import]"
        raise InputError(f"{label}: {reader.format} {words}") from None
    if reader is _Urdf:
        ends = {one.get("name", ""): (_link(one, "parent"), _link(one, "child")) for one in top.findall("joint")}
        ordered(label, ends, [one.get("name", "") for one in top.findall("link")])
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda words: None)  # else they go to a file where the user is
    try:
        return reader(mujoco, file, label, top).robot()
    except InputError:
        raise
    except Exception as error:  # of MuJoCo, which has no class of its own
        raise InputError(f"{label}: is refused by MuJoCo: {one_line(' '.join(str(error).split()))}") from None
    finally:
        mujoco.set_mju_user_warning(before)


def _link(joint: Element, end: str) -> str:
    element = joint.find(end)
    return "" if element is None else element.get("link", "")


class _Spec:
    """What URDF and MJCF have in common: bodies and joints of a specification that is not compiled."""

    format = ""
    read = ""

    def __init__(self, mujoco: Any, file: Path, label: str, top: Element) -> None:
        self.mujoco, self.file, self.label, self.top = mujoco, file, label, top
        self.spec = mujoco.MjSpec.from_file(str(file))
        self.notes: list[str] = []
        self.parts: list[Part] = []
        self.poses: dict[str, Pose] = {}
        for k, body in enumerate(self.spec.bodies):
            body.name = body.name or f"body{k}"
            above = Pose() if body.parent is None else self.poses[body.parent.name]
            self.poses[body.name] = above @ self.pose(body)
        for k, joint in enumerate(self.spec.joints):
            joint.name = joint.name or f"joint{k}"
        self.joints = {one.name: one for one in self.spec.joints}

    def robot(self) -> Robot:
        """Return what was read."""
        raise NotImplementedError

    def turn(self, one: Any, quat: FloatArray, other: Any) -> FloatArray:
        """Return axes that are given as a quaternion or in another way."""
        if other.type != self.mujoco.mjtOrientation.mjORIENTATION_QUAT:
            own = getattr(one, "compiler", self.spec.compiler)
            quat = self.spec.resolve_orientation(own.degree, own.eulerseq, other)
        return _axes(quat)

    def pose(self, one: Any) -> Pose:
        """Return the pose of a body, site or camera in its body, through the frames around it."""
        out = Pose(self.turn(one, one.quat, one.alt), np.array(one.pos))
        return out if one.frame is None else self.pose(one.frame) @ out

    def body(self, body: Any) -> Body:
        """Return mass, centre and inertia of a body, in its own axes."""
        if not body.explicitinertial:
            return NO_BODY
        xx, yy, zz, xy, xz, yz = body.fullinertia
        full = np.diag(body.inertia) if np.isnan(xx) else np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        return Pose(self.turn(body, body.iquat, body.ialt), np.array(body.ipos)).body(float(body.mass), full)

    def link(self, body: Any) -> Link:
        """Return a body as a link, with all of its numbers in the model's axes."""
        pose, own = self.poses[body.name], self.body(body)
        moved = (pose @ Pose(np.eye(3), own.centre)).body(own.mass, own.inertia)
        carrier = "" if body.parent is None else body.parent.name
        return Link(name=body.name, carrier=carrier, joint=self._joint(body), pose=pose, body=moved)

    def _joint(self, body: Any) -> Joint:
        """Return how a body hangs."""
        found, pose, kinds = list(body.joints), self.poses[body.name], self.mujoco.mjtJoint
        if len(found) != 1:
            kind = "fixed" if not found else f"one of {len(found)} joints of a body"
            return Joint(name=found[0].name if found else "", kind=kind, axis=np.zeros(3), at=pose.at, keys={})
        [joint] = found
        kind = {kinds.mjJNT_HINGE: "hinge", kinds.mjJNT_BALL: "ball", kinds.mjJNT_FREE: "free"}.get(
            joint.type, "prismatic"
        )
        around = pose if joint.frame is None else pose @ self.pose(joint.frame)
        at, axis, more = (around @ Pose(np.eye(3), np.array(joint.pos))).at, np.zeros(3), {}
        if kind == "hinge":
            axis, more = around.turn @ hinge_axis(self.label, joint.name, np.array(joint.axis)), self.hinge(joint)
        own = {"keys": {}, "armature": float(joint.armature)} | more
        return Joint(name=joint.name, kind=kind, axis=axis, at=at, **own)

    def hinge(self, joint: Any) -> dict[str, Any]:
        """Return what a hinge has besides its axis; add what acts in it."""
        for what, values in (("damping", joint.damping), ("stiffness", joint.stiffness)):
            if any(values[1:]):
                words = f"{what} {given(np.array(values).tolist())} is not linear: the first number is taken"
                self.notes.append(f"joint {given(joint.name)}: {words}")
        unit = math.pi / 180.0 if joint.compiler.degree else 1.0
        rest = unit * (joint.springref - joint.ref)
        first = (joint.damping[0], joint.frictionloss, joint.stiffness[0])
        self.parts += bearing(joint.name, *map(float, first), rest)
        if not self.limited(joint.limited, joint.range):
            return {}
        keys = stops(joint.name, *(unit * (joint.range - joint.ref)).tolist(), self.notes)
        wait, ratio = joint.solref_limit
        if keys and wait > 0.0 and 0.0 < ratio < 1.0:
            keys["restitution"] = math.exp(-math.pi * ratio / math.sqrt(1.0 - ratio * ratio))
        return {"keys": keys}

    def limited(self, flag: Any, ends: Any) -> bool:
        """Return whether a range counts."""
        choice = self.mujoco.mjtLimited
        return bool(ends[0] < ends[1] if flag == choice.mjLIMITED_AUTO else flag == choice.mjLIMITED_TRUE)

    def made(self, links: list[Link], gravity: Any, loops: Any) -> Robot:
        """Return the robot."""
        self.notes += self._unread(self.top)
        return Robot(
            label=self.label,
            format=self.format,
            name=self.spec.modelname,
            links=tuple(links),
            parts=tuple(self.parts),
            notes=tuple(self.notes),
            gravity=np.array(gravity),
            loops=tuple(loops),
        )

    def _unread(self, top: Element) -> Iterator[str]:
        yield from unread(top, self.read, _SHOWN)
        for one in top.iter("include"):
            text = read_text(self.file.parent / one.get("file", ""), "an MJCF file")
            yield from self._unread(fromstring(text.encode()))


def _axes(quat: Any) -> FloatArray:
    return np.asarray(Rotation.from_quat(quat, scalar_first=True).as_matrix())


class _Urdf(_Spec):
    format = "URDF"
    read = _READ_OF_URDF

    def robot(self) -> Robot:
        """Return what was read, with what MuJoCo drops."""
        links = [self.link(body) for body in self.spec.bodies]
        if WORLD not in [one.get("name") for one in self.top.findall("link")]:  # but MuJoCo's
            links = [replaced(one, {"carrier": one.carrier if one.carrier != WORLD else ""}) for one in links[1:]]
        loops = []
        for element in self.top.findall("joint"):
            name, mimic, limit = element.get("name", ""), element.find("mimic"), element.find("limit")
            if mimic is not None:
                of = mimic.get("joint", "")
                loops.append(((name, of), f"joint {given(name)} mimics {given(of)}"))
            if name in self.joints and self.joints[name].type == self.mujoco.mjtJoint.mjJNT_HINGE:
                effort, velocity = (
                    numbers(
                        self.label, f"joint {given(name)}: {key}", limit.get(key, "0") if limit is not None else "0", 1
                    )
                    for key in ("effort", "velocity")
                )
                self.parts.append(drive(name, float(effort[0]), float(velocity[0]), self.notes))
        for element in self.top.iter("transmission"):
            joints = ", ".join(given(one.get("name")) for one in element.iter("joint"))
            gears = ", ".join(one.text or "" for one in element.iter("mechanicalReduction")) or "1"
            words = f"gear {gears}: the torquer acts at the joint; for the inertia of the motor add [[motor]]"
            self.notes.append(f"transmission {given(element.get('name'))} of {joints}: {words}")
        for element in self.top.findall("gazebo"):
            link = element.get("reference", "")
            for sensor in element.findall("sensor"):
                if link not in self.poses:
                    self.notes.append(no_counterpart(f"gazebo {given(link)}: sensor {given(sensor.get('name'))}", "sensor"))
                    continue
                own = sdf.pose_of(self.label, sensor.find("pose"), f"link {given(link)}: pose of its sensor")
                self.parts += sdf.sensor_parts(self.label, link, sensor, self.poses[link] @ own, self.notes)
        self.notes.append(ASSUMED_GRAVITY)
        return self.made(links, GRAVITY, loops)


class _Mjcf(_Spec):
    format = "MJCF"
    read = _READ_OF_MJCF

    def robot(self) -> Robot:
        """Return what was read."""
        spec, enums = self.spec, self.mujoco
        self.spins, self.inferred = self._spins(), self._inferred()
        links = [self.link(body) for body in spec.bodies]
        for actuator in spec.actuators:
            self._actuator(actuator)
        kinds = {enums.mjtSensor.mjSENS_JOINTPOS: "pickoff", enums.mjtSensor.mjSENS_JOINTVEL: "rate_sensor"}
        for sensor in spec.sensors:
            noise = {"noise_rms": float(sensor.noise)} if sensor.noise else {}
            if sensor.type == enums.mjtSensor.mjSENS_GYRO:
                site = spec.site(sensor.objname)
                own, body = self.poses[site.parent.name] @ self.pose(site), site.parent.name
                self.parts += gyro(sensor.name or f"{body}_Omega", body, own, [noise] * 3)
            elif sensor.type in kinds:
                name = {"name": plain(sensor.name)} if sensor.name else {}
                self.parts.append(Part(kind=kinds[sensor.type], on=sensor.objname, keys=name | noise))
        for camera in spec.cameras:
            along = -(self.poses[camera.parent.name] @ self.pose(camera)).turn[:, 2]
            self.parts.append(Part(kind="camera", on=camera.parent.name, keys={"name": camera.name}, axis=along))
        active = [one for one in spec.equalities if one.active]
        loops = [((one.name1, one.name2 or WORLD), f"equality constraint on {given(one.name1)}") for one in active]
        off = int(spec.option.disableflags) & int(enums.mjtDisableBit.mjDSBL_GRAVITY)
        return self.made(links, np.zeros(3) if off else spec.option.gravity, loops)

    def _spins(self) -> dict[str, float]:
        """Return the rates of joints in the first keyframe, of which hinges have one."""
        kinds, out, k = self.mujoco.mjtJoint, {}, 0
        rates = list(self.spec.keys[0].qvel) if self.spec.keys else []
        for joint in self.spec.joints:
            out[joint.name] = float(rates[k]) if k < len(rates) else 0.0
            k += {kinds.mjJNT_FREE: 6, kinds.mjJNT_BALL: 3}.get(joint.type, 1)
        return out

    def _inferred(self) -> dict[str, Body]:
        """Return the bodies, in their own axes, whose inertia MuJoCo computes of their shapes."""
        copy = self.spec.copy()
        always = copy.compiler.inertiafromgeom == self.mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
        shapeless = [one for one in copy.bodies[1:] if one.explicitinertial and not always]
        names = [one.name for one in copy.bodies[1:] if one not in shapeless and list(one.geoms)]
        if not names:
            return {}
        for geom in [*copy.worldbody.geoms, *(geom for one in shapeless for geom in one.geoms)]:
            copy.delete(geom)
        used = [one.meshname for one in copy.geoms]
        for geom in copy.geoms:
            geom.material = ""
        kinds = (copy.equalities, copy.tendons, copy.actuators, copy.sensors, copy.keys, copy.pairs, copy.excludes)
        kinds += (copy.skins, copy.materials, copy.textures, [one for one in copy.meshes if one.name not in used])
        for one in [one for kind in kinds for one in kind]:
            copy.delete(one)
        model = copy.compile()
        found = [(name, model.body(name)) for name in names]
        return {
            name: Pose(_axes(one.iquat), one.ipos.copy()).body(float(one.mass[0]), np.diag(one.inertia))
            for name, one in found
        }

    def body(self, body: Any) -> Body:
        """Return mass, centre and inertia of a body, in its own axes."""
        return self.inferred.get(body.name) or super().body(body)

    def hinge(self, joint: Any) -> dict[str, Any]:
        """Return what a hinge has besides its axis; add what acts in it."""
        out, spin = super().hinge(joint), self.spins[joint.name]
        servo = self._servo(joint)
        turns = spin or servo or joint.parent.name.startswith(ROTOR)
        return out | ({"spin": {"spin": spin} | servo} if turns else {})

    def _servo(self, joint: Any) -> dict[str, Any]:
        """Return the keys of a rotor's speed loop."""
        gain = integral = 0.0
        for one in self.spec.actuators:
            kv, (_, position, rate) = float(one.gainprm[0]), one.biasprm[:3]
            if one.target == joint.name and kv > 0.0 and rate == -kv and position == 0.0:
                gain += kv
            elif one.target == joint.name and one.dyntype == self.mujoco.mjtDyn.mjDYN_INTEGRATOR and position == -kv:
                integral += kv
        loop = {"control": "servo", "speed_gain": gain} if gain else {}
        return loop | ({"speed_integral": integral} if gain and integral else {})

    def _actuator(self, one: Any) -> None:
        """Add the torquer that an actuator is; a bias that is proportional to the angle is a spring."""
        enums, where, joint = self.mujoco, f"actuator {given(one.name or one.target)}", self.joints.get(one.target)
        if one.trntype not in (enums.mjtTrn.mjTRN_JOINT, enums.mjtTrn.mjTRN_JOINTINPARENT) or joint is None:
            self.notes.append(no_counterpart(f"{where} acts on no joint", "actuator"))
            return
        keys: dict[str, Any] = {"name": plain(one.name)} if one.name else {}
        number = 0
        if joint.type != enums.mjtJoint.mjJNT_HINGE:
            first = 3 * (joint.type == enums.mjtJoint.mjJNT_FREE)
            axes = np.flatnonzero(one.gear[first:])
            if joint.armature or len(axes) != 1 or axes[0] > 2:
                self.notes.append(
                    no_counterpart(f"{where} turns the root about none of its axes by a torque", "actuator")
                )
                return
            keys["root_axis"], number = int(axes[0]) + 1, first + int(axes[0])
        gear, gain = float(one.gear[number]), float(one.gainprm[0])
        bias = one.biasprm[:3] * (one.biastype != enums.mjtBias.mjBIAS_NONE)
        if gain == 0.0 and bias[1] and not bias[2]:
            self.parts += bearing(joint.name, 0.0, 0.0, -float(bias[1]), -float(bias[0] / bias[1]))
            return
        motor = not bias.any() and one.gaintype == enums.mjtGain.mjGAIN_FIXED
        if not motor:
            words = f"a servo, gain {gain:g}, bias {given(bias.tolist())}"
            self.notes.append(f"{where}: {words}: its torquer takes a torque; design its loop in a job")
        elif gear * gain != 1.0:
            self.notes.append(
                f"{where}: gear {gear:g}: its torquer acts at the joint, with {gear * gain:g} times the control"
            )
        if one.dyntype in (enums.mjtDyn.mjDYN_FILTER, enums.mjtDyn.mjDYN_FILTEREXACT):
            keys["lag"] = float(one.dynprm[0])
        elif one.dyntype != enums.mjtDyn.mjDYN_NONE:
            self.notes.append(no_counterpart(f"{where}: its dynamics {one.dyntype.name}", "actuator"))
        ranges = [(one.ctrllimited, one.ctrlrange, abs(gear * gain))] if motor else []
        ranges += [(one.forcelimited, one.forcerange, abs(gear)), (joint.actfrclimited, joint.actfrcrange, 1.0)]
        limits = [
            (scale * -float(ends[0]), scale * float(ends[1]))
            for flag, ends, scale in ranges
            if self.limited(flag, ends)
        ]
        if any(low != high for low, high in limits):
            self.notes.append(f"{where}: its limits differ to both sides, {given(limits)}: the smaller ones are taken")
        if limits:
            keys["limit"] = min(min(pair) for pair in limits)
        self.parts.append(Part(kind="torquer", on=joint.name, keys=keys))
        self.parts.append(Part(kind="gear", on=joint.name, keys={"gear": gear}))
