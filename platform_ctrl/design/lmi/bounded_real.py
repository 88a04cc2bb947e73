"""The bounded real lemma with the controller eliminated (Gahinet and Apkarian 1994), for one plant or several.

Several plants are the vertices of a polytope: they share X and Y, B2, C2, D12 and D21, and each gets its controller.
With X and Y in common the closed loops have one Lyapunov matrix in common, and with the rest in common every convex
combination of them satisfies the same inequality with the same combination of the controllers (Apkarian, Gahinet and
Becker 1995).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.lmi.conic import Solver, cvxpy
from platform_ctrl.design.partition import Partition
from platform_ctrl.errors import IllPosedError

# Largest separation t in [[X, tI], [tI, Y]] ≥ 0.
LARGEST_SEPARATION = 10.0
# What to try after a failure.
CURE = 'give a larger backoff, other weights, or method="riccati"'


@value
class Pair:
    """The solver's gamma, X, Y (n, n) and separation t (1 where gamma was minimised)."""

    gamma: float
    X: FloatArray
    Y: FloatArray
    separation: float


def _sides(plant: Partition) -> tuple[tuple[FloatArray, ...], tuple[FloatArray, ...]]:
    """Return (N1, F, N2, G) of the inequalities of X and of Y.

    The columns of [N1; N2] span the kernel of [B2' D12'], which no controller changes. The inequality of X is
    [[He(N1' X F) − gamma N2' N2, G], [G', −gamma I]] < 0 with F = A' N1 + C1' N2, G = N1' B1 + N2' D11;
    that of Y is its dual.
    """
    out = []
    for p in (plant, plant.dual):
        _, sigma, Vt = np.linalg.svd(np.hstack([p.B2.T, p.D12.T]), full_matrices=True)
        N = Vt[int(np.sum(sigma > 1e-12 * sigma[0])) :].T
        N1, N2 = N[: len(p.A)], N[len(p.A) :]
        out.append((N1, p.A.T @ N1 + p.C1.T @ N2, N2, N1.T @ p.B1 + N2.T @ p.D11))
    return out[0], out[1]


def inequalities(plant: Partition, gamma: float, X: FloatArray, Y: FloatArray) -> dict[str, FloatArray]:
    """Return matrices that are all negative definite only if some closed-loop norm is below `gamma`."""
    out = {}
    for name, V, (N1, F, N2, G) in zip(("X", "Y"), (X, Y), _sides(plant), strict=True):
        half = N1.T @ V @ F - 0.5 * gamma * N2.T @ N2
        out[f"inequality of {name}"] = np.block([[half + half.T, G], [G.T, -gamma * np.eye(G.shape[1])]])
    one = np.eye(len(X))
    out["coupling of X and Y"] = -np.block([[X, one], [one, Y]])
    return out


def coupled(X: Any, Y: Any, t: Any) -> Any:
    """Return the constraint [[X, tI], [tI, Y]] ≥ 0."""
    one = np.eye(X.shape[0])
    return cvxpy().bmat([[X, t * one], [t * one, Y]]) >> 0


def minimised(plants: Sequence[Partition], solver: Solver, tolerance: float) -> Pair:
    """Return the least gamma for which the inequalities hold for every plant, with X and Y."""
    cp = cvxpy()
    n = len(plants[0].A)
    X, Y, gamma = cp.Variable((n, n), symmetric=True), cp.Variable((n, n), symmetric=True), cp.Variable()
    constraints = [coupled(X, Y, 1.0), *_constraints(plants, X, Y, gamma, 0.0)]
    solver.solve(cp.Minimize(gamma), constraints, (X, Y, gamma), "minimising gamma", tolerance)
    return Pair(gamma=float(gamma.value), X=X.value, Y=Y.value, separation=1.0)


def separated(
    plants: Sequence[Partition],
    gamma: float,
    margin: float,
    bound: float,
    reward: float,
    solver: Solver,
    tolerance: float,
) -> Pair:
    """Return X and Y for which the inequalities hold at `gamma` and [[X, tI], [tI, Y]] ≥ 0 with the largest t.

    Parameters
    ----------
    plants, gamma, solver, tolerance
        As in `minimised`.
    margin
        Distance of the inequalities from zero.
    bound, reward
        Largest mean eigenvalue of X and of Y, and its weight in the goal beside t.
    """
    cp = cvxpy()
    n = len(plants[0].A)
    X, Y, t = cp.Variable((n, n), symmetric=True), cp.Variable((n, n), symmetric=True), cp.Variable()
    mean_X, mean_Y = cp.trace(X) / n, cp.trace(Y) / n
    constraints = [coupled(X, Y, t), *_constraints(plants, X, Y, gamma, margin)]
    constraints += [t <= LARGEST_SEPARATION, mean_X <= bound, mean_Y <= bound]
    goal, step = cp.Maximize(t + reward * (mean_X + mean_Y)), f"separating X and Y at gamma = {gamma:.6g} (scaled)"
    solver.solve(goal, constraints, (X, Y, t), step, tolerance)
    return Pair(gamma=gamma, X=X.value, Y=Y.value, separation=float(t.value))


def _constraints(plants: Sequence[Partition], X: Any, Y: Any, gamma: Any, margin: float) -> list[Any]:
    cp = cvxpy()
    constraints = []
    for plant in plants:
        for V, (N1, F, N2, G) in zip((X, Y), _sides(plant), strict=True):
            half = N1.T @ V @ F
            block = cp.bmat([[half + half.T - gamma * (N2.T @ N2), G], [G.T, -gamma * np.eye(G.shape[1])]])
            constraints.append(block << -margin * np.eye(block.shape[0]))
    return constraints


