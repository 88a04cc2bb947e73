"""A robot description, whatever its format: links on joints, in the axes of the model with every joint at zero."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import field
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element

import numpy as np
from scipy.spatial.transform import Rotation

from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import InputError
from platform_ctrl.plant.fields import LARGEST, stops_written
from platform_ctrl.plant.gimbals import Body
from platform_ctrl.plant.mistakes import given, one_line, suggestion

WORLD = "world"
# How `write_mjcf` begins the names of rotors.
ROTOR = "rotor "
NO_BODY = Body(0.0, np.zeros(3), np.zeros((3, 3)))
# Angles from which on a limit of a joint means that it has none, rad: files write 1e10 or 1e16.
_UNLIMITED = 1e4
# What to do about elements and attributes that no plant file has.
_GRAVITY = "the plant has all of gravity: feed the torque forward in the controller, or take gravity out of [root]"
_HINTS = {
    "plugin": "controllers are designed in a job; other forces and sensors are added to the plant by hand",
    "include": "its file is not read; import that file",
    "gravcomp": _GRAVITY,
    "gravity": _GRAVITY,
    "turnGravityOff": _GRAVITY,
    "tendon": "add its torque as a spring or a torquer by hand",
    "springdamper": "write stiffness and damping",
    "actuator": "[[torquer]] with root_axis turns the root; other forces are added by hand",
    "safety_controller": "limits of the controller belong to the job",
}
_READ_OF_SENSORS = """name type pose relative_to degrees rotation_format imu update_rate angular_velocity x y z noise
    stddev bias_mean"""
# Shapes, and settings of simulators and displays.
SHOWN = """visual collision light material self_collide selfCollide enable_wind allow_auto_disable scene physics gui
    atmosphere magnetic_field wind spherical_coordinates must_be_base_link velocity_decay always_on visualize topic
    camera mean limit/stiffness dissipation mu1 mu2 kp kd disableFixedJointLumping preserveFixedJoint static
    world/gravity"""


class Pose(NamedTuple):
    """Axes, (3, 3), and place, (3,), m, of a frame in another one."""

    turn: FloatArray = np.eye(3)
    at: FloatArray = np.zeros(3)

    def __matmul__(self, other: Pose) -> Pose:
        """Return the pose of what has the pose `other` in this frame."""
        return Pose(self.turn @ other.turn, self.at + self.turn @ other.at)

    def body(self, mass: float, inertia: FloatArray) -> Body:
        """Return the body whose axes and centre of mass this is."""
        return Body(mass, self.at, self.turn @ inertia @ self.turn.T)


@value
class Link:
    """A body and how it hangs on its carrier, in the model's axes from the model's origin."""

    name: str
    carrier: str  # Name of the link that it hangs on; "": none
    pose: Pose
    body: Body
    joint: str = ""
    # kind: "hinge", "fixed", "ball", "free", or what else its joint is, in words
    kind: str = "fixed"
    # axis, pivot: (3,), (3,): unit vector, and a point of the joint, m
    axis: FloatArray = field(default_factory=lambda: np.zeros(3))
    pivot: FloatArray = field(default_factory=lambda: np.zeros(3))
    armature: float = 0.0  # kg m²
    # Of its table [[gimbal]], or [[rotor]] if it turns at a speed of its own
    keys: Mapping[str, Any] = field(default_factory=dict)
    spins: bool = False


class RobotPart(NamedTuple):
    """A table of the plant file on a joint, or, with an axis in the model's axes, on a link."""

    kind: str
    on: str
    keys: Mapping[str, Any]
    axis: FloatArray | None = None


