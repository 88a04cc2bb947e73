"""A robot description, whatever its format: links on joints, in the axes of the model with every joint at zero."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
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
# Angles from which on a limit of a joint means that it has none, rad: files write 1e10 or 1e16.
UNLIMITED = 1e4
NO_BODY = Body(0.0, np.zeros(3), np.zeros((3, 3)))
# How `write_mjcf` begins the names of rotors.
ROTOR = "rotor "
# Where a file does not say it.
GRAVITY = (0.0, 0.0, -9.81)
ASSUMED_GRAVITY = "gravity: not in the file: -9.81 m/s2 along its z axis is assumed; correct it in [root]"


class Pose(NamedTuple):
    """Axes, (3, 3), and place, (3,), m, of a frame in another one."""

    turn: FloatArray = np.eye(3)
    at: FloatArray = np.zeros(3)

    def __matmul__(self, other: Pose) -> Pose:  # type: ignore[override]
        """Return the pose of what has the pose `other` in this frame."""
        return Pose(self.turn @ other.turn, self.at + self.turn @ other.at)

    def body(self, mass: float, inertia: FloatArray) -> Body:
        """Return the body whose centre of mass and axes this is."""
        return Body(mass, self.at, self.turn @ inertia @ self.turn.T)


@value
class Joint:
    """How a link hangs on what carries it."""

    name: str = ""
    # kind: "hinge", "fixed", "ball", "free", or what else it is, in words
    kind: str = "fixed"
    # axis, at: (3,), (3,): unit vector, and a point of the axis, m
    axis: FloatArray
    at: FloatArray
    keys: Mapping[str, Any]  # Of its table [[gimbal]]
    armature: float = 0.0  # kg m²
    spin: Mapping[str, Any] | None = None  # Keys of the table [[rotor]] of what turns at a given speed


@value
class Link:
    """A body of the file, with all of its numbers in the model's axes from the model's origin."""

    name: str
    carrier: str  # Name of the link that it hangs on; "": none
    joint: Joint
    pose: Pose
    body: Body


@value
class Part:
    """A table of the plant file on a joint, or, with an axis in the model's axes, on a link."""

    kind: str
    on: str
    keys: Mapping[str, Any]
    axis: FloatArray | None = None


@value
class Robot:
    """What a file describes, and a line for everything in it that no plant file has."""

    label: str  # Of the file, for messages
    format: str
    name: str
    links: tuple[Link, ...]  # Carriers before what they carry
    parts: tuple[Part, ...]
    notes: tuple[str, ...]
    gravity: FloatArray
    # loops: Constraints: names of the joints and links that each couples, and a sentence
    loops: tuple[tuple[tuple[str, ...], str], ...] = ()

    def __post_init__(self) -> None:
        """Refuse numbers that nothing has."""
        for one in self.links:
            numbers = (*one.body, *one.pose, one.joint.axis, one.joint.at)
            if not all(np.all(np.abs(item) < LARGEST) for item in numbers):
                words = "has a position, mass or inertia that is huge or not a number; correct it"
                raise InputError(f"{self.label}: link {given(one.name)} {words}")


def hinge_axis(label: str, joint: str, axis: FloatArray) -> FloatArray:
    """Return the unit vector of a joint's axis."""
    length = float(np.linalg.norm(axis))
    if not 0.0 < length < LARGEST:
        raise InputError(f"{label}: joint {given(joint)}: its axis {given(axis.tolist())} has no direction; correct it")
    out: FloatArray = axis / length
    return out


def stops(joint: str, lower: float, upper: float, notes: list[str]) -> dict[str, Any]:
    """Return the keys of a gimbal with these limits of its angle, rad."""
    if lower <= -UNLIMITED and upper >= UNLIMITED:
        return {}
    if not lower <= 0.0 <= upper or lower == upper:
        notes.append(
            f"joint {given(joint)}: its limits {lower:g} and {upper:g} rad do not include a range about 0: left out; "
            "set the zero angle of the joint in between"
        )
        return {}
    return dict(stops_written([max(lower, -UNLIMITED), min(upper, UNLIMITED)]))


def bearing(joint: str, viscous: float, dry: float, stiffness: float, rest: float) -> Iterator[Part]:
    """Yield friction and spring of a joint."""
    if viscous or dry:
        keys = {"viscous": viscous, "coulomb": dry}
        yield Part(kind="friction", on=joint, keys={key: item for key, item in keys.items() if item})
    if stiffness:
        yield Part(kind="spring", on=joint, keys={"stiffness": stiffness} | ({"rest": rest} if rest else {}))


def drive(joint: str, effort: float, velocity: float, notes: list[str]) -> Part:
    """Return the torquer of a joint with these limits; none are 0, negative or infinite."""
    if 0.0 < velocity < math.inf:
        words = "a plant file has none; keep commands and manoeuvres of the job below it"
        notes.append(f"joint {given(joint)}: velocity limit {velocity:g} rad/s: {words}")
    if 0.0 < effort < math.inf:
        return Part(kind="torquer", on=joint, keys={"limit": effort})
    notes.append(f"joint {given(joint)}: no effort limit: its torquer is unlimited; give it a limit, or remove it")
    return Part(kind="torquer", on=joint, keys={})


