"""The gimbal rows (27), linear in the angles, for any Omega(t): coefficients as linear forms in the parameters.

With ∂T/∂q̇ = A*_qΩ Ω + A*_qq q̇ + (BᵀL)_q and, at q̇ = 0, T = ½ Ωᵀ A*_ΩΩ Ω + (BᵀL)_Ω Ω, row j of
d/dt ∂T/∂q̇ − ∂T/∂q = Q is to first order the sum of

    q̈_k   A*_jk
    q̇_k   (∂_k A*_ja − ∂_j A*_ka) Ω_a + ∂_k (BᵀL)_j − ∂_j (BᵀL)_k
    q_k   ∂_k A*_ja Ω̇_a − ½ ∂_j ∂_k A*_ab Ω_a Ω_b − ∂_j ∂_k (BᵀL)_a Ω_a
    1     A*_ja Ω̇_a − ½ ∂_j A*_ab Ω_a Ω_b − ∂_j (BᵀL)_a Ω_a

all at zero angles. The paper drops every derivative of A*, but keeps that of BᵀA_R B before Ω̇.
"""

from __future__ import annotations

import numpy as np

from platform_ctrl.frozen import FloatArray
from platform_ctrl.mechanics.coupling import connected
from platform_ctrl.symbolic.elements import Term, Variable
from platform_ctrl.symbolic.series import Monomial, Series, without_residue

Factors = tuple[str, ...]
Forms = dict[Factors, FloatArray]
Row = dict[tuple[Variable, int], Forms]

_ROOT = range(3)


def gimbal_rows(
    A_star: Series,
    BtL: Series,
    carried: Series | None,
    names: tuple[tuple[str, ...], tuple[str, ...]],
    elements: tuple[Term, ...],
) -> tuple[Row, ...]:
    """Return the left side of every gimbal row.

    Parameters
    ----------
    A_star, BtL
        To second order in the angles; coefficients (symbols, 3 + n, 3 + n) and (symbols, 3 + n).
    carried
        None: exact. With the paper's rule BᵀA_R B, whose slope stands before Ω̇ q.
    names
        Of Omega1 to Omega3, and of their derivatives.
    elements
        What force elements add.
    """
    rates, changes = names
    zero = np.zeros_like(next(iter(A_star.values())))
    n = zero.shape[1] - 3

    def slope(series: Series, *angles: int) -> FloatArray:
        monomial: Monomial = tuple(sorted(angles))
        out = series.get(monomial, zero if series is not BtL else zero[:, :, 0])
        return 2.0 * out if len(angles) == 2 and angles[0] == angles[1] else out

    exact = carried is None
    before_change = A_star if carried is None else carried
    rest = slope(A_star)
    rows: list[Row] = [{} for _ in range(n)]
    for j, row in enumerate(rows):
        by_j, spin_by_j = slope(A_star, j), slope(BtL, j)
        constant = row.setdefault(("constant", 0), {})
        for a in _ROOT:
            _add(constant, (changes[a],), rest[:, 3 + j, a])
            _add(constant, (rates[a],), -spin_by_j[:, a])
        if exact:
            _add_squares(constant, rates, by_j)
        for k in range(n):
            _add(row.setdefault(("acceleration", k), {}), (), rest[:, 3 + j, 3 + k])
            by_k, spin_by_k, spin_by_both = slope(A_star, k), slope(BtL, k), slope(BtL, j, k)
            rate, angle = row.setdefault(("rate", k), {}), row.setdefault(("angle", k), {})
            _add(rate, (), spin_by_k[:, 3 + j] - spin_by_j[:, 3 + k])
            for a in _ROOT:
                _add(angle, (rates[a],), -spin_by_both[:, a])
                _add(angle, (changes[a],), slope(before_change, k)[:, 3 + j, a])
                if exact:
                    _add(rate, (rates[a],), by_k[:, 3 + j, a] - by_j[:, 3 + k, a])
            if exact:
                _add_squares(angle, rates, slope(A_star, j, k))
    for term in elements:
        form = np.zeros(len(zero))
        form[term.position] = term.coefficient
        _add(rows[term.row].setdefault((term.variable, term.of), {}), term.factors, form)
    return tuple(rows)


def at_rest(row: Row, moving: tuple[str, ...]) -> Row:
    """Return (19): linear in the angles and in Omega, whose components and derivatives are `moving`, together."""

    def kept(variable: Variable, factors: Factors) -> bool:
        return sum(name in moving for name in factors) <= (variable == "constant")

    return {
        (variable, k): {factors: form for factors, form in forms.items() if kept(variable, factors)}
        for (variable, k), forms in row.items()
    }


def without_inertia(row: Row, kept: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> Row:
    """Return (15): only what contains a parameter of `kept`, momenta and force elements."""
    return {
        where: {factors: np.where(kept, form, 0.0) for factors, form in forms.items()}
        for where, forms in row.items()
        if where[0] != "acceleration"
    }


def coupled_groups(rows: tuple[Row, ...]) -> tuple[tuple[int, ...], ...]:
    """Return the gimbals whose equations are coupled when Omega is given, group by group."""
    coupled = np.zeros((len(rows), len(rows)), dtype=bool)
    for j, row in enumerate(rows):
        for (variable, k), forms in row.items():
            coupled[j, k] |= variable != "constant" and any(form.any() for form in forms.values())
    return tuple(map(tuple, connected(coupled)))


def _add_squares(into: Forms, rates: tuple[str, ...], slope: FloatArray) -> None:
    """Add −½ Ω_a Ω_b slope_ab."""
    for a in _ROOT:
        _add(into, (rates[a], rates[a]), -0.5 * slope[:, a, a])
        for b in range(a):
            _add(into, (rates[b], rates[a]), -slope[:, a, b])


def _add(into: Forms, factors: Factors, form: FloatArray) -> None:
    kept = without_residue(form)
    if kept.any():
        into[factors] = into[factors] + kept if factors in into else kept
