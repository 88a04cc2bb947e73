"""SDF as a robot: poses relative to any frame, nested models, joints of one axis, gyros of IMUs."""

from __future__ import annotations

import math
from collections.abc import Iterator
from xml.etree.ElementTree import Element

import numpy as np
from scipy.spatial.transform import Rotation

from platform_ctrl.common.values import FloatArray
from platform_ctrl.errors import InputError
from platform_ctrl.export.robots.robot import (
    ASSUMED_GRAVITY,
    GRAVITY,
    NO_BODY,
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
    stops,
    turned,
    unread,
)
from platform_ctrl.plant.gimbals import Body
from platform_ctrl.plant.mistakes import given

_HINGES = {"revolute": "hinge", "continuous": "hinge", "fixed": "fixed"}
_READ = """sdf version model world name canonical_link pose link joint frame attached_to static relative_to degrees
    rotation_format inertial mass inertia ixx ixy ixz iyy iyz izz type parent child axis xyz expressed_in
    use_parent_model_frame limit lower upper effort velocity dynamics damping friction spring_stiffness
    spring_reference"""
_READ_OF_SENSORS = """name type pose relative_to degrees rotation_format imu update_rate angular_velocity x y z noise stddev bias_mean"""
# Shapes and settings of simulators and displays.
SHOWN = """visual collision light material self_collide selfCollide enable_wind allow_auto_disable scene physics gui
    atmosphere magnetic_field wind spherical_coordinates must_be_base_link velocity_decay always_on visualize
    topic camera mean stiffness dissipation mu1 mu2 kp kd disableFixedJointLumping preserveFixedJoint"""


def read_sdf(label: str, top: Element) -> Robot:
    """Return the robot that an SDF file describes; files that it includes are not read."""
    return _Sdf(label, top).robot()


