"""A picture of a platform's axes, from its description alone: the bodies in perspective."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from platform_ctrl.common.arguments import instance
from platform_ctrl.common.text import greek
from platform_ctrl.common.values import FloatArray
from platform_ctrl.plant.drawing import Outline, bodies, camera, disc_axis, levels
from platform_ctrl.plant.platform import Platform
from platform_ctrl.report.figures.panels import LabelPlacer
from platform_ctrl.report.style import (
    BAND,
    DASH_DOTTED,
    DASHED,
    FULL_WIDTH,
    INK,
    MUTED,
    PAGE,
    REFERENCE,
    SERIES,
    legend,
    panels,
    standalone,
)

# Inches of a disc's radius at most, and below a panel for its scale; in radii: room around each body, length of the
# root's axes.
_RADIUS, _NO_SCALE, _ROOM, _ROOT_AXIS = 0.62, 0.46, (1.3, 0.55), 0.8
# Of gimbals by how many joints lie between them and the root.
_LEVELS = (INK, SERIES[7], SERIES[6], SERIES[3], REFERENCE)
_ANGLE, _SPIN, _SIGN = SERIES[1], SERIES[0], SERIES[2]
_ROTORS = {
    "regulated": ("-", "rotor, constant relative spin"),
    "free": (DASHED, "rotor, free-running"),
    "servo": (DASH_DOTTED, "rotor, speed loop"),
}
# What acts or measures at a joint: its marker, and what it is called.
_SIGNS: dict[str, tuple[dict[str, Any], str]] = {
    "torquer": ({"marker": "s", "markerfacecolor": _SIGN, "markersize": 5.5}, "torquer"),
    "pickoff": ({"marker": "o", "markerfacecolor": PAGE, "markersize": 5.5}, "pick-off"),
    "spring": ({"marker": "x", "markersize": 6.0}, "spring"),
    "cage": ({"marker": "|", "markersize": 9.0}, "cage"),
    "erection": ({"marker": "v", "markerfacecolor": PAGE, "markersize": 6.0}, "erection"),
}


@standalone
def axes_picture(platform: Platform) -> Figure:
    """Picture of the axes of `platform`.

    Gimbals are frames on their bearings with the positive direction and turn of their angle, rotors are discs with the
    direction of L, the root is its axes 1, 2, 3 and the hatched mounts. In the model all axes go through one point; the
    drawing moves bodies apart and keeps every direction.

    Parameters
    ----------
    platform
        From `read_platform`.

    Returns
    -------
    matplotlib.figure.Figure
        One panel without scales, the same for the same platform.
    """
    instance("platform", platform, Platform)
    rows = camera(platform)
    shapes, low, high = _placed([_root_axes(platform), *bodies(platform, rows[2])], rows)
    width, height = high - low
    scale = min(_RADIUS, FULL_WIDTH / width)
    handles, names = _entries(platform, shapes)
    figure, [[axes]] = panels(1, 1, scale * height - _NO_SCALE, names, titles=False)
    axes.set_position((0.0, 0.0, 1.0, scale * height / figure.get_size_inches()[1]))
    axes.set_axis_off()
    middle = 0.5 * (low[0] + high[0])
    axes.set_xlim(middle - 0.5 * FULL_WIDTH / scale, middle + 0.5 * FULL_WIDTH / scale)
    axes.set_ylim(low[1], high[1])
    order = sorted(range(len(shapes)), key=lambda k: (round(_depth(shapes[k][0], rows), 6), k))
    for rank, k in enumerate(order):
        _draw(axes, *shapes[k], rows, platform, 2.0 + 1e-3 * rank)
    _label(axes, platform, shapes, rows)
    legend(figure, handles, names)
    return figure


def _root_axes(platform: Platform) -> list[Outline]:
    torqued = [t.root_axis for t in platform.torquers if t.root_axis is not None]
    arrows = [Outline("root", np.array([np.zeros(3), _ROOT_AXIS * e]), str(k)) for k, e in enumerate(np.eye(3), 1)]
    return [*arrows, *(Outline("sign torquer", 0.5 * _ROOT_AXIS * np.eye(3)[[k - 1]]) for k in torqued)]


def _placed(
    groups: Sequence[list[Outline]], rows: FloatArray
) -> tuple[list[tuple[Outline, FloatArray]], FloatArray, FloatArray]:
    """Return every shape with where the origin of its body lies, side by side, and the corners of the whole."""
    found, x, top = [], 0.0, 0.0
    for group in groups:
        ink = np.concatenate([_ink(shape, rows) for shape in group])
        low, high = ink.min(axis=0), ink.max(axis=0)
        at = np.array([x + 0.5 * _ROOM[0] - low[0], -0.5 * (low[1] + high[1])])
        found += [(shape, at) for shape in group]
        x += float(high[0] - low[0]) + _ROOM[0]
        top = max(top, 0.5 * float(high[1] - low[1]) + _ROOM[1])
    return found, np.array([0.0, -top]), np.array([x, top])


def _rim(shape: Outline, face: int) -> FloatArray:
    """Return points on the rim of a disc's face, (k, 3)."""
    turn = np.linspace(0.0, 2.0 * np.pi, 73)[:, None]
    side, other = np.linalg.svd(disc_axis(shape)[None, :])[2][1:]
    return np.asarray(shape.points[face] + np.cos(turn) * side + np.sin(turn) * other)


