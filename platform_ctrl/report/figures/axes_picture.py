"""A picture of a platform's axes, from its description alone: the bodies in perspective, and the structure scheme."""

from __future__ import annotations

import re
from importlib import resources
from typing import NamedTuple

import numpy as np

from platform_ctrl.common.arguments import instance
from platform_ctrl.common.palette import PALETTE, Theme
from platform_ctrl.common.text import greek, text_width
from platform_ctrl.common.values import FloatArray
from platform_ctrl.job.quantities import count, listed
from platform_ctrl.plant.drawing import camera, signs, spin_direction
from platform_ctrl.plant.gimbals import Gimbal
from platform_ctrl.plant.platform import Platform, Rotor
from platform_ctrl.report.figures.axes_view import (
    SIGNS,
    Sketch,
    arrow_head,
    attribute,
    axes_view,
    direction_text,
    level_class,
    line,
    number,
    plain_text,
    sign,
    triad,
    words,
)

WIDTH = 1000.0
_MARGIN, _HEAD, _FOOT = 24.0, 58.0, 124.0
_BESIDE, _ABOVE, _LEAST_WIDTH = 500.0, 640.0, 430.0  # the view's height beside or above the scheme, its width

_TEMPLATES = resources.files("platform_ctrl.report") / "templates"


def axes_picture(platform: Platform, alone: bool = True) -> str:
    """Return a picture of the axes of `platform`: the text of an SVG file, or with `alone` false an element of a page.

    On the left the bodies: gimbals as frames on their bearings with the positive direction and turn of their angle,
    rotors as discs with the direction of L, the root as hatched mounts and as axes 1, 2, 3. In the model all axes go
    through one point; the drawing moves bodies apart and keeps every direction. On the right, or below if it is wide,
    the tree of the bodies: each joint with its axis in the parent's axes and its angle.

    The same platform gives the same text; nothing is loaded from elsewhere. Colours are those of the report's page.

    Parameters
    ----------
    platform
        From `read_platform`.
    alone
        Whether the text is a file of its own.

    Returns
    -------
    str
        SVG.
    """
    instance("platform", platform, Platform)
    scheme = structure_scheme(platform)
    beside = WIDTH - 3.0 * _MARGIN - scheme.width >= _LEAST_WIDTH
    width = max(WIDTH, scheme.width + 2.0 * _MARGIN)
    view_width = width - 2.0 * _MARGIN - ((scheme.width + _MARGIN) if beside else 0.0)
    rows = camera(platform)
    view = axes_view(platform, rows, view_width, max(_BESIDE, scheme.height) if beside else _ABOVE)
    if beside:
        high = max(view.height, scheme.height)
        top, bottom = _HEAD + 0.5 * (high - view.height), _HEAD + high + _MARGIN
        at = WIDTH - _MARGIN - scheme.width, _HEAD + 0.5 * (high - scheme.height)
    else:
        top, bottom = _HEAD, _HEAD + view.height + scheme.height + 2.0 * _MARGIN
        at = 0.5 * (width - scheme.width), _HEAD + view.height + _MARGIN
    height = bottom + _FOOT
    size = f"{number(width)} {number(height)}"
    rules = _TEMPLATES.joinpath("axes.css").read_text(encoding="utf-8").strip()
    dark = f"@media (prefers-color-scheme:dark){{svg:root{{{_variables('dark', rules)}}}}}\n"
    colours = f"svg:root{{{_variables('light', rules)}}}\n{dark}" if alone else ""
    space = 'xmlns="http://www.w3.org/2000/svg" ' if alone else ""
    pieces = [
        f'<svg {space}class="axes-picture" viewBox="0 0 {size}" role="img">',
        f"<title>{plain_text(f'Axes of {platform.name}')}</title>",
        f"<desc>{plain_text(description(platform))}</desc>",
        f"<style>\n{colours}{rules}</style>",
        f'<rect class="paper" width="{number(width)}" height="{number(height)}" rx="6"/>',
        words(platform.name, (_MARGIN, 34.0), "title"),
        f'<g class="view" transform="translate({number(_MARGIN)} {number(top)})">\n{view.svg}\n</g>',
        f'<g class="scheme" transform="translate({number(at[0])} {number(at[1])})">\n{scheme.svg}\n</g>',
        _foot(platform, rows, bottom, width),
        "</svg>\n",
    ]
    return "\n".join(pieces)


