"""Columns of the sources: what goes to the browser is single precision, finite or a gap, and one array a column."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

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
