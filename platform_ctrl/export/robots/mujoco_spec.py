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
from platform_ctrl.export.robots import robot as robots
from platform_ctrl.plant.fields import SMALLEST
from platform_ctrl.plant.gimbals import Body
from platform_ctrl.plant.mistakes import given, one_line
from platform_ctrl.plant.source import read_text

_READ_OF_URDF = """robot name version link joint transmission gazebo inertial origin xyz rpy mass value inertia ixx iyy
    izz ixy ixz iyz type parent child axis limit lower upper effort velocity dynamics damping friction mimic multiplier
    offset actuator mechanicalReduction reference"""
_READ_OF_MJCF = """mujoco model compiler default worldbody actuator sensor equality include file class childclass
    name pos quat euler axisangle xyaxes zaxis angle eulerseq autolimits inertiafromgeom body frame inertial mass
    diaginertia fullinertia joint freejoint type axis range limited ref stiffness springref damping frictionloss
    armature actuatorfrcrange actuatorfrclimited solreflimit site camera motor position velocity intvelocity general
    jointinparent gear ctrllimited ctrlrange forcelimited forcerange kp kv dampratio dyntype dynprm gaintype gainprm
    biastype biasprm timeconst gyro jointpos jointvel noise connect weld active"""
_SHOWN = f"""{robots.SHOWN} hardwareInterface sensor mujoco option size statistic asset contact keyframe custom geom
    mesh pair group user solimplimit solreffriction solimpfriction margin meshdir texturedir assetdir strippath
    discardvisual fusestatic coordinate convexhull usethread saveinertial alignfree fitaabb align rgba fovy ipd
    resolution focal sensorsize principal mode fromto inheritrange actrange actlimited anchor relpose body1 body2
    joint1 joint2 polycoef solref solimp"""


def read_spec(file: Path, label: str, top: Element) -> _Spec:
    """Return the robot that a URDF or MJCF file describes."""
    reader: type[_Spec] = _Urdf if top.tag == "robot" else _Mjcf
    try:
        mujoco = import_module("mujoco")
    except ImportError:
        words = "is read by the package mujoco, which is not installed: pip install platform_ctrl[import]"
        raise InputError(f"{label}: {reader.format} {words}") from None
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda words: None)  # else they go to a file where the user is
    try:
        return reader(label, top, file, mujoco)
    finally:
        mujoco.set_mju_user_warning(before)


