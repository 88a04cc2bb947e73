"""What an axis shows at rest: it follows the data, but does not jump while a slider moves."""

from __future__ import annotations

import math
from collections.abc import Callable

from bokeh.models import Range1d

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
                _same(self.range.start, self.rest[0], self.rest) and _same(self.range.end, self.rest[1], self.rest)
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


def _same(one: object, other: float, ends: tuple[float, float]) -> bool:
    return isinstance(one, int | float) and abs(one - other) <= 1e-6 * (ends[1] - ends[0])
