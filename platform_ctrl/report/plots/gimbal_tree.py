"""The tree of a platform's gimbals, from the root down to the rotors, with the axis of each body in a cross of axes."""

from __future__ import annotations

import re
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyBboxPatch, PathPatch, Polygon
from matplotlib.path import Path

from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.text import greek, text_width
from platform_ctrl.common.values import FloatArray
from platform_ctrl.job.quantities import RPM
from platform_ctrl.job.quantities import plain as number
from platform_ctrl.plant.drawing import camera, signs, spin_direction
from platform_ctrl.plant.platform import Gimbal, Platform, Rotor
from platform_ctrl.report.axes.view import SIGNS, direction_text
from platform_ctrl.report.plots.systems import drawable
from platform_ctrl.report.style import BAND, FRAME, INK, MUTED, REFERENCE, SERIES, standalone

HEIGHT = 58.0
CROSS = 52.0  # side of the square that holds the cross of axes
_PAD, _SIGN, _AFTER = 7.0, 12.0, 5.0
_NAME, _LINE, _SMALL = 8.5, 7.5, 6.5
_LEAST, _MOST = 66.0, 150.0  # width of the text

# Borders by the level of nesting, as in the pictures of axes.
LEVELS = (INK, SERIES[7], SERIES[6], SERIES[3], REFERENCE)
AXIS, SPIN, ACTS = SERIES[1], SERIES[0], SERIES[2]
CONTROL: dict[str, Any] = {"regulated": "-", "free": (0, (5, 2)), "servo": (0, (6, 1.6, 1.2, 1.6))}
# The signs of the pictures of axes, and two more.
_SIGNS = {kind: path for kind, (path, _) in SIGNS.items()} | {
    "rate": "M0-5.5L5.5 0L0 5.5L-5.5 0Z",
    "stop": "M-5-4.5V4.5M5-4.5V4.5M-5 0H5",
    "friction": "M-5.5 3.5H5.5M-4.5 3.5V-1.5H4.5V3.5",
    "unbalance": "M0-4.5A",
    "attitude": "M-5.5 4.5H5.5L-5.5-4.5V4.5",
    "sight": "M-5.5 0H5.5M1.5-3.5L5.5 0L1.5 3.5",
}
WORDS = {kind: words for kind, (_, words) in SIGNS.items()} | {
    "rate": "rate sensor",
    "stop": "stops",
    "friction": "friction",
    "unbalance": "unbalance",
    "attitude": "attitude sensor",
    "sight": "line of sight",
}


class Card(NamedTuple):
    """A body: its text, its signs with words, and the vectors of its cross of axes."""

    name: str
    kind: str  # root, gimbal, rotor
    lines: tuple[tuple[str, str], ...]  # text, colour
    signs: tuple[tuple[str, str], ...]  # kind, word
    arrow: FloatArray | None
    edge: str
    dashes: Any

    @property
    def width(self) -> float:
        """Of the card, points."""
        own = [text_width(self.name, _NAME) + 4.0, *(text_width(text, _LINE) for text, _ in self.lines)]
        own.append(sum(_SIGN + (text_width(word, _SMALL) + _AFTER if word else 2.0) for _, word in self.signs))
        return CROSS + 2.0 * _PAD + float(np.clip(max(own), _LEAST, _MOST))


def root_card(platform: Platform) -> Card:
    """Return the card of the root: the axes that all vectors are written in."""
    torquers = [t.name for t in platform.torquers if t.root_axis is not None]
    root = platform.root_name
    sensors = [s.name for s in platform.rate_sensors if s.root_axis is not None or s.body == root]
    marks = [("torquer", ", ".join(map(drawable, torquers)))] if torquers else []
    marks += [("rate", ", ".join(greek(drawable(name)) for name in sensors))] if sensors else []
    marks += [*_inertial(platform, root), *_unbalance(platform, root)]
    lines = (("root: axes 1, 2, 3", MUTED),)
    return Card(drawable(platform.root_name), "root", lines, tuple(marks), None, INK, "-")