def gyro(name: str, link: str, pose: Pose, keys: Iterable[Mapping[str, Any]]) -> Iterator[Part]:
    """Yield three rate sensors about the axes of a pose, with the keys of each."""
    for k, own in enumerate(keys):
        table = {"name": f"{plain(name)}{k + 1}", **own}
        yield Part(kind="rate_sensor", on=link, keys=table, axis=pose.turn[:, k])


def plain(name: str) -> str:
    """Return a name as signals may have it."""
    return one_line(name).replace(".", "_")


def ordered(label: str, joints: Mapping[str, tuple[str, str]], links: Iterable[str]) -> list[str]:
    """Return links with carriers first; `joints`: name -> carrier and carried link. Refuse what is no tree."""
    links, above = list(links), dict[str, tuple[str, str]]()
    for joint, (parent, child) in joints.items():
        for link in (parent, child):
            if link not in links and link != WORLD:
                raise InputError(
                    f"{label}: joint {given(joint)}: there is no link {given(link)}; {suggestion(link, links)}"
                )
        if child in above:
            two = f"two joints, {given(above[child][0])} and {given(joint)}: a closed loop, which no plant has"
            raise InputError(f"{label}: link {given(child)} hangs on {two}; remove one of them")
        above[child] = (joint, parent)
    out: list[str] = []
    for link in links:
        chain = [link]
        while chain[-1] in above and (parent := above[chain[-1]][1]) not in out and parent != WORLD:
            if parent in chain:
                raise InputError(f"{label}: link {given(parent)} carries itself: a closed loop; remove a joint of it")
            chain.append(parent)
        out += [one for one in reversed(chain) if one not in out]
    return out


def numbers(label: str, where: str, text: str | None, count: int) -> FloatArray:
    """Return the numbers in a text."""
    try:
        found = np.array([float(word) for word in (text or "").split()])
    except ValueError:
        found = np.zeros(0)
    if len(found) != count or not np.isfinite(found).all():
        words = "a number" if count == 1 else f"{count} numbers"
        raise InputError(f"{label}: {where} must be {words}, got {given(text)}; correct it")
    return found


def turned(angles: FloatArray) -> FloatArray:
    """Return the axes, (3, 3), of roll, pitch and yaw, rad."""
    return np.asarray(Rotation.from_euler("xyz", angles).as_matrix())


# What to do about elements that no plant file has.
_HINTS = {
    "plugin": "controllers are designed in a job; other forces and sensors are added to the plant by hand",
    "gazebo": "add what it stands for by hand",
    "mimic": "hold one of the joints by --tip",
    "include": "its file is not read; import that file",
    **dict.fromkeys(
        ("gravity", "gravcomp", "turnGravityOff"),
        "the plant has all of gravity: feed the torque forward in the controller, or take gravity out of [root]",
    ),
    "sensor": "the plant has sensors of angles, rates and attitudes; add what it stands for by hand",
    "tendon": "add its torque as a spring or a torquer by hand",
    "springdamper": "write stiffness and damping",
    "safety_controller": "limits of the controller belong to the job",
    "fluid_added_mass": "add it to the inertia by hand",
}


def unread(element: Element, read: str, shown: str, where: str = "") -> Iterator[str]:
    """Yield a line for each part of an element that is neither `read` nor of what only shows, in words."""
    name = element.get("name") or element.get("joint") or element.get("reference") or element.get("class")
    where = f"{element.tag} {given(name)}" if name else f"{where}{' ' * bool(where)}<{element.tag}>"
    for key, item in element.items():
        if key not in f"{read} {shown}".split():
            yield no_counterpart(f"{where}: {one_line(key)} = {given(item)}", key)
    for child in element:
        if child.tag in read.split():
            yield from unread(child, read, shown, where)
        elif not {child.tag, f"{element.tag}/{child.tag}"} & {*shown.split()}:
            yield no_counterpart(f"{where}: {_shown(child)}", child.tag)


def no_counterpart(what: str, tag: str) -> str:
    """Return a line about an element or attribute `tag`, and what to do."""
    return f"{what}: no counterpart in a plant file{'; ' * (tag in _HINTS)}{_HINTS.get(tag, '')}"


def _shown(element: Element) -> str:
    """Return an element in a line: its attributes, and those of its children that are values."""
    items = [f"{key}={item}" for key, item in element.items()]
    items += [(one.text or "").strip()[:60] and f"{one.tag}={(one.text or '').strip()[:60]}" for one in element]
    return one_line(f"<{element.tag}> {', '.join(filter(None, items)) or (element.text or '').strip()[:60]}".strip())
