"""Parts of every drawing of a platform: its bodies as frames, discs and axes in space, and the colours of its signals.

Lengths are in radii of a rotor's disc. In the model all axes go through one point; here every body keeps its axis's
direction and is moved apart from its neighbours, which no equation notices.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from platform_ctrl.common.values import FloatArray
from platform_ctrl.plant.gimbals import Gimbal, Rotor
from platform_ctrl.plant.platform import Platform
from platform_ctrl.plant.sensors import body_rates, body_rotations, gimbal_rate

HALF_THICKNESS = 0.16  # of a disc
_PIN = 0.8  # between a frame and its bearings: room for the turn arrow on one side, torquer and pick-off on the other
_TIP = 0.5  # of an axis beyond its bearing
_CLEAR = 0.3  # between bodies
_TURN = 0.36  # radius of a turn arrow


class Outline(NamedTuple):
    """A piece in space: its kind, its points (k, 3), and the body that it belongs to."""

    kind: str
    points: FloatArray
    body: str = ""

    def moved(self, by: FloatArray) -> Outline:
        """Return it at another place."""
        return self._replace(points=self.points + by)


class Item(NamedTuple):
    """A body with all that it carries, its own centre at the origin."""

    body: Gimbal | Rotor
    axis: FloatArray
    reach: float  # from the centre to where its shaft begins
    signs: tuple[str, ...]  # of what acts and measures at its joint
    shapes: list[Outline]


def camera(platform: Platform) -> FloatArray:
    """Return the directions to the right, up and toward the viewer in root axes, the rows of (3, 3).

    Up is the principal axis nearest to the specific force, axis 3 without one. The usual point of view is left
    only where an axis would be seen almost end on, a frame almost from its edge, or where two
    arrows would end in one place.
    """
    force = platform.specific_force - platform.gravity
    k = int(np.argmax(np.abs(force))) if np.any(force) else 2
    sign = -1.0 if force[k] < 0.0 else 1.0
    up, right = sign * np.eye(3)[k], sign * np.eye(3)[(k + 2) % 3]
    root = np.array([np.cross(right, up), right, up])
    axes = np.array([*np.eye(3), *(g.axis for g in platform.gimbals), *(r.axis for r in platform.rotors)])
    carried = [(g.parent, g.axis) for g in platform.gimbals] + [(r.carrier, r.axis) for r in platform.rotors]
    planes = [(g.axis, _across(g.axis, [axis for name, axis in carried if name == g.name])) for g in platform.gimbals]
    normals = np.array([np.cross(a, b) for a, b in planes]).reshape(-1, 3)

    def view(azimuth: float, elevation: float) -> FloatArray:
        ca, sa = np.cos(np.radians(azimuth)), np.sin(np.radians(azimuth))
        ce, se = np.cos(np.radians(elevation)), np.sin(np.radians(elevation))
        turn = np.array([[-sa, ca, 0.0], [-se * ca, -se * sa, ce], [ce * ca, ce * sa, se]])
        return np.asarray(turn @ root)

    elevations, azimuths = (28.0, 22.0, 34.0, 14.0, 44.0), (36.0, 28.0, 44.0, 20.0, 54.0, 64.0)
    best, clearest = view(sign * azimuths[0], elevations[0]), 0.0
    for elevation, azimuth in itertools.product(elevations, azimuths):
        # Axis 3 down: from the other side, so that axes 1 and 2 come toward the viewer all the same.
        rows = view(sign * azimuth, elevation)
        shortest = np.linalg.norm(axes @ rows[:2].T, axis=1).min() / 0.45
        narrowest = np.abs(normals @ rows[2]).min(initial=1.0) / 0.25
        clear = min(float(shortest), 1.0) * min(float(narrowest), 1.0)
        if clear > clearest + 1e-6:
            closest = min((_closest_tips(group, rows) for group in bodies(platform, rows[2])), default=2.0) / 1.2
            clear *= min(closest, 1.0)
            if clear > clearest + 1e-6:
                best, clearest = rows, clear
        if clearest > 1.0 - 1e-6:
            break
    return best


def _closest_tips(shapes: list[Outline], rows: FloatArray) -> float:
    """Return how near to one another two arrows are seen to end."""
    tips = np.array([shape.points[-1] @ rows[:2].T for shape in shapes if shape.kind in ("axis", "spin")])
    apart = np.linalg.norm(tips[:, None] - tips, axis=2)
    return float(apart[np.triu_indices(len(tips), 1)].min(initial=2.0))


def bodies(platform: Platform, toward: FloatArray) -> list[list[Outline]]:
    """Return shapes of the root's parts, body by body in the file's order, gimbals first, each about its own origin."""
    out = []
    for item in _carried(platform, platform.root_name, toward):
        end = _beyond(item)
        mounts = [
            Outline("mount", np.array([side * end * item.axis, side * (end + 0.1) * item.axis])) for side in (1, -1)
        ]
        out.append([*item.shapes, *_shaft(item, end, toward), *mounts])
    return out


def signs(platform: Platform, gimbal: str) -> tuple[str, ...]:
    """Return the forces and sensors at a gimbal's joint, without bearing friction."""
    there: dict[str, set[str | None]] = {
        "torquer": {torquer.gimbal for torquer in platform.torquers},
        "pickoff": {*(one.gimbal for one in platform.pickoffs), *(one.gimbal for one in platform.angle_sensors)},
        "spring": {spring.gimbal for spring in platform.springs},
        "cage": {cage.gimbal for cage in platform.cages},
        "erection": {erection.gimbal for erection in platform.erections},
    }
    return tuple(kind for kind, gimbals in there.items() if gimbal in gimbals)