def gimbal_card(platform: Platform, gimbal: Gimbal, level: int) -> Card:
    """Return the card of a gimbal, `level` joints away from the root."""
    there = signs(platform, gimbal.name)
    marks = [("torquer", drawable(t.name)) for t in platform.torquers if t.gimbal == gimbal.name]
    marks += [("pickoff", "")] * ("pickoff" in there)
    marks += [("rate", "")] * any(gimbal.name in (s.gimbal, s.body) for s in platform.rate_sensors)
    marks += _inertial(platform, gimbal.name)
    if gimbal.stops is not None:
        marks.append(("stop", _degrees(*gimbal.stops)))
    marks += [(kind, "") for kind in ("spring", "cage", "erection") if kind in there]
    marks += [("friction", "")] * any(f.gimbal == gimbal.name for f in platform.frictions)
    marks += _unbalance(platform, gimbal.name)
    text = f"{greek(drawable(gimbal.angle))} about {direction_text(gimbal.axis)}"
    edge = LEVELS[(level - 1) % len(LEVELS)]
    return Card(drawable(gimbal.name), "gimbal", ((text, AXIS),), tuple(marks), gimbal.axis, edge, "-")


def _inertial(platform: Platform, body: str) -> list[tuple[str, str]]:
    marks = [("attitude", "")] * any(s.body == body for s in platform.attitude_sensors)
    sight = platform.line_of_sight
    return marks + ([("sight", direction_text(sight.direction))] if sight is not None and sight.body == body else [])


def rotor_card(rotor: Rotor) -> Card:
    """Return the card of a rotor."""
    spin = f"{number(abs(rotor.spin) * RPM, 4)} rpm, {rotor.control}"
    lines = ((f"L = {number(abs(rotor.angular_momentum), 3)} N m s", SPIN), (spin, MUTED))
    return Card(drawable(rotor.name), "rotor", lines, (), spin_direction(rotor), SPIN, CONTROL[rotor.control])


def _unbalance(platform: Platform, body: str) -> list[tuple[str, str]]:
    return [("unbalance", "")] * any(u.body == body and np.any(u.moment) for u in platform.unbalances)


def _degrees(low: float, high: float) -> str:
    a, b = (number(float(np.degrees(x)), 3) for x in (low, high))
    return f"±{b}°" if abs(low + high) <= 1e-9 * max(abs(low), abs(high)) else f"{a}° to {b}°"


def draw_card(axes: Axes, card: Card, left: float, top: float, rows: FloatArray) -> None:
    """Draw a card with its upper left corner at a point; `rows` are right, up and toward the viewer in root axes."""
    radius = 13.0 if card.kind == "rotor" else 3.0
    box = FancyBboxPatch(
        (left, top),
        card.width,
        HEIGHT,
        boxstyle=f"round,pad=0,rounding_size={radius}",
        facecolor=BAND if card.kind == "root" else "none",
        edgecolor=card.edge,
        linewidth=1.5,
        linestyle=card.dashes,
    )
    box.set_gid(f"{card.kind} {card.name}")
    axes.add_patch(box)
    _cross(axes, np.array([left + 0.5 * CROSS + 4.0, top + 0.5 * HEIGHT]), rows, card)
    x, room = left + CROSS + _PAD, card.width - CROSS - 2.0 * _PAD
    y = top + (14.0 if len(card.lines) + bool(card.signs) > 1 else 20.0)
    colour = SPIN if card.kind == "rotor" else INK
    axes.text(x, y, fitted(card.name, _NAME, room), fontsize=_NAME, fontweight="bold", color=colour, va="center")
    for text, ink in card.lines:
        y += 14.0
        axes.text(x, y, fitted(text, _LINE, room), fontsize=_LINE, color=ink, va="center")
    y += 15.0
    at = x + 6.0
    for kind, word in card.signs:
        draw_sign(axes, kind, at, y)
        at += _SIGN
        if word:
            shown = fitted(word, _SMALL, left + card.width - at)
            axes.text(at - 4.0, y, shown, fontsize=_SMALL, color=MUTED, va="center")
            at += text_width(shown, _SMALL) + _AFTER - 2.0
        at += 2.0


