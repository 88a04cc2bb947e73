"""A platform's bodies in space, each in its own axes, for the view in the browser. Nothing here draws."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from bokeh.models.sources import ColumnDataSource
from bokeh.models.widgets import Div

from platform_ctrl.common.text import greek
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.mechanics.kinematics import topology
from platform_ctrl.plant.drawing import Shape, bodies, camera, levels
from platform_ctrl.plant.platform import Platform
from platform_ctrl.simulation.closed_loop import Trajectory

# Radii, in those of a rotor's disc.
_BAR, _PIN, _BEARING, _ARROW, _TORQUER = 0.085, 0.055, 0.12, 0.03, 0.16
_CLEAR = 0.45  # between what the root carries, and around it
# How round the corners of a frame are, in parts of its shorter half.
_ROUND = 0.55


@value
class Node:
    """A body of the tree.

    `kind` is ``"root"``, ``"gimbal"`` or ``"rotor"``, `parent` the index of the node that carries it, -1 for the root.
    `pivot` (3,) is the point about which it turns, from its parent's, in radii of a rotor's disc, and `axis` (3,) the
    unit vector, both in its parent's axes. `level` counts the joints to the root, `spin` is in rad/s. `tip` (3,) is the
    place of its label and `pieces` are its shapes (kind, points, radius), both in its own axes from its own pivot.
    """

    name: str
    label: str
    kind: str
    parent: int
    pivot: FloatArray
    axis: FloatArray
    level: int
    spin: float
    control: str
    tip: FloatArray
    pieces: tuple[dict[str, Any], ...]


@value
class Scene:
    """What is shown of a platform: the root, the gimbals and the rotors in the file's order.

    `camera` (3, 3) are the directions to the right, up and toward the viewer, in root axes; a ball of radius `reach`
    about `centre`, in radii of a rotor's disc, holds everything.
    """

    nodes: tuple[Node, ...]
    camera: FloatArray
    centre: FloatArray
    reach: float

    def data(self) -> dict[str, Any]:
        """Return it as JSON values."""
        nodes = [{name: _plain(getattr(node, name)) for name in Node.__dataclass_fields__} for node in self.nodes]
        return {"nodes": nodes} | {name: _plain(getattr(self, name)) for name in ("camera", "centre", "reach")}


def scene(platform: Platform) -> Scene:
    """Return what is seen of a platform."""
    rows = camera(platform)
    groups = bodies(platform, rows[2])
    places = _places(groups, rows)
    placed = [[one.moved(place) for one in group] for group, place in zip(groups, places, strict=True)]
    shapes = [one for group in placed for one in group]
    depth = levels(platform)
    tree = topology(platform)
    names = [platform.root_name, *(g.name for g in platform.gimbals), *(r.name for r in platform.rotors)]
    parents = [-1, *(int(k) + 1 for k in tree.parents), *(int(k) for k in tree.carriers)]
    pivots = [np.zeros(3), *(_pivot(shapes, name) for name in names[1:])]
    root = _Root(placed, rows)
    pieces = _pieces(shapes, names, parents)
    pieces[0] += root.pieces
    nodes = []
    for k, (name, parent) in enumerate(zip(names, parents, strict=True)):
        gimbal = platform.gimbals[k - 1] if 0 < k <= len(platform.gimbals) else None
        rotor = platform.rotors[k - 1 - len(platform.gimbals)] if k > len(platform.gimbals) else None
        body = gimbal or rotor
        nodes.append(
            Node(
                name=name,
                label=name if gimbal is None or greek(gimbal.angle) == name else f"{name}  {greek(gimbal.angle)}",
                kind="root" if body is None else "gimbal" if rotor is None else "rotor",
                parent=parent,
                pivot=pivots[k] - pivots[max(parent, 0)],
                axis=np.zeros(3) if body is None else body.axis,
                level=depth[name] if rotor is None else depth[names[parent]] + 1,
                spin=0.0 if rotor is None else rotor.spin,
                control="" if rotor is None else rotor.control,
                tip=root.tip if body is None else _tip(shapes, name) - pivots[k],
                pieces=tuple(_from(piece, pivots[k]) for piece in pieces[k]),
            )
        )
    return Scene(nodes=tuple(nodes), camera=rows, centre=root.centre, reach=root.reach)


def _plain(item: Any) -> Any:
    if isinstance(item, np.ndarray):
        return [_plain(one) for one in item] if item.ndim > 1 else [round(float(x), 9) + 0.0 for x in item]
    if isinstance(item, tuple):
        return [_plain(one) for one in item]
    if isinstance(item, dict):
        return {name: _plain(one) for name, one in item.items()}
    return item


def _from(piece: dict[str, Any], pivot: FloatArray) -> dict[str, Any]:
    return piece | {"points": np.atleast_2d(piece["points"]) - pivot}


def _pivot(shapes: list[Shape], name: str) -> FloatArray:
    """Return the point that a body turns about: midway between its pins, or the middle of its disc."""
    own = [one for one in shapes if one.body == name]
    pins = [one.points for one in own if one.kind in ("pin", "disc")]
    return np.asarray(np.concatenate(pins).mean(axis=0))


def _tip(shapes: list[Shape], name: str) -> FloatArray:
    return np.asarray(next(one for one in shapes if one.body == name and one.kind in ("axis", "spin")).points[-1])


def _pieces(shapes: list[Shape], names: list[str], parents: list[int]) -> list[list[dict[str, Any]]]:
    """Sort shapes by node; bearings belong to the body that holds them, and so do what acts and measures there."""
    out: list[list[dict[str, Any]]] = [[] for _ in names]
    place = {name: k for k, name in enumerate(names)}
    chain: list[Shape] = []
    holder = 0
    for one in [*shapes, Shape("end", np.zeros((1, 3)))]:
        if chain and (one.kind != "bar" or one.body != chain[-1].body or not _joins(chain[-1], one)):
            out[place[chain[0].body]].append(_bars(chain))
            chain = []
        if one.kind == "bar":
            chain.append(one)
            continue
        own = place.get(one.body, 0)
        if one.kind in ("pin", "shaft", "spin"):
            holder = parents[own]
        if one.kind in ("pin", "shaft"):
            out[own].append(_tube(one.points, _PIN))
        elif one.kind in ("axis", "spin"):
            out[own].append({"kind": "arrow", "points": one.points, "radius": _ARROW, "looks": one.kind})
        elif one.kind == "disc":
            out[own].append({"kind": "disc", "points": one.points, "radius": 1.0, "looks": "disc"})
        elif one.kind == "plate":
            out[own].append(_loop(one.points))
        elif one.kind == "bearing":
            out[holder].append({"kind": "ball", "points": one.points, "radius": _BEARING, "looks": "bearing"})
        elif one.kind == "sign torquer":
            along = _pin_direction(shapes, one.body)
            ends = one.points[0] + 0.1 * np.array([-along, along])
            out[parents[own]].append({"kind": "tube", "points": ends, "radius": _TORQUER, "looks": "torquer"})
    return out


def _pin_direction(shapes: list[Shape], name: str) -> FloatArray:
    pin = next(one.points for one in shapes if one.body == name and one.kind == "pin")
    return np.asarray((pin[1] - pin[0]) / np.linalg.norm(pin[1] - pin[0]))


def _joins(one: Shape, other: Shape) -> bool:
    return bool(np.allclose(one.points[-1], other.points[0]))


def _bars(chain: list[Shape]) -> dict[str, Any]:
    """Return a frame if its sides close, else a bar."""
    points = np.array([chain[0].points[0], *(one.points[-1] for one in chain)])
    if len(chain) == 8 and np.allclose(points[0], points[-1]):
        return _loop(points[:-1:2])
    return _tube(points[[0, -1]], _BAR)


def _tube(points: FloatArray, radius: float) -> dict[str, Any]:
    return {"kind": "tube", "points": points, "radius": radius, "looks": "frame"}


def _loop(corners: FloatArray) -> dict[str, Any]:
    """Return a closed frame with round corners."""
    points = []
    shorter = min(float(np.linalg.norm(corners[k] - corners[k - 1])) for k in range(4)) / 2.0
    arcs = np.radians(np.linspace(0.0, 90.0, 9))
    for before, corner, after in zip(np.roll(corners, 1, axis=0), corners, np.roll(corners, -1, axis=0), strict=True):
        into, on = _unit(before - corner), _unit(after - corner)
        r = _ROUND * shorter
        centre = corner + r * (into + on)
        points += [centre - r * (np.sin(x) * into + np.cos(x) * on) for x in arcs]
    return {"kind": "loop", "points": np.array(points), "radius": _BAR, "looks": "frame"}


def _unit(vector: FloatArray) -> FloatArray:
    return np.asarray(vector / np.linalg.norm(vector))


def _sizes(group: list[Shape]) -> tuple[float, float]:
    """Return how far a group reaches from its axis, and along it, however its bodies turn."""
    c = _mount_axis(group)
    along, across = 0.0, 0.0
    for one in group:
        rim = 1.0 if one.kind == "disc" else 0.0
        for point in one.points:
            along = max(along, abs(float(point @ c)) + rim)
            across = max(across, float(np.linalg.norm(point - (point @ c) * c)) + rim)
    return across, along


def _mount_axis(group: list[Shape]) -> FloatArray:
    first = next(one for one in group if one.kind == "mount")
    return _unit(first.points[1])


def _places(groups: list[list[Shape]], rows: FloatArray) -> list[FloatArray]:
    """Return the places of the bodies that the root carries: in rows, beside and behind one another."""
    if not groups:
        return []
    step = 2.0 * max(max(_sizes(group)) for group in groups) + _CLEAR
    columns = len(groups) if len(groups) < 4 else int(np.ceil(np.sqrt(len(groups))))
    up = _upward(rows)
    right = _unit(rows[0] - (rows[0] @ up) * up)
    right = np.eye(3)[int(np.argmax(np.abs(right)))] * np.sign(right[int(np.argmax(np.abs(right)))])
    back = np.cross(up, right)
    depth = int(np.ceil(len(groups) / columns))
    return [
        step * ((k % columns - 0.5 * (columns - 1)) * right + (0.5 * (depth - 1) - k // columns) * -back)
        for k in range(len(groups))
    ]


def _upward(rows: FloatArray) -> FloatArray:
    """Return the principal axis that points up most."""
    k = int(np.argmax(np.abs(rows[1])))
    return np.asarray(np.sign(rows[1, k]) * np.eye(3)[k])


class _Root:
    """What the root itself is drawn as: a frame about each body that it carries, on a plate."""

    def __init__(self, placed: list[list[Shape]], rows: FloatArray) -> None:
        self.pieces: list[dict[str, Any]] = []
        up = _upward(rows)
        low = -0.8
        middles = []
        widest = 1.5
        for group in placed:
            mounts = [one.points for one in group if one.kind == "mount"]
            middle = 0.5 * (mounts[0][0] + mounts[1][0])
            middles.append(middle)
            c = _unit(mounts[0][1] - middle)
            across, _ = _sizes([one.moved(-middle) for one in group])
            end = float(np.linalg.norm(mounts[0][1] - middle))
            down = -up - (-up @ c) * c
            # The axis is upright: the frame lies in the plane that faces the viewer.
            d = _unit(down) if np.linalg.norm(down) > 0.3 else _unit(rows[0] - (rows[0] @ c) * c)
            width = across + _CLEAR
            widest = max(widest, 0.6 * width)
            corners = middle + np.array([s * end * c + r * width * d for s, r in ((1, 1), (1, -1), (-1, -1), (-1, 1))])
            self.pieces.append(_loop(corners))
            foot = middle + (width * d if np.linalg.norm(down) > 0.3 else -end * np.sign(c @ up) * c)
            low = min(low, float((foot - 0.35 * up) @ up))
            self.pieces.append(_tube(np.array([foot, foot]), 1.6 * _BAR) | {"foot": True})
        for piece in self.pieces:
            if piece.pop("foot", False):
                foot = piece["points"][0]
                piece["points"] = np.array([foot, foot + (low - float(foot @ up)) * up])
        flat = [np.linalg.norm(one - (one @ up) * up) for one in middles]
        radius = max(flat, default=0.0) + widest
        plate = np.array([(low - 0.12) * up, low * up])
        self.pieces.append({"kind": "disc", "points": plate, "radius": radius, "looks": "plate"})
        start = low * up + 0.02 * up
        for k in range(3):
            tip = start + (radius + 0.7) * np.eye(3)[k]
            self.pieces.append(
                {"kind": "arrow", "points": np.array([start, tip]), "radius": 0.04, "looks": f"axis {k + 1}"}
            )
        self.tip = start - (radius + 0.2) * _unit(rows[0] - (rows[0] @ up) * up)
        seen = np.concatenate(
            [*(one.points for group in placed for one in group), *(one["points"] for one in self.pieces)]
        )
        self.centre = 0.5 * (seen.min(axis=0) + seen.max(axis=0))
        self.reach = float(np.linalg.norm(seen - self.centre, axis=1).max())


# Samples that a run is shown with: more are thinned out, every second, third, ... one kept.
SAMPLES = 4000


class TreeView:
    """The gimbal tree of a platform in 3-D, turning with a run once there is one.

    The template has to load ``/page/tree.js`` as a module.

    Attributes
    ----------
    layout
        What the document takes: fills its box; named ``tree``.
    """

    def __init__(self, platform: Platform) -> None:
        self._source = ColumnDataSource(data={"t": np.zeros(0)})
        self.layout = Div(
            text="<gimbal-tree></gimbal-tree>",
            name="tree",
            tags=[self._source, _text(platform)],
            disable_math=True,
            sizing_mode="stretch_both",
            styles={"position": "relative"},
        )

    def stage(self, platform: Platform) -> None:
        """Show another platform; the run is dropped."""
        text = _text(platform)
        if text != self.layout.tags[1]:
            self._source.data = {"t": np.zeros(0)}
            self.layout.tags = [self._source, text]

    def show(self, trajectory: Trajectory) -> None:
        """Turn with a run; the one before it is dropped."""
        self._source.data = columns(trajectory)


def columns(trajectory: Trajectory) -> dict[str, Any]:
    """Return what the script needs of a run: every angle, the attitude, and how far servo rotors have turned."""
    rows = slice(None, None, max(1, -(-len(trajectory.t) // SAMPLES)))
    out: dict[str, Any] = {"t": trajectory.t[rows]}
    out |= {f"q {k}": trajectory.q[rows, k] for k in range(trajectory.q.shape[1])}
    out |= {name: trajectory.attitude[rows, k] for k, name in enumerate("wxyz")}
    if len(trajectory.rotor_names) and len(trajectory.t):
        middle = 0.5 * (trajectory.rotor_spin[1:] + trajectory.rotor_spin[:-1]) * np.diff(trajectory.t)[:, None]
        turned = np.concatenate([np.zeros((1, middle.shape[1])), np.cumsum(middle, axis=0)])
        out |= {f"turned {name}": turned[rows, k] for k, name in enumerate(trajectory.rotor_names)}
    return {name: np.ascontiguousarray(column) for name, column in out.items()}


def _text(platform: Platform) -> str:
    return json.dumps(scene(platform).data(), separators=(",", ":"))
