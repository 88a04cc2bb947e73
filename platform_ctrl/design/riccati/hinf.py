"""H-infinity synthesis by two Riccati equations (Glover and Doyle 1988), on a scaled plant.

The central controller for a general D11, in the normal form D12 = [0; I], D21 = [0, I], which the scaling and a
rotation of z and w give exactly; formulae as in Zhou, Doyle and Glover, Robust and Optimal Control (1996),
theorem 17.1.
"""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.partition import Partition
from platform_ctrl.design.riccati.equations import SOLUTION_ROUNDING, stabilising
from platform_ctrl.design.scaling import (
    ScaledPlant,
    regularised_and_report,
    require_full_rank,
    require_no_zero_on_axis,
    unscale,
)
from platform_ctrl.errors import UnscalableError

if TYPE_CHECKING:
    from control import StateSpace

WHERE = "hinf, riccati"
# The least gamma is found to this relative accuracy.
ACCURACY = 1e-8
# Least and largest gamma of the scaled plant in the search.
LEAST_GAMMA, LARGEST_GAMMA = 1e-6, 1e8
# What replaces an infinite slack, and the largest bound on t from which the first trial is derived.
LARGEST_SLACK, LARGEST_FIRST = 1e14, 1e3
# A slack this many times t belongs to solutions of which one is nearly zero.
NEGLIGIBLE_COUPLING = 1e6
# A solution larger than 1 / this hides a negative eigenvalue in its rounding; at this share of t it is smaller.
NEARLY_INFINITE, SMALLER_T = 1e-5, 1.0 - 1e-3
# Free parameters that are tried, and the largest condition of the loop around D22.
SHARES, LARGEST_LOOP_CONDITION = (0.0, 0.3, -0.3), 1e8
# Largest number of trials of gamma; about six are needed.
MOST_TRIALS = 100
# Eigenvalues this near to the imaginary axis, relative to the norm, give frequencies of a peak.
NEAR_AXIS = 1e-5
# Eigenvalues of the H2 Hamiltonian matrix farther from the axis than this exclude a zero on it.
SAFE_DISTANCE = 1e-5


def hinf_riccati(
    scaled: ScaledPlant, backoff: float, P: StateSpace, regularise: float | None = None
) -> tuple[StateArrays, float, dict[str, float]]:
    """Return the controller in the units of the plant as given, the least gamma, and the residuals (scaled).

    With `regularise` the least gamma is that of the regularised plant; the residuals report what was added.
    """

    def least_gamma(less: ScaledPlant) -> float:
        form = _normal_form(less.plant)
        return _least_gamma(form, _sides(form), less, P) * less.gain

    scaled, extra = regularised_and_report(scaled, regularise, "gamma", least_gamma)
    require_full_rank(scaled, P, WHERE)
    normal = _normal_form(scaled.plant)
    sides = _sides(normal)
    least = _least_gamma(normal, sides, scaled, P)
    best = _trial(sides, ((1 + backoff) * least) ** -2)
    if best.solution is None or best.slack is None or best.slack <= 0.0:
        raise UnscalableError(
            f"{WHERE}: no solution at {1 + backoff:.6g} times the least gamma {least * scaled.gain:.6g}; "
            'give a larger backoff, or method="lmi"',
            P,
        )
    residual = extra | {"spectral radius of X Y over gamma squared": best.t / (best.slack + best.t)}
    for name, side, V in zip("XY", sides, best.solution, strict=True):
        H = side.hamiltonian(best.t)
        one = np.eye(len(V))
        error = np.hstack([-V, one]) @ H @ np.vstack([one, V])
        residual[f"relative residual of the Riccati equation of {name}"] = float(
            np.linalg.norm(error) / (1 + np.linalg.norm(V)) / np.linalg.norm(H)
        )
    for share in SHARES:
        try:
            made = _central(normal, best.t**-0.5, best.solution, share)
            # The loop around D22, which was left out so far, has to stay well posed.
            around = np.linalg.cond(np.eye(len(made.D)) + scaled.control @ made.D @ scaled.measurement @ scaled.D22)
            if around < LARGEST_LOOP_CONDITION:
                return unscale(made, scaled), least * scaled.gain, residual
        except np.linalg.LinAlgError:
            continue
    raise UnscalableError(
        f"{WHERE}: the controllers at gamma = {best.t**-0.5 * scaled.gain:.6g} are not finite; "
        'give a larger backoff, or method="lmi"',
        P,
    )


