"""Columns, units, axis ranges and empty figures of the plots."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from bokeh import models
from bokeh.plotting import figure
from numpy.typing import NDArray

from platform_ctrl.common.values import FloatArray

FONT = 'system-ui, -apple-system, "Segoe UI", "Helvetica Neue", "Noto Sans", "Liberation Sans", Arial, sans-serif'
SMALL, NORMAL = "11px", "12px"
# Height of the numbers and the label below a figure, pixels.
_BELOW = 28
_LEFT, _RIGHT, _TOP = 54, 12, 7


def assign(model: Any, **values: Any) -> None:
    """Set the properties of a model that differ: to Bokeh one that stays is as much work as one that changes."""
    for name, new in values.items():
        if getattr(model, name) != new:
            setattr(model, name, new)


def put(source: Any, columns: Mapping[str, Any]) -> None:
    """Set the columns of a source that have changed: each array that is sent costs two messages."""
    changed = {key: one for key, one in columns.items() if not _equal(source.data.get(key), one)}
    if changed:
        source.data.update(changed)


def _equal(one: Any, other: Any) -> bool:
    if one is other:
        return True
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        return np.array_equal(one, other, equal_nan=True)
    if isinstance(one, list):
        return len(one) == len(other) and all(map(_equal, one, other))
    return bool(one == other)


Column = NDArray[np.float32]

# Beyond this nothing is drawn; single precision ends at 3e38.
_LARGEST = 1e30


def column(numbers: Any, scale: float = 1.0) -> Column:
    """Return real numbers times `scale` in single precision; what is not finite or too large becomes a gap (NaN)."""
    with np.errstate(invalid="ignore", over="ignore"):
        out = np.multiply(numbers, scale, dtype=np.float64)
        fine = np.abs(out) <= _LARGEST
    return (out if fine.all() else np.where(fine, out, np.nan)).astype(np.float32)


def joined(rows: Iterable[FloatArray]) -> FloatArray:
    """Return arrays one after the other with a gap after each: many curves as one line."""
    gap = np.full(1, np.nan)
    return np.concatenate([np.zeros(0), *(part for one in rows for part in (one, gap))])


def finite(*columns: Column) -> tuple[Column, ...]:
    """Return columns of one length without the places where any of them has a gap."""
    keep = np.logical_and.reduce([np.isfinite(one) for one in columns])
    return tuple(one[keep] for one in columns)


def thinned(number: int, most: int) -> NDArray[np.intp]:
    """Return the indices of at most `most` of `number` points, evenly spaced, with both ends."""
    return np.unique(np.linspace(0, number - 1, min(number, most)).round().astype(np.intp))


def extent(columns: Sequence[Any]) -> tuple[float, float] | None:
    """Return the smallest and the largest number of some arrays that can be drawn; None if there is none."""
    numbers = np.concatenate([np.zeros(0), *(np.ravel(one) for one in columns)])
    with np.errstate(invalid="ignore"):
        numbers = numbers[np.abs(numbers) <= _LARGEST]
    return (float(numbers.min()), float(numbers.max())) if numbers.size else None


_PREFIXES = ((1e-3, "m"), (1e-6, "µ"), (1e-9, "n"))
_PREFIXED = frozenset({"rad", "rad/s", "N m", "s", "rad/(rad/s)"})


class Unit:
    """A unit with a prefix for readable numbers, which changes only when the numbers have become awkward.

    `name` is the unit as written, `scale` the factor on numbers in the plain unit.
    """

    def __init__(self) -> None:
        self._plain, self.name, self.scale = "", "", 1.0

    def follow(self, unit: str, size: float) -> None:
        """Choose the prefix for numbers in `unit` whose largest magnitude is `size`."""
        if unit == self._plain and (not 0.0 < size < math.inf or 0.2 <= size * self.scale < 2000.0):
            return
        self._plain = unit
        self.scale, self.name = 1.0, unit
        if unit in _PREFIXED and 0.0 < size < 0.5:
            scale, prefix = next((one for one in _PREFIXES if size >= 0.5 * one[0]), _PREFIXES[-1])
            self.scale, self.name = 1.0 / scale, f"{prefix}{unit}"


Bounds = Callable[[float, float], tuple[float, float]]

# The view shrinks when the data take less than this share of it.
_SHRINK = 0.42


def round_bounds(low: float, high: float) -> tuple[float, float]:
    """Return round bounds with a little margin around the data: steps of 1, 2, 2.5 or 5 times a power of ten."""
    span = high - low
    if not span > 1e-12 * max(abs(low), abs(high)):
        span = 2.0 * abs(high) if high else 2.0
        low, high = low - 0.5 * span, high + 0.5 * span
    rough = span / 6.0
    decade = 10.0 ** math.floor(math.log10(rough))
    step = next(unit * decade for unit in (1.0, 2.0, 2.5, 5.0, 10.0) if unit * decade >= rough * (1.0 - 1e-9))
    margin = 0.04 * span
    return step * math.floor((low - margin) / step), step * math.ceil((high + margin) / step)


def stepped(step: float, least: float, most: float) -> Bounds:
    """Return the function that gives bounds in multiples of `step`, cut to `least` and `most`."""

    def bounds(low: float, high: float) -> tuple[float, float]:
        low, high = max(least, min(low, most - step)), min(most, max(high, least + step))
        bottom, top = step * math.floor(low / step), step * math.ceil(high / step)
        return bottom, max(top, bottom + step)

    return bounds


def decades(low: float, high: float) -> tuple[float, float]:
    """Return bounds at whole powers of ten."""
    bottom, top = math.floor(math.log10(low) + 1e-9), math.ceil(math.log10(high) - 1e-9)
    return 10.0**bottom, 10.0 ** max(top, bottom + 1)


class View:
    """The range of an axis, which follows the data with some hysteresis and stays where the user has zoomed to.

    `rest` are the bounds without zoom, `name` what it is called at the mouse.
    """

    def __init__(
        self, low: float, high: float, bounds: Bounds = round_bounds, *, logarithmic: bool = False, name: str = ""
    ) -> None:
        self.range = models.Range1d(start=low, end=high)
        self.rest = (low, high)
        self._bounds, self.logarithmic, self.name = bounds, logarithmic, name
        self.zoomed = self._fitted = False
        for name in ("start", "end"):
            self.range.on_change(name, self._changed)

    def _changed(self, name: str, old: object, new: object) -> None:
        tolerance = 1e-6 * abs(self.rest[1] - self.rest[0])
        ends = zip((self.range.start, self.range.end), self.rest, strict=True)
        self.zoomed = not all(isinstance(a, int | float) and abs(a - b) <= tolerance for a, b in ends)

    def fit(self, data: tuple[float, float] | None) -> None:
        """Show `data`, the smallest and the largest number; None leaves the view as it is.

        The view grows as soon as something would be cut off, and shrinks when the data need much less.
        """
        if data is None or (self.logarithmic and data[0] <= 0.0):
            return
        bounds = self._bounds(*data)
        # Data beyond the bounds is cut off on purpose and does not count.
        low, high = max(data[0], bounds[0]), min(data[1], bounds[1])
        left, right = self.rest
        inside = left <= low + 1e-9 * abs(low) and high - 1e-9 * abs(high) <= right
        if self._fitted and inside and self._length(*bounds) >= _SHRINK * self._length(left, right):
            return
        self._fitted = True
        self.show(*bounds)

    def forget(self) -> None:
        """Fit the next data closely: they show something else than those before."""
        self._fitted = False

    def show(self, low: float, high: float) -> None:
        """Set the bounds without zoom; a zoomed view changes only when it is reset."""
        if (low, high) != self.rest:
            self.rest = (low, high)
            if not self.zoomed:
                self.reset()

    def reset(self) -> None:
        """Undo the user's zoom."""
        self.range.update(start=self.rest[0], end=self.rest[1])

    def _length(self, low: float, high: float) -> float:
        return math.log(high / low) if self.logarithmic else high - low


