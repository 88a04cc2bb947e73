"""H-infinity controllers for a plant, or for the vertices of a polytope with one Lyapunov matrix, on scaled plants.

Three steps: the least gamma over X, Y with the controller eliminated (Gahinet and Apkarian 1994); at (1 + backoff)
times that gamma the pair X, Y that is farthest from X Y = I; from X, Y a controller in closed form for every vertex.
Nothing is assumed about D11, D12 and D21. The inequalities are evaluated again for the solver's result.

The vertices share X and Y, B2, C2, D12 and D21. With X and Y in common the closed loops have one Lyapunov matrix in
common, and with the rest in common every convex combination of them satisfies the same inequality with the same
combination of the controllers (Apkarian, Gahinet and Becker 1995).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.lmi.conic import Solver, cp
from platform_ctrl.design.lmi.linearised import (
    Pair,
    balancing,
    coupled,
    factors,
    from_linearised,
    in_states,
    lyapunov_matrix,
    separated,
)
from platform_ctrl.design.partition import Partition
from platform_ctrl.design.scaling import ScaledPlant, autoscale, unscale, weakest_mode
from platform_ctrl.errors import DesignError, IllPosedError, TimeLimitError, UnscalableError

if TYPE_CHECKING:
    from control import StateSpace

# What to try after a failure.
CURE = 'give a larger backoff, other weights, or method="riccati"'
# Solved again in other units when the least gamma of the scaled plant is not within 1/8 .. 8.
GAMMA_RANGE = 8.0
# Units of gamma that are tried until the first solution succeeds.
GAINS = (1.0, 1e2, 1e-2, 1e4, 1e-4)
# A gamma below this (above its inverse) is not refined.
LEAST_GAIN = 1e-12
# Largest mean eigenvalue of X and of Y, and its least multiple of what gamma alone needs: X and Y are unbounded in some
# directions otherwise.
LARGEST_MEAN = 100.0
LEAST_ROOM = 10.0


class Round(NamedTuple):
    """How the second step is tried."""

    strictness: float  # distance of the inequalities from zero, relative to gamma and the back-off
    # Weight of the mean eigenvalues of X and Y. The separation is that of one direction; where X and Y are small in the
    # others, I − X Y is near singular and the controller has poles ten to a hundred times faster than that of the
    # Riccati route, but large ones hide violations from the solver.
    reward: float
    tolerance: float  # the solver's


# Until everything holds.
ROUNDS = (Round(5e-3, 1e-4, 1e-6), Round(5e-4, 1e-4, 1e-8), Round(5e-5, -1e-4, 1e-8))
LEAST_STRICTNESS = 1e-6
# Tolerances of the first solve, which only serves to find the right states, and of the least gamma.
ROUGH, FINE = 1e-4, 1e-7


@value
class Quadratic:
    """Controllers of the vertices, in the units of the plants, with what they have in common."""

    controllers: tuple[StateArrays, ...]  # one for each plant, in common states
    least: float  # the least gamma
    # (2n, 2n): V > 0 such that d/dt x'V x + (z'z − g² w'w)/g < 0 for [x, xK] in the plants' units, every vertex and
    # every convex combination, g = (1 + backoff) least.
    lyapunov: FloatArray
    residual: dict[str, float]  # how well the inequalities hold (scaled)


def quadratic_hinf(
    plants: Sequence[Partition],
    backoff: float,
    time_limit: float,
    P: object,
    where: str = "hinf, lmi",
    needed: Sequence[int] = (),
) -> Quadratic:
    """Return controllers for plants that share B2, C2, D12, D21 and D22.

    `needed` are indices of plants whose convex hull contains all, by default all of them.
    """
    needed = list(needed) or list(range(len(plants)))
    solver = Solver(where=where, cure=CURE, time_limit=time_limit, P=P)
    scaled, vertices, least = _rough(plants, needed, solver)
    T, failure = np.diag(scaled.state), None
    for attempt in ROUNDS:
        change = balancing(least)
        vertices, T = [in_states(vertex, change) for vertex in vertices], T @ change
        # In these states X = Y; their mean square does not depend on the states.
        own = float(np.sqrt(np.trace(least.X @ least.Y) / len(least.X)))
        bound = max(LARGEST_MEAN, LEAST_ROOM * own)
        try:
            hull = [vertices[k] for k in needed]
            least = minimised(hull, solver, FINE)
            level = (1 + backoff) * least.gamma
            margin = max(LEAST_STRICTNESS, attempt.strictness * min(backoff, 0.02)) * level
            best = _farthest(hull, level, margin, bound, attempt, solver)
            residual = _strict(vertices, best, scaled.gain, solver)
            made = [reconstructed(v, scaled.control_rank, scaled.measurement_rank, best, P) for v in vertices]
        except TimeLimitError:
            raise
        except DesignError as error:
            failure = failure or error
            continue
        V = lyapunov_matrix(best.X, best.Y, *factors(best.X, best.Y))
        n = len(T)
        back = np.eye(2 * n)
        back[:n, :n] = np.linalg.inv(T)
        # Scaled time: x'V x counts in units of 1 / rate.
        V = back.T @ V @ back / scaled.rate
        return Quadratic(
            controllers=tuple(unscale(controller, scaled) for controller in made),
            least=least.gamma * scaled.gain,
            lyapunov=0.5 * (V + V.T),
            residual=residual,
        )
    assert failure is not None
    raise failure


def rescaled(plant: Partition, scaled: ScaledPlant) -> Partition:
    """Return another plant in the units that `autoscale` found for one with the same D22."""
    root, d, S, St = np.sqrt(scaled.gain), scaled.state, scaled.control, scaled.measurement
    D12, D21 = plant.D12 / root @ S, St @ plant.D21 / root
    D12[:, scaled.control_rank :] = 0.0
    D21[scaled.measurement_rank :] = 0.0
    return Partition(
        A=plant.A / scaled.rate / d[:, None] * d, B1=plant.B1 / scaled.rate / root / d[:, None],
        B2=plant.B2 / scaled.rate @ S / d[:, None], C1=plant.C1 / root * d, C2=St @ plant.C2 * d,
        D11=plant.D11 / scaled.gain, D12=D12, D21=D21, D22=scaled.plant.D22,
    )  # fmt: skip


def mean_plant(plants: Sequence[Partition]) -> Partition:
    """Return the plant in the middle."""
    return weighted_mean(plants, np.full(len(plants), 1.0 / len(plants)))


def weighted_mean(plants: Sequence[Partition], weights: ArrayLike) -> Partition:
    """Return a convex combination of plants."""
    shares = np.asarray(weights)
    names = ("A", "B1", "B2", "C1", "C2", "D11", "D12", "D21", "D22")
    parts: dict[str, Any] = {
        name: np.tensordot(shares, np.array([getattr(one, name) for one in plants]), axes=1) for name in names
    }
    return Partition(**parts)


def _strict(vertices: Sequence[Partition], best: Pair, gain: float, solver: Solver) -> dict[str, float]:
    """Return residuals of the solver's X and Y; raise an UnscalableError where an inequality is not strict."""
    residual = {"separation of X and Y": best.separation}
    for vertex in vertices:
        for name, matrix in inequalities(vertex, best.gamma, best.X, best.Y).items():
            largest = float(np.linalg.eigvalsh(matrix)[-1])
            if not largest < 0:
                raise UnscalableError(
                    f"{solver.where}: X and Y from the solver violate the {name} at gamma = {best.gamma * gain:.6g}, "
                    f"its largest eigenvalue is {largest:.2g}; {CURE}",
                    solver.P,
                )
            key = f"largest eigenvalue of the {name}"
            residual[key] = max(largest, residual.get(key, -np.inf))
    return residual


