"""What the legends of a figure show, held against what is drawn in it."""

from __future__ import annotations

from typing import Any

from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.lines import Line2D


def _look(line: Any) -> tuple[Any, ...]:
    """Return colour, dashes relative to the width, and marker of a line."""
    _, dashes = line._dash_pattern  # no public way to the dashes of a line
    drawn = line.get_linestyle() not in ("None", "none", "", " ")
    pattern = tuple(round(one / line.get_linewidth(), 3) for one in dashes or ()) if drawn else None
    marker = line.get_marker()
    return to_hex(line.get_color()), pattern, None if marker in (None, "None", "none", "", " ") else marker


def without_a_curve(figure: Figure) -> list[str]:
    """Return the legend entries with a line, marker or patch that nothing in the figure is drawn like."""
    lines = [line for axes in figure.axes for line in axes.lines if len(line.get_xdata())]
    looks = {_look(line) for line in lines}
    # A line with a marker may stand for a curve and for marks on it.
    looks |= {(colour, pattern, None) for colour, pattern, _ in looks}
    marks = {(colour, marker) for colour, _, marker in looks}
    faces = {to_hex(one.get_facecolor(), keep_alpha=True) for axes in figure.axes for one in axes.patches}
    faces |= {to_hex(f, keep_alpha=True) for axes in figure.axes for c in axes.collections for f in c.get_facecolor()}
    out = []
    for legend in [*figure.legends, *(axes.get_legend() for axes in figure.axes if axes.get_legend())]:
        for handle in legend.findobj(Line2D):
            colour, pattern, marker = _look(handle)
            both = (colour, pattern, marker) in looks
            apart = marker is not None and (colour, pattern, None) in looks and (colour, marker) in marks
            if not (both or apart or (pattern is None and (colour, marker) in marks)):
                out.append(f"{figure.get_label()} {colour} {pattern} {marker}")
        for patch in legend.get_patches():
            if to_hex(patch.get_facecolor(), keep_alpha=True) not in faces:
                out.append(f"patch {to_hex(patch.get_facecolor())}")
    return out