class _Sdf:
    def __init__(self, label: str, top: Element) -> None:
        self.label = label
        version = numbers(label, "version", top.get("version", "1.9").replace(".", " "), 2)
        self.model_axes = tuple(version) < (1.0, 5.0)  # then axes of joints are in the model's frame
        self.top = top
        self.notes: list[str] = []
        # frames: by name with its models, the frame that its pose is relative to ("": none), and the pose
        self.frames: dict[str, tuple[str, Pose]] = {"": ("", Pose())}
        self.attached: dict[str, str] = {}  # Frames and models, and what they are fixed to
        self.links: dict[str, Element] = {}
        self.joints: dict[str, tuple[str, Element]] = {}  # Of each its scope
        self.static: set[str] = set()
        models = [*top.findall("model"), *top.findall("world/model")]
        for model in models:
            self._enter(model, "", f"{model.get('name')}::" if len(models) > 1 else "")
        self.name = models[0].get("name", "") if models else ""
        included = [one.findtext("uri", "") for one in top.iter("include")]
        if included and not self.joints:
            words = f"its parts are in the files that it includes; import those: {', '.join(map(given, included))}"
            raise InputError(f"{label}: {words}")

    def _enter(self, model: Element, parent: str, own: str) -> None:
        """Note the frames of a model, which are called `own` + name; `parent`: the model around it."""
        frame = f"{own}__model__"
        self._place(
            frame, model, f"{parent}__model__" if own != parent and parent + "__model__" in self.frames else "", parent
        )
        for link in model.findall("link"):
            self.links[own + link.get("name", "")] = link
            self._place(own + link.get("name", ""), link, frame, own)
        for one in model.findall("frame"):
            to = self._named(own, one.get("attached_to", "__model__"))
            self.attached[own + one.get("name", "")] = to
            self._place(own + one.get("name", ""), one, to, own)
        for one in model.findall("model"):
            self._enter(one, own, f"{own}{one.get('name')}::")
        for one in model.findall("joint"):
            self.joints[own + one.get("name", "")] = (own, one)
            self._place(own + one.get("name", ""), one, self._named(own, one.findtext("child", "").strip()), own)
        canonical = model.get("canonical_link") or next((one.get("name", "") for one in model.iter("link")), "")
        self.attached[frame] = self.attached[own.removesuffix("::")] = own + canonical
        if own:
            self.frames[own.removesuffix("::")] = (frame, Pose())
        if model.findtext("static", "").strip() in ("true", "1"):
            self.static |= {name for name in self.links if name.startswith(own)}

    def _named(self, scope: str, name: str) -> str:
        return "" if name in (WORLD, "__root__") else scope + name

    def _place(self, name: str, element: Element, default: str, scope: str) -> None:
        pose = element.find("pose")
        relative = None if pose is None else pose.get("relative_to") or pose.get("frame")
        own = pose_of(self.label, pose, f"pose of {given(name)}")
        self.frames[name] = (self._named(scope, relative) if relative else default, own)

    def _frame(self, name: str, inside: tuple[str, ...] = ()) -> Pose:
        if name not in self.frames or name in inside:
            words = "is defined by itself" if name in inside else "is not in this file"
            raise InputError(f"{self.label}: the frame {given(name)} {words}; correct relative_to or attached_to")
        base, own = self.frames[name]
        return own if name == base == "" else self._frame(base, (*inside, name)) @ own

    def _link(self, scope: str, joint: Element, end: str) -> str:
        """Return the link at an end of a joint."""
        name = self._named(scope, joint.findtext(end, "").strip())
        for _ in range(len(self.attached)):
            name = self.attached.get(name, name) if name not in self.links else name
        return name or WORLD

    def robot(self) -> Robot:
        """Return what was read."""
        ends = {
            name: (self._link(scope, one, "parent"), self._link(scope, one, "child"))
            for name, (scope, one) in self.joints.items()
        }
        on = {child: (name, parent) for name, (parent, child) in ends.items()}
        parts: list[Part] = []
        links: list[Link] = []
        nowhere = Joint(axis=np.zeros(3), at=np.zeros(3), keys={})
        if any(parent == WORLD for parent, _ in ends.values()) or self.static:
            links.append(Link(name=WORLD, carrier="", joint=nowhere, pose=Pose(), body=NO_BODY))
        for name in ordered(self.label, ends, self.links):
            hangs, carrier = on.get(name, ("", WORLD if name in self.static else ""))
            joint = self._joint(hangs, parts) if hangs else nowhere
            pose = self._frame(name)
            links.append(Link(name=name, carrier=carrier, joint=joint, pose=pose, body=self._body(name, pose)))
            scope = name[: name.rfind("::") + 2] if "::" in name else ""
            for sensor in self.links[name].findall("sensor"):
                self._place(f"{name}::sensor", sensor, name, scope)
                parts += sensor_parts(self.label, name, sensor, self._frame(f"{name}::sensor"), self.notes)
        self.notes += unread(self.top, _READ, f"{SHOWN} sensor world/gravity")
        field = self.top.find("world/gravity")
        if field is None:
            self.notes.append(ASSUMED_GRAVITY)
        gravity = np.array(GRAVITY) if field is None else numbers(self.label, "gravity", field.text, 3)
        return Robot(
            label=self.label, format="SDF", name=self.name, links=tuple(links), parts=tuple(parts),
            notes=tuple(self.notes), gravity=gravity,
        )  # fmt: skip

    def _number(self, element: Element | None, path: str, default: float, where: str) -> float:
        text = None if element is None else element.findtext(path)
        return default if text is None else float(numbers(self.label, f"{where}: {path}", text, 1)[0])

    def _body(self, name: str, pose: Pose) -> Body:
        inertial, where = self.links[name].find("inertial"), f"link {given(name)}"
        if inertial is None or inertial.get("auto") == "true":
            return NO_BODY
        if inertial.find("mass") is None or inertial.find("inertia") is None:
            raise InputError(f"{self.label}: {where}: its inertial has no mass or no inertia; give both")
        xx, xy, xz, yy, yz, zz = (
            self._number(inertial, f"inertia/{key}", float(key in ("ixx", "iyy", "izz")), where)
            for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        )
        matrix = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        own = pose @ pose_of(self.label, inertial.find("pose"), f"{where}: pose of its inertial")
        return own.body(self._number(inertial, "mass", 0.0, where), matrix)

    def _joint(self, name: str, parts: list[Part]) -> Joint:
        scope, element = self.joints[name]
        where, axis = f"joint {given(name)}", element.find("axis")
        kind, pose = str(element.get("type")), self._frame(name)
        lower, upper, effort, velocity = (
            self._number(axis, f"limit/{key}", default, where)
            for key, default in (("lower", -math.inf), ("upper", math.inf), ("effort", -1.0), ("velocity", -1.0))
        )
        hinge = _HINGES.get(kind, kind)
        if hinge == "hinge" and lower == upper:
            self.notes.append(f"{where}: its limits are both {lower:g} rad: it is taken as fixed at zero")
            hinge = "fixed"
        if hinge != "hinge":
            return Joint(name=name, kind=hinge, axis=np.zeros(3), at=pose.at, keys={})
        viscous, dry, stiffness, rest = (
            self._number(axis, f"dynamics/{key}", 0.0, where)
            for key in ("damping", "friction", "spring_stiffness", "spring_reference")
        )
        parts += bearing(name, viscous, dry, stiffness, rest)
        parts.append(drive(name, effort, velocity, self.notes))
        keys = {} if kind == "continuous" else stops(name, lower, upper, self.notes)
        return Joint(name=name, kind=hinge, axis=self._axis(name, scope, axis), at=pose.at, keys=keys)

    def _axis(self, name: str, scope: str, axis: Element | None) -> FloatArray:
        xyz = None if axis is None else axis.find("xyz")
        along = np.array([0.0, 0.0, 1.0])
        if axis is None or xyz is None:
            return self._frame(name).turn @ along
        along = hinge_axis(self.label, name, numbers(self.label, f"joint {given(name)}: xyz", xyz.text, 3))
        by_model = self.model_axes or axis.findtext("use_parent_model_frame", "").strip() in ("true", "1")
        frame = xyz.get("expressed_in") or ("__model__" if by_model else "")
        return self._frame(self._named(scope, frame) if frame else name).turn @ along