class _Spec(robots.Reader):
    """What URDF and MJCF have in common: bodies and joints of a specification that is not compiled."""

    read = ""

    def __init__(self, label: str, top: Element, file: Path, mujoco: Any) -> None:
        super().__init__(label, top)
        self.mujoco, self.file = mujoco, file
        self.check()
        try:
            self.spec = mujoco.MjSpec.from_file(str(file))
        except Exception as error:  # MuJoCo has no class of its own
            raise self.refused("is refused by MuJoCo", error) from None
        self.name = self.spec.modelname
        self.poses: dict[str, robots.Pose] = {}
        for kind in ("body", "joint"):
            for k, one in enumerate(self.spec.bodies if kind == "body" else self.spec.joints):
                one.name = one.name or f"{kind}{k}"
        self.joints = {one.name: one for one in self.spec.joints}
        self.start()
        for body in self.spec.bodies:
            above = robots.Pose() if body.parent is None else self.poses[body.parent.name]
            self.poses[body.name] = above @ self.placed(body)
            self._add(body)
        self.finish()
        self.notes += self._unread(top)

    def check(self) -> None:
        """Refuse what MuJoCo would accept, or refuse without saying what it is."""

    def start(self) -> None:
        """Read what bodies need."""

    def finish(self) -> None:
        """Read everything but bodies and what acts in their joints."""

    def refused(self, words: str, error: Exception) -> InputError:
        """Return what is wrong in MuJoCo's words."""
        return self.error(f"{words}: {one_line(' '.join(str(error).split()))}")

    def _turn(self, one: Any, quat: FloatArray, other: Any) -> FloatArray:
        """Return axes that are given as a quaternion or in another way."""
        if other.type != self.mujoco.mjtOrientation.mjORIENTATION_QUAT:
            own = getattr(one, "compiler", self.spec.compiler)
            quat = self.spec.resolve_orientation(own.degree, own.eulerseq, other)
        return axes(quat)

    def placed(self, one: Any) -> robots.Pose:
        """Return the pose of a body, site, camera or frame in its body, through the frames around it."""
        out = robots.Pose(self._turn(one, one.quat, one.alt), np.array(one.pos))
        return out if one.frame is None else self.placed(one.frame) @ out

    def body(self, body: Any) -> Body:
        """Return mass, centre and inertia of a body, in its own axes."""
        if not body.explicitinertial:
            return robots.NO_BODY
        xx, yy, zz, xy, xz, yz = body.fullinertia
        full = np.diag(body.inertia) if np.isnan(xx) else np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        return robots.Pose(self._turn(body, body.iquat, body.ialt), np.array(body.ipos)).body(float(body.mass), full)

    def _add(self, body: Any) -> None:
        """Add a body with its joint."""
        pose, own = self.poses[body.name], self.body(body)
        moved = (pose @ robots.Pose(np.eye(3), own.centre)).body(own.mass, own.inertia)
        carrier = "" if body.parent is None else body.parent.name
        about: dict[str, Any] = {"pivot": pose.at}
        if joints := list(body.joints):
            about["joint"], kinds = joints[0].name, self.mujoco.mjtJoint
            known = {kinds.mjJNT_HINGE: "hinge", kinds.mjJNT_BALL: "ball", kinds.mjJNT_FREE: "free"}
            about["kind"] = known.get(joints[0].type, "prismatic")
            around = pose if joints[0].frame is None else pose @ self.placed(joints[0].frame)
            about["pivot"] = around.at + around.turn @ joints[0].pos
            about["armature"] = float(joints[0].armature)
            if len(joints) > 1:
                about["kind"] = f"one of {len(joints)} joints of a body"
            elif about["kind"] == "hinge":
                length = float(np.linalg.norm(joints[0].axis))
                about |= {"axis": around.turn @ joints[0].axis / (length or 1.0)} | self.hinge(joints[0])
        self.add(robots.Link(name=body.name, carrier=carrier, pose=pose, body=moved, **about))

    def hinge(self, joint: Any) -> dict[str, Any]:
        """Return what a link on a hinge has besides; add what acts in it."""
        for what, values in (("damping", joint.damping), ("stiffness", joint.stiffness)):
            if any(values[1:]):
                words = f"{what} {given(np.array(values).tolist())} is not linear: the first number is taken"
                self.notes.append(f"joint {given(joint.name)}: {words}")
        unit = math.pi / 180.0 if joint.compiler.degree else 1.0
        first = (joint.damping[0], joint.frictionloss, joint.stiffness[0], unit * (joint.springref - joint.ref))
        self.bearing(joint.name, *map(float, first))
        if not self.limited(joint.limited, joint.range):
            return {}
        keys, (wait, ratio) = self.stops(joint.name, *(unit * (joint.range - joint.ref)).tolist()), joint.solref_limit
        if keys and wait > 0.0 and 0.0 < ratio < 1.0:  # the share of the rate that the contact's damping leaves
            keys["restitution"] = math.exp(-math.pi * ratio / math.sqrt(1.0 - ratio * ratio))
        return {"keys": keys}

    def limited(self, flag: Any, ends: Any) -> bool:
        """Return whether a range counts."""
        choice = self.mujoco.mjtLimited
        return bool(ends[0] < ends[1] if flag == choice.mjLIMITED_AUTO else flag == choice.mjLIMITED_TRUE)

    def _unread(self, top: Element) -> Iterator[str]:
        yield from robots.unread(top, self.read, _SHOWN)
        for one in top.iter("include"):
            yield from self._unread(fromstring(read_text(self.file.parent / one.get("file", ""), "an MJCF file")))


def axes(quat: Any) -> FloatArray:
    """Return the axes, (3, 3), of a quaternion w, x, y, z."""
    return np.asarray(Rotation.from_quat(quat, scalar_first=True).as_matrix())