def _rough(
    plants: Sequence[Partition], needed: Sequence[int], solver: Solver
) -> tuple[ScaledPlant, list[Partition], Pair]:
    """Return scaled plants whose least gamma is near one, and the first X and Y."""
    failure: DesignError | None = None
    centre = plants[0] if len(plants) == 1 else mean_plant(plants)

    def attempt(gain: float) -> tuple[ScaledPlant, list[Partition], Pair]:
        scaled = autoscale(centre, gain)
        vertices = [scaled.plant] if len(plants) == 1 else [rescaled(plant, scaled) for plant in plants]
        hull = [vertices[k] for k in needed]
        return scaled, vertices, minimised(hull, solver, ROUGH)

    for gain in GAINS:
        try:
            scaled, vertices, rough = attempt(gain)
            while not 1 / GAMMA_RANGE <= rough.gamma <= GAMMA_RANGE and LEAST_GAIN < scaled.gain < 1 / LEAST_GAIN:
                # Far from one, gamma is inaccurate: a limited step.
                scaled, vertices, rough = attempt(scaled.gain * float(np.clip(rough.gamma, 1e-3, 1e6)))
        except TimeLimitError:
            raise
        except DesignError as error:
            failure = failure or error
            continue
        return scaled, vertices, rough
    sigma, word, pole = weakest_mode(autoscale(centre))
    hint = ""
    if word and sigma < 1e-4:
        hint = (
            f"; the mode at {pole.real:.4g}{pole.imag:+.4g}j rad/s is hardly {word} (smallest singular value "
            f"{sigma:.1g} of the scaled plant)"
        )
    assert failure is not None
    raise type(failure)(f"{failure}{hint}", solver.P) from None


