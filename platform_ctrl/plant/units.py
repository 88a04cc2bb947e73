"""Units of input files: a key with a suffix is its SI value in another unit, ``lag_ms = 2`` is ``lag = 0.002``."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

_TURN = 2.0 * math.pi

# What a suffix is a unit of, and that unit in SI.
SUFFIXES: dict[str, tuple[str, float]] = {
    "deg": ("angle", _TURN / 360.0),
    "arcsec": ("angle", _TURN / 360.0 / 3600.0),
    "bits": ("angle", _TURN),  # of a turn divided into 2^bits steps
    "deg_s": ("rate", _TURN / 360.0),
    "rpm": ("rate", _TURN / 60.0),
    "ms": ("time", 1e-3),
    "us": ("time", 1e-6),
}
# How many an encoder may have.
BITS = range(1, 65)
# Keys by what they are, in whatever table they are numbers.
_QUANTITIES = {
    "angle": """rest angle angle_between_stops clearance play limit_cycle phase misalignment attitude
        angle_following_error los_angle_rms jitter jitter_per_axis windowed_jitter smear""",
    "rate": """spin coulomb_rate stribeck_rate friction_rate turning_rate gimbal_rate rate_following_error
        los_rate_rms rate Omega Omega1 Omega2 Omega3""",
    "time": "lag delay duration rise hold settle fade at until time_constant exposure t",
}
_OF_KEY = {key: quantity for quantity, keys in _QUANTITIES.items() for key in keys.split()}
# Keys of a sensor that are in the unit of its reading.
_OF_READING = ("noise_rms", "quantisation", "bias")


def base_key(key: str, known: Mapping[str, Any], reading: str) -> tuple[str, str] | None:
    """Return the key that `key` is with a suffix, and the suffix; None where there is no such key among the known.

    `reading` is the SI unit of a sensor's reading, or empty.
    """
    for suffix, (quantity, _) in SUFFIXES.items():
        base = key.removesuffix(f"_{suffix}")
        if base == key or base not in known:
            continue
        own = {"rad": "angle", "rad/s": "rate"}.get(reading) if base in _OF_READING else _OF_KEY.get(base)
        if own == quantity and (suffix != "bits" or base == "quantisation"):
            return base, suffix
    return None


def in_si(item: Any, suffix: str) -> Any:
    """Return a number, or the numbers of a list, in SI; anything else as it is, to be refused."""
    if isinstance(item, list):
        return [in_si(one, suffix) for one in item]
    if isinstance(item, bool) or not isinstance(item, int | float):
        return item
    unit = SUFFIXES[suffix][1]
    try:
        return unit / 2.0**item if suffix == "bits" else item * unit
    except OverflowError:  # an integer beyond all floats
        return item
