"""Closed loops that are linear in the unknowns of a matrix inequality, their constraints, and the way back.

With the Lyapunov matrix in the congruent form [[X, I], [I, Y]] the loop of a full-order controller is linear in X, Y
and the transformed controller Â, B̂, Ĉ, D̂ (Scherer, Gahinet and Chilali 1997).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.lmi.conic import Solver, cp
from platform_ctrl.design.lmi.tasks import Region
from platform_ctrl.design.partition import Partition

# Largest separation t in [[X, tI], [tI, Y]] ≥ 0.
LARGEST_SEPARATION = 10.0


class LinearLoop(NamedTuple):
    """V, V A, V B, C and D of a closed loop w -> z, possibly after a congruence; all linear in the unknowns."""

    V: Any
    VA: Any
    VB: Any
    C: Any
    D: Any


def output_feedback(p: Partition, X: Any, Y: Any, hat: StateArrays) -> LinearLoop:
    """Return the loop of a full-order controller with transformed variables `hat`."""
    one = np.eye(len(p.A))
    return LinearLoop(
        V=cp.bmat([[X, one], [one, Y]]),
        VA=cp.bmat([[p.A @ X + p.B2 @ hat.C, p.A + p.B2 @ hat.D @ p.C2], [hat.A, Y @ p.A + hat.B @ p.C2]]),
        VB=cp.vstack([p.B1 + p.B2 @ hat.D @ p.D21, Y @ p.B1 + hat.B @ p.D21]),
        C=cp.hstack([p.C1 @ X + p.D12 @ hat.C, p.C1 + p.D12 @ hat.D @ p.C2]),
        D=p.D11 + p.D12 @ hat.D @ p.D21,
    )


def state_feedback(p: Partition, X: Any, L: Any) -> LinearLoop:
    """Return the loop of u = L X⁻¹ x."""
    return LinearLoop(V=X, VA=p.A @ X + p.B2 @ L, VB=p.B1, C=p.C1 @ X + p.D12 @ L, D=p.D11)


def hinf_below(
    loop: LinearLoop, w: Sequence[int], z: Sequence[int], levels: tuple[Any, Any], margin: float
) -> list[Any]:
    """Constraints: the H-infinity norm from w to z is below the geometric mean of the two levels."""
    w, z = list(w), list(z)
    B, C, D = loop.VB[:, w], loop.C[z, :], loop.D[z, :][:, w]
    block = cp.bmat(
        [
            [loop.VA + loop.VA.T, B, C.T],
            [B.T, -levels[0] * np.eye(len(w)), D.T],
            [C, D, -levels[1] * np.eye(len(z))],
        ]
    )
    return [block << -margin * np.eye(block.shape[0])]


def h2_below(loop: LinearLoop, w: Sequence[int], z: Sequence[int], levels: tuple[Any, Any], margin: float) -> list[Any]:
    """Constraints: the H2 norm from w to z is below the geometric mean of the levels; D must be zero there."""
    w, z = list(w), list(z)
    B, C = loop.VB[:, w], loop.C[z, :]
    block = cp.bmat([[loop.VA + loop.VA.T, B], [B.T, -levels[0] * np.eye(len(w))]])
    Q = cp.Variable((len(z), len(z)), symmetric=True)
    cover = cp.bmat([[loop.V, C.T], [C, Q]])
    return [block << -margin * np.eye(block.shape[0]), cover >> 0, cp.trace(Q) <= levels[1]]


def poles_in(loop: LinearLoop, wanted: Region, margin: float) -> list[Any]:
    """Constraints: all poles lie in the region."""
    L, M = wanted.L, wanted.M
    k = len(L)
    block = cp.bmat([[L[i, j] * loop.V + M[i, j] * loop.VA + M[j, i] * loop.VA.T for j in range(k)] for i in range(k)])
    return [block << -margin * np.eye(block.shape[0])]


@value
class Pair:
    """The solver's gamma, X, Y (n, n) and separation t (1 where gamma was minimised)."""

    gamma: float
    X: FloatArray
    Y: FloatArray
    separation: float


