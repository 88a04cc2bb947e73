"""Terms as (27) prints them: Greek letters, dots for derivatives, sums of rotors' L."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Sequence

import numpy as np

from platform_ctrl.frozen import FloatArray
from platform_ctrl.greek import LETTERS, dotted, initial


def coordinate(angle: str, derivative: int) -> str:
    """Return an angle or its derivative: ``alpha4``, 2 becomes α̈4."""
    head, _ = initial(angle)
    if len(LETTERS.get(head, head)) == 1:
        return unicodedata.normalize("NFC", dotted(angle, derivative))
    return ("{}", "d({})/dt", "d²({})/dt²")[derivative].format(angle)


def rates(monomial: str) -> str:
    """Return a product of platform rates: ``Omega1*Omega2`` becomes Ω1 Ω2, ``Omega1'`` Ω̇1, and ``1`` nothing."""
    if monomial == "1":
        return ""
    changing = re.sub("Omega([123])'", "Ω\u0307\\1", monomial)
    return changing.replace("Omega", "Ω").replace("*", " ").replace("^2", "²")


def symbol(letter: str, name: str) -> str:
    """Return a quantity of a body: L6, J_outer."""
    return f"{letter}{name}" if name[:1].isdigit() else f"{letter}_{name}"


def combination(names: Sequence[str], weights: FloatArray) -> str:
    """Return a sum of named quantities: (L6 − L8), −L8, 0.5 L6."""
    out = ""
    relevant = [k for k in range(len(names)) if abs(weights[k]) > 1e-12 * np.abs(weights).max()]
    for k in relevant:
        size = abs(weights[k])
        sign = "−" if weights[k] < 0.0 else "+"
        number = "" if abs(size - 1.0) < 1e-9 else f"{size:.3g} "
        joint = f" {sign} " if out else sign.replace("+", "")
        out += f"{joint}{number}{names[k]}"
    return f"({out})" if len(relevant) > 1 else out


def product(*factors: str) -> str:
    """Return factors with spaces between those that are not empty."""
    return " ".join(factor for factor in factors if factor)