def levels(platform: Platform) -> dict[str, int]:
    """Return how many joints lie between the root and each body."""
    parent = {g.name: g.parent for g in platform.gimbals}

    def level(name: str) -> int:
        return 1 + level(parent[name]) if name in parent else 0

    return {name: level(name) for name in (platform.root_name, *parent)}


def _carried(platform: Platform, name: str, toward: FloatArray) -> list[Item]:
    gimbals = [_gimbal(platform, g, toward) for g in platform.gimbals if g.parent == name]
    return [*gimbals, *(_rotor(r) for r in platform.rotors if r.carrier == name)]


def _rotor(rotor: Rotor) -> Item:
    axis = -rotor.axis if rotor.angular_momentum < 0.0 else rotor.axis  # that of L
    face = HALF_THICKNESS * axis
    return Item(rotor, axis, HALF_THICKNESS, (), [Outline("disc", np.array([-face, face]), rotor.name)])


def _gimbal(platform: Platform, gimbal: Gimbal, toward: FloatArray) -> Item:
    """Return a gimbal's frame, in the plane of its axis and of the first axis across it, around a row of its bodies."""
    a = gimbal.axis
    own = signs(platform, gimbal.name)
    items = _carried(platform, gimbal.name, toward)
    b = _across(a, [item.axis for item in items])
    if not items:
        plate = np.array([0.8 * a + 0.5 * b, 0.8 * a - 0.5 * b, -0.8 * a - 0.5 * b, -0.8 * a + 0.5 * b])
        return Item(gimbal, a, 0.8, own, [Outline("plate", plate, gimbal.name)])
    n = np.cross(a, b)
    alone = len(items) == 1
    along_b = [_reach(item.shapes, b) + _CLEAR for item in items]
    along_b += [_beyond(item) for item in items if _lies(item.axis, b)]
    width = max(along_b)
    groups = []
    for item in items:
        c = item.axis
        if _lies(c, b) or (abs(c @ n) < 1e-6 and abs(c @ b) > 0.5):
            end = width / abs(float(c @ b))
            extra: list[Outline] = []
        elif abs(c @ n) < 1e-6 and abs(c @ a) > 1e-6:
            end = _beyond(item)
            bars = [np.array([s * end * c - (s * end * (c @ b)) * b - w * b for w in (width, -width)]) for s in (1, -1)]
            extra = [] if alone else [Outline("bar", bar, gimbal.name) for bar in bars]
        else:
            # Its axis leaves the plane: a second frame across the first holds it.
            end = max(_beyond(item), _reach(item.shapes, c) + _CLEAR)
            corners = np.array([s * end * c + r * width * b for s, r in ((1, 1), (1, -1), (-1, -1), (-1, 1))])
            extra = _sides(corners, gimbal.name)
        groups.append([*item.shapes, *extra, *_shaft(item, end, toward)])
    spans = [_span(group, a) for group in groups]
    length = sum(high - low for low, high in spans) + _CLEAR * (len(spans) - 1)
    cursor, shapes = -0.5 * length, []
    for group, (low, high) in zip(groups, spans, strict=True):
        shift = 0.0 if alone else cursor - low
        shapes += [shape.moved(shift * a) for shape in group]
        cursor += high - low + _CLEAR
    half = max(abs(x) for x in spans[0]) + _CLEAR if alone else 0.5 * length + _CLEAR
    if alone and _lies(items[0].axis, a):
        half = _beyond(items[0])
    corners = np.array([s * half * a + r * width * b for s, r in ((1, 1), (1, -1), (-1, -1), (-1, 1))])
    return Item(gimbal, a, half, own, [*_sides(corners, gimbal.name), *shapes])