def coupled(X: Any, Y: Any, t: Any) -> Any:
    """Return the constraint [[X, tI], [tI, Y]] ≥ 0."""
    one = np.eye(X.shape[0])
    return cp.bmat([[X, t * one], [t * one, Y]]) >> 0


def separated(
    X: Any, Y: Any, required: list[Any], bound: float, solver: Solver, step: str, tolerance: float, reward: float = 0.0
) -> float:
    """Return the largest t of [[X, tI], [tI, Y]] ≥ 0 under constraints; X and Y then have their values.

    `bound` is the largest mean eigenvalue of X and of Y, `reward` its weight in the goal beside t.
    """
    t, means = cp.Variable(), [cp.trace(V) / V.shape[0] for V in (X, Y)]
    constraints = [coupled(X, Y, t), *required, t <= LARGEST_SEPARATION, *(mean <= bound for mean in means)]
    goal = cp.Maximize(t + reward * sum(means) if reward else t)
    solver.solve(cp.Problem(goal, constraints), (X, Y, t), step, tolerance)
    return float(t.value)


def balancing(pair: Pair) -> FloatArray:
    """Return states T, x = T x', in which X and Y are equal and diagonal: there the solver is most accurate."""
    values, vectors = np.linalg.eigh(pair.X)
    root = vectors * np.sqrt(np.maximum(values, 1e-10 * values[-1]))
    products, turn = np.linalg.eigh(root.T @ pair.Y @ root)
    products = np.maximum(products, 1.0)
    return np.asarray(root @ turn / products**0.25)


def in_states(plant: Partition, T: FloatArray) -> Partition:
    """Return the plant in the states x', x = T x'."""
    Ti = np.linalg.inv(T)
    return dataclasses.replace(
        plant, A=Ti @ plant.A @ T, B1=Ti @ plant.B1, B2=Ti @ plant.B2, C1=plant.C1 @ T, C2=plant.C2 @ T
    )


def factors(X: FloatArray, Y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return N and M with I − Y X = N M', of equal size: the states of the controller."""
    U, sigma, Vt = np.linalg.svd(np.eye(len(X)) - Y @ X)
    root = np.sqrt(sigma)
    return U * root, Vt.T * root


def lyapunov_matrix(X: FloatArray, Y: FloatArray, N: FloatArray, M: FloatArray) -> FloatArray:
    """Return V (2n, 2n) of the closed loop in the states [x, xK]: Y is its first block, X that of its inverse."""
    one, none = np.eye(len(X)), np.zeros_like(X)
    # V [X, I; M', 0] = [I, Y; 0, N']
    V = np.linalg.solve(np.block([[X, one], [M.T, none]]).T, np.block([[one, Y], [none, N.T]]).T).T
    return np.asarray(0.5 * (V + V.T))


def from_linearised(plant: Partition, X: FloatArray, Y: FloatArray, hat: StateArrays) -> StateArrays:
    """Return the controller from the linearising variables Â, B̂, Ĉ, D̂ (Scherer, Gahinet and Chilali 1997)."""
    p, D = plant, hat.D
    N, M = factors(X, Y)
    BK = np.linalg.solve(N, hat.B - Y @ p.B2 @ D)
    CK = np.linalg.solve(M, (hat.C - D @ p.C2 @ X).T).T
    inner = hat.A - Y @ (p.A + p.B2 @ D @ p.C2) @ X - N @ BK @ p.C2 @ X - Y @ p.B2 @ CK @ M.T
    AK = np.linalg.solve(M, np.linalg.solve(N, inner).T).T
    return StateArrays(A=np.asarray(AK), B=np.asarray(BK, dtype=np.float64), C=np.asarray(CK, dtype=np.float64), D=D)
