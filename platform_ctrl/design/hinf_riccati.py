"""H-infinity synthesis by two Riccati equations (Glover and Doyle 1988), on a scaled plant.

The central controller for a general D11, in the normal form D12 = [0; I], D21 = [0, I], which the scaling and a
rotation of z and w give exactly; formulae as in Zhou, Doyle and Glover, Robust and Optimal Control (1996),
theorem 17.1.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import schur

from platform_ctrl.design.partition import Partition, Realisation
from platform_ctrl.design.scaling import ScaledPlant, clustered, unscale
from platform_ctrl.errors import DesignError
from platform_ctrl.frozen import FloatArray, value

if TYPE_CHECKING:
    from control import StateSpace

# The least gamma is found to this relative accuracy.
ACCURACY = 1e-8
# Least and largest gamma of the scaled plant that are tried.
LEAST_GAMMA, LARGEST_GAMMA = 1e-6, 1e8
# Eigenvalues of a Hamiltonian matrix nearer to the imaginary axis than this share of its norm lie on it.
AXIS = 1e-10
# Largest relative asymmetry of a Riccati solution before it is made symmetric.
SYMMETRY = 1e-6


@value
class Solution:
    """Stabilising solutions X and Y of the two Riccati equations at `gamma`, and ``excess`` = rho(X Y) / gamma² − 1."""

    gamma: float
    X: FloatArray
    Y: FloatArray
    excess: float


def hinf_riccati(scaled: ScaledPlant, backoff: float, P: StateSpace) -> tuple[Realisation, float, dict[str, float]]:
    """Controller in the units of the plant that was scaled, the least gamma, and the residuals (scaled).

    Raises
    ------
    DesignError
        D12 or D21 loses rank, the plant has an invariant zero on the imaginary axis, or no gamma is large enough;
        `P` is attached.
    """
    for rank, number, name, shape, cure in (
        (scaled.control_rank, scaled.plant.B2.shape[1], "D12", "column", "a small weight on every control in z"),
        (scaled.measurement_rank, scaled.plant.C2.shape[0], "D21", "row", "a small noise on every measurement in w"),
    ):
        if rank < number:
            raise DesignError(
                f"hinf, riccati: {name} has {shape} rank {rank}; expected full {shape} rank {number}; "
                f'add {cure}, or give method="lmi", which needs no rank',
                P,
            )
    normal = _normal_form(scaled.plant)
    _require_no_zero_on_axis(normal, scaled.rate, P)
    least = _least_gamma(normal, P)
    best = _solution(normal, (1 + backoff) * least)
    if best is None or best.excess >= 0:
        raise DesignError(
            f"hinf, riccati: no solution at {1 + backoff:.6g} times the least gamma {least * scaled.gain:.6g}; "
            'expected one; give a larger backoff, or method="lmi"',
            P,
        )
    residual = {"spectral radius of X Y over gamma squared": 1 + float(best.excess)}
    for name, H, V in zip("XY", _hamiltonians(normal, best.gamma), (best.X, best.Y), strict=True):
        one = np.eye(len(V))
        error = np.hstack([-V, one]) @ H @ np.vstack([one, V])
        residual[f"relative residual of the Riccati equation of {name}"] = float(
            np.linalg.norm(error) / (1 + np.linalg.norm(V)) / np.linalg.norm(H)
        )
    try:
        made = _central(normal, best)
    except np.linalg.LinAlgError:
        raise DesignError(
            f"hinf, riccati: the controller at gamma = {best.gamma * scaled.gain:.6g} is not finite; "
            'give a larger backoff, or method="lmi"',
            P,
        ) from None
    return unscale(made, scaled), least * scaled.gain, residual


def _require_no_zero_on_axis(p: Partition, rate: float, P: StateSpace) -> None:
    """Raise a DesignError where [A − jωI, B2; C1, D12] or [A − jωI, B1; C2, D21] loses rank."""
    size = max(1.0, float(np.linalg.norm(p.A, 2)))
    for A, B, C, D, names, kind in (
        (p.A, p.B2, p.C1, p.D12, "[A − jωI, B2; C1, D12]", "column"),
        (p.A.T, p.C2.T, p.B1.T, p.D21.T, "[A − jωI, B1; C2, D21]", "row"),
    ):
        # D'D = I: zeros are eigenvalues of A − B D'C.
        for zero in clustered(np.linalg.eigvals(A - B @ D.T @ C), size):
            if abs(zero.real) > 1e-7 * size:
                continue
            shifted = A - 1j * zero.imag * np.eye(len(A))
            if np.linalg.svd(np.block([[shifted, B], [C, D]]), compute_uv=False)[-1] < 1e-10 * size:
                raise DesignError(
                    f"hinf, riccati: {names} loses {kind} rank at {abs(zero.imag) * rate:.4g} rad/s; expected no zero "
                    'on the imaginary axis; shift the weight with that pole or zero to the left, or give method="lmi"',
                    P,
                )


def _normal_form(plant: Partition) -> Partition:
    """Rotate z and w so that D12 = [0; I] and D21 = [0, I]; norms do not notice."""
    nu, ny = plant.D12.shape[1], plant.D21.shape[0]
    U = np.hstack([np.linalg.svd(plant.D12)[0][:, nu:], plant.D12])
    V = np.hstack([np.linalg.svd(plant.D21.T)[0][:, ny:], plant.D21.T])
    return Partition(
        A=plant.A, B1=plant.B1 @ V, B2=plant.B2, C1=U.T @ plant.C1, C2=plant.C2,
        D11=U.T @ plant.D11 @ V, D12=U.T @ plant.D12, D21=plant.D21 @ V, D22=plant.D22,
    )  # fmt: skip


def _hamiltonians(p: Partition, gamma: float) -> tuple[FloatArray, FloatArray]:
    """Hamiltonian matrices of X and Y, (2n, 2n)."""
    out = []
    for A, B1, B2, C1, D11, D12 in (
        (p.A, p.B1, p.B2, p.C1, p.D11, p.D12),
        (p.A.T, p.C1.T, p.C2.T, p.B1.T, p.D11.T, p.D21.T),
    ):
        B, D = np.hstack([B1, B2]), np.hstack([D11, D12])
        R = D.T @ D
        R[np.diag_indices(B1.shape[1])] -= gamma**2
        column = np.vstack([B, -C1.T @ D])
        row = np.hstack([D.T @ C1, B.T])
        H = np.block([[A, np.zeros_like(A)], [-C1.T @ C1, -A.T]])
        out.append(H - column @ np.linalg.solve(R, row))
    return out[0], out[1]


def _stabilising(H: FloatArray) -> FloatArray | None:
    """Stabilising solution of a Hamiltonian matrix's Riccati equation; None where none is positive semidefinite."""
    n = len(H) // 2
    try:
        T, U, stable = schur(H, output="real", sort="lhp")
        # Eigenvalues on the axis come out on either side of it, sometimes n on each.
        if stable != n or np.min(np.abs(np.diag(T))) < AXIS * np.linalg.norm(H):
            return None
        X = np.linalg.solve(U[:n, :n].T, U[n:, :n].T).T
    except np.linalg.LinAlgError:
        return None
    # Then their subspace is not Lagrangian.
    if not np.linalg.norm(X - X.T) <= SYMMETRY * np.linalg.norm(X):
        return None
    X = 0.5 * (X + X.T)
    values = np.linalg.eigvalsh(X)
    return X if np.all(np.isfinite(values)) and values[0] >= -1e-7 * abs(values[-1]) else None