def _across(a: FloatArray, axes: list[FloatArray]) -> FloatArray:
    """Return the unit vector normal to `a` in the plane of `a` and the first of `axes` that crosses it."""
    principal = np.eye(3)[np.argsort(np.abs(a), kind="stable")]
    for c in (*axes, *principal):
        b = c - (c @ a) * a
        if np.linalg.norm(b) > 0.1:
            return np.asarray(b / np.linalg.norm(b))
    raise AssertionError("one principal axis always crosses a")


def _lies(c: FloatArray, b: FloatArray) -> bool:
    return bool(abs(c @ b) > 1.0 - 1e-6)


def _beyond(item: Item) -> float:
    """Return how far from its centre a body's bearings are."""
    more = 0.2 * max(0, len(item.signs) - 2)
    return item.reach + (_PIN + more if isinstance(item.body, Gimbal) else 0.4)


def _sides(corners: FloatArray, body: str) -> list[Outline]:
    """Return a frame as its four sides, each in two halves, so that near ones can be drawn over far ones."""
    out = []
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        middle = 0.5 * (start + end)
        out += [Outline("bar", np.array([start, middle]), body), Outline("bar", np.array([middle, end]), body)]
    return out


def _shaft(item: Item, end: float, toward: FloatArray) -> list[Outline]:
    """Return bearing shapes of a body at ± `end` along its axis, and the arrows of the positive direction."""
    c, start, name = item.axis, item.reach, item.body.name
    if isinstance(item.body, Rotor):
        away = -float(c @ toward)
        tip = end + 0.8
        if away > 0.0:
            # L points away from the viewer: its tip has to come out from behind the disc.
            tip = max(tip, min((away + 0.5) / math.sqrt(1.0 - min(away, 0.97) ** 2), 3.0))
        return [
            Outline("shaft", np.array([-end * c, -start * c]), name),
            Outline("bearing", np.array([-end * c])),
            Outline("bearing", np.array([end * c])),
            Outline("spin", np.array([start * c, tip * c]), name),
        ]
    out = [
        Outline("pin", np.array([-end * c, -start * c]), name),
        Outline("pin", np.array([start * c, end * c]), name),
        Outline("bearing", np.array([-end * c])),
        Outline("bearing", np.array([end * c])),
        Outline("axis", np.array([end * c, (end + _TIP) * c]), name),
        *_turn(c, 0.5 * (start + end), toward, name),
    ]
    for k, kind in enumerate(item.signs):
        at = -(start + (end - start) * (k + 1.0) / (len(item.signs) + 1.0))
        out.append(Outline("sign " + kind, np.array([at * c]), name))
    return out


