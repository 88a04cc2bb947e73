"""Pieces of a hand-made SVG: numbers, escaped text and how wide it is, lines, arrow heads. Coordinates are pixels."""

from __future__ import annotations

import re
from collections.abc import Sequence
from xml.sax.saxutils import escape, quoteattr

import numpy as np

from platform_ctrl.frozen import FloatArray

# What XML 1.0 cannot hold, escaped or not.
_FORBIDDEN = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ud800-\udfff\ufffe\uffff]")


def plain_text(text: str) -> str:
    """Return `text` escaped for the inside of an element."""
    return escape(_FORBIDDEN.sub("\ufffd", text))


def attribute(text: str) -> str:
    """Return `text` as an attribute's value, quotes included."""
    return quoteattr(_FORBIDDEN.sub("\ufffd", text))


def number(x: float) -> str:
    """Return a coordinate to a tenth of a pixel, without a zero that says nothing."""
    text = f"{x:.1f}".removesuffix(".0")
    return "0" if text == "-0" else text


def path(points: FloatArray, *, closed: bool = False) -> str:
    """Return the path data of a polyline through `points`, (k, 2)."""
    return "M" + "L".join(f"{number(x)} {number(y)}" for x, y in points) + ("Z" if closed else "")


def line(points: FloatArray, kind: str, *, closed: bool = False) -> str:
    """Return a polyline of the CSS class `kind`."""
    return f'<path class="{kind}" d="{path(points, closed=closed)}"/>'


def arrow_head(tail: FloatArray, tip: FloatArray, kind: str, size: float = 10.0) -> str:
    """Return a filled arrow head at `tip`, seen from `tail`."""
    along = direction(tail, tip)
    across = 0.36 * size * np.array([-along[1], along[0]])
    back = tip - size * along
    return line(np.array([tip, back + across, back - across]), kind, closed=True)


def direction(tail: FloatArray, tip: FloatArray) -> FloatArray:
    """Return the unit vector from `tail` to `tip`; to the right where they coincide."""
    along = np.asarray(tip - tail, dtype=np.float64)
    length = float(np.hypot(*along))
    return along / length if length > 1e-9 else np.array([1.0, 0.0])


def words(text: str, at: Sequence[float], kind: str, anchor: str = "start") -> str:
    """Return `text` with its baseline starting (or ``middle``, ``end``) at a point."""
    place = "" if anchor == "start" else f' text-anchor="{anchor}"'
    return f'<text class="{kind}" x="{number(at[0])}" y="{number(at[1])}"{place}>{plain_text(text)}</text>'


_NARROW, _WIDE = frozenset("iljtfrI.,:;'|!()[] "), frozenset("mwMW@%—")


def text_width(text: str, size: float) -> float:
    """Return about how wide `text` is in any common sans-serif face, rather too wide than too narrow."""
    per_letter = (0.37 if c in _NARROW else 0.92 if c in _WIDE else 0.71 if c.isupper() else 0.61 for c in text)
    return size * sum(per_letter)


def level_class(level: int) -> str:
    """Return the CSS class of a body that many joints away from the root."""
    return f"level-{1 + (level - 1) % 5}"


def circle(at: Sequence[float], radius: float, kind: str) -> str:
    """Return a circle."""
    return f'<circle class="{kind}" cx="{number(at[0])}" cy="{number(at[1])}" r="{number(radius)}"/>'


# What acts or measures at a joint, drawn about the origin, with what it is called.
SIGNS = {
    "torquer": ("M-4.5-4.5H4.5V4.5H-4.5Z", "torquer"),
    "pickoff": ("M-4.5 0A4.5 4.5 0 1 1 4.5 0A4.5 4.5 0 1 1-4.5 0Z", "pick-off"),
    "spring": ("M-6 0L-4-4.5L-1.5 4.5L1.5-4.5L4 4.5L6 0", "spring"),
    "cage": ("M-2-5.5H-5V5.5H-2M2-5.5H5V5.5H2", "cage"),
    "erection": ("M-5-4.5H5L0 5Z", "erection"),
}


def sign(kind: str, at: Sequence[float], size: float = 1.0) -> str:
    """Return one of `SIGNS` at a point."""
    scale = "" if size == 1.0 else f" scale({size:.2f})"
    place = f"translate({number(at[0])} {number(at[1])}){scale}"
    return f'<path class="{kind}" transform="{place}" d="{SIGNS[kind][0]}"/>'
