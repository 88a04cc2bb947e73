"""Linear gimbal equations with some of their accelerations dropped: roots, state equations, distance to the full ones.

Coordinates x with q = T x and Tᵀ M T = 1 bring (19) to

    ẍ + D ẋ + S x + W ω' + g ω = f,        D, S = Tᵀ (G − ∂Q/∂q̇) T, Tᵀ (K − ∂Q/∂q) T,        f = Tᵀ Q

so that D is in rad/s whatever the units of the gimbals: with S = 0 its singular values are the nutation frequencies.
The directions split into N, which keep their momenta π = Nᵀ (ẋ + W ω), H, which are held by a restraint, and the rest U
(all together orthonormal):

    in U   D ẋ + S x + g ω = f               without inertia
    in N   π' = Nᵀ (f − D ẋ − S x − g ω)     with it
    in H   S x + D U Uᵀ ẋ + g ω = f          without inertia, and without damping of its own

Only orthogonality with regard to M makes this right: whatever Uᵀ M N is left would be dropped with the inertia of U.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.mechanics.linearisation import LinearModel
from platform_ctrl.mechanics.matrices import inverse_inertia

ComplexArray = NDArray[np.complex128]

# A stage of the search for roots at zero takes what is this small against the whole for zero.
_ZERO_ROOT = 1e-10

# Against the largest entry of a matrix in x: some 50 machine epsilons, what orthonormal bases and a solve leave where
# there is a 0. Nothing hangs on it but that zeros look like zeros; small true coefficients have to stay.
_NOISE = 1e-14
# Coordinates of a direction this near to the largest are as large: a name must not hang on the last digits of a plant
# file, and the two digits of a coefficient in words do not tell them apart.
_AS_LARGE = 0.999
# A coordinate of a direction with largest coordinate 1 that elimination leaves this small is 0.
_ABSENT = 1e-9


@value
class Scaled:
    """Equations (19) of some gimbals in the coordinates x of this module."""

    # T, back: (n, n): q = T x, x = back q
    T: FloatArray
    back: FloatArray
    # D, S: (n, n): in rad/s and rad²/s²
    D: FloatArray
    S: FloatArray
    # W, g: (n, 3): coefficients of ω' and ω
    W: FloatArray
    g: FloatArray

    @property
    def size(self) -> float:
        """Frequency in which time is measured, rad/s: the largest that D or S makes."""
        n = len(self.D)
        by_spring = np.sqrt(np.linalg.norm(self.S, 2)) if n else 0.0
        return float(max(np.linalg.norm(self.D, 2), by_spring)) if n else 0.0


@value
class Reduction:
    """Directions in x whose acceleration is kept (N) and which a restraint holds (H), (n, k) and (n, h)."""

    N: FloatArray
    H: FloatArray

    @property
    def U(self) -> FloatArray:
        """The other directions, (n, n − k − h)."""
        taken = np.hstack([self.N, self.H])
        vectors = np.linalg.svd(taken, full_matrices=True)[0] if taken.shape[1] else np.eye(len(taken))
        return np.asarray(vectors[:, taken.shape[1] :])


@value
class ReducedEquations:
    """ξ' = A ξ + B f + E ω and x = C ξ + F f + J ω, with ξ = [y, Nᵀ x, π] or, where H is held, ξ = Uᵀ x."""

    A: FloatArray
    B: FloatArray
    E: FloatArray
    C: FloatArray
    F: FloatArray
    J: FloatArray


def scaled(model: LinearModel, rows: Sequence[int]) -> Scaled:
    """Return the equations of the gimbals in `rows` in coordinates of unit inertia."""
    part = np.ix_(rows, rows)
    M = model.M[part]
    inverse_inertia(M, [model.angle_names[k] for k in rows])
    back: FloatArray = np.asarray(np.linalg.cholesky(M).T, dtype=np.float64)
    T: FloatArray = np.asarray(np.linalg.inv(back), dtype=np.float64)
    return Scaled(
        T=T,
        back=back,
        D=T.T @ model.damping[part] @ T,
        S=T.T @ model.stiffness[part] @ T,
        W=T.T @ model.M_Omega[list(rows)],
        g=T.T @ model.G_Omega[list(rows)],
    )


def full_poles(at: Scaled) -> ComplexArray:
    """Return the 2 n poles of the full equations, slowest first."""
    n = len(at.D)
    return roots(at, Reduction(N=np.eye(n), H=np.zeros((n, 0))))[0]


def reduced_equations(at: Scaled, kept: Reduction) -> ReducedEquations:
    """Return the state equations of a reduction; H and N are not both there, and D is regular on U."""
    n = len(at.D)
    U, N, H = kept.U, kept.N, kept.H
    if H.shape[1]:
        # w = Hᵀ x follows from y = Uᵀ x without a derivative; its rate is dropped with its inertia.
        hold = H @ np.linalg.solve(H.T @ at.S @ H, H.T)
        balance = U.T @ (np.eye(n) - at.S @ hold)
        y_dot = np.linalg.solve(balance @ at.D @ U, balance)
        give = hold @ (np.eye(n) - at.D @ U @ y_dot)
        S_U = at.S @ U
        J = -give @ at.g
        return ReducedEquations(A=_clean(-y_dot @ S_U), B=_clean(y_dot), E=-y_dot @ at.g, C=U - give @ S_U, F=give, J=J)
    k = N.shape[1]
    # Columns of everything below: [x, π, f, ω].
    force = np.hstack([-at.S, np.zeros((n, k)), np.eye(n), -at.g])
    z_dot = np.hstack([np.zeros((k, n)), np.eye(k), np.zeros((k, n)), -N.T @ at.W])
    y_dot = np.linalg.solve(U.T @ at.D @ U, U.T @ (force - at.D @ N @ z_dot))
    x_dot = U @ y_dot + N @ z_dot
    both = np.vstack([x_dot, N.T @ (force - at.D @ x_dot)])
    return ReducedEquations(
        A=_clean(both[:, : n + k]),
        B=_clean(both[:, n + k : 2 * n + k]),
        E=_clean(both[:, 2 * n + k :]),
        C=np.hstack([np.eye(n), np.zeros((n, k))]),
        F=np.zeros((n, n)),
        J=np.zeros((n, 3)),
    )