def _solution(p: Partition, gamma: float) -> Solution | None:
    """X and Y at `gamma`; None where one of them does not exist."""
    try:
        H, J = _hamiltonians(p, gamma)
    except np.linalg.LinAlgError:
        return None
    X = _stabilising(H)
    if X is None:
        return None
    Y = _stabilising(J)
    if Y is None:
        return None
    radius = float(np.max(np.abs(np.linalg.eigvals(X @ Y)), initial=0.0))
    return Solution(gamma=gamma, X=X, Y=Y, excess=radius / gamma**2 - 1)


def _floor(p: Partition) -> float:
    """What no controller can undercut: the largest singular value of the rows and columns of D11 out of its reach."""
    z, w = p.D11.shape[0] - p.D12.shape[1], p.D11.shape[1] - p.D21.shape[0]
    return float(max(np.linalg.norm(p.D11[:z], 2) if z else 0.0, np.linalg.norm(p.D11[:, :w], 2) if w else 0.0))


def _least_gamma(p: Partition, P: StateSpace) -> float:
    """Least gamma: a secant on the coupling rho(X Y) / gamma² = 1 where both ends have solutions, else bisection."""
    floor = max(_floor(p), LEAST_GAMMA)
    gamma = max(1.0, 2 * floor)
    high = _solution(p, gamma)
    while high is None or high.excess >= 0:
        gamma *= 4
        if gamma > LARGEST_GAMMA * max(1.0, floor):
            raise DesignError(
                "hinf, riccati: no gamma is large enough for both Riccati equations; expected unstable modes well "
                'within reach of u and y and no zeros near the imaginary axis; give method="lmi"',
                P,
            )
        high = _solution(p, gamma)
    low, low_excess = floor, None  # not reached; an excess only where X and Y exist
    top, top_excess = high.gamma, high.excess
    last = ""
    for _ in range(100):
        if top - low <= ACCURACY * top:
            break
        if low_excess is None:
            middle = np.sqrt(low * top) if low > 1e-3 * top else 0.1 * top
        else:
            middle = top - top_excess * (top - low) / (top_excess - low_excess)
            middle = min(max(middle, low + 0.1 * ACCURACY * top), top - 0.1 * ACCURACY * top)
        trial = _solution(p, middle)
        if trial is not None and trial.excess < 0:
            if last == "top" and low_excess is not None:
                low_excess *= 0.5
            top, top_excess, last = middle, trial.excess, "top"
        else:
            if last == "low":
                top_excess *= 0.5
            low, low_excess, last = middle, None if trial is None else trial.excess, "low"
    return top