def hinf_lmi(
    plant: Partition, backoff: float, time_limit: float, P: StateSpace
) -> tuple[StateArrays, float, dict[str, float]]:
    """Return the controller in the units of `plant`, the least gamma, and how well the inequalities hold (scaled)."""
    found = quadratic_hinf([plant], backoff, time_limit, P)
    return found.controllers[0], found.least, found.residual


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


def minimised(plants: Sequence[Partition], solver: Solver, tolerance: float) -> Pair:
    """Return the least gamma for which the inequalities hold for every plant, with X and Y."""
    n = len(plants[0].A)
    X, Y, gamma = cp.Variable((n, n), symmetric=True), cp.Variable((n, n), symmetric=True), cp.Variable()
    constraints = [coupled(X, Y, 1.0), *_constraints(plants, X, Y, gamma, 0.0)]
    solver.solve(cp.Problem(cp.Minimize(gamma), constraints), (X, Y, gamma), "minimising gamma", tolerance)
    return Pair(gamma=float(gamma.value), X=X.value, Y=Y.value, separation=1.0)


def _farthest(
    plants: Sequence[Partition], gamma: float, margin: float, bound: float, attempt: Round, solver: Solver
) -> Pair:
    """Return X and Y farthest from X Y = I for which the inequalities hold at `gamma`, by `margin`."""
    n = len(plants[0].A)
    X, Y = cp.Variable((n, n), symmetric=True), cp.Variable((n, n), symmetric=True)
    required, step = _constraints(plants, X, Y, gamma, margin), f"separating X and Y at gamma = {gamma:.6g} (scaled)"
    t = separated(X, Y, required, bound, solver, step, attempt.tolerance, attempt.reward)
    return Pair(gamma=gamma, X=X.value, Y=Y.value, separation=t)


def _constraints(plants: Sequence[Partition], X: Any, Y: Any, gamma: Any, margin: float) -> list[Any]:
    constraints = []
    for plant in plants:
        for V, (N1, F, N2, G) in zip((X, Y), _sides(plant), strict=True):
            half = N1.T @ V @ F
            block = cp.bmat([[half + half.T - gamma * (N2.T @ N2), G], [G.T, -gamma * np.eye(G.shape[1])]])
            constraints.append(block << -margin * np.eye(block.shape[0]))
    return constraints


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
