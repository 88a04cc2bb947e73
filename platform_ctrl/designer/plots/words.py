"""Numbers and names as the plots write them."""

from __future__ import annotations

import math

_PREFIXES = ((1e-3, "m"), (1e-6, "µ"), (1e-9, "n"))
_PREFIXED = frozenset({"rad", "rad/s", "N m", "s", "rad s/rad"})


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
