"""What the bodies look like: rings, wheels, a base, light and camera. Nothing of it takes part in the motion."""

from __future__ import annotations

import itertools
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from platform_ctrl.description import Platform
from platform_ctrl.export.mujoco.bodies import ROTOR_RADIUS, Placed, children, perpendicular, rotors_on
from platform_ctrl.frozen import FloatArray

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
    held = [platform.gimbals[c - 1].axis for c in children(platform, body)]
    held += [platform.rotors[k].axis for k in rotors_on(platform, body)]
    across = [axis - (axis @ own) * own for axis in held]
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
