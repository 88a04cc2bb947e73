"""What the bodies look like: rings, wheels, a base, light and camera. Nothing of it takes part in the motion."""

from __future__ import annotations

import dataclasses
import itertools
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.export.mujoco.tree import point_inertia
from platform_ctrl.plant.platform import Platform

# Radius that rotors are drawn with, m, and by how much a ring is larger than what it holds.
ROTOR_RADIUS = 0.05
_AROUND = 1.22
# Mass of a body, relative to its inertia over its size: what is placed apart is light beside its carrier.
_LIGHT = 1e-3
# Second moments below this share of a body's largest are those of a plate; no mass can be moved out of it.
_FLAT = 1e-6


@value
class Placed:
    """A gimbal, or the root: where it is drawn, and its mass."""

    radius: float  # That what it holds is drawn within, m
    position: FloatArray  # (3,): Of its centre in its parent's axes, m
    mass: float  # Its own, kg, rotors not included: of no effect on the motion but through centre
    centre: FloatArray  # (3,): Of its own mass, m, body axes
    inertia: FloatArray  # (3, 3): About that centre, kg m²


def placed(platform: Platform) -> list[Placed]:
    """Return the root and all gimbals, in the order of `Platform.body`."""
    apart = [] if platform.unbalances else _apart(platform)
    found = _placed(platform, apart)
    return found if found is not None else _placed(platform, []) or []


def children(platform: Platform, body: int) -> list[int]:
    """Return the bodies that a body carries."""
    return [1 + int(k) for k in np.flatnonzero(platform.parents == body - 1)]


def rotors_on(platform: Platform, body: int) -> list[int]:
    """Return the rotors that spin in a body."""
    return [int(k) for k in np.flatnonzero(platform.carriers == body - 1)]


def rotor_mass(axial_inertia: float) -> float:
    """Return the mass that a rotor is given, kg."""
    return _LIGHT * 2.0 * axial_inertia / ROTOR_RADIUS**2


def _apart(platform: Platform) -> list[int]:
    """Bodies of which a carrier has several, and that are therefore placed apart."""
    return [k for body in range(1 + len(platform.gimbals)) if len(c := children(platform, body)) > 1 for k in c]


def _leaves_first(platform: Platform) -> list[int]:
    order, waiting = [], [0]
    while waiting:
        body = waiting.pop()
        order.append(body)
        waiting += children(platform, body)
    return order[::-1]


def _placed(platform: Platform, apart: list[int]) -> list[Placed] | None:
    """Place all bodies; None where a carrier is too light for what it carries apart."""
    n = 1 + len(platform.gimbals)
    inertias = [platform.root_inertia, *(g.inertia for g in platform.gimbals)]
    moments = np.zeros((n, 3))
    for unbalance in platform.unbalances:
        moments[platform.body(unbalance.body)] += unbalance.moment
    radius, weight, position = np.zeros(n), np.zeros(n), np.zeros((n, 3))
    out: list[Placed | None] = [None] * n
    for body in _leaves_first(platform):
        inside = [radius[c] for c in children(platform, body)]
        spinning = rotors_on(platform, body)
        inside += [ROTOR_RADIUS] * bool(spinning)
        several = [c for c in children(platform, body) if c in apart]
        for c, where in zip(several, _spots(platform, body, several, max(inside, default=0.0)), strict=True):
            position[c] = where
            inside.append(float(np.linalg.norm(where)) + radius[c])
        radius[body] = _AROUND * max(inside, default=ROTOR_RADIUS)
        inertia, moment = np.array(inertias[body]), moments[body].copy()
        for c in several:
            inertia -= weight[c] * point_inertia(position[c])
            moment -= weight[c] * position[c]
        second = 0.5 * np.trace(inertia) * np.eye(3) - inertia
        spread = np.linalg.eigvalsh(second)
        mass = _LIGHT * np.trace(inertias[body]) / radius[body] ** 2
        if moment.any():
            # The centre of mass takes a quarter of the smallest second moment away.
            mass = max(mass, 4.0 * float(moment @ moment) / max(spread[0], _FLAT * spread[-1]))
        if several and spread[0] < 0.0:
            return None
        centre = moment / mass
        weight[body] = mass + sum(rotor_mass(platform.rotors[k].axial_inertia) for k in spinning)
        weight[body] += sum(weight[c] for c in children(platform, body))
        out[body] = Placed(
            radius=float(radius[body]),
            position=np.zeros(3),
            mass=float(mass),
            centre=centre,
            inertia=inertia - mass * point_inertia(centre),
        )
    return [dataclasses.replace(one, position=position[k]) for k, one in enumerate(out) if one is not None]


