"""Pieces of a hand-made SVG: numbers, escaped text and how wide it is, lines, arrow heads. Coordinates are pixels."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple
from xml.sax.saxutils import escape, quoteattr

import numpy as np

from platform_ctrl.common.text import greek, text_width
from platform_ctrl.common.values import FloatArray
from platform_ctrl.plant.platform import Gimbal, Platform, Rotor
from platform_ctrl.report.axes.bodies import signs, spin_direction
from platform_ctrl.report.quantities import axis_text

# What XML 1.0 cannot hold, escaped or not.
_FORBIDDEN = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ud800-\udfff\ufffe\uffff]")


def plain_text(text: str) -> str:
    """Return `text` escaped for the inside of an element."""
    return escape(_FORBIDDEN.sub("\ufffd", text))


def attribute(text: str) -> str:
    """Return `text` as an attribute's value, quotes included."""
    return quoteattr(_FORBIDDEN.sub("\ufffd", text))


def number(x: float) -> str:
    """Return a coordinate to a tenth of a pixel, without a zero that says nothing."""
    text = f"{x:.1f}".removesuffix(".0")
    return "0" if text == "-0" else text


def path(points: FloatArray, *, closed: bool = False) -> str:
    """Return the path data of a polyline through `points`, (k, 2)."""
    return "M" + "L".join(f"{number(x)} {number(y)}" for x, y in points) + ("Z" if closed else "")


def line(points: FloatArray, kind: str, *, closed: bool = False) -> str:
    """Return a polyline of the CSS class `kind`."""
    return f'<path class="{kind}" d="{path(points, closed=closed)}"/>'


def arrow_head(tail: FloatArray, tip: FloatArray, kind: str, size: float = 10.0) -> str:
    """Return a filled arrow head at `tip`, seen from `tail`."""
    along = direction(tail, tip)
    across = 0.36 * size * np.array([-along[1], along[0]])
    back = tip - size * along
    return line(np.array([tip, back + across, back - across]), kind, closed=True)


def direction(tail: FloatArray, tip: FloatArray) -> FloatArray:
    """Return the unit vector from `tail` to `tip`; to the right where they coincide."""
    along = np.asarray(tip - tail, dtype=np.float64)
    length = float(np.hypot(*along))
    return along / length if length > 1e-9 else np.array([1.0, 0.0])


def words(text: str, at: Sequence[float], kind: str, anchor: str = "start") -> str:
    """Return `text` with its baseline starting (or ``middle``, ``end``) at a point."""
    place = "" if anchor == "start" else f' text-anchor="{anchor}"'
    return f'<text class="{kind}" x="{number(at[0])}" y="{number(at[1])}"{place}>{plain_text(text)}</text>'


def level_class(level: int) -> str:
    """Return the CSS class of a body that many joints away from the root."""
    return f"level-{1 + (level - 1) % 5}"


def circle(at: Sequence[float], radius: float, kind: str) -> str:
    """Return a circle."""
    return f'<circle class="{kind}" cx="{number(at[0])}" cy="{number(at[1])}" r="{number(radius)}"/>'


# What acts or measures at a joint, drawn about the origin, with what it is called.
SIGNS = {
    "torquer": ("M-4.5-4.5H4.5V4.5H-4.5Z", "torquer"),
    "pickoff": ("M-4.5 0A4.5 4.5 0 1 1 4.5 0A4.5 4.5 0 1 1-4.5 0Z", "pick-off"),
    "spring": ("M-6 0L-4-4.5L-1.5 4.5L1.5-4.5L4 4.5L6 0", "spring"),
    "cage": ("M-2-5.5H-5V5.5H-2M2-5.5H5V5.5H2", "cage"),
    "erection": ("M-5-4.5H5L0 5Z", "erection"),
}


def sign(kind: str, at: Sequence[float], size: float = 1.0) -> str:
    """Return one of `SIGNS` at a point."""
    scale = "" if size == 1.0 else f" scale({size:.2f})"
    place = f"translate({number(at[0])} {number(at[1])}){scale}"
    return f'<path class="{kind}" transform="{place}" d="{SIGNS[kind][0]}"/>'


FONT = 14.0
_PITCH, _TIGHT = 42.0, 34.0  # from leaf to leaf; where there are many
_BOX = 25.0  # height of a node
_STUB = 15.0  # from a node to where its edges part


class Scheme(NamedTuple):
    """The drawn scheme and its size, pixels."""

    svg: str
    width: float
    height: float