def _central(p: Partition, best: Solution) -> Realisation:
    """The central controller; the names follow theorem 17.1, with 1 and 2 for the parts of the controller's ports."""
    gamma, X, Y = best.gamma, best.X, best.Y
    nw, nz, nu, ny = p.B1.shape[1], p.C1.shape[0], p.B2.shape[1], p.C2.shape[0]
    w, z = nw - ny, nz - nu
    B, C = np.hstack([p.B1, p.B2]), np.vstack([p.C1, p.C2])
    Drow, Dcol = np.hstack([p.D11, p.D12]), np.vstack([p.D11, p.D21])
    R = Drow.T @ Drow
    R[np.diag_indices(nw)] -= gamma**2
    Rt = Dcol @ Dcol.T
    Rt[np.diag_indices(nz)] -= gamma**2
    F = -np.linalg.solve(R, Drow.T @ p.C1 + B.T @ X)
    L = -np.linalg.solve(Rt, Dcol @ p.B1.T + C @ Y).T
    F12, F2 = F[w:nw], F[nw:]
    L12, L2 = L[:, z:nz], L[:, nz:]
    a, b, c, d = p.D11[:z, :w], p.D11[:z, w:], p.D11[z:, :w], p.D11[z:, w:]
    square = gamma**2 * np.eye(z) - a @ a.T
    D11 = -c @ a.T @ np.linalg.solve(square, b) - d
    E12 = np.eye(nu) - c @ np.linalg.solve(gamma**2 * np.eye(w) - a.T @ a, c.T)  # D̂12 D̂12'
    E21 = np.eye(ny) - b.T @ np.linalg.solve(square, b)  # D̂21' D̂21
    D12, D21 = np.linalg.cholesky(E12), np.linalg.cholesky(E21).T
    Z = np.linalg.inv(np.eye(len(X)) - Y @ X / gamma**2)
    B2 = Z @ (p.B2 + L12) @ D12
    C2 = -D21 @ (p.C2 + F12)
    B1 = -Z @ L2 + B2 @ np.linalg.solve(D12, D11)
    C1 = F2 + D11 @ np.linalg.solve(D21, C2)
    A = p.A + B @ F + B1 @ np.linalg.solve(D21, C2)
    return Realisation(A=A, B=B1, C=C1, D=D11)
