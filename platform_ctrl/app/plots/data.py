"""Data, colours, units and axis ranges of the plots."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from functools import cache
from importlib import resources
from typing import Any

import numpy as np
from bokeh.core.property.descriptors import UnsetValueError
from bokeh.models import ColumnDataSource, Range1d
from numpy.typing import NDArray

# Dashes of the k-th design in pixels; empty is a solid line.
DASHES: tuple[tuple[int, ...], ...] = ((), (8, 3), (2, 3), (9, 3, 2, 3), (9, 3, 2, 3, 2, 3), (5, 2), (14, 4), (4, 4))
# Dashes of what the job asks for, pixels.
LIMIT_DASHES = (6, 3)
FONT = 'system-ui, -apple-system, "Segoe UI", "Helvetica Neue", "Noto Sans", "Liberation Sans", Arial, sans-serif'
SMALL, NORMAL = "11px", "12px"

_BLOCK = re.compile(r":root\s*\{([^}]*)\}")
_VARIABLE = re.compile(r"--([\w-]+):\s*(#[0-9a-fA-F]{6})\s*;")


@cache
def _themes() -> tuple[dict[str, str], dict[str, str]]:
    text = resources.files("platform_ctrl.report").joinpath("templates/report.css").read_text(encoding="utf-8")
    light, dark = (dict(_VARIABLE.findall(block)) for block in _BLOCK.findall(text)[:2])
    return light, dark


def colours(dark: bool) -> dict[str, str]:
    """Return the colours of a theme by what they are for: ``ink``, ``muted``, ``grid``, ``limit``, ``series-1``, ..."""
    light_colours, dark_colours = _themes()
    return dict(dark_colours if dark else light_colours)


def series(k: int) -> str:
    """Return the name of the colour of the k-th of several curves."""
    return f"series-{1 + k % 8}"


def dashes(k: int) -> tuple[int, ...]:
    """Return the dashes of the k-th of several designs, pixels."""
    return DASHES[k % len(DASHES)]


class Sources:
    """The column data sources of a page's plots."""

    def __init__(self) -> None:
        self.by_name: dict[str, ColumnDataSource] = {}

    def new(self, name: str, *columns: str, lists: tuple[str, ...] = ()) -> ColumnDataSource:
        """Return a new source with empty columns: of numbers, and of texts or whole curves (`lists`)."""
        data: dict[str, Any] = {one: np.zeros(0, np.float32) for one in columns}
        out = ColumnDataSource(data=data | {one: [] for one in lists}, name=name)
        self.by_name[name] = out
        return out

    def put(self, name: str, /, **columns: Any) -> None:
        """Give a source all its columns; nothing is sent where they are as before."""
        source = self.by_name[name]
        if not _same(source.data, columns):
            source.data = columns


def _same(old: dict[str, Any], new: dict[str, Any]) -> bool:
    if old.keys() != new.keys():
        return False
    for name, one in new.items():
        before = old[name]
        if isinstance(one, np.ndarray):
            if not (isinstance(before, np.ndarray) and np.array_equal(before, one, equal_nan=True)):
                return False
        elif len(before) != len(one) or not all(map(_equal, before, one)):
            return False
    return True


def _equal(one: Any, other: Any) -> bool:
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        return np.array_equal(one, other, equal_nan=True)
    return bool(one == other)


Column = NDArray[np.float32]

# Beyond this nothing is drawn, and single precision ends.
_LARGEST = 1e30


def column(numbers: Any, scale: float = 1.0) -> Column:
    """Return real numbers, times `scale`, as a column: what is not finite, or too large to be drawn, is a gap (NaN)."""
    with np.errstate(invalid="ignore", over="ignore"):
        out = scale * np.asarray(numbers, dtype=np.float64)
        out = np.where(np.abs(out) <= _LARGEST, out, np.nan)
    return out.astype(np.float32)


def decibels(gain: Any) -> Column:
    """Return gains as a column in dB; a gain of 0 is a gap."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return column(20.0 * np.log10(np.asarray(gain, dtype=np.float64)))


def strung(rows: Any) -> Column:
    """Return the rows of an array (N, F) one after the other with a gap after each: many curves as one line."""
    out = column(rows)
    out = out.reshape(len(out), -1) if out.size else np.zeros((0, 0), np.float32)
    return np.hstack([out, np.full((len(out), 1), np.nan, np.float32)]).ravel()


def finite(*columns: Column) -> tuple[Column, ...]:
    """Return columns of one length without the places at which any of them has a gap."""
    keep = np.logical_and.reduce([np.isfinite(one) for one in columns])
    return tuple(one[keep] for one in columns)


def thinned(number: int, most: int) -> NDArray[np.intp]:
    """Return the places of at most `most` of `number` points, evenly spread, both ends among them."""
    if number <= most:
        return np.arange(number)
    return np.unique(np.linspace(0, number - 1, most).round().astype(np.intp))


def extent(columns: Sequence[Any]) -> tuple[float, float] | None:
    """Return the least and the largest number of some arrays that can be drawn; None where there is none."""
    low, high = np.inf, -np.inf
    for one in columns:
        numbers = np.asarray(one)
        with np.errstate(invalid="ignore"):
            numbers = numbers[np.abs(numbers) <= _LARGEST]
        if numbers.size:
            low, high = min(low, float(numbers.min())), max(high, float(numbers.max()))
    return (low, high) if low <= high else None


_PREFIXES = ((1e-3, "m"), (1e-6, "µ"), (1e-9, "n"))
_PREFIXED = frozenset({"rad", "rad/s", "N m", "s", "rad/(rad/s)"})


class Unit:
    """The unit that a size reads well in: it changes only when the numbers have become awkward, not at every move.

    Attributes
    ----------
    name
        As it is written.
    scale
        What numbers in the plain unit are multiplied with.
    """

    def __init__(self) -> None:
        self._plain, self.name, self.scale = "", "", 1.0

    def follow(self, unit: str, size: float) -> None:
        """Choose for numbers in `unit`, the largest of magnitude `size`."""
        if unit == self._plain and (not 0.0 < size < math.inf or 0.2 <= size * self.scale < 2000.0):
            return
        self._plain = unit
        self.scale, self.name = _handy(unit, size)


def quantity(number: float, unit: str) -> str:
    """Return a number with its unit, both as they read well: ``3 mrad``."""
    scale, name = _handy(unit, 1.01 * abs(number))
    return f"{scale * number:.3g} {name}".rstrip()


def _handy(unit: str, size: float) -> tuple[float, str]:
    # The numerator takes the prefix: "mrad per rad/s".
    head, between, rest = unit.partition(" per ")
    if head not in _PREFIXED or not size > 0.0 or size >= 0.5:
        return 1.0, unit
    scale, prefix = next((one for one in _PREFIXES if size >= 0.5 * one[0]), _PREFIXES[-1])
    return 1.0 / scale, f"{prefix}{head}{between}{rest}"


def inner_width(plot: Any) -> float:
    """Return the width of the figure's frame, pixels; a guess before the browser has said it."""
    return _told(plot, "inner_width", 320.0)


