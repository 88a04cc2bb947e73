"""Matrices that are polynomial in Omega and affine in Omega', and state space that is affine in their monomials."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.common.arguments import distinct, known_name, real_array
from platform_ctrl.common.values import FloatArray, replaced, value
from platform_ctrl.mechanics.kinematics import topology
from platform_ctrl.mechanics.linearisation import Terms, beyond, inertia_rounding, linearise, momentum_rounding
from platform_ctrl.mechanics.matrices import inverse_inertia
from platform_ctrl.mechanics.state_space import NamedMatrices
from platform_ctrl.plant.platform import OMEGA_NAMES, Platform

if TYPE_CHECKING:
    import control

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
    """

    monomials: tuple[str, ...]
    coefficients: FloatArray

    def at(self, Omega: ArrayLike, Omega_dot: ArrayLike | None = None) -> FloatArray:
        """Return the matrix at a rate (3,), rad/s, and its derivative (3,), rad/s², zero by default; in SI units."""
        values = monomial_values(self.monomials, Omega, Omega_dot)
        return np.asarray(np.tensordot(values, self.coefficients, axes=1))

    def part(self, *rows: Sequence[int]) -> MatrixPolynomial:
        """Return the polynomial of some rows (and columns, and so on): indices along each axis."""
        chosen = self.coefficients[np.ix_(range(len(self.monomials)), *rows)]
        return polynomial(dict(zip(self.monomials, chosen, strict=True)), chosen.shape[1:])

    def __getitem__(self, monomial: str) -> FloatArray:
        """Return the coefficient of a monomial, zero where it does not occur; an unknown name is an ArgumentError."""
        if monomial in self.monomials:
            return np.asarray(self.coefficients[self.monomials.index(monomial)])
        known_name("monomial", monomial, tuple(_FACTORS))
        return np.zeros(self.coefficients.shape[1:])


def monomial_values(monomials: Sequence[str], Omega: ArrayLike, Omega_dot: ArrayLike | None) -> FloatArray:
    """Return the values of named monomials at a rate, rad/s, and its derivative, rad/s², (monomials,).

    Names are such as ``"1"``, ``"Omega1^2"``, ``"Omega1*Omega2"``, ``"Omega1'"``.
    """
    variables = np.concatenate([real_array("Omega", Omega, (3,)), real_array("Omega_dot", Omega_dot, (3,), 0.0)])
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


def without_elements(platform: Platform) -> Platform:
    """Return the platform without force elements and without weight."""
    acting = ("springs", "servos", "frictions", "cages", "compliances", "unbalances", "erections")
    still = {name: np.zeros(3) for name in ("specific_force", "gravity")}
    return replaced(platform, dict.fromkeys(acting, ()) | still)


def row_polynomials(platform: Platform, q: FloatArray, terms: Terms) -> list[MatrixPolynomial]:
    """Return G (n, n), K (n, n) and Q0 (n,) about the angles q (n,) at constant Omega, without force elements.

    They are of second degree in Omega: found from their values at rest, at unit rates and at sums of two.
    """
    tree, bare, one = topology(platform), without_elements(platform), np.eye(3)
    shared = momentum_rounding(tree) + inertia_rounding(tree)

    def at(Omega: FloatArray) -> list[FloatArray]:
        model = linearise(bare, Omega, terms, q)
        return [model.G, model.K, model.Q0]

    still, ahead, back = at(np.zeros(3)), [at(rate) for rate in one], [at(-rate) for rate in one]
    both = {(a, b): at(one[a] + one[b]) for a, b in itertools.combinations(range(3), 2)}
    out = []
    for k, rounding in enumerate((shared, shared, np.diag(shared))):
        found = {"1": still[k]}
        for a, name in enumerate(OMEGA_NAMES):
            found[name] = 0.5 * (ahead[a][k] - back[a][k])
            found[f"{name}^2"] = 0.5 * (ahead[a][k] + back[a][k]) - still[k]
        for (a, b), sums in both.items():
            found[_name((a, b))] = sums[k] - ahead[a][k] - ahead[b][k] + still[k]
        out.append(polynomial({name: beyond(part, rounding) for name, part in found.items()}, still[k].shape))
    return out


def acceleration_part(platform: Platform, q: FloatArray, terms: Terms) -> MatrixPolynomial:
    """Return the coefficient of q from Omega' about the angles q (n,): all of it, or C alone as the paper has it."""
    turning = linearise(without_elements(platform), terms=terms, q=q).M_Omega_q
    shared = inertia_rounding(topology(platform))
    return polynomial({f"{a}'": beyond(turning[:, k], shared) for k, a in enumerate(OMEGA_NAMES)}, (len(q),) * 2)