def _spots(platform: Platform, body: int, several: list[int], radius: float) -> list[FloatArray]:
    """Places side by side: two along the carrier's own axis, on the root along its second one; more in a circle."""
    if not several:
        return []
    along = platform.gimbals[body - 1].axis if body else np.array([0.0, 1.0, 0.0])
    if len(several) == 2:
        return [1.1 * radius * along, -1.1 * radius * along]
    across = perpendicular(along if body else np.array([0.0, 0.0, 1.0]))
    normal = np.cross(along if body else np.array([0.0, 0.0, 1.0]), across)
    reach = 1.1 * radius / np.sin(np.pi / len(several))
    turns = 2.0 * np.pi * np.arange(len(several)) / len(several)
    return [reach * (np.cos(t) * across + np.sin(t) * normal) for t in turns]


def perpendicular(axis: FloatArray) -> FloatArray:
    """Return a unit vector across `axis`."""
    across = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    out: FloatArray = across / np.linalg.norm(across)
    return out


# Okabe and Ito's colours, which colour-blind people can tell apart; gimbals by their depth.
_MATERIALS = {
    "root": "0.55 0.57 0.60 1",
    "gimbal1": "0.00 0.45 0.70 1",
    "gimbal2": "0.34 0.71 0.91 1",
    "gimbal3": "0.00 0.62 0.45 1",
    "gimbal4": "0.80 0.47 0.65 1",
    "rotor": "0.84 0.37 0.00 1",
    "mark": "0.96 0.96 0.94 1",
    "shaft": "0.30 0.31 0.33 1",
    "axis1": "0.80 0.20 0.20 1",
    "axis2": "0.20 0.60 0.25 1",
    "axis3": "0.20 0.35 0.80 1",
}
_GIMBAL_COLOURS = 4
_SEGMENTS = 40


def text(numbers: FloatArray | tuple[float, ...] | list[float]) -> str:
    """Return numbers as an attribute, with all their digits."""
    return " ".join(repr(float(number)) for number in numbers)


def add_looks(top: Element, radius: float) -> None:
    """Add what a view needs: its size, light, background, and the materials."""
    visual = SubElement(top, "visual")
    SubElement(visual, "global", azimuth="-55", elevation="-22", offwidth="1280", offheight="960")
    SubElement(visual, "headlight", ambient="0.35 0.35 0.35", diffuse="0.35 0.35 0.35", specular="0.1 0.1 0.1")
    SubElement(visual, "quality", shadowsize="4096", offsamples="8")
    SubElement(top, "statistic", center="0 0 0", extent=repr(float(1.4 * radius)))
    asset = SubElement(top, "asset")
    sky = {"rgb1": "0.93 0.95 0.97", "rgb2": "0.62 0.68 0.75", "width": "256", "height": "1536"}
    SubElement(asset, "texture", {"type": "skybox", "builtin": "gradient", **sky})
    for name, colour in _MATERIALS.items():
        SubElement(asset, "material", name=name, rgba=colour, specular="0.35", shininess="0.4")


def add_scene(world: Element, radius: float) -> None:
    """Add lights and a camera that see a platform of this size."""
    R = radius
    SubElement(world, "light", pos=text([2 * R, -2 * R, 4 * R]), dir="-0.41 0.41 -0.82", diffuse="0.6 0.6 0.6")
    SubElement(
        world,
        "light",
        pos=text([-3 * R, -1 * R, 3 * R]),
        dir="0.69 0.23 -0.69",
        diffuse="0.25 0.25 0.28",
        castshadow="false",
    )
    aim, up = np.array([0.0, 0.0, -0.3 * R]), np.array([0.0, 0.0, 1.0])
    eye = aim + R * np.array([2.0, -2.9, 1.5])
    back = (eye - aim) / np.linalg.norm(eye - aim)
    right = np.cross(up, back) / np.linalg.norm(np.cross(up, back))
    axes = np.concatenate([right, np.cross(back, right)])
    SubElement(world, "camera", name="view", pos=text(eye), xyaxes=text(axes), fovy="40")


