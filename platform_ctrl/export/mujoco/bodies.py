"""The bodies of a platform as MuJoCo has them: mass, centre of mass, principal moments, and where each is placed.

All bodies of a platform turn about one point, which would draw all its gyros into each other. Gimbals of which a body
carries several are drawn apart. That is exact: what a balanced subtree adds to its carrier far from the centre is taken
from the carrier's own inertia, and its weight is balanced there.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from platform_ctrl.description import Platform
from platform_ctrl.frozen import FloatArray, value

# Radius that rotors are drawn with, m, and by how much a ring is larger than what it holds.
ROTOR_RADIUS = 0.05
_AROUND = 1.22
# Share of a body's size that its mass stands for: what is placed apart weighs little beside its carrier.
_LIGHT = 1e-3
# Second moments below this share of a body's largest are those of a plate; no mass can be moved out of it.
_FLAT = 1e-6


@value
class Placed:
    """A gimbal, or the root: where it is drawn, and its mass.

    Attributes
    ----------
    radius
        That what it holds is drawn within, m.
    position : (3,)
        Of its centre in its parent's axes, m.
    mass
        Its own, kg, rotors not included: of no effect on the motion but through `centre`.
    centre : (3,)
        Of its own mass, m, body axes.
    inertia : (3, 3)
        About that centre, kg m².
    """

    radius: float
    position: FloatArray
    mass: float
    centre: FloatArray
    inertia: FloatArray


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
            inertia -= weight[c] * _point(position[c])
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
            inertia=inertia - mass * _point(centre),
        )
    return [dataclasses.replace(one, position=position[k]) for k, one in enumerate(out) if one is not None]


def _point(offset: FloatArray) -> FloatArray:
    """Inertia of a unit mass at `offset`."""
    out: FloatArray = float(offset @ offset) * np.eye(3) - np.outer(offset, offset)
    return out


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