def _cross(axes: Axes, centre: FloatArray, rows: FloatArray, card: Card) -> None:
    """Draw axes 1, 2, 3 thinly and the body's own axis over them; a rotor's disc lies across its axis."""
    flat = rows[:2] * np.array([[1.0], [-1.0]])
    length = 0.34 * CROSS
    # The cross fills its square evenly, wherever its axes point.
    own = np.zeros((1, 2)) if card.arrow is None else 1.22 * (flat @ card.arrow)[None, :]
    ends = length * np.vstack([own, flat.T, np.zeros((1, 2))])
    centre = centre - 0.5 * (ends.min(axis=0) + ends.max(axis=0))
    if card.kind == "rotor" and card.arrow is not None:
        across = np.linalg.svd(card.arrow[None, :])[2][1:]
        turn = np.linspace(0.0, 2.0 * np.pi, 48)
        ring = 0.26 * CROSS * (np.cos(turn)[:, None] * across[0] + np.sin(turn)[:, None] * across[1]) @ flat.T
        axes.add_patch(Polygon(centre + ring, closed=True, facecolor=BAND, edgecolor=SPIN, linewidth=1.0))
    root = card.kind == "root"
    for k, axis in enumerate(np.eye(3)):
        tip = centre + length * flat @ axis
        if root:
            _arrow(axes, centre, tip, INK, 1.4)
        else:
            axes.plot(*np.array([centre, tip]).T, color=FRAME, linewidth=0.9, solid_capstyle="round")
        beyond = tip + 5.0 * (flat @ axis) / max(float(np.linalg.norm(flat @ axis)), 1e-9)
        if card.arrow is None or np.linalg.norm(card.arrow - axis) > 0.3:
            style: dict[str, Any] = {"color": INK if root else MUTED, "fontweight": "bold" if root else "normal"}
            axes.text(
                float(beyond[0]),
                float(beyond[1]),
                f"{k + 1}",
                fontsize=7.0 if root else 6.0,
                ha="center",
                va="center",
                **style,
            )
    if card.arrow is not None:
        colour = SPIN if card.kind == "rotor" else AXIS
        _arrow(axes, centre, centre + 1.22 * length * flat @ card.arrow, colour, 2.0)


def _arrow(axes: Axes, tail: FloatArray, tip: FloatArray, colour: str, width: float) -> None:
    along = tip - tail
    size = float(np.linalg.norm(along))
    along = along / size if size > 1e-9 else np.array([1.0, 0.0])
    head = min(2.2 + 2.0 * width, 0.8 * size + 1.0)
    back = tip - head * along
    across = 0.42 * head * np.array([-along[1], along[0]])
    axes.plot(*np.array([tail, back]).T, color=colour, linewidth=width, solid_capstyle="butt", zorder=3)
    head_shape = np.array([tip, back + across, back - across])
    axes.add_patch(Polygon(head_shape, closed=True, facecolor=colour, linewidth=0, zorder=3))


def draw_sign(axes: Axes, kind: str, x: float, y: float) -> None:
    """Draw the sign of what acts or measures."""
    style: dict[str, Any] = {"edgecolor": ACTS, "facecolor": ACTS if kind == "torquer" else "none", "linewidth": 1.3}
    if kind in ("pickoff", "unbalance"):
        axes.add_patch(Circle((x, y), 4.0, **style | {"edgecolor": MUTED if kind == "unbalance" else ACTS}))
        if kind == "unbalance":
            axes.add_patch(Circle((x + 1.6, y), 1.4, facecolor=MUTED, linewidth=0))
        return
    if kind in ("stop", "friction"):
        style["edgecolor"] = MUTED
    axes.add_patch(PathPatch(_path(_SIGNS[kind], x, y), **style))