class Reader:
    """What is read of a file, and a line for everything in it that no plant file has."""

    format = ""

    def __init__(self, label: str, top: Element) -> None:
        self.label, self.top = label, top
        self.name = ""
        self.links: list[Link] = []  # Carriers before what they carry
        self.parts: list[RobotPart] = []
        self.gears: dict[str, float] = {}  # Of joints, where the file says it
        self.notes: list[str] = []
        self.gravity = np.array([0.0, 0.0, -9.81])
        # loops: Constraints: names of the joints and links that must not turn because of each, and a sentence
        self.loops: list[tuple[tuple[str, ...], str]] = []

    def error(self, words: str) -> InputError:
        """Return what is wrong with the file."""
        return InputError(f"{self.label}: {words}")

    def numbers(self, text: str | None, count: int, where: str) -> FloatArray:
        """Return the numbers in a text."""
        try:
            found = np.array([float(word) for word in (text or "").split()])
        except ValueError:
            found = np.zeros(0)
        if len(found) != count or not np.all(np.abs(found) < LARGEST):
            raise self.error(f"{where} must be {count} number{'s' * (count > 1)}, got {given(text)}; correct it")
        return found

    def pose(self, element: Element | None, where: str) -> Pose:
        """Return the pose that an element has."""
        if element is None or not (element.text or "").strip():
            return Pose()
        quaternion = element.get("rotation_format") == "quat_xyzw"
        found = self.numbers(element.text, 7 if quaternion else 6, f"pose of {where}")
        if quaternion and found[3:].any():
            return Pose(Rotation.from_quat(found[3:]).as_matrix(), found[:3])
        angles = np.radians(found[3:6]) if element.get("degrees") == "true" else found[3:6]
        return Pose(Rotation.from_euler("xyz", angles).as_matrix(), found[:3])

    def number(self, element: Element | None, path: str, default: float, where: str) -> float:
        """Return the number in an element further in."""
        text = None if element is None else element.findtext(path)
        return default if text is None else float(self.numbers(text, 1, f"{where}: {path}")[0])

    def sensor(self, link: str, sensor: Element, turn: FloatArray) -> None:
        """Add what a plant has of a sensor with the axes `turn`: the gyro of an IMU, the direction of a camera."""
        name, kind = sensor.get("name", ""), sensor.get("type", "")
        where, keys = f"sensor {given(name)} of {given(link)}", []
        if kind == "camera":
            self.parts.append(RobotPart(kind, link, {"name": name}, turn[:, 0]))
        elif kind != "imu":
            self.notes.append(no_counterpart(f"{where}: {kind}", "sensor"))
            return
        self.notes += [f"link {given(link)}: {one}" for one in unread(sensor, _READ_OF_SENSORS, SHOWN)]
        band = 0.5 * self.number(sensor, "update_rate", 0.0, where)
        for axis in ("x", "y", "z") if kind == "imu" else ():
            noise = sensor.find(f"imu/angular_velocity/{axis}/noise")
            rms, bias = (self.number(noise, key, 0.0, where) for key in ("stddev", "bias_mean"))
            own = {"noise_rms": rms, "noise_bandwidth_hz": band * bool(rms), "bias": bias}
            keys.append({key: item for key, item in own.items() if item})
        self.gyro(name, link, turn, keys)

    def add(self, link: Link) -> None:
        """Add a link, whose carrier is there already."""
        numbers = (*link.body, *link.pose, link.axis, link.pivot)
        if not all(np.all(np.abs(item) < LARGEST) for item in numbers):
            raise self.error(f"link {given(link.name)} has a position, mass or inertia that is no number; correct it")
        if link.kind == "hinge" and not link.axis.any():
            raise self.error(f"joint {given(link.joint)}: its axis has no direction; correct it")
        self.links.append(link)

    def bearing(self, joint: str, viscous: float, dry: float, stiffness: float, rest: float) -> None:
        """Add friction and spring of a joint."""
        friction = {key: item for key, item in (("viscous", viscous), ("coulomb", dry)) if item}
        spring = {"stiffness": stiffness, "rest": rest} if stiffness else {}
        self.parts += [RobotPart(kind, joint, own) for kind, own in (("friction", friction), ("spring", spring)) if own]

    def stops(self, joint: str, lower: float, upper: float) -> dict[str, Any]:
        """Return the keys of a gimbal with these limits of its angle, rad."""
        if lower <= -_UNLIMITED and upper >= _UNLIMITED:
            return {}
        if not lower <= 0.0 <= upper or lower == upper:
            words = f"its limits {lower:g} and {upper:g} rad have no range about 0: left out; move its zero in between"
            self.notes.append(f"joint {given(joint)}: {words}")
            return {}
        return dict(stops_written([max(lower, -_UNLIMITED), min(upper, _UNLIMITED)]))

    def drive(self, joint: str, effort: float, velocity: float) -> None:
        """Add the torquer of a joint with these limits; none are 0, negative or infinite."""
        if 0.0 < velocity < math.inf:
            words = "a plant file has none; keep commands and manoeuvres of the job below it"
            self.notes.append(f"joint {given(joint)}: velocity limit {velocity:g} rad/s: {words}")
        limited = 0.0 < effort < math.inf
        if not limited:
            self.notes.append(f"joint {given(joint)}: no effort limit: give its torquer a limit, or remove it")
        self.parts.append(RobotPart("torquer", joint, {"limit": effort} if limited else {}))

    def gyro(self, name: str, link: str, turn: FloatArray, keys: Iterable[Mapping[str, Any]]) -> None:
        """Add three rate sensors about the axes `turn`, with the keys of each."""
        for k, own in enumerate(keys):
            self.parts.append(RobotPart("rate_sensor", link, {"name": f"{plain(name)}{k + 1}", **own}, turn[:, k]))

    def assume_gravity(self) -> None:
        """Say that the file has none."""
        self.notes.append("gravity: not in the file: -9.81 m/s2 along its z axis is assumed; correct it in [root]")

    def ordered(self, joints: Mapping[str, tuple[str, str]], links: Iterable[str]) -> list[str]:
        """Return links with carriers first; `joints`: name -> carrier and carried link. Refuse what is no tree."""
        links, above = [*links, WORLD], dict[str, tuple[str, str]]()
        for joint, ends in joints.items():
            if strange := [one for one in ends if one not in links]:
                words = f"there is no link {given(strange[0])}; {suggestion(strange[0], links)}"
                raise self.error(f"joint {given(joint)}: {words}")
            if ends[1] in above:
                two = f"two joints, {given(above[ends[1]][0])} and {given(joint)}: a closed loop; remove one of them"
                raise self.error(f"link {given(ends[1])} hangs on {two}")
            above[ends[1]] = (joint, ends[0])
        out: list[str] = []
        for link in links[:-1]:
            chain = [link]
            while chain[-1] in above and (parent := above[chain[-1]][1]) not in out:
                if parent in chain:
                    raise self.error(f"link {given(parent)} carries itself: a closed loop; remove a joint of it")
                chain.append(parent)
            out += [one for one in reversed(chain) if one not in out]
        return [one for one in out if one != WORLD]