@value
class AffineModel:
    """ẋ = (A_0 + Σ rho_i A_i) x + B u, y = C x: the state matrix affine in the monomials that occur.

    Attributes
    ----------
    parameters
        Names of the monomials rho.
    A_0, A
        Constant part and coefficients, in the units of the states over s and the monomials. Shapes (2k, 2k),
        (parameters, 2k, 2k).
    B, C
        Constant, in SI units. Shapes (2k, inputs), (k, 2k).
    states, inputs, outputs
        Signal names.
    """

    parameters: tuple[str, ...]
    A_0: FloatArray
    A: FloatArray
    B: FloatArray
    C: FloatArray
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]

    def state_matrix(self, parameters: ArrayLike) -> FloatArray:
        """Return A (2k, 2k) at values of the monomials (parameters,), SI units."""
        rho = real_array("parameters", parameters, (len(self.parameters),))
        return np.asarray(self.A_0 + np.tensordot(rho, self.A, axes=1))

    def system(self, parameters: ArrayLike) -> control.StateSpace:
        """Return the system at values of the monomials (parameters,), which need not belong to any Omega."""
        names = (distinct(kind, getattr(self, kind)) for kind in ("inputs", "outputs", "states"))
        A, D = self.state_matrix(parameters), np.zeros((len(self.C), self.B.shape[1]))
        return NamedMatrices(A, self.B, self.C, D, *names).state_space()


@value
class FrozenSystem:
    """The model frozen at one point: a vertex of the parameters' box or a point of a grid.

    Attributes
    ----------
    parameters : (parameters,)
        Values of the monomials, in the order of `AffineModel.parameters`, SI units.
    system
        The control.StateSpace.
    Omega, Omega_dot : (3,)
        The rate, rad/s, and its derivative, rad/s², at a grid point; None at a vertex, which need not belong to any.
    """

    parameters: FloatArray
    system: control.StateSpace
    Omega: FloatArray | None = None
    Omega_dot: FloatArray | None = None


def momentum_slope(K: MatrixPolynomial) -> MatrixPolynomial:
    """∂A*/∂q Omega, (k, k), from the Omega' terms of K: how the momenta of resting gimbals change with the angles."""
    return polynomial({name: K[f"{name}'"] for name in OMEGA_NAMES}, K.coefficients.shape[1:])


def affine_model(
    rows: tuple[FloatArray, MatrixPolynomial, MatrixPolynomial],
    angles: tuple[str, ...],
    torquers: Mapping[str, int],
    *,
    momenta: bool,
) -> AffineModel:
    """Return the form of the `rows` M, G, K; `torquers` are names with their rows, p is M q̇ or all `momenta`."""
    M, G, K = rows
    k = len(M)
    one = polynomial({"1": inverse_inertia(M, angles)}, (k, k))
    minus, zero = polynomial({"1": -np.eye(k)}, (k, k)), polynomial({}, (k, k))
    if momenta:
        # q̇ = M⁻¹ (p − N q), ṗ = (N − G) q̇ − K q: the Omega' terms of K are the derivative of N.
        slope = momentum_slope(K)
        rates = [product(minus, product(one, slope)), one]
        rest = total(slope, product(minus, G))
        constant = {name: K[name] for name in K.monomials if not name.endswith("'")}
        stiffness = product(minus, polynomial(constant, (k, k)))
        blocks = [rates, [total(stiffness, product(rest, rates[0])), product(rest, one)]]
        driven = range(2 * k)
    else:
        # ṗ = −G q̇ − K q
        blocks = [[zero, one], [product(minus, K), product(minus, product(G, one))]]
        driven = range(k, 2 * k)
    whole = total(*(_placed(block, i, j) for i, row in enumerate(blocks) for j, block in enumerate(row)))
    parameters = tuple(name for name in whole.monomials if name != "1")
    B = np.hstack([np.zeros((2 * k, len(torquers))), np.eye(2 * k)[:, driven]])
    for column, row in enumerate(torquers.values()):
        B[k + row, column] = 1.0
    states = (*angles, *(f"p_{angle}" for angle in angles))
    return AffineModel(
        parameters=parameters,
        A_0=whole["1"],
        A=np.array([whole[name] for name in parameters]).reshape(-1, 2 * k, 2 * k),
        B=B,
        C=np.eye(k, 2 * k),
        states=states,
        inputs=(*torquers, *(f"d_{states[j]}" for j in driven)),
        outputs=angles,
    )


def _placed(block: MatrixPolynomial, i: int, j: int) -> MatrixPolynomial:
    """Put a (k, k) block into its place in a (2k, 2k) matrix."""
    count, k, _ = block.coefficients.shape
    out = np.zeros((count, 2 * k, 2 * k))
    out[:, i * k : (i + 1) * k, j * k : (j + 1) * k] = block.coefficients
    return dataclasses.replace(block, coefficients=out)
