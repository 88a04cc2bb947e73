"""Polynomials in the symbols of a platform: cut off beyond an order in the angles, or exact in their sines and cosines.

Vectors and matrices are object arrays of elements of SymPy's sparse polynomial rings.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from typing import Any

import numpy as np
import sympy
from sympy.polys.rings import PolyRing

from platform_ctrl.common.values import FloatArray
from platform_ctrl.mechanics.kinematics import cross_matrix

Expression = Any  # SymPy ships no types
Polynomial = Any
Array = np.ndarray[Any, np.dtype[np.object_]]

# Axes have length 1: a coefficient this small is what rounding leaves of zero.
_RESIDUE = sympy.QQ(1, 10**14)
# Coefficients of simple axes are fractions of small numbers (Taylor's factorials); others stay floats.
_DENOMINATOR, _ROUNDING = 1000, 2e-15


def rational(number: float) -> Fraction:
    """Return the fraction of small numbers that a float is but for rounding, or the float."""
    near = Fraction(number).limit_denominator(_DENOMINATOR)
    return near if abs(number - near) <= _ROUNDING * abs(number) else Fraction(number)


class Polynomials:
    """Polynomials in parameters, in what moves, and in the angles.

    Attributes
    ----------
    symbols
        Of the parameters and of what moves, then of the angles.
    """

    def __init__(self, fixed: int, symbols: Sequence[Expression], angles: int, order: int | None) -> None:
        self.symbols, self._fixed, self._n, self._order = tuple(symbols), fixed, angles, order
        names = [*self.symbols[: len(symbols) - angles]]
        # Exact: sines, then cosines, in place of the angles.
        names += self.symbols[-angles:] * (1 if order is not None else 2) if angles else ()
        self._first = len(symbols) - angles
        self._ring = PolyRing([f"x{k}" for k in range(len(names))], sympy.QQ)
        self._shown = [*self.symbols[: self._first]]
        turns = self.symbols[self._first :]
        self._shown += turns if order is not None else [sympy.sin(q) for q in turns] + [sympy.cos(q) for q in turns]

    def symbol(self, k: int) -> Polynomial:
        """Return a symbol by its place; not an angle of an exact form."""
        return self._ring.gens[k]

    def numbers(self, array: FloatArray) -> Array:
        """Return an array of numbers as polynomials."""
        exact = np.array([self._ring.ground_new(_QQ(rational(float(x)))) for x in array.ravel()], dtype=object)
        return exact.reshape(array.shape)

    def zeros(self, *shape: int) -> Array:
        """Return zeros."""
        return np.full(shape, self._ring.zero, dtype=object)

    def cut(self, array: Array, order: int | None = None) -> Array:
        """Return the array without what lies beyond the order in the angles, and without residues of rounding."""
        return self._each(array, lambda p: self._kept(p, self._order if order is None else order))

    def product(self, left: Array, right: Array) -> Array:
        """Return a matrix product, cut off."""
        return self.cut(np.asarray(left @ right, dtype=object))

    def _each(self, array: Array, function: Any) -> Array:
        out = np.empty(array.shape, dtype=object)
        for place, polynomial in np.ndenumerate(array):
            out[place] = function(polynomial)
        return out

    def _kept(self, polynomial: Polynomial, order: int | None) -> Polynomial:
        terms: dict[tuple[int, ...], Any] = {}
        waiting = list(self._ring(polynomial).items())
        while waiting:
            powers, c = waiting.pop()
            cosine = next((k for k in range(len(powers) - self._n, len(powers)) if powers[k] > 1), None)
            if self._order is None and cosine is not None:
                # cos² = 1 − sin², so that the form is unique.
                rest = [*powers]
                rest[cosine] -= 2
                waiting.append((tuple(rest), c))
                rest[cosine - self._n] += 2
                waiting.append((tuple(rest), -c))
            elif order is None or sum(powers[self._first :]) <= order:
                terms[powers] = terms.get(powers, 0) + c
        return self._ring.from_dict({m: c for m, c in terms.items() if abs(c) > _RESIDUE})

    def slope(self, array: Array, angle: int) -> Array:
        """Return the derivative in an angle."""
        at = self._first + angle
        if self._order is not None:
            return self._each(array, lambda p: p.diff(self._ring.gens[at]))
        sine, cosine = self._ring.gens[at], self._ring.gens[at + self._n]
        return self.cut(self._each(array, lambda p: p.diff(sine) * cosine - p.diff(cosine) * sine))

    def at_zero(self, array: Array) -> Array:
        """Return the value at zero angles."""
        zeros = [(gen, 0) for gen in self._ring.gens[self._first : self._first + self._n]]
        ones = [(gen, 1) for gen in self._ring.gens[self._first + self._n :]]
        return self._each(array, lambda p: p.subs(zeros + ones) if zeros else p)

    def rotation(self, angle: int, axis: FloatArray) -> Array:
        """Return the rotation by an angle about an axis (3,)."""
        turn, at = cross_matrix(axis), self._first + angle
        if self._order is None:
            sine, cosine = self._ring.gens[at], self._ring.gens[at + self._n]
            square = self.numbers(turn @ turn)
            return np.asarray(self.numbers(np.eye(3)) + square + self.numbers(turn) * sine - square * cosine)
        power, out = np.eye(3), self.numbers(np.eye(3))
        for degree in range(1, self._order + 1):
            power = power @ turn / degree
            out = out + self.numbers(power) * self._ring.gens[at] ** degree
        return out

    def split(self, polynomial: Polynomial, places: Sequence[int]) -> dict[int | None, Polynomial]:
        """Return the coefficients of the symbols at these places, and without any of them, of a linear polynomial."""
        out: dict[int | None, dict[tuple[int, ...], Any]] = {}
        for powers, c in polynomial.items():
            degree = sum(powers[k] for k in places)
            if degree <= 1:
                at = next((k for k in places if powers[k]), None)
                rest = tuple(0 if k == at else power for k, power in enumerate(powers))
                out.setdefault(at, {})[rest] = c
        return {at: self._ring.from_dict(terms) for at, terms in out.items()}

    def select(
        self, row: dict[int | None, Polynomial], wanted: Callable[[int | None, tuple[int, ...]], bool]
    ) -> dict[int | None, Polynomial]:
        """Return the terms of a split polynomial that are wanted, by their places and powers of the symbols."""
        return {
            at: self._ring.from_dict({m: c for m, c in polynomial.items() if wanted(at, m)})
            for at, polynomial in row.items()
        }

    def written(self, polynomial: Polynomial) -> Expression:
        """Return the polynomial in SymPy's symbols: parameters collected before what moves."""
        forms: dict[tuple[int, ...], list[Expression]] = {}
        for powers, c in sorted(polynomial.items(), key=lambda item: (sum(item[0]), [-power for power in item[0]])):
            number = rational(float(sympy.QQ.to_sympy(c)))
            simple = number.denominator <= _DENOMINATOR
            factor = sympy.Rational(number.numerator, number.denominator) if simple else sympy.Float(float(number))
            form = sympy.Mul(
                factor, *(self._shown[k] ** power for k, power in enumerate(powers[: self._fixed]) if power)
            )
            forms.setdefault(powers[self._fixed :], []).append(form)
        return sympy.Add(
            *(
                sympy.Add(*form)
                * sympy.Mul(*(self._shown[self._fixed + k] ** power for k, power in enumerate(moving) if power))
                for moving, form in forms.items()
            )
        )

    def matrix(self, array: Array) -> Expression:
        """Return an array as a matrix of SymPy."""
        return sympy.ImmutableDenseMatrix(*array.shape, [self.written(polynomial) for polynomial in array.ravel()])

    def used(self, *arrays: Array) -> set[int]:
        """Return the places of the symbols that occur."""
        return {k for array in arrays for p in array.ravel() for powers in p for k, power in enumerate(powers) if power}


def _QQ(number: Fraction) -> Any:
    return sympy.QQ(number.numerator, number.denominator)
