"""The structure scheme: root at the left, every joint an edge with its axis and angle, rotors as leaves."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from platform_ctrl.description import Gimbal, Platform, Rotor
from platform_ctrl.frozen import FloatArray
from platform_ctrl.greek import greek
from platform_ctrl.report.axes_bodies import signs, spin_direction
from platform_ctrl.report.svg_pieces import attribute, level_class, line, number, sign, text_width, words
from platform_ctrl.report.tables import axis_text

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
