"""Units of the columns of files, by what their names end in: ``time_us``, ``gyro_z_dps``, ``rate (deg/s)``."""

from __future__ import annotations

import math
import re
from typing import Literal, NamedTuple

Quantity = Literal["time", "angle", "rate", "acceleration", "torque"]

G = 9.80665  # m/s², standard gravity
_TURN, _DEGREE = 2.0 * math.pi, math.pi / 180.0


class Unit(NamedTuple):
    """A unit: how it is written, what it is of, and SI units (s, rad, rad/s, m/s², N m) in it."""

    name: str
    quantity: Quantity
    factor: float


# By the end of a column's name, in small letters. A frequency is a rate: 1 Hz is 2π rad/s.
SUFFIXES: dict[str, Unit] = {
    "s": Unit("s", "time", 1.0),
    "ms": Unit("ms", "time", 1e-3),
    "us": Unit("µs", "time", 1e-6),
    "ns": Unit("ns", "time", 1e-9),
    "rad": Unit("rad", "angle", 1.0),
    "mrad": Unit("mrad", "angle", 1e-3),
    "urad": Unit("µrad", "angle", 1e-6),
    "deg": Unit("deg", "angle", _DEGREE),
    "arcmin": Unit("arcmin", "angle", _DEGREE / 60.0),
    "arcsec": Unit("arcsec", "angle", _DEGREE / 3600.0),
    "rad_s": Unit("rad/s", "rate", 1.0),
    "mrad_s": Unit("mrad/s", "rate", 1e-3),
    "urad_s": Unit("µrad/s", "rate", 1e-6),
    "deg_s": Unit("deg/s", "rate", _DEGREE),
    "dps": Unit("deg/s", "rate", _DEGREE),
    "rpm": Unit("rpm", "rate", _TURN / 60.0),
    "hz": Unit("Hz", "rate", _TURN),
    "khz": Unit("kHz", "rate", 1e3 * _TURN),
    "m_s2": Unit("m/s2", "acceleration", 1.0),
    "mps2": Unit("m/s2", "acceleration", 1.0),
    "g": Unit("g", "acceleration", G),
    "mg": Unit("mg", "acceleration", 1e-3 * G),
    "nm": Unit("N m", "torque", 1.0),
    "mnm": Unit("mN m", "torque", 1e-3),
    "unm": Unit("µN m", "torque", 1e-6),
}
_SPELLINGS = {"sec": "s", "msec": "ms", "usec": "us", "nsec": "ns"}
_IN_BRACKETS = re.compile(r"(.*?)\s*[\[(]\s*([^\[\]()]+?)\s*[\])]")

# As autopilots write it: TimeUS.
_IN_CAPITALS = re.compile(r"(.*[a-z])([UMN]S)")


def column_unit(column: str) -> tuple[str, Unit | None]:
    """Return the name of a column without its unit, and the unit that it states, or None."""
    if bracketed := _IN_BRACKETS.fullmatch(column):
        end = bracketed[2].lower().replace("/", "_").replace("²", "2").replace("°", "deg")
        end = re.sub(r"[\s^·*]", "", end).replace("µ", "u")
        found = SUFFIXES.get(_SPELLINGS.get(end, end))
        return (bracketed[1].rstrip("_"), found) if found else (column, None)
    if stated := _IN_CAPITALS.fullmatch(column):
        return stated[1], SUFFIXES[stated[2].lower()]
    small = column.lower().replace("µ", "u")
    for end in sorted((*SUFFIXES, *_SPELLINGS), key=len, reverse=True):
        if small.endswith(f"_{end}") and len(column) > len(end) + 1:
            return column[: -len(end) - 1], SUFFIXES[_SPELLINGS.get(end, end)]
    return column, None