def inner_height(plot: Any) -> float:
    """Return the height of the figure's frame, pixels; a guess before the browser has said it."""
    return _told(plot, "inner_height", 240.0)


def _told(plot: Any, name: str, guess: float) -> float:
    try:
        number = getattr(plot, name)
    except UnsetValueError:
        return guess
    return float(number) if isinstance(number, int | float) and number > 10 else guess


# The data may shrink to this share of the view before the view shrinks with it.
_SLACK = 0.42


def nice(low: float, high: float) -> tuple[float, float]:
    """Return round bounds with a little room around `low` to `high`: steps of 1, 2, 2.5 or 5 times a power of ten."""
    span = high - low
    if not span > 1e-12 * max(abs(low), abs(high)):
        span = 2.0 * abs(high) if high else 2.0
        low, high = low - 0.5 * span, high + 0.5 * span
    rough = span / 6.0
    decade = 10.0 ** math.floor(math.log10(rough))
    step = next(unit * decade for unit in (1.0, 2.0, 2.5, 5.0, 10.0) if unit * decade >= rough * (1.0 - 1e-9))
    room = 0.04 * span
    return step * math.floor((low - room) / step), step * math.ceil((high + room) / step)


def stepped(step: float, least: float, most: float) -> Callable[[float, float], tuple[float, float]]:
    """Return bounds that are multiples of `step`, cut to `least` and `most`."""

    def bounds(low: float, high: float) -> tuple[float, float]:
        low, high = max(least, min(low, most - step)), min(most, max(high, least + step))
        bottom, top = step * math.floor(low / step), step * math.ceil(high / step)
        return bottom, max(top, bottom + step)

    return bounds


def decades(low: float, high: float) -> tuple[float, float]:
    """Return the ends of a logarithmic axis: the data's own."""
    return low, high if high > low else 10.0 * low


class View:
    """A range that follows the data with some play, and leaves what the user zoomed to alone."""

    def __init__(
        self,
        low: float,
        high: float,
        bounds: Callable[[float, float], tuple[float, float]] = nice,
        *,
        logarithmic: bool = False,
    ) -> None:
        self.range = Range1d(start=low, end=high, reset_start=low, reset_end=high)
        self.rest = (low, high)
        self.moved = False
        self._bounds = bounds
        self._logarithmic = logarithmic
        self._own = False
        self._begun = False
        for name in ("start", "end"):
            self.range.on_change(name, self._changed)

    def _changed(self, name: str, old: object, new: object) -> None:
        if not self._own:
            self.moved = not (
                _near(self.range.start, self.rest[0], self.rest) and _near(self.range.end, self.rest[1], self.rest)
            )

    def fit(self, data: tuple[float, float] | None) -> None:
        """Show `data`, least and largest number; None leaves everything as it is.

        The view grows as soon as something would be cut off, and shrinks when the data have left most of it.
        """
        if data is None or (self._logarithmic and data[0] <= 0.0):
            return
        bounds = self._bounds(*data)
        # What the bounds cut off on purpose does not count.
        low, high = max(data[0], bounds[0]), min(data[1], bounds[1])
        left, right = self.rest
        inside = left <= low + 1e-9 * abs(low) and high - 1e-9 * abs(high) <= right
        if self._begun and inside and self._length(*bounds) >= _SLACK * self._length(left, right):
            return
        self._begun = True
        self.show(*bounds)

    def anew(self) -> None:
        """Have the next data fitted closely: they are of something else than those before."""
        self._begun = False

    def show(self, low: float, high: float) -> None:
        """Rest at `low` to `high`; where the user has zoomed, only after a reset."""
        if (low, high) == self.rest:
            return
        self.rest = (low, high)
        self._own = True
        try:
            if self.moved:
                self.range.update(reset_start=low, reset_end=high)
            else:
                self.range.update(start=low, end=high, reset_start=low, reset_end=high)
        finally:
            self._own = False

    def reset(self) -> None:
        """Go back to rest from wherever the user has zoomed to."""
        self._own = True
        try:
            self.range.update(start=self.rest[0], end=self.rest[1])
            self.moved = False
        finally:
            self._own = False

    def _length(self, low: float, high: float) -> float:
        return math.log(high / low) if self._logarithmic else high - low


def _near(one: object, other: float, ends: tuple[float, float]) -> bool:
    return isinstance(one, int | float) and abs(one - other) <= 1e-6 * (ends[1] - ends[0])
