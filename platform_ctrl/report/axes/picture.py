"""A picture of a platform's axes, from its description alone: the bodies in perspective, and the structure scheme."""

from __future__ import annotations

import numpy as np

from platform_ctrl.common.text import greek
from platform_ctrl.common.values import FloatArray
from platform_ctrl.plant.platform import Platform
from platform_ctrl.report.axes.bodies import camera, signs, spin_direction
from platform_ctrl.report.axes.svg import (
    SIGNS,
    arrow_head,
    direction_text,
    line,
    number,
    plain_text,
    sign,
    structure_scheme,
    words,
)
from platform_ctrl.report.axes.view import axes_view, triad
from platform_ctrl.report.quantities import count, listed

WIDTH = 1000.0
_MARGIN, _HEAD, _FOOT = 24.0, 58.0, 124.0
_BESIDE, _ABOVE, _LEAST_WIDTH = 500.0, 640.0, 430.0  # the view's height beside or above the scheme, its width

# The page's own variables and colours; a picture that stands alone sets them itself.
LIGHT = {
    "page": "#ffffff",
    "ink": "#1b2430",
    "muted": "#5c6675",
    "frame": "#b9c0ca",
    "band": "#dfe7f1",
    "reference": "#8a93a0",
    "series-1": "#0072b2",
    "series-2": "#d55e00",
    "series-3": "#009e73",
    "series-4": "#cc79a7",
    "series-7": "#7a7a00",
    "series-8": "#6a5acd",
}
DARK = {
    "page": "#14181e",
    "ink": "#e6e9ee",
    "muted": "#a0a9b6",
    "frame": "#4a5361",
    "band": "#222c3a",
    "reference": "#7d8795",
    "series-1": "#4aa8e6",
    "series-2": "#f58a3c",
    "series-3": "#2fc799",
    "series-4": "#e8a0c6",
    "series-7": "#c9c94a",
    "series-8": "#a79bf0",
}

_RULES = """
.axes-picture text{font:15px system-ui,-apple-system,"Segoe UI","Helvetica Neue",Arial,sans-serif;fill:var(--ink)}
.axes-picture path,.axes-picture line{fill:none;stroke-linecap:round;stroke-linejoin:round}
.axes-picture .paper{fill:var(--page)}
.axes-picture .title{font-size:18px;font-weight:600}
.axes-picture .muted,.axes-picture .edge-axis{fill:var(--muted)}
.axes-picture .small{font-size:13px}
.axes-picture .strong,.axes-picture .angle,.axes-picture .rotor-name{font-weight:600}
.axes-picture .angle,.axes-picture .edge-angle{fill:var(--series-2);font-weight:600}
.axes-picture .rotor-name{fill:var(--series-1)}
.axes-picture .node-name,.axes-picture .edge-axis,.axes-picture .edge-angle{font-size:14px}
.axes-picture .haloed{paint-order:stroke;stroke:var(--page);stroke-width:4px;stroke-linejoin:round}
.axes-picture .halo{stroke:var(--page);stroke-width:8px;stroke-linecap:butt}
.axes-picture .bar{stroke-width:4px}
.axes-picture .pin{stroke-width:2.4px}
.axes-picture .plate{fill:var(--band);stroke-width:3px}
.axes-picture .level-1{stroke:var(--ink)}
.axes-picture .level-2{stroke:var(--series-8)}
.axes-picture .level-3{stroke:var(--series-7)}
.axes-picture .level-4{stroke:var(--series-4)}
.axes-picture .level-5{stroke:var(--reference)}
.axes-picture .mount{stroke:var(--muted);stroke-width:2.4px}
.axes-picture .hatch,.axes-picture .leader{stroke:var(--muted);stroke-width:1.1px}
.axes-picture .bearing{fill:var(--page);stroke:var(--ink);stroke-width:1.6px}
.axes-picture .axis,.axes-picture .turn{stroke:var(--series-2);stroke-width:2.4px}
.axes-picture .spin,.axes-picture .shaft{stroke:var(--series-1);stroke-width:3px}
.axes-picture .shaft{stroke-width:2.2px}
.axes-picture .axis-head,.axes-picture .turn-head{fill:var(--series-2)}
.axes-picture .spin-head{fill:var(--series-1)}
.axes-picture .disc,.axes-picture .node.rotor{fill:var(--band);stroke:var(--series-1);stroke-width:2px}
.axes-picture .disc-side{fill:var(--band)}
.axes-picture .triad{stroke:var(--ink);stroke-width:2px}
.axes-picture .triad-head{fill:var(--ink)}
.axes-picture .torquer{fill:var(--series-3);stroke:var(--page);stroke-width:1px}
.axes-picture .pickoff,.axes-picture .erection{fill:var(--page);stroke:var(--series-3);stroke-width:2px}
.axes-picture .spring,.axes-picture .cage{stroke:var(--series-3);stroke-width:2px}
.axes-picture .edge{stroke:var(--muted);stroke-width:1.8px}
.axes-picture .edge.regulated,.axes-picture .edge.free,.axes-picture .edge.servo{stroke:var(--series-1)}
.axes-picture .free{stroke-dasharray:6 4}
.axes-picture .servo{stroke-dasharray:9 3 1.5 3}
.axes-picture .node.root{fill:var(--ink);stroke:var(--ink)}
.axes-picture .node.gimbal{fill:var(--page);stroke-width:2.2px}
.axes-picture .root-node{fill:var(--page);font-weight:600}
.axes-picture .rule{stroke:var(--frame);stroke-width:1px}
""".strip()


def axes_picture(platform: Platform, alone: bool = True) -> str:
    """Return a picture of the axes of `platform` as the text of an SVG file, or as an element of the report's page.

    On the left the bodies: gimbals as frames on their bearings with the positive direction and turn of their angle,
    rotors as discs with the direction of L, the root as hatched mounts and as axes 1, 2, 3. In the model all axes go
    through one point; the drawing moves bodies apart and keeps every direction. On the right the tree of the bodies,
    each joint with its axis in the parent's axes and its angle. Where the tree is too wide it stands below.

    The same platform gives the same text. Colours are those of the report's page, light or dark as the reader's
    screen; nothing is loaded from elsewhere.

    Parameters
    ----------
    platform
        What is drawn.
    alone
        Whether the text is a file of its own, with its own colours; otherwise it takes those of the page around it.
    """
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
    dark = f"@media (prefers-color-scheme:dark){{svg:root{{{_variables(DARK)}}}}}\n"
    colours = f"svg:root{{{_variables(LIGHT)}}}\n{dark}" if alone else ""
    space = 'xmlns="http://www.w3.org/2000/svg" ' if alone else ""
    pieces = [
        f'<svg {space}class="axes-picture" viewBox="0 0 {size}" role="img">',
        f"<title>{plain_text(f'Axes of {platform.name}')}</title>",
        f"<desc>{plain_text(description(platform))}</desc>",
        f"<style>\n{colours}{_RULES}</style>",
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
    return " ".join(sentences)


def _variables(colours: dict[str, str]) -> str:
    return "".join(f"--{name}:{colour};" for name, colour in colours.items())


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
    words_for = {"regulated": "rotor, relative spin held", "free": "rotor, free-running", "servo": "rotor, speed loop"}
    for control, text in words_for.items():
        if control in controls:
            entries.append((f'<rect class="node rotor {control}" x="2" y="-8" width="30" height="16" rx="8"/>', text))
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
