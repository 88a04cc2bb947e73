"""What a known controller reaches with one Lyapunov matrix for one plant or several."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from platform_ctrl.design.lmi.conic import cvxpy, solve
from platform_ctrl.design.lmi.linearised import LinearLoop
from platform_ctrl.design.lmi.search import CURE, FINE, Problem, constrained
from platform_ctrl.design.partition import Partition, Realisation, closed_loop
from platform_ctrl.frozen import FloatArray

# Largest eigenvalue of V relative to the one before, on the average, and the inverse of the least one.
ROOM = 10.0
# Factor of `near`.
NEAR = 30.0


def slackest(
    problem: Problem,
    plants: Sequence[Partition],
    ratios: Sequence[Any],
    V: FloatArray,
    K: Realisation,
    near: FloatArray | None = None,
) -> FloatArray:
    """Return the matrix for which the requirements hold with the most slack, the norms at `ratios` times their limits.

    Parameters
    ----------
    problem, plants
        The requirements, and the scaled plants for which they have to hold.
    ratios
        One for each norm.
    V
        A matrix to start from.
    K
        The controller.
    near
        A matrix from which that one stays within a factor, as a quadratic form.

    Raises
    ------
    InfeasibleError, TimeLimitError, UnscalableError
        There is none, or the solver gave up.
    """
    cp = cvxpy()
    slack = cp.Variable()
    return _solved(problem, plants, ratios, V, K, slack, cp.Maximize(slack), [slack >= 0], "looking for slack", near)


def least_ratio(
    problem: Problem, plants: Sequence[Partition], V: FloatArray, K: Realisation, backoff: float
) -> tuple[float, FloatArray]:
    """Return the least ratio of the goals that a common matrix proves, and the matrix; see `slackest`."""
    cp = cvxpy()
    ratio = cp.Variable()
    ratios = [ratio if goal else 1 / (1 + backoff) for goal in problem.goals]
    V = _solved(problem, plants, ratios, V, K, 0.0, cp.Minimize(ratio), [ratio >= 0], "looking for a common matrix")
    return float(ratio.value), V


def _solved(
    problem: Problem,
    plants: Sequence[Partition],
    ratios: Sequence[Any],
    V: FloatArray,
    K: Realisation,
    slack: Any,
    objective: Any,
    more: list[Any],
    what: str,
    near: FloatArray | None = None,
) -> FloatArray:
    cp = cvxpy()
    # In the states in which the last V is the identity.
    root = np.linalg.cholesky(V).T
    inverse = np.linalg.inv(root)
    size = len(V)
    new = cp.Variable((size, size), symmetric=True)
    constraints = [new >> 1 / ROOM**2 * np.eye(size), cp.trace(new) <= size * ROOM, *more]
    if near is not None:
        there = inverse.T @ near @ inverse
        constraints += [new >> there / NEAR, new << NEAR * there]
    for plant in plants:
        loop = closed_loop(plant, K)
        linear = LinearLoop(
            V=new, VA=new @ (root @ loop.A @ inverse), VB=new @ (root @ loop.B),
            C=cp.Constant(loop.C @ inverse), D=cp.Constant(loop.D),
        )  # fmt: skip
        constraints += constrained(problem, linear, ratios, 1.0, slack)[0]
    solve(
        cp.Problem(objective, constraints), (new,),
        what=f"{problem.where}: {what}", time_limit=problem.time_limit, P=problem.P, tolerance=FINE, cure=CURE,
    )  # fmt: skip
    out = root.T @ new.value @ root
    return np.asarray(0.5 * (out + out.T))