class _Urdf(_Spec):
    format = "URDF"
    read = _READ_OF_URDF

    def check(self) -> None:
        """Refuse what is no tree."""
        ends = {}
        for one in self.top.findall("joint"):
            found = [element.get("link", "") for end in ("parent", "child") for element in one.findall(end)[:1]]
            if len(found) != 2 or not one.get("name"):
                raise self.error(f"joint {given(one.get('name'))} has no name, no parent or no child; add it")
            ends[one.get("name", "")] = (found[0], found[1])
        self.ordered(ends, [one.get("name", "") for one in self.top.findall("link")])

    def add(self, link: robots.Link) -> None:
        """Add a link; the world is MuJoCo's, unless the file has it."""
        own = {one.get("name") for one in self.top.findall("link")}
        if robots.WORLD in own or link.name != robots.WORLD:
            carrier = link.carrier if link.carrier in own else ""
            super().add(replaced(link, {"carrier": carrier}))

    def finish(self) -> None:
        """Read what MuJoCo drops."""
        for element in self.top.findall("joint"):
            name, where = element.get("name", ""), f"joint {given(element.get('name'))}"
            if (mimic := element.find("mimic")) is not None:
                self.loops.append(((name,), f"{where} mimics {given(mimic.get('joint'))}"))
            if element.get("type") in ("revolute", "continuous"):
                limit = element.find("limit")
                ends = ("0" if limit is None else limit.get(key, "0") for key in ("effort", "velocity"))
                self.drive(name, *(float(self.numbers(one, 1, f"limit of {where}")[0]) for one in ends))
                joint = self.joints[name]
                if element.get("type") == "revolute" and not self.limited(joint.limited, joint.range):
                    self.notes.append(f"{where}: no limits of its angle: it turns freely; give it stops")
        for element in self.top.iter("transmission"):
            joints = ", ".join(given(one.get("name")) for one in element.iter("joint"))
            gears = ", ".join(one.text or "" for one in element.iter("mechanicalReduction")) or "1"
            words = f"gear {gears}: the torquer acts at the joint; for the inertia of the motor add [[motor]]"
            self.notes.append(f"transmission {given(element.get('name'))} of {joints}: {words}")
        for element in self.top.findall("gazebo"):
            link = element.get("reference", "")
            for sensor in element.findall("sensor"):
                if link in self.poses:
                    own = self.pose(sensor.find("pose"), f"the sensor of {given(link)}")
                    self.sensor(link, sensor, (self.poses[link] @ own).turn)
                else:
                    words = f"gazebo {given(link)}, which is no link: sensor {given(sensor.get('name'))}"
                    self.notes.append(robots.no_counterpart(words, "sensor"))
        self.assume_gravity()


