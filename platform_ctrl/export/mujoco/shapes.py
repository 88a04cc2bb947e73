"""What the bodies look like, and the masses that they are given. Nothing of it takes part in the motion."""

from __future__ import annotations

from xml.etree.ElementTree import Element, SubElement

import numpy as np

from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.export.mujoco.tree import point_inertia
from platform_ctrl.plant.platform import Platform

# Radius that rotors are drawn with, m, and by how much a gimbal is larger than what it holds.
ROTOR_RADIUS = 0.05
_AROUND = 1.22
# Mass of a body, relative to its inertia over its size.
_LIGHT = 1e-3
# Second moments below this share of a body's largest are those of a plate; no mass can be moved out of it.
_FLAT = 1e-6
# Okabe and Ito's colours, which colour-blind people can tell apart; gimbals by their depth.
_GIMBALS = ("0.00 0.45 0.70 1", "0.34 0.71 0.91 1", "0.00 0.62 0.45 1", "0.80 0.47 0.65 1")
_ROTOR, _ROOT = "0.84 0.37 0.00 1", "0.55 0.57 0.60 1"


@value
class Placed:
    """A gimbal, or the root, with its mass."""

    radius: float  # That it is drawn with, m
    mass: float  # Its own, kg, rotors not included: of no effect on the motion but through centre
    centre: FloatArray  # (3,): Of its own mass, m, body axes
    inertia: FloatArray  # (3, 3): About that centre, kg m²


def placed(platform: Platform) -> list[Placed]:
    """Return the root and all gimbals, in the order of `Platform.body`."""
    out = []
    for body, inertia in enumerate([platform.root_inertia, *(g.inertia for g in platform.gimbals)]):
        name = platform.gimbal_names[body - 1] if body else platform.root_name
        moment = sum((one.moment for one in platform.unbalances if one.body == name), np.zeros(3))
        radius = _radius(platform, body)
        mass = _LIGHT * float(np.trace(inertia)) / radius**2
        if moment.any():
            # The centre of mass takes a quarter of the smallest second moment away.
            spread = np.linalg.eigvalsh(0.5 * np.trace(inertia) * np.eye(3) - inertia)
            mass = max(mass, float(4.0 * (moment @ moment) / max(spread[0], _FLAT * spread[-1])))
        centre = moment / mass
        out.append(Placed(radius=radius, mass=mass, centre=centre, inertia=inertia - mass * point_inertia(centre)))
    return out


def _radius(platform: Platform, body: int) -> float:
    return _AROUND * max((_radius(platform, child) for child in children(platform, body)), default=ROTOR_RADIUS)


def children(platform: Platform, body: int) -> list[int]:
    """Return the bodies that a body carries."""
    return [1 + int(k) for k in np.flatnonzero(platform.parents == body - 1)]


def rotors_on(platform: Platform, body: int) -> list[int]:
    """Return the rotors that spin in a body."""
    return [int(k) for k in np.flatnonzero(platform.carriers == body - 1)]


def rotor_mass(axial_inertia: float) -> float:
    """Return the mass that a rotor is given, kg."""
    return _LIGHT * 2.0 * axial_inertia / ROTOR_RADIUS**2


def text(numbers: FloatArray | tuple[float, ...] | list[float]) -> str:
    """Return numbers as an attribute, with all their digits."""
    return " ".join(repr(float(number)) for number in numbers)


def add_root(element: Element, radius: float) -> None:
    """Draw the root: a plate below everything."""
    size, below = text([0.95 * radius, 0.03 * radius]), text([0.0, 0.0, -1.12 * radius])
    SubElement(element, "geom", type="cylinder", rgba=_ROOT, size=size, pos=below)


def add_gimbal(element: Element, axis: FloatArray, radius: float, depth: int) -> None:
    """Draw a gimbal: a shaft along its axis."""
    ends = text([*(-radius * axis), *(radius * axis)])
    colour = _GIMBALS[(depth - 1) % len(_GIMBALS)]
    SubElement(element, "geom", type="capsule", rgba=colour, size=repr(0.045 * radius), fromto=ends)


def add_wheel(element: Element, axis: FloatArray) -> None:
    """Draw a rotor: a wheel."""
    r = ROTOR_RADIUS
    ends = text([*(-0.2 * r * axis), *(0.2 * r * axis)])
    SubElement(element, "geom", type="cylinder", rgba=_ROTOR, size=repr(0.82 * r), fromto=ends)


def quaternion_to(axis: FloatArray) -> FloatArray:
    """Return the unit quaternion w, x, y, z that turns the third axis to `axis`."""
    half = np.array([1.0 + axis[2], -axis[1], axis[0], 0.0])
    if half[0] < 1e-9:
        return np.array([0.0, 1.0, 0.0, 0.0])
    out: FloatArray = half / np.linalg.norm(half)
    return out