def pose_of(label: str, pose: Element | None, where: str) -> Pose:
    """Return the pose that an element has."""
    if pose is None or not (pose.text or "").strip():
        return Pose()
    quaternion = pose.get("rotation_format") == "quat_xyzw"
    found = numbers(label, where, pose.text, 7 if quaternion else 6)
    if quaternion:
        return Pose(np.asarray(Rotation.from_quat(found[3:]).as_matrix()), found[:3])
    return Pose(turned(np.radians(found[3:]) if pose.get("degrees") == "true" else found[3:]), found[:3])


def sensor_parts(label: str, link: str, sensor: Element, pose: Pose, notes: list[str]) -> Iterator[Part]:
    """Yield what a plant has of a sensor whose pose is given: the gyro of an IMU, the direction of a camera."""
    name, kind = sensor.get("name", ""), sensor.get("type", "")
    where = f"sensor {given(name)} of {given(link)}"
    if kind not in ("imu", "camera"):
        notes.append(no_counterpart(f"{where}: {kind}", "sensor"))
        return
    notes += [f"link {given(link)}: {one}" for one in unread(sensor, _READ_OF_SENSORS, SHOWN)]
    if kind == "camera":
        yield Part(kind="camera", on=link, keys={"name": name}, axis=pose.turn[:, 0])
        return

    def number(path: str) -> float:
        return float(numbers(label, f"{where}: {path}", sensor.findtext(path, "0"), 1)[0])

    keys = []
    for axis in ("x", "y", "z"):
        noise = f"imu/angular_velocity/{axis}/noise"
        found = {"noise_rms": number(f"{noise}/stddev"), "noise_bandwidth_hz": 0.5 * number("update_rate")}
        if not found["noise_rms"]:
            found = {}
        keys.append({key: item for key, item in (found | {"bias": number(f"{noise}/bias_mean")}).items() if item})
    yield from gyro(name, link, pose, keys)
