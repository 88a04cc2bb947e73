"""Greek letters in the names of angles and rates: ``alpha4`` is read as α4, its derivative as α̇4, in columns too."""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Collection
from decimal import ROUND_CEILING, ROUND_FLOOR, ROUND_HALF_EVEN, Context, Decimal
from typing import Literal

_SMALL = "alpha beta gamma delta epsilon zeta eta theta kappa lambda mu nu xi rho sigma tau phi chi psi omega"
_CAPITAL = "Gamma Delta Theta Lambda Phi Psi Omega"
LETTERS = dict(zip(f"{_SMALL} {_CAPITAL}".split(), "αβγδεζηθκλμνξρστφχψωΓΔΘΛΦΨΩ", strict=True))

# Combining marks of an angle, its rate and its acceleration.
DOTS = ("", "\u0307", "\u0308")

_LETTER = re.compile(rf"(?<![A-Za-z])({'|'.join(LETTERS)})(?![A-Za-z])")


def greek(name: str) -> str:
    """Return a signal name with its Greek letters as letters: ``alpha4`` is α4, ``q_theta`` is q_θ."""
    return _LETTER.sub(lambda found: LETTERS[found[0]], name)


def dotted(angle: str, derivative: int) -> str:
    """Return an angle or its derivative: ``alpha4``, 2 is α̈4; a word has primes instead: ``pan``, 1 is pan'."""
    head = re.split(r"[\W\d_]", angle, maxsplit=1)[0]
    letter, rest = LETTERS.get(head, head), angle[len(head) :]
    return letter + DOTS[derivative] + rest if len(letter) == 1 else letter + rest + "'" * derivative


def unused(name: str, taken: Collection[str], between: str = "_") -> str:
    """Return a name, numbered if it is taken."""
    new, count = name, 1
    while new in taken:
        count += 1
        new = f"{name}{between}{count}"
    return new


def width(text: str) -> int:
    """Return the columns that a text takes on a terminal: dots above letters take none."""
    return sum(0 if unicodedata.combining(c) else 1 + (unicodedata.east_asian_width(c) in "WF") for c in text)


def padded(text: str, columns: int) -> str:
    """Return the text filled with spaces on the right."""
    return text + " " * (columns - width(text))


Rounding = Literal["nearest", "down", "up"]

_MODES = {"nearest": ROUND_HALF_EVEN, "down": ROUND_FLOOR, "up": ROUND_CEILING}


def rounded(number: float | Decimal, digits: int, rounding: Rounding = "nearest") -> float:
    """Return `number` with `digits` significant digits."""
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


_NARROW, _WIDE = frozenset("iljtfrI.,:;'|!()[] "), frozenset("mwMW@%—")


def text_width(text: str, size: float) -> float:
    """Return about how wide `text` is in any common sans-serif face, rather too wide than too narrow."""
    per_letter = (0.37 if c in _NARROW else 0.92 if c in _WIDE else 0.71 if c.isupper() else 0.61 for c in text)
    return size * sum(per_letter)