class _Node(NamedTuple):
    name: str
    kind: str  # root, gimbal, rotor
    edge: tuple[str, str]  # axis, angle
    line: str  # CSS class of the edge
    signs: tuple[str, ...]
    carries: list[_Node]


def structure_scheme(platform: Platform) -> Scheme:
    """Return the tree of `platform`, its upper left corner at the origin."""
    root = _Node(platform.root_name, "root", ("", ""), "", (), _carried(platform, platform.root_name))
    levels: list[list[_Node]] = [[root]]
    while levels[-1]:
        levels.append([child for node in levels[-1] for child in node.carries])
    starts, ends = [0.0], [_width(root.name)]
    for level in levels[1:-1]:
        starts.append(ends[-1] + _STUB + max(_edge_width(node) for node in level))
        ends.append(starts[-1] + max(_width(node.name) for node in level))
    out: list[str] = []
    leaves = sum(not node.carries for level in levels for node in level)
    pitch = _PITCH if leaves <= 10 else _TIGHT
    _drawn(root, 0, 0, starts, pitch, out)
    return Scheme("\n".join(out), ends[-1], pitch * leaves)


def direction_text(axis: FloatArray) -> str:
    """Return +1, −3 or the components of an axis, without the last digits of a rounded zero."""
    return axis_text(np.round(axis, 9) + 0.0)


def _carried(platform: Platform, name: str) -> list[_Node]:
    return [_gimbal_node(platform, g) for g in platform.gimbals if g.parent == name] + [
        _rotor_node(r) for r in platform.rotors if r.carrier == name
    ]


def _gimbal_node(platform: Platform, gimbal: Gimbal) -> _Node:
    edge = direction_text(gimbal.axis), greek(gimbal.angle)
    return _Node(gimbal.name, "gimbal", edge, "edge", signs(platform, gimbal.name), _carried(platform, gimbal.name))


def _rotor_node(rotor: Rotor) -> _Node:
    return _Node(rotor.name, "rotor", (direction_text(spin_direction(rotor)), ""), f"edge {rotor.control}", (), [])


def _width(name: str) -> float:
    return max(_BOX, text_width(name, FONT) + 16.0)


def _edge_width(node: _Node) -> float:
    axis, angle = node.edge
    text = text_width(axis, FONT) + (text_width(angle, FONT) + 6.0 if angle else 0.0)
    return max(text + 14.0, 15.0 * len(node.signs) + 10.0)


def _drawn(node: _Node, level: int, leaf: int, starts: list[float], pitch: float, out: list[str]) -> tuple[float, int]:
    """Draw a node and all that it carries from the given leaf row down; return its middle and the next free row."""
    middles, first = [], leaf
    for child in node.carries:
        middle, leaf = _drawn(child, level + 1, leaf, starts, pitch, out)
        middles.append(middle)
    if not middles:
        leaf = first + 1
        middles = [pitch * (first + 0.5)]
    y, x, width = 0.5 * (middles[0] + middles[-1]), starts[level], _width(node.name)
    trunk = (starts[level + 1] - max(_edge_width(child) for child in node.carries)) if node.carries else 0.0
    for child, middle in zip(node.carries, middles, strict=False):
        out.append(f'<g class="joint" data-body={attribute(child.name)}>')
        run = np.array([[x + width, y], [trunk, y], [trunk, middle], [starts[level + 1], middle]])
        out.append(line(run if abs(middle - y) > 0.05 else run[[0, 3]], child.line))
        axis, angle = child.edge
        out.append(words(axis, (trunk + 7.0, middle - 8.0), "edge-axis"))
        if angle:
            out.append(words(angle, (trunk + 14.0 + text_width(axis, FONT), middle - 8.0), "edge-angle"))
        for k, mark in enumerate(reversed(child.signs)):
            at = starts[level + 1] - 9.0 - 14.0 * k
            out.append(sign(mark, (at, middle)))
        out.append("</g>")
    radius = 0.5 * _BOX if node.kind == "rotor" else 3.0
    control = node.line.removeprefix("edge").strip()
    look = {"root": "root", "gimbal": f"gimbal {level_class(level)}", "rotor": f"rotor {control}"}[node.kind]
    out.append(
        f'<rect class="node {look}" x="{number(x)}" y="{number(y - 0.5 * _BOX)}"'
        f' width="{number(width)}" height="{number(_BOX)}" rx="{number(radius)}"/>'
    )
    out.append(words(node.name, (x + 0.5 * width, y + 5.0), f"node-name {node.kind}-node", "middle"))
    return y, leaf
