"""Significant digits with a direction: a proved bound is still proved as it is printed."""

from __future__ import annotations

import math
from decimal import ROUND_CEILING, ROUND_FLOOR, ROUND_HALF_EVEN, Context, Decimal
from typing import Literal

Rounding = Literal["nearest", "down", "up"]

_MODES = {"nearest": ROUND_HALF_EVEN, "down": ROUND_FLOOR, "up": ROUND_CEILING}


def rounded(number: float | Decimal, digits: int, rounding: Rounding = "nearest") -> float:
    """Return `number` with `digits` significant digits.

    Parameters
    ----------
    number
        A float counts as the shortest decimal that reads back as it: 0.29 is already rounded.
    digits
        At least 1, at most 15.
    rounding
        ``"down"`` (towards minus infinity) for a proved lower bound, ``"up"`` for an upper one.
    """
    if not math.isfinite(number):
        return float(number)
    exact = number if isinstance(number, Decimal) else Decimal(repr(float(number)))
    return float(Context(prec=digits, rounding=_MODES[rounding]).create_decimal(exact))


def at_least(number: float, digits: int) -> str:
    """Return a lower bound as text, rounded down."""
    return f"{rounded(number, digits, 'down'):.{digits}g}"


def at_most(number: float, digits: int) -> str:
    """Return an upper bound as text, rounded up."""
    return f"{rounded(number, digits, 'up'):.{digits}g}"