def add_root(element: Element, platform: Platform, bodies: list[Placed]) -> None:
    """Draw the root: a base plate with posts up to the pivots of what it carries, and its axes."""
    R = bodies[0].radius
    below = -1.12 * R
    _geom(element, "cylinder", "root", size=text([0.95 * R, 0.03 * R]), pos=text([0.0, 0.0, below]))
    for child in children(platform, 0):
        axis, where, reach = platform.gimbals[child - 1].axis, bodies[child].position, 1.1 * bodies[child].radius
        for end in (where + reach * axis, where - reach * axis):
            foot = np.array([end[0], end[1], below])
            if np.linalg.norm(end - foot) > 0.1 * R and (abs(axis[2]) < 0.7 or end[2] < where[2]):
                _bar(element, end, foot, 0.03 * R, "root")
    for k in rotors_on(platform, 0):
        add_pivots(element, platform.rotors[k].axis, 0.9 * ROTOR_RADIUS, 1.3 * ROTOR_RADIUS)
    for k in range(3):
        tip = np.array([0.0, 0.0, below + 0.05 * R]) + 0.35 * R * np.eye(3)[k]
        _bar(element, np.array([0.0, 0.0, below + 0.05 * R]), tip, 0.012 * R, f"axis{k + 1}")


def add_ring(element: Element, platform: Platform, body: int, bodies: list[Placed], depth: int) -> None:
    """Draw a gimbal: a ring through its own pivots and those of what it holds."""
    own, R = platform.gimbals[body - 1].axis, bodies[body].radius
    carried = [platform.gimbals[c - 1].axis for c in children(platform, body)]
    carried += [platform.rotors[k].axis for k in rotors_on(platform, body)]
    across = [axis - (axis @ own) * own for axis in carried]
    across = [axis / np.linalg.norm(axis) for axis in across if np.linalg.norm(axis) > 0.1]
    side = across[0] if across else perpendicular(own)
    material = f"gimbal{1 + (depth - 1) % _GIMBAL_COLOURS}"
    turns = 2.0 * np.pi * np.arange(_SEGMENTS + 1) / _SEGMENTS
    points = R * 0.97 * (np.cos(turns)[:, None] * own + np.sin(turns)[:, None] * side)
    for start, end in itertools.pairwise(points):
        _bar(element, start, end, 0.045 * R, material)
    add_pivots(element, own, 0.97 * R, 1.16 * R)


def add_pivots(element: Element, axis: FloatArray, start: float, end: float) -> None:
    """Draw the two ends of a shaft."""
    for sign in (1.0, -1.0):
        _bar(element, sign * start * axis, sign * end * axis, 0.14 * (end - start) + 0.002, "shaft")


def add_wheel(element: Element, axis: FloatArray) -> None:
    """Draw a rotor: a wheel with a shaft, and marks that show that it turns."""
    r = ROTOR_RADIUS
    _bar(element, -1.15 * r * axis, 1.15 * r * axis, 0.07 * r, "shaft")
    turn = text(quaternion_to(axis))
    _geom(element, "cylinder", "rotor", size=text([0.82 * r, 0.2 * r]), quat=turn)
    _geom(element, "cylinder", "mark", size=text([0.3 * r, 0.24 * r]), quat=turn)
    side = perpendicular(axis)
    for across in (side, np.cross(axis, side)):
        spot = 0.58 * r * across
        ends = spot + 0.205 * r * axis, spot - 0.205 * r * axis
        _bar(element, *ends, 0.09 * r, "mark")


def quaternion_to(axis: FloatArray) -> FloatArray:
    """Return the unit quaternion w, x, y, z that turns the third axis to `axis`."""
    half = np.array([1.0 + axis[2], -axis[1], axis[0], 0.0])
    if half[0] < 1e-9:
        return np.array([0.0, 1.0, 0.0, 0.0])
    out: FloatArray = half / np.linalg.norm(half)
    return out


def _bar(element: Element, start: FloatArray, end: FloatArray, radius: float, material: str) -> None:
    _geom(element, "capsule", material, size=repr(float(radius)), fromto=text([*start, *end]))


def _geom(element: Element, kind: str, material: str, **more: str) -> None:
    SubElement(element, "geom", {"type": kind, "material": material, **more})