def _clean(matrix: NDArray[np.floating[Any]]) -> FloatArray:
    """Set to 0 what orthonormal bases leave as rounding noise where exact arithmetic has 0."""
    return np.where(np.abs(matrix) > _NOISE * np.abs(matrix).max(initial=0.0), matrix, 0.0)


def roots(at: Scaled, kept: Reduction) -> tuple[ComplexArray, int]:
    """Return the roots of a reduction, slowest first, and the length of the longest chain of vectors at the root 0.

    A length of 1 is a complete set of eigenvectors. Roots at 0 are split off by rank, stage by stage: as eigenvalues
    they would come out as noise of unknown size.
    """
    A = reduced_equations(at, kept).A
    unit, k = at.size or 1.0, kept.N.shape[1]
    # π in units of x times frequency.
    scale = np.concatenate([np.ones(len(A) - k), np.full(k, unit)])
    A = A * scale / scale[:, None]
    tolerance = _ZERO_ROOT * (np.linalg.norm(A, 2) if A.size else 0.0)
    zeros, chain = 0, 0
    while len(A):
        _, values, vectors = np.linalg.svd(A)
        null = int(np.sum(values <= tolerance))
        if not null:
            break
        zeros, chain = zeros + null, chain + 1
        rest = vectors[: len(A) - null]
        A = rest @ A @ rest.T
    found = np.linalg.eigvals(A) if len(A) else np.zeros(0)
    found = found[np.argsort(np.abs(found), kind="stable")]
    return np.concatenate([np.zeros(zeros), found]).astype(np.complex128), chain


def precession_rate(at: Scaled, kept: Reduction) -> float:
    """Return how fast stiffness drives the directions U, ‖∂(Uᵀ ẋ)/∂x‖₂, rad/s.

    Over the nutation frequency it is the error that a spring makes at the lowest frequencies, even if all roots are 0.
    """
    of = reduced_equations(at, kept)
    if kept.U.shape[1] == 0:
        return 0.0
    by_angles = of.A if kept.H.shape[1] else kept.U.T @ of.A[: len(at.D), : len(at.D)]
    return float(np.linalg.norm(by_angles, 2))


def distance(at: Scaled, kept: Reduction, frequency: FloatArray, each: bool) -> FloatArray:
    """Return ‖X_r − X‖₂/‖X‖₂, or with `each` ‖X⁻¹ (X_r − X)‖₂, over frequency; X: torque to angle (or rate) in x.

    Z = X⁻¹ is the dynamic stiffness. X_r − X = X (Z − Z_r) X_r holds the difference without cancellation.
    """
    n = len(at.D)
    if n == 0:
        return np.zeros(len(frequency))
    held = kept.H @ kept.H.T
    inertia = kept.N @ kept.N.T
    s = 1j * frequency[:, None, None]
    Z = s**2 * np.eye(n) + s * at.D + at.S
    Z_r = s**2 * inertia + s * (at.D - at.D @ held) + at.S
    dropped = s**2 * (np.eye(n) - inertia) + s * (at.D @ held)
    left, values, right = np.linalg.svd(Z_r)
    # On a root of the reduction its response, and so the error, is infinite.
    regular = values[:, -1] > 0.0
    values = np.where(regular[:, None], values, 1.0)
    error = dropped @ (_adjoint(right) / values[:, None, :]) @ _adjoint(left)
    if not each:
        left, values, right = np.linalg.svd(Z)
        # X over its norm: finite on a pole of the full equations, too.
        smallest = values[:, -1:]
        share = np.divide(smallest, values, out=np.ones_like(values), where=values > smallest)
        error = (_adjoint(right) * share[:, None, :]) @ _adjoint(left) @ error
    return np.where(regular, np.linalg.norm(error, 2, axis=(1, 2)), np.inf)


def _adjoint(stack: ComplexArray) -> ComplexArray:
    return np.conj(np.swapaxes(stack, 1, 2))


def echelon(rows: FloatArray) -> tuple[FloatArray, list[int]]:
    """Return the same row space by vectors with a 1 where all others have a 0, and where those are, in that order.

    As few coordinates as possible take part in each vector, so that it can be called by their names.
    """
    out = np.array(rows, dtype=np.float64)
    pivots: list[int] = []
    for k in range(len(out)):
        # Among equals the first coordinate.
        size = np.abs(out[k:]).max(axis=0)
        column = int(np.argmax(size >= _AS_LARGE * size.max()))
        row = k + int(np.argmax(np.abs(out[k:, column])))
        out[[k, row]] = out[[row, k]]
        out[k] /= out[k, column]
        others = np.arange(len(out)) != k
        out[others] -= np.outer(out[others, column], out[k])
        pivots.append(column)
    out[np.abs(out) < _ABSENT] = 0.0
    order = np.argsort(pivots)
    return np.asarray(out[order]), [pivots[k] for k in order]