def description(platform: Platform) -> str:
    """Return in words what the picture shows."""
    sentences = [f"{platform.name}: {count(len(platform.gimbals), 'gimbal')}, {count(len(platform.rotors), 'rotor')}."]
    for g in platform.gimbals:
        sentences.append(f"Gimbal {g.name} turns in {g.parent} about {direction_text(g.axis)} by {greek(g.angle)}.")
    for r in platform.rotors:
        sentences.append(
            f"Rotor {r.name} ({r.control}) spins in {r.carrier}, L along {direction_text(spin_direction(r))}."
        )
    torqued = [f"{t.gimbal or f'root axis {t.root_axis}'}" for t in platform.torquers]
    if torqued:
        sentences.append(f"Torquers on {listed(torqued)}.")
    if platform.pickoffs:
        sentences.append(f"Pick-offs on {listed([s.gimbal for s in platform.pickoffs])}.")
    if platform.line_of_sight is not None:
        sight = platform.line_of_sight
        sentences.append(f"The line of sight is fixed in {sight.body}, along {direction_text(sight.direction)}.")
    return " ".join(sentences)


def _variables(theme: Theme, rules: str) -> str:
    colours = PALETTE[theme]
    used = sorted(set(re.findall(r"var\(--([\w-]+)\)", rules)), key=list(colours).index)
    return "".join(f"--{name}:{colours[name]};" for name in used)


def _foot(platform: Platform, rows: FloatArray, top: float, width: float) -> str:
    """Return the root's axes and what the signs mean, only those that occur."""
    at = np.array([_MARGIN + 62.0, top + 66.0])
    pieces = [
        line(np.array([[_MARGIN, top + 8.0], [width - _MARGIN, top + 8.0]]), "rule"),
        triad(platform, rows, at, 46.0),
    ]
    entries: list[tuple[str, str]] = []

    def arrow(kind: str) -> str:
        return line(np.array([[0.0, 0.0], [26.0, 0.0]]), kind) + arrow_head(
            np.zeros(2), np.array([34.0, 0.0]), f"{kind}-head"
        )

    if platform.gimbals:
        entries.append((arrow("axis"), "axis and turn of a positive angle"))
    if platform.rotors:
        entries.append((arrow("spin"), "spin axis, direction of L"))
    controls = [r.control for r in platform.rotors]
    for control, text in (("regulated", "constant relative spin"), ("free", "free-running"), ("servo", "speed loop")):
        if control in controls:
            node = f'<rect class="node rotor {control}" x="2" y="-8" width="30" height="16" rx="8"/>'
            entries.append((node, f"rotor, {text}"))
    there = {kind for g in platform.gimbals for kind in signs(platform, g.name)}
    there |= {"torquer"} if platform.torquers else set()
    entries += [(sign(kind, (17.0, 0.0)), text) for kind, (_, text) in SIGNS.items() if kind in there]
    left, row = _MARGIN + 180.0, top + 36.0
    for k, (drawing, text) in enumerate(entries):
        x, y = left + 275.0 * (k % 3), row + 25.0 * (k // 3)
        pieces.append(f'<g transform="translate({number(x)} {number(y)})">{drawing}</g>')
        pieces.append(words(text, (x + 44.0, y + 5.0), "small"))
    note = f"1, 2, 3: axes of {platform.root_name}; hatched: mounted on it"
    if platform.gimbals or platform.rotors:
        note += "; drawn apart, in the model all axes go through one point"
    pieces.append(words(note, (left, top + _FOOT - 18.0), "muted small"))
    return "\n".join(pieces)


_NODE_FONT = 14.0
_BOLD = 1.12  # width of bold letters over that of others: angles are bold
_PITCH, _TIGHT = 42.0, 34.0  # from leaf to leaf; where there are many
_BOX = 25.0  # height of a node
_STUB = 15.0  # from a node to where its edges part


class _Node(NamedTuple):
    name: str
    kind: str  # root, gimbal, rotor
    edge: tuple[str, str]  # axis, angle
    line: str  # CSS class of the edge
    signs: tuple[str, ...]
    carries: list[_Node]


def structure_scheme(platform: Platform) -> Sketch:
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
    return Sketch("\n".join(out), ends[-1], pitch * leaves)


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
    return max(_BOX, text_width(name, _NODE_FONT) + 16.0)


def _edge_width(node: _Node) -> float:
    axis, angle = node.edge
    text = text_width(axis, _NODE_FONT) + (_BOLD * text_width(angle, _NODE_FONT) + 7.0 if angle else 0.0)
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
            out.append(words(angle, (trunk + 14.0 + text_width(axis, _NODE_FONT), middle - 8.0), "edge-angle"))
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
