"""Data, colours, units and axis ranges of the plots."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from bokeh.core.property.descriptors import UnsetValueError
from bokeh.models import ColumnDataSource, Range1d
from numpy.typing import NDArray

from platform_ctrl.analysis import curves
from platform_ctrl.common.palette import PALETTE
from platform_ctrl.common.values import FloatArray

HZ = 1.0 / (2.0 * math.pi)
# Dashes of the k-th design in pixels; empty is a solid line.
DASHES: tuple[tuple[int, ...], ...] = ((), (8, 3), (2, 3), (9, 3, 2, 3), (9, 3, 2, 3, 2, 3), (5, 2), (14, 4), (4, 4))
# Dashes of the job's limits, pixels.
LIMIT_DASHES = (6, 3)
FONT = 'system-ui, -apple-system, "Segoe UI", "Helvetica Neue", "Noto Sans", "Liberation Sans", Arial, sans-serif'
SMALL, NORMAL = "11px", "12px"


def colours(dark: bool) -> Mapping[str, str]:
    """Return the colours of a theme by role: ``ink``, ``muted``, ``grid``, ``limit``, ``series-1``, ..."""
    return PALETTE["dark" if dark else "light"]


def series(k: int) -> str:
    """Return the role of the colour of the k-th of several curves."""
    return f"series-{1 + k % 8}"


def dashes(k: int) -> tuple[int, ...]:
    """Return the dashes of the k-th of several designs, pixels."""
    return DASHES[k % len(DASHES)]


def assign(model: Any, **values: Any) -> None:
    """Set the properties of a model that differ: to Bokeh one that stays is as much work as one that changes."""
    for name, new in values.items():
        if getattr(model, name) != new:
            setattr(model, name, new)


class Sources:
    """The column data sources of a page's plots, by name."""

    def __init__(self) -> None:
        self.by_name: dict[str, ColumnDataSource] = {}

    def new(self, name: str, *columns: str, lists: tuple[str, ...] = ()) -> ColumnDataSource:
        """Return a new source with empty columns: of numbers, and of texts or whole curves (`lists`)."""
        data: dict[str, Any] = {one: np.zeros(0, np.float32) for one in columns}
        out = ColumnDataSource(data=data | {one: [] for one in lists}, name=name)
        self.by_name[name] = out
        return out

    def put(self, name: str, /, **columns: Any) -> None:
        """Set all columns of a source; nothing is sent if they have not changed."""
        source = self.by_name[name]
        if not all(_equal(source.data[key], one) for key, one in columns.items()):
            source.data = columns


def _equal(one: Any, other: Any) -> bool:
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
        out = scale * np.asarray(numbers, dtype=np.float64)
        out = np.where(np.abs(out) <= _LARGEST, out, np.nan)
    return out.astype(np.float32)


def decibels(gain: Any) -> Column:
    """Return gains as a column in dB; a gain of 0 is a gap."""
    return column(curves.decibels(gain))


def positive(gain: FloatArray) -> FloatArray:
    """Return gains with gaps where they are not positive."""
    with np.errstate(invalid="ignore"):
        return np.asarray(np.where(gain > 0.0, gain, np.nan))


def joined_curves(rows: Any) -> Column:
    """Return the rows of an array (N, F) one after the other with a gap after each: many curves as one line."""
    out = column(rows)
    out = out.reshape(len(out), -1) if out.size else np.zeros((0, 0), np.float32)
    return np.hstack([out, np.full((len(out), 1), np.nan, np.float32)]).ravel()


def finite(*columns: Column) -> tuple[Column, ...]:
    """Return columns of one length without the places where any of them has a gap."""
    keep = np.logical_and.reduce([np.isfinite(one) for one in columns])
    return tuple(one[keep] for one in columns)


def thinned(number: int, most: int) -> NDArray[np.intp]:
    """Return the indices of at most `most` of `number` points, evenly spaced, with both ends."""
    if number <= most:
        return np.arange(number)
    return np.unique(np.linspace(0, number - 1, most).round().astype(np.intp))


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
        self.scale, self.name = _prefixed(unit, size)


def quantity(number: float, unit: str) -> str:
    """Return a number with its unit and a suitable prefix: ``3 mrad``."""
    scale, name = _prefixed(unit, 1.01 * abs(number))
    return f"{scale * number:.3g} {name}".rstrip()


def _prefixed(unit: str, size: float) -> tuple[float, str]:
    if unit not in _PREFIXED or not size > 0.0 or size >= 0.5:
        return 1.0, unit
    scale, prefix = next((one for one in _PREFIXES if size >= 0.5 * one[0]), _PREFIXES[-1])
    return 1.0 / scale, f"{prefix}{unit}"


def inner_size(plot: Any) -> tuple[float, float]:
    """Return width and height of the figure's frame, pixels; a guess before the browser has sent them."""
    return _pixels(plot, "inner_width", 320.0), _pixels(plot, "inner_height", 240.0)


def _pixels(plot: Any, name: str, guess: float) -> float:
    try:
        number = getattr(plot, name)
    except UnsetValueError:
        return guess
    return float(number) if isinstance(number, int | float) and number > 10 else guess


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

    `rest` are the bounds without zoom.
    """

    def __init__(self, low: float, high: float, bounds: Bounds = round_bounds, *, logarithmic: bool = False) -> None:
        self.range = Range1d(start=low, end=high, reset_start=low, reset_end=high)
        self.rest = (low, high)
        self._bounds, self.logarithmic = bounds, logarithmic
        self.zoomed = self._setting = self._fitted = False
        for name in ("start", "end"):
            self.range.on_change(name, self._changed)

    def _changed(self, name: str, old: object, new: object) -> None:
        if not self._setting:
            tolerance = 1e-6 * (self.rest[1] - self.rest[0])
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
            self._set(reset_start=low, reset_end=high, **({} if self.zoomed else {"start": low, "end": high}))

    def reset(self) -> None:
        """Undo the user's zoom."""
        self.zoomed = False
        self._set(start=self.rest[0], end=self.rest[1])

    def _set(self, **ends: float) -> None:
        self._setting = True
        try:
            self.range.update(**ends)
        finally:
            self._setting = False

    def _length(self, low: float, high: float) -> float:
        return math.log(high / low) if self.logarithmic else high - low