def balancing(pair: Pair) -> FloatArray:
    """Return states T, x = T x', in which X and Y are equal and diagonal: there the solver is most accurate."""
    values, vectors = np.linalg.eigh(pair.X)
    root = vectors * np.sqrt(np.maximum(values, 1e-10 * values[-1]))
    products, turn = np.linalg.eigh(root.T @ pair.Y @ root)
    products = np.maximum(products, 1.0)
    return np.asarray(root @ turn / products**0.25)


def turned(plant: Partition, T: FloatArray) -> Partition:
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


def reconstructed(plant: Partition, r: int, s: int, best: Pair, P: object) -> StateArrays:
    """Return a controller from strictly feasible X and Y; r and s are the ranks of D12 and D21 (Gahinet 1996).

    In the variables Â, B̂, Ĉ of the linearised inequality, Ĉ satisfies the part of X, B̂ that of Y, and Â cancels the
    cross term.
    """
    p, gamma, X, Y = plant, best.gamma, best.X, best.Y
    D = _feedthrough(p, r, s, gamma)
    Dc = p.D11 + p.D12 @ D @ p.D21
    nz, nw = Dc.shape
    weight = np.linalg.inv(np.block([[gamma * np.eye(nw), -Dc.T], [-Dc, gamma * np.eye(nz)]]))

    through = p.A + p.B2 @ D @ p.C2
    Bc, Cc = p.B1 + p.B2 @ D @ p.D21, p.C1 + p.D12 @ D @ p.C2
    seen = np.vstack([np.zeros((nw, p.D12.shape[1])), p.D12])
    C, Mx = _gain(p.A @ X, p.B2, np.vstack([Bc.T, p.C1 @ X]), seen, weight, r, P)
    seen = np.vstack([p.D21.T, np.zeros((nz, p.D21.shape[0]))])
    Bt, My = _gain(p.A.T @ Y, p.C2.T, np.vstack([p.B1.T @ Y, Cc]), seen, weight, s, P)
    A = -through.T - My.T @ weight @ Mx
    return from_linearised(plant, X, Y, StateArrays(A=A, B=Bt.T, C=C, D=D))


def from_linearised(plant: Partition, X: FloatArray, Y: FloatArray, hat: StateArrays) -> StateArrays:
    """Return the controller from the linearising variables Â, B̂, Ĉ, D̂ (Scherer, Gahinet and Chilali 1997)."""
    p, D = plant, hat.D
    N, M = factors(X, Y)
    BK = np.linalg.solve(N, hat.B - Y @ p.B2 @ D)
    CK = np.linalg.solve(M, (hat.C - D @ p.C2 @ X).T).T
    inner = hat.A - Y @ (p.A + p.B2 @ D @ p.C2) @ X - N @ BK @ p.C2 @ X - Y @ p.B2 @ CK @ M.T
    AK = np.linalg.solve(M, np.linalg.solve(N, inner).T).T
    return StateArrays(A=np.asarray(AK), B=np.asarray(BK, dtype=np.float64), C=np.asarray(CK, dtype=np.float64), D=D)


def _feedthrough(p: Partition, r: int, s: int, gamma: float) -> FloatArray:
    """Return D_K with |D11 + D12 D_K D21| < gamma: the central solution of Parrott's problem."""
    U1, V1 = p.D12[:, :r], p.D21[:s].T
    U0, V0 = np.linalg.svd(U1)[0][:, r:], np.linalg.svd(V1)[0][:, s:]
    a, b, c, d = U0.T @ p.D11 @ V0, U0.T @ p.D11 @ V1, U1.T @ p.D11 @ V0, U1.T @ p.D11 @ V1
    D = np.zeros((p.D12.shape[1], p.D21.shape[0]))
    D[:r, :s] = -d - c @ np.linalg.solve(gamma**2 * np.eye(a.shape[1]) - a.T @ a, a.T @ b)
    return D


def _gain(
    AX: FloatArray, B: FloatArray, M0: FloatArray, E: FloatArray, weight: FloatArray, rank: int, P: object
) -> tuple[FloatArray, FloatArray]:
    """Return F with He(AX + B F) + M' weight M < 0, and M = M0 + E F; E is zero beyond `rank` columns."""
    F = np.zeros((B.shape[1], AX.shape[0]))
    regular = E[:, :rank]
    F[:rank] = -np.linalg.solve(
        regular.T @ weight @ regular, B[:, :rank].T + regular.T @ weight @ M0
    )  # the minimum of the quadratic form
    M = M0 + E @ F
    left = AX + B @ F
    left = left + left.T + M.T @ weight @ M
    singular = B[:, rank:]
    if not singular.size:
        return F, M
    # Signals that are not in z directly may be used without limit (Finsler): as little as is enough, doubled.
    gain = 1e-3
    while np.linalg.eigvalsh(left - 2 * gain * singular @ singular.T)[-1] >= 0:
        gain *= 2
        if gain > 1e12:
            raise IllPosedError(
                "lmi: no finite gain of the channels that D12 or D21 leave out satisfies the inequalities; "
                "give a larger backoff, or add a small weight on every control and a small noise on every measurement",
                P,
            )
    F[rank:] = -2 * gain * singular.T
    return F, M
