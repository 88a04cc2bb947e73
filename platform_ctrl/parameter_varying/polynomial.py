"""Matrices that are polynomial in Omega and affine in Omega'."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.arguments import known_name, real_array
from platform_ctrl.description import OMEGA_NAMES
from platform_ctrl.frozen import FloatArray, value
from platform_ctrl.signatures import check_arguments

_VARIABLES = (*OMEGA_NAMES, *(f"{name}'" for name in OMEGA_NAMES))


def _name(factors: tuple[int, ...]) -> str:
    """Name of a product of at most two of Omega1..3, or of one of Omega1'..3'; the factors are sorted."""
    if len(factors) == 2 and factors[0] == factors[1]:
        return f"{_VARIABLES[factors[0]]}^2"
    return "*".join(_VARIABLES[k] for k in factors) or "1"


_PAIRS = tuple(itertools.combinations_with_replacement(range(3), 2))
_FACTORS = {_name(factors): factors for factors in ((), (0,), (1,), (2,), *_PAIRS, (3,), (4,), (5,))}


@value
class MatrixPolynomial:
    """A matrix that is polynomial in Omega and affine in Omega'.

    Attributes
    ----------
    monomials
        Those that occur, such as ``"1"``, ``"Omega1"``, ``"Omega1^2"``, ``"Omega1*Omega2"``, ``"Omega1'"``.
    coefficients : (monomials, ...)
        Their coefficient matrices, SI units.

    References
    ----------
    As `parameter_varying`.
    """

    monomials: tuple[str, ...]
    coefficients: FloatArray

    def at(self, Omega: ArrayLike, Omega_dot: ArrayLike | None = None) -> FloatArray:
        """Return the matrix at a rate and its derivative.

        Parameters
        ----------
        Omega : (3,)
            rad/s.
        Omega_dot : (3,)
            rad/s²; default zero.

        Returns
        -------
        (...)
            In SI units.

        Raises
        ------
        ArgumentError
            Wrong shape or not finite.
        """
        values = monomial_values(self.monomials, Omega, Omega_dot)
        return np.asarray(np.tensordot(values, self.coefficients, axes=1))

    def part(self, *rows: Sequence[int]) -> MatrixPolynomial:
        """Return the polynomial of some rows (and columns, and so on).

        Parameters
        ----------
        *rows
            Indices along each axis.

        Returns
        -------
        MatrixPolynomial
            With the same monomials.

        Notes
        -----
        The arguments are not judged.
        """
        chosen = self.coefficients[np.ix_(range(len(self.monomials)), *rows)]
        return polynomial(dict(zip(self.monomials, chosen, strict=True)), chosen.shape[1:])

    def __getitem__(self, monomial: str) -> FloatArray:
        """Return the coefficient of a monomial, zero where it does not occur; an unknown name is an ArgumentError."""
        if monomial in self.monomials:
            return np.asarray(self.coefficients[self.monomials.index(monomial)])
        known_name("monomial", monomial, tuple(_FACTORS))
        return np.zeros(self.coefficients.shape[1:])


@check_arguments
def monomial_values(
    monomials: Sequence[str], Omega: ArrayLike = (0.0, 0.0, 0.0), Omega_dot: ArrayLike | None = None
) -> FloatArray:
    """Return the values of named monomials at a rate and its derivative.

    Parameters
    ----------
    monomials
        Names such as ``"1"``, ``"Omega1^2"``, ``"Omega1*Omega2"``, ``"Omega1'"``.
    Omega : (3,)
        rad/s.
    Omega_dot : (3,)
        rad/s²; default zero.

    Returns
    -------
    (monomials,)
        In SI units.

    Raises
    ------
    ArgumentError
        Wrong shape, not finite, or a name that is no monomial.

    References
    ----------
    Own definition.
    """
    variables = np.concatenate([real_array("Omega", Omega, (3,)), real_array("Omega_dot", Omega_dot, (3,), 0.0)])
    for name in monomials:
        if name not in _FACTORS:
            known_name("monomial", name, tuple(_FACTORS))
    values = [math.prod(variables[k] for k in _FACTORS[name]) for name in monomials]
    return np.array(values, dtype=np.float64)


def polynomial(terms: Mapping[str, FloatArray], shape: tuple[int, ...]) -> MatrixPolynomial:
    """Return the sum of coefficient times monomial, without the monomials whose coefficient is zero."""
    occurring = tuple(name for name in _FACTORS if name in terms and np.any(terms[name]))
    stack = np.array([terms[name] for name in occurring], dtype=np.float64)
    return MatrixPolynomial(monomials=occurring, coefficients=stack.reshape(len(occurring), *shape))


def total(*parts: MatrixPolynomial) -> MatrixPolynomial:
    """Return the sum of polynomials of one shape."""
    out: dict[str, FloatArray] = {}
    for part in parts:
        for name in part.monomials:
            out[name] = out.get(name, 0.0) + part[name]
    return polynomial(out, parts[0].coefficients.shape[1:])


def product(first: MatrixPolynomial, second: MatrixPolynomial) -> MatrixPolynomial:
    """Return the matrix product of two polynomials that are affine in Omega."""
    out: dict[str, FloatArray] = {}
    for left, right in itertools.product(first.monomials, second.monomials):
        name = _name(tuple(sorted(_FACTORS[left] + _FACTORS[right])))
        out[name] = out.get(name, 0.0) + first[left] @ second[right]
    return polynomial(out, (first.coefficients.shape[1], second.coefficients.shape[2]))