class _Mjcf(_Spec):
    format = "MJCF"
    read = _READ_OF_MJCF

    def start(self) -> None:
        """Read rates of joints from the first keyframe, and inertias that MuJoCo computes of shapes."""
        kinds, k = self.mujoco.mjtJoint, 0
        rates = list(self.spec.keys[0].qvel) if self.spec.keys else []
        self.rates: dict[str, float] = {}
        self.speed_loops: list[int] = []  # Actuators that are speed loops of rotors
        for joint in self.spec.joints:
            self.rates[joint.name] = float(rates[k]) if k < len(rates) else 0.0
            k += {kinds.mjJNT_FREE: 6, kinds.mjJNT_BALL: 3}.get(joint.type, 1)
        self.inferred = self._inferred()

    def _inferred(self) -> dict[str, Body]:
        """Return the bodies, in their own axes, whose inertia MuJoCo computes of their shapes."""
        copy = self.spec.copy()
        always = copy.compiler.inertiafromgeom == self.mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
        names = [one.name for one in copy.bodies[1:] if list(one.geoms) and (always or not one.explicitinertial)]
        if not names:
            return {}
        # Files of other shapes need not be there.
        for geom in [geom for one in copy.bodies if one.name not in names for geom in one.geoms]:
            copy.delete(geom)
        used = [one.meshname for one in copy.geoms]
        for mesh in [one for one in copy.meshes if one.name not in used]:
            copy.delete(mesh)
        try:
            model = copy.compile()
        except Exception as error:
            words = "have no inertial, and MuJoCo cannot compute it of their shapes; give them mass and inertia"
            raise self.refused(f"bodies {', '.join(map(given, names))} {words}", error) from None
        return {
            name: robots.Pose(axes(one.iquat), np.array(one.ipos)).body(float(one.mass[0]), np.diag(one.inertia))
            for name, one in ((name, model.body(name)) for name in names)
        }

    def body(self, body: Any) -> Body:
        """Return mass, centre and inertia of a body, in its own axes."""
        return self.inferred.get(body.name) or super().body(body)

    def hinge(self, joint: Any) -> dict[str, Any]:
        """Return what a link on a hinge has besides; add what acts in it."""
        rate = self.rates[joint.name]
        if not rate and not joint.parent.name.startswith(robots.ROTOR):
            return super().hinge(joint)
        loop: dict[str, float] = {}
        for k, one in enumerate(self.spec.actuators):
            gain, bias = float(one.gainprm[0]), one.biasprm[1:3].tolist()
            integrates = one.dyntype == self.mujoco.mjtDyn.mjDYN_INTEGRATOR
            key = {(0.0, -gain): "speed_gain", (-gain, 0.0): "speed_integral" if integrates else ""}.get(tuple(bias))
            if one.target == joint.name and gain > 0.0 and key:
                loop[key] = gain
                self.speed_loops.append(k)
        return {"spins": True, "keys": {"spin": rate} | ({"control": "servo"} | loop if "speed_gain" in loop else {})}

    def finish(self) -> None:
        """Read actuators, sensors, cameras, constraints and gravity."""
        spec, enums = self.spec, self.mujoco
        for k, actuator in enumerate(spec.actuators):
            if k not in self.speed_loops:
                self._actuator(actuator)
        kinds = {enums.mjtSensor.mjSENS_JOINTPOS: "pickoff", enums.mjtSensor.mjSENS_JOINTVEL: "rate_sensor"}
        for sensor in spec.sensors:
            noise = {"noise_rms": float(sensor.noise)} if sensor.noise else {}
            if sensor.type == enums.mjtSensor.mjSENS_GYRO:
                if (site := spec.site(sensor.objname)) is None:
                    raise self.error(f"sensor {given(sensor.name)}: there is no site {given(sensor.objname)}")
                body = site.parent.name
                turn = (self.poses[body] @ self.placed(site)).turn
                self.gyro(sensor.name or f"{body}_Omega", body, turn, [noise] * 3)
            elif sensor.type in kinds:
                name = {"name": robots.plain(sensor.name)} if sensor.name else {}
                self.parts.append(robots.RobotPart(kinds[sensor.type], sensor.objname, name | noise))
        for camera in spec.cameras:
            along = -(self.poses[camera.parent.name] @ self.placed(camera)).turn[:, 2]
            self.parts.append(robots.RobotPart("camera", camera.parent.name, {"name": camera.name}, along))
        for one in spec.equalities:
            # The first of two joints follows the other.
            names = (one.name1,) if one.type == enums.mjtEq.mjEQ_JOINT else (one.name1, one.name2)
            if one.active:
                self.loops.append((names, f"equality constraint on {given(one.name1)}"))
        off = int(spec.option.disableflags) & int(enums.mjtDisableBit.mjDSBL_GRAVITY)
        self.gravity = np.zeros(3) if off else np.array(spec.option.gravity)

    def _actuator(self, one: Any) -> None:
        """Add the torquer that an actuator is."""
        enums, where, joint = self.mujoco, f"actuator {given(one.name or one.target)}", self.joints.get(one.target)
        joints = (enums.mjtTrn.mjTRN_JOINT, enums.mjtTrn.mjTRN_JOINTINPARENT)
        if one.trntype not in joints or joint is None or joint.type != enums.mjtJoint.mjJNT_HINGE:
            self.notes.append(robots.no_counterpart(f"{where} acts on no hinge", "actuator"))
            return
        gear, gain = float(one.gear[0]), float(one.gainprm[0])
        bias = one.biasprm[:3] * (one.biastype != enums.mjtBias.mjBIAS_NONE)
        if gain == 0.0 and bias[1] and not bias[2]:  # as `write_mjcf` has springs that drive away
            self.bearing(joint.name, 0.0, 0.0, -float(bias[1]), -float(bias[0] / bias[1]))
            return
        motor = not bias.any() and one.gaintype == enums.mjtGain.mjGAIN_FIXED
        if not motor:
            words = f"a servo, gain {gain:g}, bias {given(bias.tolist())}"
            self.notes.append(f"{where}: {words}: its torquer takes a torque; design its loop in a job")
        elif gear * gain != 1.0:
            words = f"gear {gear:g}: its torquer acts at the joint, with {gear * gain:g} times the control"
            self.notes.append(f"{where}: {words}")
        keys: dict[str, Any] = {"name": robots.plain(one.name)} if one.name else {}
        if one.dyntype in (enums.mjtDyn.mjDYN_FILTER, enums.mjtDyn.mjDYN_FILTEREXACT):
            keys["lag"] = float(one.dynprm[0])
        elif one.dyntype != enums.mjtDyn.mjDYN_NONE:
            self.notes.append(robots.no_counterpart(f"{where}: its dynamics {one.dyntype.name}", "actuator"))
        ranges = [(one.ctrllimited, one.ctrlrange, abs(gear * gain))] if motor else []
        ranges += [(one.forcelimited, one.forcerange, abs(gear)), (joint.actfrclimited, joint.actfrcrange, 1.0)]
        limits = [scale * ends * (-1, 1) for flag, ends, scale in ranges if self.limited(flag, ends)]
        if any(low != high for low, high in limits):
            self.notes.append(f"{where}: its limits differ to both sides: the smaller ones are taken")
        if limits:
            keys["limit"] = float(f"{np.min(limits):.15g}")
        self.parts.append(robots.RobotPart("torquer", joint.name, keys))
        self.gears[joint.name] = gear if abs(gear) > SMALLEST else 1.0