def _path(text: str, x: float, y: float) -> Path:
    """Return a path of straight lines, in SVG's letters M, L, H, V and Z, about a point."""
    points: list[tuple[float, float]] = []
    codes: list[Any] = []
    for letter, values in re.findall(r"([MLHVZ])([^MLHVZ]*)", text):
        v = [float(number) for number in re.findall(r"-?\d*\.?\d+", values)]
        if letter == "H":
            v = [v[0], points[-1][1]]
        elif letter == "V":
            v = [points[-1][0], v[0]]
        elif letter == "Z":
            v = [*points[0]]
        points += zip(v[::2], v[1::2], strict=True)
        first = {"M": Path.MOVETO, "Z": Path.CLOSEPOLY}.get(letter, Path.LINETO)
        codes += [first, *[Path.LINETO] * (len(v) // 2 - 1)]
    return Path(np.array([x, y]) + 0.9 * np.array(points), codes)


def fitted(text: str, size: float, room: float) -> str:
    """Return the beginning of a text that fits, with an ellipsis where something is left out."""
    if text_width(text, size) <= room + 4.0:
        return text
    while text and text_width(text + "…", size) > room + 4.0:
        text = text[:-1]
    return text.rstrip() + "…"


_BESIDE, _BELOW = 14.0, 24.0  # between cards
_MARGIN, _HEAD, _ENTRY = 10.0, 30.0, 15.0
_LEAST_WIDTH = 420.0
_CONTROLS = {
    "regulated": "rotor, constant relative spin",
    "free": "rotor, free-running",
    "servo": "rotor, with a speed loop",
}


class _Node(NamedTuple):
    card: Card
    carries: list[_Node]

    @property
    def width(self) -> float:
        """Of the card, or of all that it carries."""
        below = sum(node.width for node in self.carries) + _BESIDE * max(len(self.carries) - 1, 0)
        return max(self.card.width, below)

    @property
    def depth(self) -> int:
        return 1 + max((node.depth for node in self.carries), default=0)


@standalone
@check_arguments
def gimbal_tree(platform: Platform) -> Figure:
    """Schematic of the bodies of a platform: what turns in what, about which axis, and what acts and measures there.

    A card for each body, the root at the top. The orange arrow is a gimbal's axis and the sense of its positive angle,
    the blue arrow a rotor's spin with the direction of L, both among the axes 1, 2, 3 of the root at zero angles, seen
    from the same direction as in the picture of the axes. Signs mark torquers, pick-offs, rate sensors, stops
    and whatever else the plant file puts there; those that occur are explained below.

    Parameters
    ----------
    platform
        From `read_platform`.

    Returns
    -------
    matplotlib.figure.Figure
        One picture.

    Raises
    ------
    ArgumentError
        It is no platform.
    """
    root = _Node(root_card(platform), _carried(platform, platform.root_name, 1))
    rows = camera(platform)
    entries = _entries(platform, root)
    longest = max((text_width(text, 7.5) for _, _, text in entries), default=0.0) + 44.0
    width = max(root.width, _LEAST_WIDTH, text_width(drawable(platform.name), 10.0)) + 2.0 * _MARGIN
    columns = max(1, int((width - 2.0 * _MARGIN) // longest))
    body = root.depth * HEIGHT + (root.depth - 1) * _BELOW
    height = _HEAD + body + 16.0 + _ENTRY * -(-len(entries) // columns) + _MARGIN
    figure = Figure(figsize=(width / 72.0, height / 72.0))
    FigureCanvasSVG(figure)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_xlim(0.0, width)
    axes.set_ylim(height, 0.0)
    axes.set_axis_off()
    axes.text(_MARGIN, 15.0, drawable(platform.name), fontsize=10.0, fontweight="bold", color=INK, va="center")
    _drawn(axes, root, 0.5 * (width - root.width), _HEAD, rows)
    top = _HEAD + body + 16.0 + 0.5 * _ENTRY
    for k, (kind, extra, text) in enumerate(entries):
        x = _MARGIN + longest * (k % columns)
        y = top + _ENTRY * (k // columns)
        _entry(axes, kind, extra, x, y)
        axes.text(x + 32.0, y, text, fontsize=7.5, color=MUTED, va="center")
    return figure


def _carried(platform: Platform, name: str, level: int) -> list[_Node]:
    gimbals = [
        _Node(gimbal_card(platform, gimbal, level), _carried(platform, gimbal.name, level + 1))
        for gimbal in platform.gimbals
        if gimbal.parent == name
    ]
    return gimbals + [_Node(rotor_card(rotor), []) for rotor in platform.rotors if rotor.carrier == name]


def _drawn(axes: Axes, node: _Node, left: float, top: float, rows: FloatArray) -> float:
    """Draw a body over all that it carries, within its width; return the middle of its card."""
    whole = sum(child.width for child in node.carries) + _BESIDE * max(len(node.carries) - 1, 0)
    at = left + 0.5 * (node.width - whole)
    middles = []
    for child in node.carries:
        middles.append(_drawn(axes, child, at, top + HEIGHT + _BELOW, rows))
        at += child.width + _BESIDE
    middle = 0.5 * (middles[0] + middles[-1]) if middles else left + 0.5 * node.width
    start = float(np.clip(middle - 0.5 * node.card.width, left, left + node.width - node.card.width))
    middle = start + 0.5 * node.card.width
    draw_card(axes, node.card, start, top, rows)
    fork = top + HEIGHT + 0.45 * _BELOW
    for child, below in zip(node.carries, middles, strict=True):
        rotor = child.card.kind == "rotor"
        x = [middle, middle, below, below]
        y = [top + HEIGHT, fork, fork, top + HEIGHT + _BELOW]
        style: dict[str, Any] = {"color": SPIN if rotor else MUTED, "linewidth": 1.2}
        axes.plot(x, y, linestyle=child.card.dashes, zorder=0.9 if rotor else 1.0, **style)
    return middle


def _entries(platform: Platform, root: _Node) -> list[tuple[str, str, str]]:
    """Return what has to be explained: kind, what sort of it, words."""
    out = []
    if platform.gimbals:
        out.append(("axis", "", "axis, positive angle"))
    if platform.rotors:
        out.append(("spin", "", "spin axis, direction of L"))
    controls = {rotor.control for rotor in platform.rotors}
    out += [("rotor", control, words) for control, words in _CONTROLS.items() if control in controls]
    there = _kinds(root)
    return out + [("sign", kind, words) for kind, words in WORDS.items() if kind in there]


def _kinds(node: _Node) -> set[str]:
    return {kind for kind, _ in node.card.signs}.union(*(_kinds(child) for child in node.carries))


def _entry(axes: Axes, kind: str, extra: str, x: float, y: float) -> None:
    if kind == "sign":
        draw_sign(axes, extra, x + 14.0, y)
    elif kind == "rotor":
        outline = FancyBboxPatch(
            (x + 4.0, y - 5.0), 22.0, 10.0, boxstyle="round,pad=0,rounding_size=4", facecolor="none", edgecolor=SPIN
        )
        outline.set_linestyle(CONTROL[extra])
        axes.add_patch(outline)
    else:
        arrow = {"arrowstyle": "-|>", "color": AXIS if kind == "axis" else SPIN, "linewidth": 2.0, "mutation_scale": 9}
        axes.annotate("", (x + 28.0, y), (x + 2.0, y), arrowprops=arrow)