def _normal_form(plant: Partition) -> Partition:
    """Rotate z and w so that D12 = [0; I] and D21 = [0, I], which keeps the norm."""
    nu, ny = plant.D12.shape[1], plant.D21.shape[0]
    U = np.hstack([np.linalg.svd(plant.D12)[0][:, nu:], plant.D12])
    V = np.hstack([np.linalg.svd(plant.D21.T)[0][:, ny:], plant.D21.T])
    return dataclasses.replace(
        plant, B1=plant.B1 @ V, C1=U.T @ plant.C1, D11=U.T @ plant.D11 @ V, D12=U.T @ plant.D12, D21=plant.D21 @ V
    )


class Side(NamedTuple):
    """The equation of X, or of the dual that of Y, by its Hamiltonian matrix fixed + t column (I − t weight)⁻¹ row.

    D12 is eliminated exactly, v = u + D12'(C1 x + D11 w) in place of u: then a fast pole of a weight on u, which that
    moves to a zero of the weight, is in no other entry.
    """

    fixed: FloatArray
    column: FloatArray
    row: FloatArray
    weight: FloatArray

    def hamiltonian(self, t: float) -> FloatArray:
        """Return H for gamma⁻² = t, also for t = 0."""
        R = np.eye(len(self.weight)) - t * self.weight
        out: FloatArray = self.fixed + t * self.column @ np.linalg.solve(R, self.row)
        return out


def _sides(p: Partition) -> tuple[Side, Side]:
    out = []
    for one in (p, p.dual):
        z = len(one.C1) - one.D12.shape[1]
        A, B1 = one.A - one.B2 @ one.C1[z:], one.B1 - one.B2 @ one.D11[z:]
        C, D = one.C1[:z], one.D11[:z]
        fixed = np.block([[A, -one.B2 @ one.B2.T], [-C.T @ C, -A.T]])
        out.append(Side(fixed, np.vstack([B1, -C.T @ D]), np.hstack([D.T @ C, B1.T]), D.T @ D))
    return out[0], out[1]


class Trial(NamedTuple):
    """What one gamma gives: the solutions, or why there are none."""

    t: float
    # The stabilising X and Y of the two Riccati equations at t = gamma⁻².
    solution: tuple[FloatArray, FloatArray] | None = None
    # 1/rho(X Y) − gamma⁻²: positive where gamma can be reached, negative where the coupling forbids it; None where X or
    # Y does not exist or is not positive semidefinite.
    slack: float | None = None
    # 1/lambda_max of X and of Y, or 1/lambda_min where that is negative: zero at the gamma where they become infinite.
    room: tuple[float, ...] = ()
    # Which side has eigenvalues on the imaginary axis (0 for X, 1 for Y), and their frequencies; else None.
    axis: tuple[int, FloatArray] | None = None
    distance: float = 0.0


def _trial(sides: tuple[Side, Side], t: float) -> Trial:
    found: list[tuple[FloatArray, FloatArray]] = []
    room: list[float] = []
    distance = np.inf
    for k, side in enumerate(sides):
        try:
            H = side.hamiltonian(t)
        except np.linalg.LinAlgError:
            return Trial(t)
        subspace = stabilising(H)
        distance = min(distance, subspace.distance)
        if subspace.X is None:
            near = np.abs(subspace.eigenvalues.real) <= NEAR_AXIS * np.linalg.norm(H)
            return Trial(t, axis=(k, np.unique(np.abs(subspace.eigenvalues.imag[near]))))
        values, vectors = np.linalg.eigh(subspace.X)
        if values[0] < -1e-7 * abs(values[-1]) - SOLUTION_ROUNDING:
            return Trial(t, room=(*room, 1.0 / float(values[0])))
        room.append(1.0 / max(float(values[-1]), 1.0 / LARGEST_SLACK))
        found.append((subspace.X, vectors * np.sqrt(np.maximum(values, 0.0))))
    (X, _), (Y, root) = found
    radius = max(float(np.linalg.eigvalsh(root.T @ X @ root)[-1]), 0.0)
    slack = 1.0 / max(radius, 1.0 / LARGEST_SLACK) - t
    return Trial(t, (X, Y), slack, tuple(room), None, distance)


