"""State-space form of equations that are polynomial in Omega: the state matrix affine in the monomials."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.common.arguments import distinct, real_array
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.mechanics.matrices import inverse_inertia
from platform_ctrl.mechanics.polynomials import MatrixPolynomial, polynomial, product, total
from platform_ctrl.plant.platform import OMEGA_NAMES

if TYPE_CHECKING:
    import control


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
        import control

        names = {kind: distinct(kind, getattr(self, kind)) for kind in ("states", "inputs", "outputs")}
        A, D = self.state_matrix(parameters), np.zeros((len(self.C), self.B.shape[1]))
        return control.StateSpace(A, self.B, self.C, D, remove_useless_states=False, **names)


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
