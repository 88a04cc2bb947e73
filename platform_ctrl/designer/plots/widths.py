"""How large a figure is on the screen, as the browser tells it."""

from __future__ import annotations

from typing import Any

from bokeh.core.property.descriptors import UnsetValueError


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
