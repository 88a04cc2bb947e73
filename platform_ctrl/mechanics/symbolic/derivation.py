"""A platform's equations worked out in polynomials, as a value that holds SymPy matrices."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import sympy
from numpy.typing import ArrayLike

from platform_ctrl.common.arguments import real_array
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError
from platform_ctrl.mechanics.kinematics import topology
from platform_ctrl.mechanics.linearisation import Terms, connected
from platform_ctrl.mechanics.symbolic import symbols as symbolic
from platform_ctrl.plant.platform import Platform

RowTerms = tuple[tuple[symbolic.Expression, symbolic.Expression], ...]

# Trees whose exact trigonometric form can still be read.
_MOST_GIMBALS, _DEEPEST = 5, 3


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
        By equation, ``"partially_linear"`` (27), ``"linear"`` (19), ``"precession"`` (15): for each gimbal the terms
        (coefficient, variable) of the left side whose sum is Q; the variable is an acceleration, a rate, an angle, or
        1.
    groups
        Gimbals whose equations are coupled when Omega is given.
    notes
        What a reader has to know: what was left out, where (15) is singular.
    """

    platform: Platform
    order: int | None
    terms: Terms
    symbols: tuple[symbolic.NamedSymbol, ...]
    q: symbolic.Expression
    rates: symbolic.Expression
    accelerations: symbolic.Expression
    Omega: symbolic.Expression
    Omega_dot: symbolic.Expression
    velocity: symbolic.Expression
    forces: symbolic.Expression
    L: symbolic.Expression
    A_R: symbolic.Expression
    B0: symbolic.Expression
    B_A: symbolic.Expression
    A: symbolic.Expression
    BtA_RB: symbolic.Expression
    A_star: symbolic.Expression
    G_A: symbolic.Expression
    G_R: symbolic.Expression
    G_root: symbolic.Expression
    rows: Mapping[str, tuple[RowTerms, ...]]
    groups: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...]

    @property
    def B(self) -> symbolic.Expression:
        """B0 + B_A, (m, 3 + n)."""
        return self.B0 + self.B_A

    @property
    def partially_linear(self) -> tuple[symbolic.Expression, ...]:
        """(27): one `Eq` a gimbal, linear in the angles for any Omega(t); gimbal coordinates on the left."""
        return self._equations("partially_linear")

    @property
    def linear(self) -> tuple[symbolic.Expression, ...]:
        """(19): one `Eq` a gimbal, linear in Omega as well."""
        return self._equations("linear")

    @property
    def precession(self) -> tuple[symbolic.Expression, ...]:
        """(15): one `Eq` a gimbal, (27) with rotors' momenta and force elements alone."""
        return self._equations("precession")

    def numbers(self) -> dict[symbolic.Expression, float]:
        """Return the platform's number of every symbol that has one: ``expression.subs(equations.numbers())``."""
        return {sympy.Symbol(s.name): s.value for s in self.symbols if s.value is not None}

    def evaluate(
        self,
        expression: symbolic.Expression,
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
        whole = sympy.sympify(expression)
        used = sorted(whole.free_symbols, key=str)
        missing = [s.name for s in used if s.name not in point]
        if missing:
            raise ArgumentError(f"values: {missing[0]!r} has no number; give one: values={{name: number}}")
        found = sympy.lambdify(used, whole, "numpy")(*(float(point[s.name]) for s in used))
        return np.asarray(found, dtype=np.float64).reshape(getattr(whole, "shape", ()))

    def _equations(self, name: str) -> tuple[symbolic.Expression, ...]:
        out = []
        for terms, torque in zip(self.rows[name], list(self.forces)[3:], strict=True):
            left = sympy.Add(*(c * v for c, v in terms if v != 1))
            right = torque - sympy.Add(*(c for c, v in terms if v == 1))
            out.append(sympy.Eq(left, right, evaluate=False))
        return tuple(out)


def derived(platform: Platform, order: int | None, terms: Terms) -> Equations:
    """Return the equations of a platform, matrices to `order` in the angles (None: exact)."""
    return _Derivation(platform, order, terms).equations()


class _Core:
    """The matrices of a platform in polynomials: B (3), A without C, BᵀA_R B and BᵀL."""

    def __init__(self, work: _Derivation, algebra: symbolic.Polynomials, constant_A: bool) -> None:
        tree, self.algebra = work.tree, algebra
        turned = [algebra.rotation(k, axis) for k, axis in enumerate(tree.axes)]
        axes, m, n = algebra.numbers(tree.axes), len(tree.carriers), len(tree.parents)
        self.B = algebra.zeros(m, 3 + n)
        for rotor, carrier in enumerate(tree.carriers):
            self.B[rotor] = self._direction(work, turned, axes, algebra.numbers(tree.spin_axes[rotor]), carrier)
        none = algebra.zeros(3 + n, 3 + n)
        C, L = (
            np.array([none[0, 0] if k is None else algebra.symbol(k) for k in some], dtype=object)
            for some in (work.C, work.L)
        )
        self.B = algebra.cut(self.B)
        self.BtL = algebra.cut(self.B.T @ L) if m else none[0]
        self.BtA_RB = algebra.cut(self.B.T @ (C[:, None] * self.B)) if m else none
        self.A = self._mass(work, turned, axes)
        if constant_A:
            self.A = algebra.at_zero(self.A)
        self.A_star = self.A + self.BtA_RB

    def _direction(
        self, work: _Derivation, turned: list[symbolic.Array], axes: symbolic.Array, axis: symbolic.Array, body: int
    ) -> symbolic.Array:
        """Return the rate of a body about an axis that is fixed in it, by [Omega, q̇]: a row of B (3)."""
        out, k = self.algebra.zeros(3 + len(axes)), int(body) - 1
        while k >= 0:
            out[3 + k] = axis @ axes[k]
            axis, k = self.algebra.product(turned[k], axis), int(work.tree.parents[k])
        out[:3] = axis
        return out

    def _mass(self, work: _Derivation, turned: list[symbolic.Array], axes: symbolic.Array) -> symbolic.Array:
        tree, algebra = work.tree, self.algebra
        n = len(tree.parents)
        forms, joints, moments = algebra.zeros(1 + n, 3, 3), algebra.zeros(1 + n, 3), algebra.zeros(1 + n, 3)
        of_bodies = {at: algebra.symbol(place) for place, at in enumerate(work.of_bodies)}
        for (kind, body, i, j), symbol in of_bodies.items():
            if kind == "inertia":
                forms[body, i, j] = forms[body, j, i] = symbol
            if kind in ("moment", "joint"):
                (moments if kind == "moment" else joints)[body, i] = symbol
        # Inertia and first moment of what each body carries, about its joint, in its axes.
        J, S = [*forms], [*moments]
        for k in reversed(tree.order):
            above, d = 1 + int(tree.parents[k]), joints[1 + k]
            change = algebra.product(turned[k], S[1 + k]) - moments[1 + k]
            both = np.outer(d, change)
            whole = algebra.product(algebra.product(turned[k], J[1 + k]), turned[k].T) - forms[1 + k]
            J[above] = J[above] + whole - both - both.T + np.diag([d @ change + d @ change] * 3)
            S[above] = S[above] + change
        out, P = algebra.zeros(3 + n, 3 + n), algebra.zeros(3, 3 + n)
        out[:3, :3] = J[0]
        P[:, :3] = np.array([_cross(axis, S[0]) for axis in algebra.numbers(np.eye(3))], dtype=object).T
        for k in range(n):
            momentum, push, i = J[1 + k] @ axes[k], _cross(axes[k], S[1 + k]), k
            while i >= 0:
                out[3 + i, 3 + k] = out[3 + k, 3 + i] = momentum @ axes[i]
                momentum, push = algebra.product(turned[i], momentum), algebra.product(turned[i], push)
                momentum, i = momentum + _cross(joints[1 + i], push), int(tree.parents[i])
            out[:3, 3 + k] = out[3 + k, :3] = momentum
            P[:, 3 + k] = push
        for (kind, j, *_), symbol in of_bodies.items():
            if kind == "motor":
                k = int(tree.geared[j])
                b = self._direction(work, turned, axes, axes[k], 1 + int(tree.parents[k]))
                b[3 + k] = b[3 + k] + algebra.numbers(tree.gears[j : j + 1])[0]
                out = out + np.outer(b, b) * symbol
            if kind == "whole":
                out = out - algebra.product(P.T, P) * symbol
        return algebra.cut(out)


class _Derivation:
    """Works out one platform's equations."""

    def __init__(self, platform: Platform, order: int | None, terms: Terms) -> None:
        self.platform, self.order, self.terms = platform, order, terms
        self.tree = tree = topology(platform)
        n, depth = len(platform.gimbals), int(tree.on_path.sum(axis=1).max(initial=0))
        if order is None and (n > _MOST_GIMBALS or depth > _DEEPEST):
            raise ArgumentError(
                f"order: None is possible up to {_MOST_GIMBALS} gimbals, {_DEEPEST} deep, not for {n}, {depth} deep; "
                f"take an order from 0 to 3"
            )
        names = symbolic.SymbolNames()
        self.motion = motion = symbolic.motion_symbols(platform, names)
        self.of_bodies = symbolic.body_symbols(platform, tree, names)
        C, L = symbolic.rotor_symbols(platform, names)
        self._elements, self._notes = symbolic.elements(platform, names)
        self.known = [*self.of_bodies.values(), *(one for one in C if one is not None), *L]
        self.known += [one.symbol for one in self._elements]
        places = {symbol.name: k for k, symbol in enumerate(self.known)}
        self.C = [None if one is None else places[one.name] for one in C]
        self.L = [places[one.name] for one in L]
        self._symbols = [sympy.Symbol(s.name) for s in (*self.known, *motion.moving)]
        self._n = n

    def _algebra(self, order: int | None) -> symbolic.Polynomials:
        return symbolic.Polynomials(len(self.known), self._symbols, self._n, order)

    def equations(self) -> Equations:
        """Return the equations."""
        order, exact, n, motion = self.order, self.terms == "exact", self._n, self.motion
        # (27) needs BᵀL to second order; G_A and G_R are derivatives.
        linear = _Core(self, self._algebra(2 if order is None else max(2, order + 1)), not exact)
        core = _Core(self, self._algebra(None), False) if order is None else linear
        algebra, m = core.algebra, len(self.platform.rotors)
        full = [self._row(linear, j) for j in range(n)]
        select, first = linear.algebra.selected, len(self.known)
        kept = [k for k, s in enumerate(self.known) if s.kind in ("momentum", "element")]
        rows = {
            "partially_linear": full,
            # (19): linear in the angles and in Omega and Omega' together.
            "linear": [select(row, lambda powers: sum(powers[first:]) <= 1) for row in full],
            # (15): only what contains a momentum or the strength of a force element.
            "precession": [select(row, lambda powers: any(powers[k] for k in kept)) for row in full],
        }
        coupled = np.zeros((n, n), dtype=bool)
        for j, row in enumerate(full):
            for at in linear.algebra.split(row, first + 6):
                coupled[j, (at - first - 6) % n if at is not None else j] = True
        groups = tuple(map(tuple, connected(coupled)))
        B0, N = algebra.at_zero(core.B), self._slopes(algebra, core.BtL)  # N of (14)
        shown = {
            "B0": B0,
            "B_A": algebra.cut(core.B - B0, None if order is None else order + 1),
            "A": algebra.cut(core.A, order),
            "BtA_RB": algebra.cut(core.BtA_RB, order),
            "A_star": algebra.cut(core.A_star, order),
            "G_A": algebra.cut(self._coriolis(core), order),
            "G_R": algebra.cut(np.asarray(N - N.T), order),
            "G_root": algebra.cut(self._root_turning(core), order),
        }
        used = algebra.used(*shown["A"].ravel()) | linear.algebra.used(*full)
        listed = [s for k, s in enumerate(self.known) if k in used or s.kind != "inertia"]
        A_R = [sympy.S.Zero if k is None else self._symbols[k] for k in self.C]
        return Equations(
            platform=self.platform,
            order=order,
            terms=self.terms,
            symbols=(*listed, *motion.moving, *motion.torques, *motion.root_torques),
            q=_column(motion.angles),
            rates=_column(motion.rates),
            accelerations=_column(motion.accelerations),
            Omega=_column(motion.Omega),
            Omega_dot=_column(motion.Omega_dot),
            velocity=_column(motion.Omega + motion.rates),
            forces=_column(motion.root_torques + motion.torques),
            L=sympy.ImmutableDenseMatrix(m, 1, [self._symbols[k] for k in self.L]),
            A_R=sympy.ImmutableDenseMatrix(m, m, lambda i, j: A_R[i] if i == j else 0),
            rows={key: tuple(self._written(linear.algebra, row) for row in some) for key, some in rows.items()},
            groups=tuple(tuple(self.platform.gimbal_names[k] for k in group) for group in groups),
            notes=(*self._notes, *self._singular(groups)),
            **{key: algebra.matrix(array) for key, array in shown.items()},
        )

    def _velocity(self, algebra: symbolic.Polynomials) -> symbolic.Array:
        """Return u = [Omega, q̇]."""
        first, n = len(self.known), self._n
        return algebra.symbols([*range(first, first + 3), *range(first + 6 + n, first + 6 + 2 * n)])

    def _slopes(self, algebra: symbolic.Polynomials, column: symbolic.Array) -> symbolic.Array:
        """∂/∂q of a column, root columns zero."""
        N = algebra.zeros(3 + self._n, 3 + self._n)
        for j in range(self._n):
            N[:, 3 + j] = algebra.slope(column, j)
        return N

    def _coriolis(self, core: _Core) -> symbolic.Array:
        """N − ½ Nᵀ with N = ∂(A* u)/∂q (13), root columns of N zero."""
        # The paper differentiates the truncated (24); the exact derivative needs one order more.
        A_star = core.algebra.cut(core.A_star, self.order) if self.terms == "paper" else core.A_star
        momentum = A_star @ self._velocity(core.algebra)
        N = self._slopes(core.algebra, momentum)
        return np.asarray(N - N.T * sympy.QQ(1, 2))

    def _root_turning(self, core: _Core) -> symbolic.Array:
        """−[∂T/∂Omega]× in the root's block; with the paper's terms of the rotors' momentum alone."""
        h = core.BtL[:3]
        if self.terms == "exact" or self.order is None:
            h = h + (core.A_star @ self._velocity(core.algebra))[:3]
        out = core.algebra.zeros(3 + self._n, 3 + self._n)
        for a in range(3):
            b, c = (a + 1) % 3, (a + 2) % 3
            out[a, b], out[b, a] = h[c], -h[c]
        return out

    def _row(self, core: _Core, j: int) -> symbolic.Polynomial:
        """Return the left side of a gimbal row, linear in the angles and their derivatives."""
        algebra, n, first = core.algebra, self._n, len(self.known)
        u, changes = self._velocity(algebra), algebra.symbols(range(first + 3, first + 6 + n))
        q, rates = algebra.symbols(range(first + 6 + 2 * n, first + 6 + 3 * n)), u[3:]
        momentum, half = core.BtL, sympy.QQ(1, 2)
        out = core.A_star[3 + j] @ changes - u @ algebra.slope(core.BtL, j)
        if self.terms == "exact":
            momentum = momentum + core.A_star @ u
            out = out - u @ algebra.slope(core.A_star, j) @ u * half
        own = momentum[3 + j : 4 + j]
        for k in range(n):
            out = out + algebra.slope(own, k)[0] * rates[k]
        for place, element in enumerate(self._elements, first - len(self._elements)):
            constant, angle, rate = map(
                algebra.numbers, (element.constant[j : j + 1], element.angle[j], element.rate[j])
            )
            out = out + (constant[0] + angle @ q + rate @ rates) * algebra.symbol(place)
        out = algebra.cut(np.array([out], dtype=object))[0]
        return algebra.selected(out, lambda powers: sum(powers[first + 6 :]) <= 1)

    def _singular(self, groups: tuple[tuple[int, ...], ...]) -> list[str]:
        """Return a note where G_R, which is skew, is singular: (15) without dampers does not determine the rates."""
        odd = [", ".join(self.platform.gimbal_names[k] for k in group) for group in groups if len(group) % 2]
        singular = "is singular, for it is skew and of odd order; without dampers (15) does not determine the rates"
        return [f"G_R of {'; of '.join(odd)} {singular}"] if odd and self.platform.rotors else []

    def _written(self, algebra: symbolic.Polynomials, row: symbolic.Polynomial) -> RowTerms:
        parts = algebra.split(row, len(self.known) + 6).items()
        return tuple((algebra.written(p), sympy.S.One if at is None else self._symbols[at]) for at, p in parts)


def _cross(a: symbolic.Array, b: symbolic.Array) -> symbolic.Array:
    return np.array([a[i] * b[j] - a[j] * b[i] for i, j in ((1, 2), (2, 0), (0, 1))], dtype=object)


def _column(symbols: tuple[symbolic.NamedSymbol, ...]) -> symbolic.Expression:
    return sympy.ImmutableDenseMatrix(len(symbols), 1, [sympy.Symbol(s.name) for s in symbols])