def _ink(shape: Outline, rows: FloatArray) -> FloatArray:
    """Return points of a shape as seen, right and up."""
    points = np.concatenate([_rim(shape, 0), _rim(shape, 1)]) if shape.kind == "disc" else shape.points
    return np.asarray(points @ rows[:2].T)


def _depth(shape: Outline, rows: FloatArray) -> float:
    # Signs on a pin are seen whichever end of it is nearer.
    ahead = 0.45 if shape.kind.startswith("sign ") else 1e-3 if shape.kind == "bearing" else 0.0
    return float(shape.points.mean(axis=0) @ rows[2]) + ahead


def _draw(axes: Axes, shape: Outline, at: FloatArray, rows: FloatArray, platform: Platform, order: float) -> None:
    flat, kind = at + shape.points @ rows[:2].T, shape.kind
    level = levels(platform).get(shape.body, 1)
    colour = _LEVELS[(level - 1) % len(_LEVELS)]
    if kind == "disc":
        _disc(axes, shape, at, rows, platform, order)
    elif kind == "mount":
        _mount(axes, flat, order)
    elif kind == "plate":
        axes.fill(*flat.T, facecolor=BAND, edgecolor=colour, linewidth=2.0, zorder=order, clip_on=False)
    elif kind == "bearing":
        dot: dict[str, Any] = {"markerfacecolor": PAGE, "markeredgecolor": INK, "markersize": 4.0}
        axes.plot(*flat.T, "o", zorder=order, clip_on=False, **dot)
    elif kind.startswith("sign "):
        look: dict[str, Any] = {"color": _SIGN, **_SIGNS[kind.removeprefix("sign ")][0]}
        axes.plot(*flat.T, linestyle="none", zorder=order, clip_on=False, **look)
    elif kind in ("axis", "spin", "root"):
        colour = {"axis": _ANGLE, "spin": _SPIN, "root": INK}[kind]
        _arrow(axes, flat[0], flat[1], colour, order, f"{kind} {shape.body}")
    else:
        colour, thick = {"bar": (colour, 2.8), "pin": (colour, 1.7), "shaft": (_SPIN, 1.6)}.get(kind, (_ANGLE, 1.6))
        # What lies behind a line is cut off on both sides of it, not so at its ends, where it joins others.
        along = flat[-1] - flat[0]
        ends = 0.1 * along / max(float(np.hypot(*along)), 0.3)
        halo = np.array([flat[0] + ends, *flat[1:-1], flat[-1] - ends])
        axes.plot(*halo.T, color=PAGE, linewidth=6.0, solid_capstyle="butt", zorder=order, clip_on=False)
        axes.plot(*flat.T, color=colour, linewidth=thick, zorder=order, clip_on=False, gid=kind)
        if kind == "turn-tip":
            _arrow(axes, flat[-2], flat[-1], _ANGLE, order, "")


def _arrow(axes: Axes, tail: FloatArray, tip: FloatArray, colour: str, order: float, name: str) -> None:
    look = {"arrowstyle": "-|>,head_length=0.5,head_width=0.2", "shrinkA": 0.0, "shrinkB": 0.0}
    drawn = axes.annotate(
        "", (tip[0], tip[1]), (tail[0], tail[1]), arrowprops={**look, "color": colour, "linewidth": 1.7}, zorder=order
    )
    drawn.set_gid(name)