def plain(name: str) -> str:
    """Return a name as signals may have it."""
    return one_line(name).replace(".", "_")


def unread(element: Element, read: str, shown: str, where: str = "") -> Iterator[str]:
    """Yield a line for each part of an element but those that are `read` and those without effect, `shown`: words."""
    name = element.get("name") or element.get("joint") or element.get("reference") or element.get("class")
    where = f"{element.tag} {given(name)}" if name else f"{where}{' ' * bool(where)}<{element.tag}>"
    for key, item in element.items():
        if key not in f"{read} {shown}".split():
            yield no_counterpart(f"{where}: {one_line(key)} = {given(item)}", key)
    for child in element:
        if child.tag in read.split():
            yield from unread(child, read, shown, where)
        elif not {child.tag, f"{element.tag}/{child.tag}"} & {*shown.split()}:
            items = [*child.items(), *((one.tag, (one.text or "").strip()) for one in child), ("", child.text or "")]
            shown_items = ", ".join(f"{key} {item[:60]}".strip() for key, item in items if item.strip())
            yield no_counterpart(f"{where}: {one_line(f'<{child.tag}> {shown_items}')}", child.tag)


def no_counterpart(what: str, tag: str) -> str:
    """Return a line about an element or attribute `tag`, and what to do."""
    return f"{what}: no counterpart in a plant file{'; ' * (tag in _HINTS)}{_HINTS.get(tag, '')}"
