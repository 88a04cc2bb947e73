"""H-infinity synthesis by linear matrix inequalities (Gahinet and Apkarian 1994), on a scaled plant.

Three steps: the least gamma over X, Y with the controller eliminated; at (1 + backoff) times that gamma the pair X, Y
that stays farthest from X Y = I; and from X, Y a controller in closed form (Gahinet 1996).
Nothing is assumed about D11, D12 and D21. What the solver says is not believed: the inequalities are evaluated again.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from platform_ctrl.design.lmi.conic import solve
from platform_ctrl.design.partition import Partition, Realisation
from platform_ctrl.design.scaling import ScaledPlant, autoscale, unscale, weakest_mode
from platform_ctrl.errors import DesignError, IllPosedError, TimeLimitError, UnscalableError
from platform_ctrl.frozen import FloatArray, value

if TYPE_CHECKING:
    from control import StateSpace

# Solved again in other units when the least gamma of the scaled plant is not within 1/8 .. 8.
GAMMA_RANGE = 8.0
# Other units of gamma to start from where the first solve gives nothing.
GAINS = (1.0, 1e2, 1e-2, 1e4, 1e-4)
# A gamma below this (above its inverse) is not looked into any closer.
LEAST_GAIN = 1e-12
# Largest separation t in [[X, tI], [tI, Y]] ≥ 0 that is asked for.
LARGEST_SEPARATION = 10.0
# Largest mean eigenvalue of X and of Y, and its least multiple of what gamma alone needs: in directions that no
# inequality bounds X and Y would grow without end.
LARGEST_MEAN = 100.0
LEAST_ROOM = 10.0


class Round(NamedTuple):
    """How the second step is tried.

    Attributes
    ----------
    strictness
        How far the inequalities are kept from zero, relative to gamma and the back-off.
    reward
        What is paid for the mean eigenvalues of X and Y. The separation sees one direction only. Where X and Y are
        small in the others, I − X Y is near singular there and the controller has poles ten to a hundred times faster
        than that of the Riccati route; but large ones hide violations from the solver.
    tolerance
        The solver's.
    """

    strictness: float
    reward: float
    tolerance: float


# Until everything holds.
ROUNDS = (Round(5e-3, 1e-4, 1e-6), Round(5e-4, 1e-4, 1e-8), Round(5e-5, -1e-4, 1e-8))
LEAST_STRICTNESS = 1e-6
# Tolerances of the first solve, which only serves to find the right states, and of the least gamma.
ROUGH, FINE = 1e-4, 1e-7


@value
class Certificate:
    """What the solver returned: gamma, X, Y (n, n) and the separation t (0 where gamma was minimised)."""

    gamma: float
    X: FloatArray
    Y: FloatArray
    separation: float


def hinf_lmi(
    plant: Partition, backoff: float, time_limit: float, P: StateSpace
) -> tuple[Realisation, float, dict[str, float]]:
    """Controller in the units of `plant`, the least gamma, and how well the inequalities hold (scaled).

    Raises
    ------
    DesignError
        The solver failed, or what it returned does not satisfy the inequalities; `P` is attached.
    """
    scaled, least = _rough(plant, time_limit, P)
    turned, failure = scaled.plant, None
    for attempt in ROUNDS:
        turned = _balanced(turned, least)
        # In these states X = Y; their mean square does not depend on the states.
        own = float(np.sqrt(np.trace(least.X @ least.Y) / len(least.X)))
        bound = max(LARGEST_MEAN, LEAST_ROOM * own)
        try:
            least = _minimised(turned, time_limit, P, FINE)
            level = (1 + backoff) * least.gamma
            margin = max(LEAST_STRICTNESS, attempt.strictness * min(backoff, 0.02)) * level
            best = _separated(turned, level, margin, bound, attempt, time_limit, P)
            residual = _strict(turned, best, scaled.gain, P)
            made = _reconstructed(turned, scaled.control_rank, scaled.measurement_rank, best, P)
        except TimeLimitError:
            raise
        except DesignError as error:
            failure = failure or error
            continue
        return unscale(made, scaled), least.gamma * scaled.gain, residual
    assert failure is not None
    raise failure


def _strict(plant: Partition, best: Certificate, gain: float, P: StateSpace) -> dict[str, float]:
    """Residuals of the solver's X and Y; raise an UnscalableError where an inequality is not strict."""
    residual = {"separation of X and Y": best.separation}
    for name, matrix in inequalities(plant, best.gamma, best.X, best.Y).items():
        largest = float(np.linalg.eigvalsh(matrix)[-1])
        if not largest < 0:
            raise UnscalableError(
                f"hinf, lmi: X and Y from the solver violate the {name} at gamma = {best.gamma * gain:.6g} "
                f'(largest eigenvalue {largest:.2g}, expected < 0); give a larger backoff, or method="riccati"',
                P,
            )
        residual[f"largest eigenvalue of the {name}"] = largest
    return residual