def _floor(p: Partition) -> float:
    """Return the largest singular value of the rows and columns of D11 that no controller reaches, a lower bound."""
    z, w = p.D11.shape[0] - p.D12.shape[1], p.D11.shape[1] - p.D21.shape[0]
    return float(max(np.linalg.norm(p.D11[:z], 2) if z else 0.0, np.linalg.norm(p.D11[:, :w], 2) if w else 0.0))


def _least_gamma(p: Partition, sides: tuple[Side, Side], scaled: ScaledPlant, P: StateSpace) -> float:  # noqa: PLR0915 - one bisection
    """Search the least gamma in t = gamma⁻² from t = 0 upwards, where X and Y are those of the H2 problem.

    The slack falls with t and is concave, so interpolation finds its zero in a few steps. Where X or Y ceases to exist
    before, the bound is the peak of the response that no control (or no measurement) reaches, and every t beyond it
    gives frequencies nearer to that peak.
    """
    start = _trial(sides, 0.0)
    if start.slack is None or start.distance < SAFE_DISTANCE:
        require_no_zero_on_axis(scaled, P, WHERE)
    if start.slack is None or start.solution is None:
        raise UnscalableError(
            f"{WHERE}: no gamma is large enough for both Riccati equations, which need unstable modes that u moves and "
            'y sees well, and no zeros near the imaginary axis; give method="lmi"',
            P,
        )
    # rho(X Y) grows with t, so that gamma² is at least what rho is at t = 0.
    beyond = min(1.0 / max(_floor(p), LEAST_GAMMA) ** 2, start.slack)
    reached = 0.0
    # The slack, and the room of X and of Y.
    known: list[list[tuple[float, float]]] = [[], [], []]
    _note(known, start)
    t, width = 0.3 * beyond if beyond < LARGEST_FIRST else 1.0, beyond
    for step in range(MOST_TRIALS):
        trial = _trial(sides, t)
        if trial.slack is not None and min(trial.room) < NEARLY_INFINITE and SMALLER_T * t > reached:
            # Past its first infinity a solution has a negative eigenvalue, which the next infinity outshines.
            below = _trial(sides, SMALLER_T * t)
            if below.slack is None:
                trial, t = below, below.t
        informed = bool(trial.room)
        _note(known, trial)
        if trial.slack is not None and trial.slack > 0.0:
            reached = t
        else:
            beyond = min(beyond, t)
            if trial.axis is not None:
                level = _unreached(p, trial.axis[0], start.solution, trial.axis[1])
                informed = level > 0.0 and 1.0 / level**2 < beyond
                beyond = min(beyond, 1.0 / level**2) if informed else beyond
        if beyond - reached <= 2.5 * ACCURACY * beyond:
            break
        # A coupling far below the level is rounding, and grows only where X or Y does: then their room says when.
        far = trial.slack is not None and trial.slack > NEGLIGIBLE_COUPLING * t
        guess = min(map(_zero, known[1:] if far else known))
        if reached == t and t < guess <= t * (1.0 + ACCURACY):
            break
        if step % 4 == 3:
            # Four steps have to halve the interval, whatever the interpolation says.
            informed, width = informed and beyond - reached < 0.5 * width, beyond - reached
        if informed:
            # A little on the side that can be reached.
            t = min(guess * (1.0 - 0.25 * ACCURACY), beyond * (1.0 - ACCURACY))
            t = max(t, reached + 0.25 * (ACCURACY * beyond))
        elif reached > 0.1 * beyond:
            t = 0.5 * (reached + beyond)
        else:
            t = math.sqrt(max(reached, 1e-3 * beyond) * beyond)
        if t < LARGEST_GAMMA**-2:
            break
    if reached == 0.0:
        raise UnscalableError(
            f"{WHERE}: no gamma up to {LARGEST_GAMMA:.0e} in scaled units is reached: an unstable mode is hardly moved "
            'by u or hardly seen by y; give method="lmi"',
            P,
        )
    return 1.0 / math.sqrt(reached)


