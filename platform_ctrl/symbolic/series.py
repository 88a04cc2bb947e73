"""Polynomials in the angles, or in their sines and cosines, with arrays as coefficients: fast, because without SymPy.

A series maps monomials to arrays. A monomial is a sorted tuple of integers; what they stand for is the algebra's.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

from platform_ctrl.frozen import FloatArray
from platform_ctrl.mechanics.kinematics import cross_matrix

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
    """2 k stands for sin q_k, 2 k + 1 for cos q_k; cos² is written 1 − sin², so that the form is unique."""

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
