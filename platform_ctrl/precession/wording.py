"""Directions, what they lack and what would help, in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from platform_ctrl.frozen import FloatArray
from platform_ctrl.precession.reduction import Scaled, echelon
from platform_ctrl.precession.restraint import NOTHING, slowest

# A coefficient of a direction that is this small, half of the last digit in words, is not worth a word.
_SILENT = 0.005


def named_directions(
    at: Scaled, directions: FloatArray, angles: Sequence[str]
) -> tuple[FloatArray, tuple[str, ...], list[int]]:
    """Return directions in x as motions of few angles, (n, k), their names, and the leading angle of each."""
    vectors, leading = echelon((at.T @ directions).T)
    # The angle that is named first moves forward.
    vectors *= np.sign([vector[np.flatnonzero(np.abs(vector) >= _SILENT)[0]] for vector in vectors]).reshape(-1, 1)
    return vectors.T, tuple(_in_words(vector, angles) for vector in vectors), leading


def _in_words(vector: FloatArray, angles: Sequence[str]) -> str:
    words = ""
    for coefficient, angle in zip(vector, angles, strict=True):
        if abs(coefficient) >= _SILENT:
            size = f"{abs(coefficient):.2g}"
            sign = (" - " if words else "-") if coefficient < 0.0 else (" + " if words else "")
            words += f"{sign}{'' if size == '1' else size + ' '}{angle}"
    return words


def lack(at: Scaled, null: FloatArray, names: Sequence[str], fast: float) -> tuple[str, str]:
    """Return why null directions that nothing holds stand in the way, and the restraint that would hold them."""
    n, k = null.shape
    singular = f"G_R is {n} x {n} and skew, so its determinant is 0" if n % 2 else f"G_R has rank {n - k} of {n}"
    why = f"{singular}: {', '.join(names)} {'has' if k == 1 else 'have'} no gyroscopic stiffness"
    if fast == 0.0:
        # No gyroscopic pair at all, so nothing that a restraint could be measured by.
        return why, f"restrain {', '.join(names)} and give loop_frequency"
    stiffness = np.linalg.eigvals(null.T @ at.S @ null)
    held = slowest(null.T @ at.D @ null)
    if np.all(stiffness.real > 0.0):
        held = max(held, float(np.sqrt(np.abs(stiffness).min())))
    if held > NOTHING * at.size:
        why += f"; what restrains it acts up to {held:.3g} rad/s, {fast:.3g} rad/s are needed"
    directions, _ = echelon((at.T @ null).T)
    inertia = k * np.sum((directions @ at.back.T) ** 2, axis=1)
    along = ", ".join(
        f"{name}: stiffness well above {J * fast**2:.3g} N m/rad or damping well above {J * fast:.3g} N m s along it"
        for name, J in zip(names, inertia, strict=True)
    )
    return why, f"restrain {along}"


def keep(names: Sequence[str], n: int) -> str:
    """Return the cure that keeps the momenta of the named directions, of n in all."""
    if len(names) == n:
        return "keep all momenta, that is the full equations"
    if len(names) == 1:
        return f"keep one momentum state, that of {names[0]} (momentum_states=True)"
    return f"keep {len(names)} momentum states, those of {', '.join(names)} (momentum_states=True)"