def _note(known: list[list[tuple[float, float]]], trial: Trial) -> None:
    if trial.slack is not None:
        known[0].append((trial.t, trial.slack))
    for points, room in zip(known[1:], trial.room, strict=False):
        points.append((trial.t, room))


def _zero(known: list[tuple[float, float]]) -> float:
    """Return the zero of a function by inverse interpolation through its last two or three points; inf if undefined."""
    if len(known) < 2:
        return math.inf
    (t0, s0), (t1, s1) = known[-2:]
    if t0 == t1 or (s1 - s0) * (t1 - t0) >= 0.0:
        return math.inf
    secant = t1 - s1 * (t1 - t0) / (s1 - s0)
    if len(known) < 3:
        return secant
    t2, s2 = known[-3]
    if s2 in (s0, s1):
        return secant
    curved = (
        t0 * s1 * s2 / ((s0 - s1) * (s0 - s2))
        + t1 * s0 * s2 / ((s1 - s0) * (s1 - s2))
        + t2 * s0 * s1 / ((s2 - s0) * (s2 - s1))
    )
    # A parabola that disagrees with its chord by more than the chord's own length is not to be trusted.
    return curved if abs(curved - secant) < abs(secant - t1) else secant


def _unreached(p: Partition, side: int, start: tuple[FloatArray, FloatArray], frequencies: FloatArray) -> float:
    """Return the largest gain, at the frequencies and between them, from w to the part of z that no control reaches.

    For the other side, to z from the part of w that no measurement sees. State feedback does not change it; that of the
    H2 problem takes the poles off the axis. The largest along all frequencies is the gamma from which X (or Y) exists.
    """
    if frequencies.size == 0:
        return 0.0
    p = p if side == 0 else p.dual
    B1, B2, D11, D12 = p.B1, p.B2, p.D11, p.D12
    F = -(B2.T @ start[side] + D12.T @ p.C1)
    A, C1 = p.A + B2 @ F, p.C1 + D12 @ F
    # Crossings come at both signs: 0 lies between the first two.
    w = np.concatenate([[0.0], frequencies, 0.5 * (frequencies[1:] + frequencies[:-1])])
    w = np.concatenate([w, np.sqrt(frequencies[1:] * frequencies[:-1])])
    states = np.linalg.solve(1j * w[:, None, None] * np.eye(len(A)) - A, np.hstack([B1, B2]).astype(complex))
    response = C1 @ states + np.hstack([D11, D12])
    G, M = response[..., : B1.shape[1]], response[..., B1.shape[1] :]
    reach = np.linalg.qr(M)[0]
    rest = G - reach @ (np.conj(np.swapaxes(reach, -1, -2)) @ G)
    return float(np.linalg.norm(rest, 2, axis=(-2, -1)).max())


def _central(p: Partition, gamma: float, solution: tuple[FloatArray, FloatArray], share: float) -> StateArrays:
    """Return the controller with the free parameter Q = `share` gamma I of theorem 17.1; |Q| < gamma keeps gamma."""
    X, Y = solution
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
    Q = share * gamma * np.eye(nu, ny)
    return StateArrays(A=A + B2 @ Q @ C2, B=B1 + B2 @ Q @ D21, C=C1 + D12 @ Q @ C2, D=D11 + D12 @ Q @ D21)
