"""The painter of curves over frequency, and what other plots share: labels where there is room, legends."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from platform_ctrl.analysis.curves import Curves, Level
from platform_ctrl.analysis.system import ComplexArray
from platform_ctrl.common.text import text_width
from platform_ctrl.common.values import FloatArray
from platform_ctrl.job.quantities import plain
from platform_ctrl.report import style as styles

if TYPE_CHECKING:
    import control

# Series that differ by their dashes alone; more have markers.
_DIFFERENT = 6
# More panels than this in a row are drawn in two.
_ONE_ROW = 4
_FORMS: dict[str, dict[str, Any]] = {
    "line": {"linewidth": 1.2},
    "strong": {"linewidth": 2.1, "zorder": 3},
    "thin": {"linewidth": 0.8},
    "mark": {"linestyle": "none", "markersize": 5, "zorder": 4},
}
_LABEL: dict[str, Any] = {"textcoords": "offset points", "fontsize": 7}


def curve_style(k: int) -> dict[str, Any]:
    """Return the look of the k-th curve: no two of the first 24 alike, also in grey."""
    style: dict[str, Any] = {"color": styles.SERIES[k % len(styles.SERIES)], "linestyle": styles.DASHES[k % _DIFFERENT]}
    if k >= _DIFFERENT:
        style |= {"marker": styles.MARKERS[k % len(styles.MARKERS)], "markersize": 3.8}
    return style


def paint(rows: Sequence[Sequence[Curves]], height: float) -> Figure:
    """Draw panels of so many inches in rows, with a legend of all names above."""
    if len(rows) == 1 and len(rows[0]) > _ONE_ROW:
        half = -(-len(rows[0]) // 2)
        rows = [rows[0][:half], rows[0][half:]]
    names = list(dict.fromkeys(one.name for row in rows for panel in row for one in panel.curves if one.name))
    figure, grid = styles.panels(len(rows), max(map(len, rows)), height, names)
    handles: dict[str, Line2D] = {}
    for k, row in enumerate(rows):
        for place, axes in enumerate(grid[k]):
            if place >= len(row):
                axes.remove()
                continue
            lowest = k + 1 == len(rows) or place >= len(rows[k + 1])
            lines = _paint(axes, row[place], label=lowest)
            for one, line in zip(row[place].curves, lines, strict=True):
                handles.setdefault(one.name, line)
    styles.legend(figure, [handles[name] for name in names], names)
    return figure


def _paint(axes: Axes, panel: Curves, *, label: bool) -> list[Line2D]:
    lines: list[Line2D] = []
    for one in panel.curves:
        k = one.series or 0
        dashes = styles.DASHES[(k if one.dashes is None else one.dashes) % len(styles.DASHES)]
        look = {
            "color": styles.REFERENCE if one.series is None else styles.SERIES[k % len(styles.SERIES)],
            "linestyle": dashes,
        }
        look |= {"marker": styles.MARKERS[k % len(styles.MARKERS)]} if one.form == "mark" else {}
        lines += axes.plot(one.x, one.y, **look | _FORMS[one.form])
    f, values = panel.curves[0].x, [one.y for one in panel.curves if one.form in ("line", "strong")]
    styles.frequency_axes(axes, f[0], f[-1], log_gain=panel.kind == "gain", label=label)
    if panel.kind == "phase":
        phase_panel(axes, values)
    else:
        styles.gain_limits(axes, values, panel.low, panel.high)
    for level, words in panel.references.items():
        axes.axhline(level, color=styles.REFERENCE, linewidth=0.8)
        axes.annotate(words, (f[-1], level), (-3, -2), color=styles.MUTED, ha="right", va="top", **_LABEL)
    if panel.required is not None:
        axes.axvspan(f[0], panel.required, color=styles.BAND, linewidth=0, zorder=0)
    if panel.wished is not None:
        axes.axvline(panel.wished, color=styles.MUTED, linewidth=0.9, linestyle=styles.DASH_DOTTED)
        at = (panel.wished, axes.get_ylim()[0])
        axes.annotate(f"goal {panel.wished:g} Hz", at, (3, 3), color=styles.MUTED, va="bottom", **_LABEL)
    for limit in panel.levels:
        _paint_level(axes, limit)
    axes.set_title(panel.title)
    axes.set_ylabel(panel.quantity)
    return lines


def _paint_level(axes: Axes, one: Level) -> None:
    """Draw a limit or a goal; above the limit of a part of the frequencies what is forbidden is shaded."""
    (left, right), top = axes.get_xlim(), axes.get_ylim()[1]
    colour, dashes = (styles.LIMIT, styles.DASHED) if one.hard else (styles.MUTED, styles.DASH_DOTTED)
    start, end = max(left, one.start or left), min(right, one.end or right)
    banded = one.end is not None
    if banded and one.hard and (start, end) != (left, right) and one.y < top:
        axes.fill_between([start, end], one.y, top, color=styles.BEYOND, linewidth=0, zorder=0.5)
    axes.plot([start, end], [one.y, one.y], color=colour, linewidth=0.9, linestyle=dashes)
    # A limit's number is above its left end, a goal's below its right one.
    at_left = one.hard or banded
    look: dict[str, Any] = {"ha": "left" if at_left else "right", "va": "bottom" if one.hard else "top"}
    text, place = one.text if one.hard else f"goal {one.text}", start if at_left else end
    shift = (3 if at_left else -3, 2 if one.hard else -2)
    axes.annotate(text, (place, one.y), shift, color=colour, **look, **_LABEL)


def phase_panel(axes: Axes, phases: Sequence[FloatArray]) -> None:
    """Give a panel its phase axis in right angles, with lines at the odd multiples of 180°."""
    known = np.concatenate([np.zeros(0), *(phase[np.isfinite(phase)] for phase in phases)])
    known = known if known.size else np.zeros(1)
    low, high = float(known.min()), float(known.max())
    if low < 0.0:
        low, high = min(low, -180.0), max(high, -180.0)
    step = next((step for step in (45.0, 90.0, 180.0, 360.0) if high - low <= 5.0 * step), None)
    step = step or 360.0 * math.ceil((high - low) / 2160.0)
    low, high = step * math.floor((low - 4.0) / step), step * math.ceil((high + 4.0) / step)
    axes.set_ylim(low, high)
    axes.set_yticks(np.arange(low, high + 1.0, step))
    odd = 360.0 * np.arange(math.ceil((low + 180.0) / 360.0), math.floor((high + 180.0) / 360.0) + 1) - 180.0
    for level in odd[:: max(1, len(odd) // 4)]:
        axes.axhline(level, color=styles.REFERENCE, linewidth=0.9, zorder=1)


def control_plot(
    axes: NDArray[Any], lines: Sequence[Any], handles: Sequence[Any], names: Sequence[str]
) -> control.ControlPlot:
    """Return a plot with one panel, its lines, and a legend."""
    import control

    listed = np.empty((1, 1), dtype=object)
    listed[0, 0] = list(lines)
    figure = axes[0, 0].figure
    return control.ControlPlot(listed, axes, figure, legend=styles.legend(figure, handles, names))


# Directions in degrees, the best first, and distances in points at which labels are tried.
_DIRECTIONS = (20, -20, 160, -160, 90, -90, 55, -55, 125, -125)
_DISTANCES = (4.5, 9.0, 14.0)
_LINE = 1.25  # height of a line over its font size
_APART = 2.0  # between words, points
_DOTS = 26.0  # between dots at frequencies, points


class LabelPlacer:
    """Places labels in one panel whose limits are set, off `curves`: lines, or points (k, 2) in data coordinates."""

    def __init__(self, axes: Axes, curves: Sequence[FloatArray | Line2D] = ()) -> None:
        axes.apply_aspect()
        self.axes = axes
        self._unit = 72.0 / axes.figure.dpi
        box = axes.get_window_extent()
        self._low, self._high = (np.array(corner) * self._unit for corner in (box.min, box.max))
        own = [np.asarray(curve.get_xydata()) if isinstance(curve, Line2D) else curve for curve in curves]
        ink = np.concatenate([np.zeros((0, 2)), *(_dense(self.points(curve)) for curve in own)])
        # The hidden length of a curve counts, not the number of its points.
        self._ink = np.unique(np.round(ink), axis=0)
        self._taken: list[tuple[FloatArray, FloatArray]] = []
        self._dots: list[FloatArray] = []

    def points(self, at: FloatArray) -> FloatArray:
        """Return data coordinates (k, 2) as points of the page, those that are not finite left out."""
        at = np.asarray(at, dtype=np.float64).reshape(-1, 2)
        placed = self.axes.transData.transform(at[np.isfinite(at).all(axis=1)]) * self._unit
        # Far outside nothing is written.
        reach = self._high - self._low
        return np.asarray(np.clip(placed, self._low - reach, self._high + reach))

    def shows(self, x: float, y: float) -> bool:
        """Whether a point lies within the panel."""
        at = self.points(np.array([[x, y]]))
        return bool(len(at) and np.all(at[0] >= self._low - 0.5) and np.all(at[0] <= self._high + 0.5))

    def length(self, curve: ComplexArray) -> float:
        """Return how long a curve in the upper half plane is within the panel, points."""
        at = self.points(np.column_stack([curve.real, np.where(curve.imag < 0.0, np.nan, curve.imag)]))
        inside = np.all((at > self._low - 1.0) & (at < self._high + 1.0), axis=1)
        steps = np.linalg.norm(np.diff(at, axis=0), axis=1)
        return float(steps[inside[1:] & inside[:-1]].sum())

    def reserve(self, x: float, y: float, radius: float = 3.5) -> None:
        """Keep labels off a marker."""
        for at in self.points(np.array([[x, y]])):
            self._taken.append((at - radius, at + radius))

    def write_frequencies(self, hz: FloatArray, curve: FloatArray, dot: str) -> None:
        """Put dots in the colour `dot` at round frequencies along a curve (N, 2), where there is room, and write them.

        `hz` are its ascending frequencies.
        """
        decades = 10.0 ** np.arange(np.floor(np.log10(max(hz[0], 1e-9))), np.ceil(np.log10(hz[-1])) + 1.0)
        for f in (number * decade for decade in decades for number in (1.0, 2.0, 5.0)):
            x, y = (float(np.interp(f, hz, column)) for column in curve.T)
            if not hz[0] <= f <= hz[-1] or not self.shows(x, y):
                continue
            at = self.points(np.array([[x, y]]))[0]
            if any(np.linalg.norm(at - other) < _DOTS for other in self._dots):
                continue
            self._dots.append(at)
            self.axes.plot([x], [y], "o", color=dot, markersize=3.0, zorder=4)
            self.write(f"{plain(f, 3)} Hz", x, y, colour=styles.MUTED, size=6.5)

    def write(
        self,
        text: str,
        x: float,
        y: float,
        *,
        colour: str = styles.INK,
        size: float = 7.0,
        bold: bool = False,
        required: bool = False,
        directions: Sequence[int] = _DIRECTIONS,
    ) -> bool:
        """Write `text` beside a point where there is room (`required`: in any case); return whether it is written."""
        if not self.shows(x, y):
            return False
        at = self.points(np.array([[x, y]]))[0]
        lines = text.split("\n")
        half = 0.5 * np.array([max(text_width(line, size) for line in lines), _LINE * size * len(lines)])
        taken = np.array(self._taken).reshape(-1, 2, 2)
        best: tuple[float, FloatArray] | None = None
        for distance in _DISTANCES:
            for rank, turn in enumerate(np.radians(directions)):
                direction = np.array([np.cos(turn), np.sin(turn)])
                # Above and below, labels are centred; beside, they begin or end at the point.
                middle = at + distance * direction + half * np.where(np.abs(direction) > 0.3, np.sign(direction), 0.0)
                low, high = middle - half, middle + half
                outside = float(np.maximum(0.0, np.maximum(self._low - low, high - self._high)).sum())
                apart = (low - _APART >= taken[:, 1]) | (taken[:, 0] >= high + _APART)
                hidden = int(np.count_nonzero(~apart.any(axis=1)))
                if (outside > 0.5 or hidden) and not required:
                    continue
                crossed = int(np.count_nonzero(np.all((self._ink > low - 1.0) & (self._ink < high + 1.0), axis=1)))
                cost = 0.6 * distance + 0.4 * rank + 1.5 * crossed + 40.0 * outside + 400.0 * hidden
                if best is None or cost < best[0]:
                    best = cost, middle
        if best is None:
            return False
        middle = best[1]
        self._taken.append((middle - half, middle + half))
        self.axes.annotate(
            text,
            (x, y),
            tuple(middle - at),
            textcoords="offset points",
            ha="center",
            va="center",
            color=colour,
            fontsize=size,
            fontweight="bold" if bold else "normal",
            annotation_clip=False,
            zorder=6,
        )
        return True


def _dense(points: FloatArray) -> FloatArray:
    """Return the points of a polyline with more between those that lie apart, page points."""
    if len(points) < 2:
        return points
    out = [points]
    gaps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    for k in np.flatnonzero((gaps > 3.0) & (gaps < 2000.0)):
        t = np.linspace(0.0, 1.0, int(gaps[k] / 3.0) + 2)[1:-1, None]
        out.append((1.0 - t) * points[k] + t * points[k + 1])
    return np.concatenate(out)
