"""The gimbal tree as the page draws it: lines in space, the bodies that they turn with, and how a run turns these."""

from __future__ import annotations

from typing import Any

import numpy as np

from platform_ctrl.common.text import greek
from platform_ctrl.common.values import FloatArray
from platform_ctrl.mechanics.kinematics import topology
from platform_ctrl.plant.drawing import Outline, bodies, camera, disc_axis
from platform_ctrl.plant.platform import Platform
from platform_ctrl.simulation.closed_loop import Trajectory

# What is drawn, from behind to the front; arrows of turns and signs at joints are left out.
_KINDS = ("mount", "bar", "plate", "shaft", "pin", "disc", "bearing", "axis", "spin")
# Points of a disc's rim, distance between bodies of the root in radii of a disc, samples of a run.
_RIM, _CLEAR, _SAMPLES = 36, 0.6, 400


def tree_data(platform: Platform) -> dict[str, Any]:
    """Return what the page draws of a platform, as JSON values; lengths are in radii of a rotor's disc.

    `bodies` are the gimbals, then the rotors: each turns about its `axis` through its `pivot`, and with its `parent`,
    -1 for the root. `shapes` are lines, or a dot, and turn with a body; `series` is the number of a gimbal's colour.
    `rows` (2, 3) are the directions to the right and up; all vectors are in root axes at zero angles.
    """
    rows = camera(platform)
    shapes = _side_by_side(bodies(platform, rows[2]), rows[0])
    tree = topology(platform)
    names = [*(g.name for g in platform.gimbals), *(r.name for r in platform.rotors)]
    parents = [*map(int, tree.parents), *(int(k) - 1 for k in tree.carriers)]
    axes = [*(g.axis for g in platform.gimbals), *(r.axis for r in platform.rotors)]
    count = len(platform.gimbals)
    texts = [
        *(greek(g.angle) if g.angle.endswith(g.name) else f"{g.name} {greek(g.angle)}" for g in platform.gimbals),
        *(r.name for r in platform.rotors),
    ]
    tips = {one.body: one.points[-1] for one in shapes if one.kind in ("axis", "spin")}
    place = {name: k for k, name in enumerate(names)}
    drawn = []
    holder = -1
    for one in shapes:
        k = place.get(one.body, -1)
        if one.kind in ("pin", "shaft"):
            holder = parents[k]
        if one.kind in _KINDS:
            # A bearing belongs to the body that holds it.
            k = holder if one.kind == "bearing" else k
            series = 1 + k % 8 if one.kind == "axis" and 0 <= k < count else 0
            drawn.append({"kind": one.kind, "body": k, "series": series, "points": _plain(_line(one))})
    drawn.sort(key=lambda one: _KINDS.index(str(one["kind"])))
    return {
        "rows": _plain(rows[:2]),
        "bodies": [
            {"parent": parent, "axis": _plain(axis), "pivot": _plain(_pivot(shapes, name))}
            for name, parent, axis in zip(names, parents, axes, strict=True)
        ],
        "shapes": drawn,
        "labels": [
            {"body": k, "text": text, "at": _plain(tips[name])}
            for k, (name, text) in enumerate(zip(names, texts, strict=True))
        ],
    }


def run_data(trajectory: Trajectory) -> dict[str, Any]:
    """Return how a run turns the gimbals, `angles` (T, n), rad, and the platform: `turns` (T, 3), rotation vectors."""
    from scipy.spatial.transform import Rotation

    rows = slice(None, None, max(1, -(-len(trajectory.t) // _SAMPLES)))
    attitudes = Rotation.from_quat(np.roll(trajectory.attitude[rows], -1, axis=1))
    turns = (attitudes[0].inv() * attitudes).as_rotvec()
    named = {"t": trajectory.t[rows], "angles": trajectory.q[rows], "turns": turns}
    return {name: np.round(array, 9).tolist() for name, array in named.items()}


def _side_by_side(groups: list[list[Outline]], right: FloatArray) -> list[Outline]:
    """Return the bodies that the root carries in a row, about the origin."""
    k = int(np.argmax(np.abs(right)))
    along = np.sign(right[k]) * np.eye(3)[k]
    out, end = [], 0.0
    for group in groups:
        rims = [(one.points @ along, float(one.kind == "disc")) for one in group]
        low, high = min(float(x.min()) - r for x, r in rims), max(float(x.max()) + r for x, r in rims)
        out += [one.moved((end - low) * along) for one in group]
        end += high - low + _CLEAR
    return [one.moved(-0.5 * (end - _CLEAR) * along) for one in out]


def _line(one: Outline) -> FloatArray:
    """Return the points of a shape: of a disc those of its rim."""
    if one.kind != "disc":
        return np.vstack([one.points, one.points[:1]]) if one.kind == "plate" else one.points
    axis = disc_axis(one)
    side = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    side /= np.linalg.norm(side)
    turn = np.linspace(0.0, 2.0 * np.pi, _RIM + 1)[:, None]
    return np.asarray(one.points.mean(axis=0) + np.cos(turn) * side + np.sin(turn) * np.cross(axis, side))


def _pivot(shapes: list[Outline], name: str) -> FloatArray:
    """Return the point that a body turns about: midway between its pins, or the middle of its disc."""
    pins = [one.points for one in shapes if one.body == name and one.kind in ("pin", "disc")]
    return np.asarray(np.concatenate(pins).mean(axis=0))


def _plain(array: FloatArray) -> Any:
    return (np.round(array, 4) + 0.0).tolist()