def _rough(plant: Partition, time_limit: float, P: StateSpace) -> tuple[ScaledPlant, Certificate]:
    """A scaled plant whose least gamma is near one, and the solver's first answer for it."""
    failure: DesignError | None = None
    for gain in GAINS:
        scaled = autoscale(plant, gain)
        try:
            rough = _minimised(scaled.plant, time_limit, P, ROUGH)
            while not 1 / GAMMA_RANGE <= rough.gamma <= GAMMA_RANGE and LEAST_GAIN < scaled.gain < 1 / LEAST_GAIN:
                # Far from one gamma is only known roughly: not too far in one step.
                scaled = autoscale(plant, scaled.gain * float(np.clip(rough.gamma, 1e-3, 1e6)))
                rough = _minimised(scaled.plant, time_limit, P, ROUGH)
        except TimeLimitError:
            raise
        except DesignError as error:
            failure = failure or error
            continue
        return scaled, rough
    sigma, word, pole = weakest_mode(autoscale(plant))
    hint = ""
    if word and sigma < 1e-4:
        hint = (
            f"; nearest to a violated assumption: the mode at {pole.real:.4g}{pole.imag:+.4g}j rad/s is "
            f"hardly {word} (smallest singular value {sigma:.1g} of the scaled plant)"
        )
    assert failure is not None
    raise type(failure)(f"{failure}{hint}", P) from None


def _balanced(plant: Partition, rough: Certificate) -> Partition:
    """Turn the states so that X and Y are equal and diagonal: there the solver reaches six digits, elsewhere three."""
    values, vectors = np.linalg.eigh(rough.X)
    root = vectors * np.sqrt(np.maximum(values, 1e-10 * values[-1]))
    products, turn = np.linalg.eigh(root.T @ rough.Y @ root)
    products = np.maximum(products, 1.0)
    T = root @ turn / products**0.25
    Ti = np.linalg.inv(T)
    return Partition(
        A=Ti @ plant.A @ T, B1=Ti @ plant.B1, B2=Ti @ plant.B2, C1=plant.C1 @ T, C2=plant.C2 @ T,
        D11=plant.D11, D12=plant.D12, D21=plant.D21, D22=plant.D22,
    )  # fmt: skip


def _sides(plant: Partition) -> tuple[tuple[FloatArray, ...], tuple[FloatArray, ...]]:
    """What the inequalities of X and Y are made of: (N1, F, N2, G) each.

    The columns of [N1; N2] span the kernel of [B2' D12'], where the controller has no say. The inequality of X is
    [[He(N1' X F) − gamma N2' N2, G], [G', −gamma I]] < 0 with F = A' N1 + C1' N2, G = N1' B1 + N2' D11;
    that of Y is its dual.
    """
    out = []
    for A, B1, B2, C1, D11, D12 in (
        (plant.A, plant.B1, plant.B2, plant.C1, plant.D11, plant.D12),
        (plant.A.T, plant.C1.T, plant.C2.T, plant.B1.T, plant.D11.T, plant.D21.T),
    ):
        _, sigma, Vt = np.linalg.svd(np.hstack([B2.T, D12.T]), full_matrices=True)
        N = Vt[int(np.sum(sigma > 1e-12 * sigma[0])) :].T
        N1, N2 = N[: len(A)], N[len(A) :]
        out.append((N1, A.T @ N1 + C1.T @ N2, N2, N1.T @ B1 + N2.T @ D11))
    return out[0], out[1]


def inequalities(plant: Partition, gamma: float, X: FloatArray, Y: FloatArray) -> dict[str, FloatArray]:
    """Matrices that are all negative definite only if some controller has a closed-loop norm below `gamma`."""
    out = {}
    for name, V, (N1, F, N2, G) in zip(("X", "Y"), (X, Y), _sides(plant), strict=True):
        half = N1.T @ V @ F - 0.5 * gamma * N2.T @ N2
        out[f"inequality of {name}"] = np.block([[half + half.T, G], [G.T, -gamma * np.eye(G.shape[1])]])
    one = np.eye(len(X))
    out["coupling of X and Y"] = -np.block([[X, one], [one, Y]])
    return out


def _minimised(plant: Partition, time_limit: float, P: StateSpace, tolerance: float) -> Certificate:
    """Least gamma for which the inequalities hold."""
    cp = _cvxpy()
    n = len(plant.A)
    X, Y, gamma = cp.Variable((n, n), symmetric=True), cp.Variable((n, n), symmetric=True), cp.Variable()
    problem = cp.Problem(cp.Minimize(gamma), _constraints(plant, X, Y, gamma, 0.0, 1.0))
    _solve(problem, (X, Y, gamma), "minimising gamma", time_limit, P, tolerance)
    return Certificate(gamma=float(gamma.value), X=X.value, Y=Y.value, separation=1.0)


