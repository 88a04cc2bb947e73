"""Series and linear forms -> SymPy expressions, collected by equal linear forms."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from fractions import Fraction
from functools import lru_cache
from typing import Any, Protocol

import numpy as np
import sympy

from platform_ctrl.common.values import FloatArray
from platform_ctrl.mechanics.kinematics import cross_matrix
from platform_ctrl.mechanics.symbolic.names import NamedSymbol

Monomial = tuple[int, ...]
Series = dict[Monomial, FloatArray]

ONE: Monomial = ()

# Axes have length 1: a coefficient this small is what rounding leaves of zero.
_RESIDUE = 1e-14


class Algebra(Protocol):
    """How monomials multiply, and what a rotation is made of."""

    def times(self, left: Monomial, right: Monomial) -> tuple[tuple[float, Monomial], ...]:
        """Return the product of two monomials as a sum; empty where it is cut off."""

    def derivative(self, monomial: Monomial, angle: int) -> tuple[tuple[float, Monomial], ...]:
        """Return the derivative in an angle as a sum."""

    def rotation(self, angle: int, axis: FloatArray) -> Series:
        """Return the rotation by `angle` about `axis` (3,), coefficients (3, 3)."""


class Taylor:
    """Monomials (i, j, ...) stand for the product q_i q_j ...; products beyond `order` are zero."""

    def __init__(self, order: int) -> None:
        self.order = order

    def times(self, left: Monomial, right: Monomial) -> tuple[tuple[float, Monomial], ...]:
        """Return the product, or nothing beyond the order."""
        if len(left) + len(right) > self.order:
            return ()
        return ((1.0, tuple(sorted(left + right))),)

    def derivative(self, monomial: Monomial, angle: int) -> tuple[tuple[float, Monomial], ...]:
        """Return what is left when one factor is taken away."""
        count = monomial.count(angle)
        if not count:
            return ()
        at = monomial.index(angle)
        return ((float(count), monomial[:at] + monomial[at + 1 :]),)

    def rotation(self, angle: int, axis: FloatArray) -> Series:
        """Return the exponential series of q [axis]×."""
        turn = cross_matrix(axis)
        power, out = np.eye(3), {ONE: np.eye(3)}
        for degree in range(1, self.order + 1):
            power = power @ turn / degree
            out[(angle,) * degree] = power
        return out


class Trigonometric:
    """2 k means sin q_k, 2 k + 1 means cos q_k; cos² is written 1 − sin², so that the form is unique."""

    def times(self, left: Monomial, right: Monomial) -> tuple[tuple[float, Monomial], ...]:
        """Return the product with cos² replaced."""
        twice = [factor for factor in left if factor % 2 and factor in right]
        if not twice:
            return ((1.0, tuple(sorted(left + right))),)
        rest = [factor for factor in left + right if factor not in twice]
        terms = [(1.0, rest)]
        for cosine in twice:
            terms += [(-factor, [*others, cosine - 1, cosine - 1]) for factor, others in terms]
        return tuple((factor, tuple(sorted(others))) for factor, others in terms)

    def derivative(self, monomial: Monomial, angle: int) -> tuple[tuple[float, Monomial], ...]:
        """Return the derivative by the product rule."""
        sine, cosine = 2 * angle, 2 * angle + 1
        others = tuple(factor for factor in monomial if factor not in (sine, cosine))
        sines, cosines = monomial.count(sine), monomial.count(cosine)
        out: list[tuple[float, Monomial]] = []
        if sines:
            # d(s^a c^b) = a s^(a−1) c^(b+1) − b s^(a+1) c^(b−1), b = 0 or 1
            lower = others + (sine,) * (sines - 1)
            out += [(sines * f, m) for f, m in self.times(tuple(sorted((*lower, *(cosine,) * cosines))), (cosine,))]
        if cosines:
            out.append((-1.0, tuple(sorted((*others, *(sine,) * (sines + 1))))))
        return tuple(out)

    def rotation(self, angle: int, axis: FloatArray) -> Series:
        """Return a aᵀ + sin q [a]× − cos q [a]×²."""
        turn = cross_matrix(axis)
        return {ONE: np.eye(3) + turn @ turn, (2 * angle,): turn, (2 * angle + 1,): -turn @ turn}


def add(into: Series, terms: Series, factor: float = 1.0) -> None:
    """Add factor × terms to a series in place."""
    for monomial, coefficient in terms.items():
        if monomial in into:
            into[monomial] = into[monomial] + factor * coefficient
        else:
            into[monomial] = factor * coefficient


def product(
    algebra: Algebra, left: Series, right: Series, of: Callable[[FloatArray, FloatArray], FloatArray]
) -> Series:
    """Return the product of two series whose coefficients multiply by `of`, without what is zero but for rounding."""
    out: Series = {}
    for a, x in left.items():
        for b, y in right.items():
            terms = algebra.times(a, b)
            if not terms:
                continue
            coefficient = of(x, y)
            for factor, monomial in terms:
                add(out, {monomial: coefficient}, factor)
    return pruned(out)


def pruned(series: Series) -> Series:
    """Return the series without coefficients that are zero but for rounding."""
    cleared = {monomial: without_residue(coefficient) for monomial, coefficient in series.items()}
    return {monomial: coefficient for monomial, coefficient in cleared.items() if coefficient.any()}


def without_residue(coefficient: FloatArray) -> FloatArray:
    """Return the array with zeros where there is only what rounding leaves of them."""
    return np.where(np.abs(coefficient) < _RESIDUE, 0.0, coefficient)


def apply(series: Series, function: Callable[[FloatArray], FloatArray]) -> Series:
    """Return the series with a linear function applied to every coefficient."""
    return pruned({monomial: function(coefficient) for monomial, coefficient in series.items()})


def derivative(algebra: Algebra, series: Series, angle: int) -> Series:
    """Return the derivative in an angle."""
    out: Series = {}
    for monomial, coefficient in series.items():
        for factor, left in algebra.derivative(monomial, angle):
            add(out, {left: coefficient}, factor)
    return pruned(out)


def up_to(series: Series, order: int | None) -> Series:
    """Return the terms of a Taylor series up to a degree; with None all."""
    return series if order is None else {m: c for m, c in series.items() if len(m) <= order}


Expression = Any  # SymPy ships no types

# Coefficients of simple axes are fractions of small numbers (Taylor's factorials); others stay floats.
_DENOMINATOR = 1000
_ROUNDING = 2e-15

# Longer sums, and those with floats, stay in the order of their symbols: to bring them into its own takes SymPy ten
# times as long.
_SHORT = 8


@lru_cache(maxsize=65536)
def exact_number(number: float) -> Expression:
    """Return a SymPy number: rational where the float is one of small numbers but for rounding."""
    near = Fraction(number).limit_denominator(_DENOMINATOR)
    if abs(number - near) <= _ROUNDING * abs(number):
        return sympy.Rational(near.numerator, near.denominator)
    return sympy.Float(number)


class Writer:
    """Writes expressions in the symbols of one platform.

    Attributes
    ----------
    symbols
        SymPy symbols by name, and ``"1/f"``.
    """

    def __init__(
        self, parameters: tuple[NamedSymbol, ...], angles: tuple[NamedSymbol, ...], trigonometric: bool
    ) -> None:
        self._parameters = [sympy.Symbol(s.name) for s in parameters]
        self._angles = [sympy.Symbol(s.name) for s in angles]
        self._trigonometric = trigonometric
        self._monomials: dict[Monomial, Expression] = {ONE: sympy.S.One}

    def monomial(self, monomial: Monomial) -> Expression:
        """Return a product of angles, or of their sines and cosines."""
        if monomial not in self._monomials:
            factors = [self._factor(i) for i in monomial]
            self._monomials[monomial] = sympy.Mul(*factors)
        return self._monomials[monomial]

    def _factor(self, i: int) -> Expression:
        if not self._trigonometric:
            return self._angles[i]
        return (sympy.cos if i % 2 else sympy.sin)(self._angles[i // 2])

    def form(self, form: FloatArray) -> Expression:
        """Return a linear form in the parameters."""
        at = np.flatnonzero(form)
        numbers = [exact_number(float(form[p])) for p in at]
        terms = [_multiple(number, self._parameters[p]) for number, p in zip(numbers, at, strict=True)]
        short = len(terms) <= _SHORT and all(number.is_Rational for number in numbers)
        return sympy.Add(*terms, evaluate=short or len(terms) < 2)

    def collected(self, terms: Iterable[tuple[Expression, FloatArray]]) -> Expression:
        """Return Σ factor × form; factors of forms that are multiples of each other share one bracket."""
        groups: dict[bytes, tuple[FloatArray, list[tuple[float, Expression]]]] = {}
        for factor, form in terms:
            ratio, basic = _split(without_residue(form))
            if not ratio:
                continue
            _, members = groups.setdefault(np.round(basic, 12).tobytes(), (basic, []))
            members.append((ratio, factor))
        return sympy.Add(*(self._bracketed(basic, members) for basic, members in groups.values()))

    def _bracketed(self, form: FloatArray, members: list[tuple[float, Expression]]) -> Expression:
        """Return form × Σ ratio × factor, with a number before it that all ratios are multiples of."""
        common, _ = _split(np.array([ratio for ratio, _ in members]))
        inside = sympy.Add(*(exact_number(ratio / common) * factor for ratio, factor in members))
        return sympy.Mul(exact_number(common), self.form(form), inside)

    def numeric_matrix(self, series: Series, shape: tuple[int, int], skip: Monomial | None = None) -> Expression:
        """Return a matrix whose coefficients are numbers, without the monomial `skip`."""
        cells: list[Expression] = [sympy.S.Zero] * (shape[0] * shape[1])
        for i, j in np.ndindex(*shape):
            terms = [exact_number(float(c[i, j])) * self.monomial(m) for m, c in _sorted(series, skip) if c[i, j]]
            cells[i * shape[1] + j] = sympy.Add(*terms)
        return sympy.ImmutableDenseMatrix(*shape, cells)

    def matrix(self, series: Series, shape: tuple[int, int]) -> Expression:
        """Return a matrix whose coefficients (symbols, rows, columns) are linear forms."""
        stored = _sorted(series)
        used = [np.asarray(coefficient.any(axis=0)) for _, coefficient in stored]
        cells = []
        for i, j in np.ndindex(*shape):
            here = [(m, c[:, i, j]) for (m, c), u in zip(stored, used, strict=True) if u[i, j]]
            cells.append(self.collected((self.monomial(m), form) for m, form in here))
        return sympy.ImmutableDenseMatrix(*shape, cells)

    def contracted(self, series: Series, velocity: list[Expression]) -> Expression:
        """Return Σ coefficient[:, y] velocity_y, collected over monomials and velocities together."""
        terms = [
            (self.monomial(m) * velocity[y], c[:, y]) for m, c in _sorted(series) for y in np.flatnonzero(c.any(axis=0))
        ]
        return self.collected(terms)


def _multiple(number: Expression, symbol: Expression) -> Expression:
    """Return number × symbol as SymPy would, but for its look at what can be said of the number."""
    return symbol if number == 1 else sympy.Mul(number, symbol, evaluate=False)


def _sorted(series: Series, skip: Monomial | None = None) -> list[tuple[Monomial, FloatArray]]:
    return sorted(((m, c) for m, c in series.items() if m != skip), key=lambda item: (len(item[0]), item[0]))


def _split(form: FloatArray) -> tuple[float, FloatArray]:
    """Return a number and a form whose product is `form`: the same form for all its simple multiples."""
    at = np.flatnonzero(form)
    if not len(at):
        return 0.0, form
    lead = float(form[at[0]])
    size = float(np.abs(form[at]).min())
    multiples = form[at] / size
    simple = np.abs(multiples - np.round(multiples)).max() < 1e-12 and np.abs(multiples).max() < _DENOMINATOR
    ratio = np.copysign(size, lead) if simple else np.copysign(1.0, lead)
    return float(ratio), np.where(form == 0.0, 0.0, form / ratio)
