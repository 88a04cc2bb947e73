"""The equations of a platform as a value that holds SymPy matrices."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import sympy
from numpy.typing import ArrayLike

from platform_ctrl.common.arguments import known_name, real_array
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError
from platform_ctrl.mechanics.symbolic.expressions import Expression
from platform_ctrl.mechanics.symbolic.names import NamedSymbol
from platform_ctrl.mechanics.symbolic.options import Terms
from platform_ctrl.plant.platform import Platform

RowTerms = tuple[tuple[Expression, Expression], ...]

# Keys of `Equations.rows`, with the paper's numbers.
PARTIALLY_LINEAR, LINEAR, PRECESSION = "partially_linear", "linear", "precession"


@value
class Equations:
    """The equations of a platform in symbols. Matrices are SymPy's `ImmutableDenseMatrix`.

    Attributes
    ----------
    platform, order, terms
        What was asked for.
    symbols
        Every symbol: its name, meaning, unit and number.
    q, rates, accelerations : (n, 1)
        Gimbal angles and their derivatives.
    Omega, Omega_dot : (3, 1)
        Rate of the root and its derivative.
    velocity : (3 + n, 1)
        u = [Omega, q̇] (20).
    forces : (3 + n, 1)
        [M, Q].
    L : (m, 1)
        Angular momenta (22); for free rotors p.
    A_R : (m, m)
        diag(C) of the regulated rotors.
    B0, B_A : (m, 3 + n)
        B at zero angles and the rest (21).
    A, BtA_RB, A_star, G_A, G_R, G_root : (3 + n, 3 + n)
        (23), (24), (12), (25), (26), and the Boltzmann-Hamel term of the root.
    rows
        By equation: for each gimbal the terms (coefficient, variable) of the left side whose sum is Q; the variable
        is an acceleration, a rate, an angle, or 1.
    groups
        Gimbals whose equations are coupled when Omega is given.
    notes
        What a reader has to know: what was left out, where (15) is singular.
    """

    platform: Platform
    order: int | None
    terms: Terms
    symbols: tuple[NamedSymbol, ...]
    q: Expression
    rates: Expression
    accelerations: Expression
    Omega: Expression
    Omega_dot: Expression
    velocity: Expression
    forces: Expression
    L: Expression
    A_R: Expression
    B0: Expression
    B_A: Expression
    A: Expression
    BtA_RB: Expression
    A_star: Expression
    G_A: Expression
    G_R: Expression
    G_root: Expression
    rows: Mapping[str, tuple[RowTerms, ...]]
    groups: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...]

    @property
    def B(self) -> Expression:
        """B0 + B_A, (m, 3 + n)."""
        return self.B0 + self.B_A

    @property
    def partially_linear(self) -> tuple[Expression, ...]:
        """(27): one `Eq` a gimbal, linear in the angles for any Omega(t); gimbal coordinates on the left."""
        return self._equations(PARTIALLY_LINEAR)

    @property
    def linear(self) -> tuple[Expression, ...]:
        """(19): one `Eq` a gimbal, linear in Omega as well."""
        return self._equations(LINEAR)

    @property
    def precession(self) -> tuple[Expression, ...]:
        """(15): one `Eq` a gimbal, (27) with rotors' momenta and force elements alone."""
        return self._equations(PRECESSION)

    def row_terms(self, gimbal: str, equation: str = PARTIALLY_LINEAR) -> RowTerms:
        """Return the terms (coefficient, variable) of a gimbal's left side; their sum is Q.

        Parameters
        ----------
        gimbal
            Its name in the plant.
        equation
            ``"partially_linear"`` (27), ``"linear"`` (19) or ``"precession"`` (15).

        Returns
        -------
        RowTerms
            In the symbols of these equations.
        """
        known_name("equation", equation, tuple(self.rows))
        return self.rows[equation][known_name("gimbal", gimbal, self.platform.gimbal_names)]

    def numbers(self) -> dict[Expression, float]:
        """Return the platform's number of every symbol that has one: ``expression.subs(equations.numbers())``."""
        return {sympy.Symbol(s.name): s.value for s in self.symbols if s.value is not None}

    def evaluate(
        self,
        expression: Expression,
        q: ArrayLike | None = None,
        velocity: ArrayLike | None = None,
        velocity_dot: ArrayLike | None = None,
        values: Mapping[str, float] | None = None,
    ) -> FloatArray:
        """Return the number of an expression, or the array of a matrix, at a state.

        Parameters
        ----------
        expression
            In the symbols of these equations.
        q : (n,)
            Angles, rad; default zero.
        velocity, velocity_dot : (3 + n,)
            [Omega, q̇] and its derivative, SI; default zero.
        values
            Numbers of further symbols by name (torques), SI, or in place of the platform's own.

        Returns
        -------
        (...)
            As the expression's shape, SI.
        """
        n = len(self.platform.gimbals)
        point = {symbol.name: number for symbol, number in self.numbers().items()}
        for symbols, name, given in (
            (self.q, "q", q),
            (self.velocity, "velocity", velocity),
            ([*self.Omega_dot, *self.accelerations], "velocity_dot", velocity_dot),
        ):
            shape = (n if name == "q" else 3 + n,)
            point |= dict(zip((s.name for s in symbols), real_array(name, given, shape, 0.0).tolist(), strict=True))
        point |= values or {}
        known: dict[Any, float] = {}
        if isinstance(expression, sympy.MatrixBase):
            cells = [_number(cell, point, known) for cell in expression]
            return np.array(cells, dtype=np.float64).reshape(expression.shape)
        return np.asarray(_number(sympy.sympify(expression), point, known), dtype=np.float64)

    def _equations(self, name: str) -> tuple[Expression, ...]:
        out = []
        for terms, torque in zip(self.rows[name], list(self.forces)[3:], strict=True):
            left = sympy.Add(*(c * v for c, v in terms if v != 1))
            right = torque - sympy.Add(*(c for c, v in terms if v == 1))
            out.append(sympy.Eq(left, right, evaluate=False))
        return tuple(out)


def _number(expression: Expression, point: Mapping[str, float], known: dict[Any, float]) -> float:
    """Evaluate sums, products, powers, sines and cosines; faster on long sums than substituting."""
    if expression in known:
        return known[expression]
    if expression.is_Symbol:
        if expression.name not in point:
            raise ArgumentError(f"values: {expression.name!r} has no number; give one: values={{name: number}}")
        return float(point[expression.name])
    if expression.is_Number:
        return float(expression)
    parts = [_number(part, point, known) for part in expression.args]
    if expression.is_Add:
        out = sum(parts)
    elif expression.is_Mul:
        out = float(np.prod(parts))
    elif expression.is_Pow:
        out = parts[0] ** parts[1]
    elif expression.func in (sympy.sin, sympy.cos):
        out = float(np.sin(parts[0]) if expression.func is sympy.sin else np.cos(parts[0]))
    else:
        out = float(sympy.N(expression.func(*parts)))
    known[expression] = out
    return out