def _disc(axes: Axes, shape: Outline, at: FloatArray, rows: FloatArray, platform: Platform, order: float) -> None:
    near = int(disc_axis(shape) @ rows[2] > 0.0)
    front, back = (at + _rim(shape, face) @ rows[:2].T for face in (near, 1 - near))
    [control] = [rotor.control for rotor in platform.rotors if rotor.name == shape.body]
    dashes = _ROTORS[control][0]
    look: dict[str, Any] = {
        "edgecolor": _SPIN,
        "linewidth": 1.4,
        "linestyle": dashes,
        "zorder": order,
        "clip_on": False,
    }
    axes.fill(*back.T, facecolor=BAND, **look)
    along = front[0] - back[0]
    side = (front - front.mean(axis=0)) @ np.array([-along[1], along[0]])
    ends = [int(np.argmax(side)), int(np.argmin(side))]
    axes.fill(
        *np.concatenate([back[ends], front[ends[::-1]]]).T, facecolor=BAND, linewidth=0.0, zorder=order, clip_on=False
    )
    for k in ends:
        axes.plot(*np.array([back[k], front[k]]).T, color=_SPIN, linewidth=1.4, zorder=order, clip_on=False)
    axes.fill(*front.T, facecolor=BAND, **look)


def _mount(axes: Axes, flat: FloatArray, order: float) -> None:
    """Draw a bearing block on either side of the axis, hatched, on the root."""
    along = (flat[1] - flat[0]) / max(float(np.hypot(*(flat[1] - flat[0]))), 1e-9)
    across, gap = np.array([-along[1], along[0]]), np.full(2, np.nan)
    blocks, hatch = [], []
    for side in (1.0, -1.0):
        block = flat[0] + side * np.outer([0.1, 0.3], across)
        blocks += [*block, gap]
        for foot in np.linspace(block[0], block[1], 4)[:-1] + side * 0.03 * across:
            hatch += [foot, foot + 0.09 * (along + 0.5 * side * across), gap]
    for lines, width in ((blocks, 1.7), (hatch, 0.8)):
        axes.plot(*np.array(lines).T, color=MUTED, linewidth=width, zorder=order, clip_on=False)


def _label(axes: Axes, platform: Platform, shapes: Sequence[tuple[Outline, FloatArray]], rows: FloatArray) -> None:
    """Write the names beside the tips of the arrows."""
    names = {
        g.name: greek(g.angle) if g.angle.endswith(g.name) else f"{greek(g.angle)}\n{g.name}" for g in platform.gimbals
    }
    places = LabelPlacer(axes, [at + _ink(shape, rows) for shape, at in shapes])
    for shape, at in shapes:
        if shape.kind not in ("axis", "spin", "root"):
            continue
        tail, tip = at + shape.points @ rows[:2].T
        text = names[shape.body] if shape.kind == "axis" else shape.body
        turn = round(math.degrees(math.atan2(*(tip - tail)[::-1])))
        directions = [turn + more for more in (0, 30, -30, 60, -60, 90, -90, 125, -125)]
        colour = {"axis": _ANGLE, "spin": _SPIN, "root": INK}[shape.kind]
        places.write(text, *tip, colour=colour, size=9.0, bold=True, required=True, directions=directions)


def _entries(platform: Platform, shapes: Sequence[tuple[Outline, FloatArray]]) -> tuple[list[Any], list[str]]:
    """Return the legend: what occurs in the picture."""
    kinds = {shape.kind for shape, _ in shapes}
    entries: dict[str, Any] = {f"1, 2, 3: axes of {platform.root_name}": Line2D([], [], color=INK)}
    if platform.gimbals:
        entries["axis and turn of a positive angle"] = Line2D([], [], color=_ANGLE)
    if platform.rotors:
        entries["spin axis, direction of L"] = Line2D([], [], color=_SPIN)
    for control in dict.fromkeys(rotor.control for rotor in platform.rotors):
        dashes, name = _ROTORS[control]
        entries[name] = Patch(facecolor=BAND, edgecolor=_SPIN, linestyle=dashes)
    for kind, (look, name) in _SIGNS.items():
        if f"sign {kind}" in kinds:
            entries[name] = Line2D([], [], color=_SIGN, linestyle="none", **look)
    return list(entries.values()), list(entries)
