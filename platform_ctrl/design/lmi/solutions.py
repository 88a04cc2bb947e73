"""From the least ratio to controllers: back off, separate X and Y, reconstruct, bound the controller's poles."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.lmi.conic import cp
from platform_ctrl.design.lmi.linearised import (
    LinearLoop,
    Pair,
    balancing,
    factors,
    from_linearised,
    in_states,
    lyapunov_matrix,
    output_feedback,
)
from platform_ctrl.design.lmi.search import (
    CURE,
    FINE,
    Found,
    Problem,
    best_ratio,
    constrained,
    direct,
    farthest,
    improved_problem,
    minimised,
)
from platform_ctrl.design.partition import Partition, closed_loop
from platform_ctrl.errors import DesignError, IllPosedError, InfeasibleError, TimeLimitError, UnscalableError

# Largest eigenvalue of V relative to the one before, on the average, and the inverse of the least one.
ROOM = 10.0
# Factor of `near`.
LARGEST_RATIO = 30.0


def slackest(
    problem: Problem,
    plants: Sequence[Partition],
    ratios: Sequence[Any],
    V: FloatArray,
    K: StateArrays,
    near: FloatArray | None = None,
) -> FloatArray:
    """Return the Lyapunov matrix for which the requirements hold with the most slack, for a known controller K.

    `ratios` are those of the norms to their limits, `V` is a matrix to start from; as a quadratic form the result
    differs from `near` by a factor at most.
    """
    slack = cp.Variable()
    return _matrix(problem, plants, ratios, V, K, slack, (cp.Maximize(slack), slack >= 0, "maximising slack"), near)


def least_ratio(
    problem: Problem, plants: Sequence[Partition], V: FloatArray, K: StateArrays, backoff: float
) -> tuple[float, FloatArray]:
    """Return the least ratio of the goals that a common matrix proves, and the matrix; see `slackest`."""
    ratio = cp.Variable()
    ratios = [ratio if goal else 1 / (1 + backoff) for goal in problem.goals]
    aim = cp.Minimize(ratio), ratio >= 0, "minimising the ratio of a common matrix"
    V = _matrix(problem, plants, ratios, V, K, 0.0, aim)
    return float(ratio.value), V


def _matrix(
    problem: Problem,
    plants: Sequence[Partition],
    ratios: Sequence[Any],
    V: FloatArray,
    K: StateArrays,
    slack: Any,
    aim: tuple[Any, Any, str],
    near: FloatArray | None = None,
) -> FloatArray:
    """Return the matrix of the best goal; `aim` is the goal, its constraint and the step's name."""
    # In the states in which the last V is the identity.
    root = np.linalg.cholesky(V).T
    inverse = np.linalg.inv(root)
    size = len(V)
    new = cp.Variable((size, size), symmetric=True)
    goal, more, step = aim
    constraints = [new >> 1 / ROOM**2 * np.eye(size), cp.trace(new) <= size * ROOM, more]
    if near is not None:
        there = inverse.T @ near @ inverse
        constraints += [new >> there / LARGEST_RATIO, new << LARGEST_RATIO * there]
    for plant in plants:
        loop = closed_loop(plant, K)
        linear = LinearLoop(
            V=new, VA=new @ (root @ loop.A @ inverse), VB=new @ (root @ loop.B),
            C=cp.Constant(loop.C @ inverse), D=cp.Constant(loop.D),
        )  # fmt: skip
        constraints += constrained(problem, linear, ratios, 1.0, slack)[0]
    problem.solver.solve(cp.Problem(goal, constraints), (new,), step, FINE)
    out = root.T @ new.value @ root
    return np.asarray(0.5 * (out + out.T))


class KnownMatrix:
    """Plants (scaled) and the unknown controller for a known V (2n, 2n) of the states [x, xK]; D is the unknown D_K.

    `loops` has a closed loop for each plant, linear in the `unknowns`, which are variables of the problem; `A_K` is the
    expression of the controller's state matrix in states `own` xK, `own` (n, n).
    """

    def __init__(self, plants: Sequence[Partition], V: FloatArray, D: Any) -> None:
        n = len(plants[0].A)
        inverse = np.asarray(np.linalg.inv(V), dtype=np.float64)
        T = balancing(Pair(gamma=0.0, X=inverse[:n, :n], Y=V[:n, :n], separation=0.0))
        back = np.linalg.inv(T)
        X, Y = back @ inverse[:n, :n] @ back.T, T.T @ V[:n, :n] @ T
        self._N, self._M = factors(X, Y)
        self.own = np.linalg.solve(self._N, T.T @ V[:n, n:])
        nu, ny = D.shape
        # The unknowns are Â, B̂, Ĉ of the first plant, divided by the sizes of X and Y, which are large.
        half = np.sqrt(np.diag(X))
        self.unknowns = cp.Variable((n, n)), cp.Variable((n, ny)), cp.Variable((nu, n))
        sizes = np.diag(half)
        A, B, C = sizes @ self.unknowns[0] @ sizes, sizes @ self.unknowns[1], self.unknowns[2] @ sizes
        p = in_states(plants[0], T)
        NB, CM = B - Y @ p.B2 @ D, C - D @ (p.C2 @ X)
        NAM = A - NB @ (p.C2 @ X) - (Y @ p.B2) @ CM - Y @ (p.A + p.B2 @ D @ p.C2) @ X
        self.A_K = np.linalg.inv(self._N) @ NAM @ np.linalg.inv(self._M.T)
        self._parts = NB, CM, D
        small = np.diag(np.tile(1 / half, 2))
        self.loops: list[LinearLoop] = []
        for plant in plants:
            q = in_states(plant, T)
            A = NAM + NB @ (q.C2 @ X) + (Y @ q.B2) @ CM + Y @ (q.A + q.B2 @ D @ q.C2) @ X
            hat = StateArrays(A=A, B=NB + Y @ q.B2 @ D, C=CM + D @ (q.C2 @ X), D=D)
            V_q, VA, VB, C_q, D_q = output_feedback(q, X, Y, hat)
            self.loops.append(LinearLoop(small @ V_q @ small, small @ VA @ small, small @ VB, C_q @ small, D_q))

    def controller(self) -> StateArrays:
        """Return what the solver found, in the states xK."""
        NB, CM, D = self._parts
        inverse = np.linalg.inv(self.own)
        return StateArrays(
            A=inverse @ self.A_K.value @ self.own,
            B=inverse @ np.linalg.solve(self._N, NB.value),
            C=np.linalg.solve(self._M, CM.value.T).T @ self.own,
            D=np.asarray(getattr(D, "value", D)),
        )


