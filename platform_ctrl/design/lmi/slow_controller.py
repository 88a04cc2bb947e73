"""A controller whose own poles stay within a disc, while the closed loop keeps its inequalities.

With X and Y free the controller's poles are no linear function of anything. With a known Lyapunov matrix V of the
closed loop all requirements are linear in the controller itself, and so is a bound on its poles, for a known Lyapunov
matrix W of the controller. So in turn: the slowest controller for V and W, then the V with the most slack and a W for
that controller. Every step keeps what the step before has reached.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from platform_ctrl.design.lmi.analysis import slackest
from platform_ctrl.design.lmi.bounded_real import factors, lyapunov_matrix
from platform_ctrl.design.lmi.conic import cvxpy, solve
from platform_ctrl.design.lmi.known_matrix import KnownMatrix
from platform_ctrl.design.lmi.search import CURE, FINE, Found, Problem, constrained, direct
from platform_ctrl.design.partition import Realisation
from platform_ctrl.errors import InfeasibleError, UnscalableError
from platform_ctrl.frozen import FloatArray

# Rounds, and what one must bring.
MOST_ROUNDS, LEAST_PROGRESS = 40, 1e-3
# Strictness of the inequalities while the controller changes, and of the bound that is met.
MARGIN, BELOW = 1e-6, 0.999


def slowed(problem: Problem, best: Found, K: Realisation, bound: float) -> Realisation:
    """Return a controller whose poles are smaller than `bound` (scaled), with the requirements still met.

    Raises
    ------
    InfeasibleError
        The poles stay larger; the message says how large.
    TimeLimitError
        The solver was ended.
    """
    n = len(problem.plant.A)
    X, Y = best.pair.X, best.pair.Y
    V = lyapunov_matrix(X, Y, *factors(X, Y))
    # Near the first matrix: from one to the next their condition would grow without end.
    first, W = V, V[n:, n:]
    problem = problem._replace(splits=best.splits)
    fastest = _fastest(K)
    for _ in range(MOST_ROUNDS):
        if fastest <= BELOW * bound:
            return K
        try:
            slower = _slowest(problem, best, V, W)
            reached = _fastest(slower)
            if not reached < (1 - LEAST_PROGRESS) * fastest:
                break
            K, fastest = slower, reached
            V = slackest(problem, [problem.plant], best.ratios, V, K, first)
        except (InfeasibleError, UnscalableError):
            break
        W = _own(K, fastest)
    if fastest <= BELOW * bound:
        return K
    rate = problem.scaled.rate
    raise InfeasibleError(
        f"{problem.where}: the controller's fastest pole has {fastest * rate:.4g} rad/s; expected at most "
        f"{bound * rate:.4g}, and slower ones were not found; {CURE}",
        problem.P,
    )


def _fastest(K: Realisation) -> float:
    return float(np.max(np.abs(np.linalg.eigvals(K.A)), initial=0.0))


def _slowest(problem: Problem, best: Found, V: FloatArray, W: FloatArray) -> Realisation:
    """The controller with the least r in [[−r W, W A_K], [(W A_K)', −r W]] < 0, for a known V."""
    cp = cvxpy()
    known = KnownMatrix([problem.plant], V, direct(problem))
    r = cp.Variable()
    constraints, _ = constrained(problem, known.loops[0], best.ratios, 1.0, MARGIN)
    # In the states in which W is the identity.
    inverse = np.linalg.inv(known.own)
    root = np.linalg.cholesky(inverse.T @ W @ inverse).T
    turned = root @ known.A_K @ np.linalg.inv(root)
    eye = np.eye(len(W))
    constraints.append(cp.bmat([[r * eye, turned], [turned.T, r * eye]]) >> 0)
    _solve(problem, cp.Problem(cp.Minimize(r), constraints), (r, *known.unknowns))
    return known.controller()


def _own(K: Realisation, fastest: float) -> FloatArray:
    """W > 0 with A_K' W A_K < r² W for an r just above the fastest pole."""
    from scipy.linalg import solve_discrete_lyapunov

    W = solve_discrete_lyapunov(K.A.T / (1.02 * fastest), np.eye(len(K.A)))
    return np.asarray(len(W) / np.trace(W) * 0.5 * (W + W.T))


def _solve(problem: Problem, asked: Any, variables: tuple[Any, ...]) -> None:
    solve(
        asked, variables,
        what=f"{problem.where}: bounding the controller's poles", time_limit=problem.time_limit, P=problem.P,
        tolerance=FINE, cure=CURE,
    )  # fmt: skip