def _separated(
    plant: Partition, gamma: float, margin: float, bound: float, attempt: Round, time_limit: float, P: StateSpace
) -> Certificate:
    """X and Y for which the inequalities hold at `gamma` and [[X, tI], [tI, Y]] ≥ 0 with the largest t."""
    cp = _cvxpy()
    n = len(plant.A)
    X, Y, t = cp.Variable((n, n), symmetric=True), cp.Variable((n, n), symmetric=True), cp.Variable()
    mean_X, mean_Y = cp.trace(X) / n, cp.trace(Y) / n
    constraints = _constraints(plant, X, Y, gamma, margin, t)
    constraints += [t <= LARGEST_SEPARATION, mean_X <= bound, mean_Y <= bound]
    problem = cp.Problem(cp.Maximize(t + attempt.reward * (mean_X + mean_Y)), constraints)
    _solve(problem, (X, Y, t), f"separating X and Y at gamma = {gamma:.6g} (scaled)", time_limit, P, attempt.tolerance)
    return Certificate(gamma=gamma, X=X.value, Y=Y.value, separation=float(t.value))


def _cvxpy() -> Any:
    return import_module("cvxpy")  # Any: its annotations are incomplete


def _constraints(plant: Partition, X: Any, Y: Any, gamma: Any, margin: float, t: Any) -> list[Any]:
    cp = _cvxpy()
    one = np.eye(len(plant.A))
    constraints = [cp.bmat([[X, t * one], [t * one, Y]]) >> 0]
    for V, (N1, F, N2, G) in zip((X, Y), _sides(plant), strict=True):
        half = N1.T @ V @ F
        block = cp.bmat([[half + half.T - gamma * (N2.T @ N2), G], [G.T, -gamma * np.eye(G.shape[1])]])
        constraints.append(block << -margin * np.eye(block.shape[0]))
    return constraints


def _solve(
    problem: Any, variables: tuple[Any, ...], what: str, time_limit: float, P: StateSpace, tolerance: float
) -> None:
    solve(
        problem,
        variables,
        what=f"hinf, lmi: {what}",
        time_limit=time_limit,
        P=P,
        tolerance=tolerance,
        cure='give a larger backoff, other weights, or method="riccati"',
    )


def _reconstructed(plant: Partition, r: int, s: int, best: Certificate, P: StateSpace) -> Realisation:
    """Controller from strictly feasible X and Y; r and s are the ranks of D12 and D21 (Gahinet 1996).

    In the variables Â, B̂, Ĉ of the linearised inequality, Ĉ meets the part of X, B̂ that of Y, and Â removes
    the cross term.
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

    # I − Y X = N M' with N and M' of equal size.
    U, sigma, Vt = np.linalg.svd(np.eye(len(X)) - Y @ X)
    Ni, Mi = (U / np.sqrt(sigma)).T, Vt.T / np.sqrt(sigma)
    BK = Ni @ (Bt.T - Y @ p.B2 @ D)
    CK = (C - D @ p.C2 @ X) @ Mi
    AK = Ni @ (A - Y @ through @ X) @ Mi - BK @ p.C2 @ X @ Mi - Ni @ Y @ p.B2 @ CK
    return Realisation(A=AK, B=BK, C=CK, D=D)


def _feedthrough(p: Partition, r: int, s: int, gamma: float) -> FloatArray:
    """D_K with |D11 + D12 D_K D21| < gamma: the central solution of Parrott's problem."""
    U1, V1 = p.D12[:, :r], p.D21[:s].T
    U0, V0 = np.linalg.svd(U1)[0][:, r:], np.linalg.svd(V1)[0][:, s:]
    a, b, c, d = U0.T @ p.D11 @ V0, U0.T @ p.D11 @ V1, U1.T @ p.D11 @ V0, U1.T @ p.D11 @ V1
    D = np.zeros((p.D12.shape[1], p.D21.shape[0]))
    D[:r, :s] = -d - c @ np.linalg.solve(gamma**2 * np.eye(a.shape[1]) - a.T @ a, a.T @ b)
    return D


def _gain(
    AX: FloatArray, B: FloatArray, M0: FloatArray, E: FloatArray, weight: FloatArray, rank: int, P: StateSpace
) -> tuple[FloatArray, FloatArray]:
    """F that makes He(AX + B F) + M' weight M negative definite, and M = M0 + E F; E is zero beyond `rank` columns."""
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
    # What z does not see directly may be used without limit (Finsler): as little as is enough, doubled for some margin.
    gain = 1e-3
    while np.linalg.eigvalsh(left - 2 * gain * singular @ singular.T)[-1] >= 0:
        gain *= 2
        if gain > 1e12:
            raise IllPosedError(
                "hinf, lmi: no finite gain of the channels that D12 or D21 leave out satisfies the inequalities; "
                "give a larger backoff, or add a small weight on every control and a small noise on every measurement",
                P,
            )
    F[rank:] = -2 * gain * singular.T
    return F, M