def empty_figure(name: str, x: View, y: View, last: bool) -> Any:
    """Return an empty figure with zoom and pan but without a tool bar."""
    out = figure(
        name=name,
        x_range=x.range,
        y_range=y.range,
        x_axis_type="log" if x.logarithmic else "linear",
        y_axis_type="log" if y.logarithmic else "linear",
        title=None,
        toolbar_location=None,
        tools=[],
        sizing_mode="stretch_both",
        min_height=36,
        min_width=200,
        min_border_left=_LEFT,
        min_border_right=_RIGHT,
        min_border_top=_TOP,
        min_border_bottom=0,
        output_backend="canvas",
        lod_threshold=None,
        margin=0,
        # The frames of two figures are equally high, with or without a label below.
        styles={"flex-grow": "1", "flex-basis": f"{_BELOW}px" if last else "0"},
    )
    pan, wheel = models.PanTool(), models.WheelZoomTool(zoom_on_axis=True)
    out.add_tools(pan, wheel)
    out.toolbar.active_drag, out.toolbar.active_scroll = pan, wheel
    # The page shows through: half of the outermost pixels would keep the colour of the theme before.
    out.background_fill_color = out.border_fill_color = out.outline_line_color = None
    for axis in (*out.xaxis, *out.yaxis):
        _style(axis)
    return out


def _style(axis: Any) -> None:
    # The page's style sheet has the colours of axes and grids.
    axis.major_tick_in, axis.major_tick_out = 0, 4
    axis.major_label_standoff, axis.axis_label_standoff = 3, 4
    axis.major_label_text_font = axis.axis_label_text_font = FONT
    axis.major_label_text_font_size = axis.axis_label_text_font_size = SMALL
    axis.axis_label_text_font_style = "normal"
    if isinstance(axis, models.LogAxis):
        axis.ticker = models.LogTicker(desired_num_ticks=8, num_minor_ticks=9)
        axis.minor_tick_in, axis.minor_tick_out = 0, 2
        axis.formatter = models.LogTickFormatter(ticker=axis.ticker, min_exponent=4)
    else:
        axis.ticker.desired_num_ticks = 5
        axis.minor_tick_in = axis.minor_tick_out = 0
        axis.formatter = models.BasicTickFormatter(use_scientific=False)