def _turn(c: FloatArray, at: float, toward: FloatArray, name: str) -> list[Outline]:
    """Return a right-handed turn about `c` in stretches behind and before the axis; the last ends in the tip."""
    front = _across(c, [toward])
    side = np.cross(c, front)
    angles = np.radians(np.linspace(-215.0, 55.0, 19))
    points = at * c + _TURN * (np.cos(angles)[:, None] * front + np.sin(angles)[:, None] * side)
    cuts = [0, *(np.flatnonzero(np.diff(np.cos(angles) > 0.0)) + 1), len(angles)]
    stretches = [points[max(low - 1, 0) : high] for low, high in itertools.pairwise(cuts)]
    return [Outline("turn" if k < len(stretches) - 1 else "turn-tip", p, name) for k, p in enumerate(stretches)]


def _span(shapes: list[Outline], d: FloatArray) -> tuple[float, float]:
    low, high = 0.0, 0.0
    for shape in shapes:
        x = shape.points @ d
        rim = 0.0
        if shape.kind == "disc":
            rim = math.sqrt(max(0.0, 1.0 - float(disc_axis(shape) @ d) ** 2))
        low, high = min(low, float(x.min()) - rim), max(high, float(x.max()) + rim)
    return low, high


def _reach(shapes: list[Outline], d: FloatArray) -> float:
    low, high = _span(shapes, d)
    return max(-low, high)


def disc_axis(shape: Outline) -> FloatArray:
    """Return the unit vector from the back face of a disc to its front face, the direction of L."""
    return np.asarray((shape.points[1] - shape.points[0]) / (2.0 * HALF_THICKNESS))


# The first gimbals have the first five colours of the palette, the root axes the last three.
_ROOT_SERIES = 5


def root_series(axis: int) -> int:
    """Return which colour of the palette, from 0 on, whatever belongs to root axis 1, 2 or 3 has in every plot."""
    return _ROOT_SERIES + axis - 1


def signal_series(platform: Platform) -> Mapping[str, int]:
    """Return which colour of the palette, from 0 on, each signal of a plant has in every plot, by its name.

    A gimbal's angle, rate and torque, and the readings of sensors on bodies that it turns, share a colour, and so do
    the signals of a root axis.
    """
    out = {angle: k for k, angle in enumerate(platform.angle_names)}
    for axis in (1, 2, 3):
        out |= dict.fromkeys((f"Omega{axis}", f"M{axis}", f"attitude{axis}"), root_series(axis))
    rates = {gimbal_rate(angle): k for k, angle in enumerate(platform.angle_names)}
    rates |= {f"theta{axis}": root_series(axis) for axis in (1, 2, 3)}
    for k in range(len(platform.gimbals)):
        for signals in (body_rates(platform, k + 1), body_rotations(platform, k + 1)):
            rates |= {name: _turned_by(platform, k, component) for component, name in enumerate(signals)}
    for sensor in platform.sensors:
        out[sensor.name] = (out | rates)[next(iter(sensor.signals(platform)))]
    if platform.line_of_sight is not None:
        for name, parts in platform.line_of_sight.signals(platform).items():
            out[name] = (out | rates)[max(parts, key=lambda part: abs(parts[part]))]
    for part in platform.torquers:
        out[part.name] = platform.gimbal(part.gimbal) if part.gimbal is not None else root_series(part.root_axis or 1)
    return out


def _turned_by(platform: Platform, k: int, component: int) -> int:
    """Return the series of the gimbal that turns the body of gimbal `k` most about one of its axes, at zero angles."""
    best, most = root_series(component + 1), 0.5
    while k >= 0:
        if (share := abs(float(platform.gimbals[k].axis[component]))) > most:
            best, most = k, share
        k = int(platform.parents[k])
    return best
