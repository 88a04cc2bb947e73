"""The tree of a platform's gimbals, from the root down to the rotors, with the axis of each body in a cross of axes."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

from platform_ctrl.description import Platform
from platform_ctrl.frozen import FloatArray
from platform_ctrl.report.axes_bodies import camera
from platform_ctrl.report.plots.systems import drawable
from platform_ctrl.report.plots.tree_cards import (
    AXIS,
    CONTROL,
    HEIGHT,
    SPIN,
    WORDS,
    Card,
    draw_card,
    draw_sign,
    gimbal_card,
    root_card,
    rotor_card,
)
from platform_ctrl.report.style import INK, MUTED, standalone
from platform_ctrl.report.svg_pieces import text_width
from platform_ctrl.signatures import check_arguments

_BESIDE, _BELOW = 14.0, 24.0  # between cards
_MARGIN, _HEAD, _ENTRY = 10.0, 30.0, 15.0
_LEAST_WIDTH = 420.0
_CONTROLS = {
    "regulated": "rotor, relative spin held",
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
    from where the picture of the axes in space is seen from. Signs stand for torquers, pick-offs, rate sensors, stops
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

    References
    ----------
    See docs/plant-file.md.
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