# Largest number of rounds, and the least progress of one.
MOST_ROUNDS, LEAST_PROGRESS = 40, 1e-3
# Strictness of the inequalities while the controller changes, and of the bound that is met.
MARGIN, POLE_MARGIN = 1e-6, 0.999


def slowed(problem: Problem, best: Found, K: StateArrays, bound: float) -> StateArrays:
    """Return a controller whose poles are smaller than `bound` (scaled), with the requirements still met."""
    n = len(problem.plant.A)
    X, Y = best.pair.X, best.pair.Y
    V = lyapunov_matrix(X, Y, *factors(X, Y))
    # Near the first matrix: otherwise the condition would grow from one to the next.
    first, W = V, V[n:, n:]
    problem = problem._replace(splits=best.splits)
    fastest = _fastest_pole(K)
    for _ in range(MOST_ROUNDS):
        if fastest <= POLE_MARGIN * bound:
            return K
        try:
            slower = _slowest_controller(problem, best, V, W)
            reached = _fastest_pole(slower)
            if not reached < (1 - LEAST_PROGRESS) * fastest:
                break
            K, fastest = slower, reached
            V = slackest(problem, [problem.plant], best.ratios, V, K, first)
        except (InfeasibleError, UnscalableError):
            break
        W = _pole_matrix(K, fastest)
    if fastest <= POLE_MARGIN * bound:
        return K
    rate = problem.scaled.rate
    raise InfeasibleError(
        f"{problem.solver.where}: the controller's fastest pole has {fastest * rate:.4g} rad/s, more than "
        f"{bound * rate:.4g}, and a slower one was not found; {CURE}",
        problem.solver.P,
    )


def _fastest_pole(K: StateArrays) -> float:
    return float(np.max(np.abs(np.linalg.eigvals(K.A)), initial=0.0))


def _slowest_controller(problem: Problem, best: Found, V: FloatArray, W: FloatArray) -> StateArrays:
    """Return the controller with the least r in [[−r W, W A_K], [(W A_K)', −r W]] < 0, for a known V."""
    known = KnownMatrix([problem.plant], V, direct(problem))
    r = cp.Variable()
    constraints, _ = constrained(problem, known.loops[0], best.ratios, 1.0, MARGIN)
    # In the states in which W is the identity.
    inverse = np.linalg.inv(known.own)
    root = np.linalg.cholesky(inverse.T @ W @ inverse).T
    A_K = root @ known.A_K @ np.linalg.inv(root)
    eye = np.eye(len(W))
    constraints.append(cp.bmat([[r * eye, A_K], [A_K.T, r * eye]]) >> 0)
    convex = cp.Problem(cp.Minimize(r), constraints)
    problem.solver.solve(convex, (r, *known.unknowns), "bounding the controller's poles", FINE)
    return known.controller()


def _pole_matrix(K: StateArrays, fastest: float) -> FloatArray:
    """Return W > 0 with A_K' W A_K < r² W for an r just above the fastest pole."""
    from scipy.linalg import solve_discrete_lyapunov

    W = solve_discrete_lyapunov(K.A.T / (1.02 * fastest), np.eye(len(K.A)))
    return np.asarray(len(W) / np.trace(W) * 0.5 * (W + W.T))


# Strictness of the inequalities in the last step (scaled), tried in turn.
MARGINS = (1e-4, 1e-5, 1e-6)


class Solution(NamedTuple):
    """What the search found, in scaled units: the problem, X and Y, the least ratio and the controller."""

    problem: Problem
    best: Found
    least: float
    made: StateArrays


def solutions(problem: Problem, backoff: float) -> Iterator[Solution | DesignError]:
    """Yield controllers, or why there is none, for inequalities that are less and less strict."""
    requested = problem.requested
    problem, found = best_ratio(problem, backoff)
    for margin in MARGINS:
        try:
            problem = improved_problem(problem, found)
            found = minimised(problem, problem.goals, backoff, FINE)
            if requested.norms and not problem.soft and found.ratio >= 1:
                raise InfeasibleError(
                    f"{problem.solver.where}: the least ratio to the limits of the norms with one Lyapunov matrix for "
                    f"all requirements is {found.ratio:.4g}, not below 1; {CURE}",
                    problem.solver.P,
                )
            best = farthest(problem, found, backoff, margin)
            made = from_linearised(problem.plant, best.pair.X, best.pair.Y, best.hats)
            if requested.controller:
                bound = min(one.limit for one in requested.controller) / problem.scaled.rate
                made = slowed(problem, best, made, bound)
            yield Solution(problem, best, found.ratio, made)
        except (TimeLimitError, InfeasibleError, IllPosedError):
            raise
        except DesignError as error:
            yield error
        except np.linalg.LinAlgError as error:
            yield UnscalableError(f"{problem.solver.where}: {str(error).lower()}; {CURE}", problem.solver.P)
