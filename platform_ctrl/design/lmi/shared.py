"""One Lyapunov matrix for the sampled closed loops of a nominal plant and its variations.

    P > 0 with A_i' P A_i − P < 0 for the closed loops A_i of as many plants as possible

Such loops stay stable however fast the plant changes from one to another. Only the plants whose inequalities hold least
for the matrix of the nominal loop are taken into the problem, so that it stays small.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_discrete_lyapunov

from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.lmi.inequalities import cp, solve
from platform_ctrl.errors import DesignError

# Plants in the problem beside the nominal one. With more states than the second number the matrix of the nominal loop
# alone is tried: the effort grows with the sixth power.
WORST, MOST_STATES = 6, 24
# How far the inequalities hold in the problem, for X ≥ I, and the solver's tolerance.
STRICT, TOLERANCE = 0.01, 1e-3


def sharing(loops: FloatArray, time_limit: float) -> int:
    """Return for how many of the closed loops (N, n, n), the first one stable, one Lyapunov matrix was found."""
    n = loops.shape[-1]
    one = np.eye(n)
    # States in which white noise on each state of the first loop makes variances of one, then its P is one.
    scale = np.sqrt(np.diag(solve_discrete_lyapunov(loops[0], one)))
    values, vectors = np.linalg.eigh(solve_discrete_lyapunov((loops[0] / scale[:, None] * scale).T, one))
    T = scale[:, None] * vectors / np.sqrt(values)
    A = np.linalg.solve(T, loops @ T)
    held = _distance(one, A) > 0.0
    if np.all(held) or n > MOST_STATES:
        return int(np.sum(held))
    taken = {0, *np.argsort(_distance(one, A))[:WORST]}
    P = cp.Variable((n, n), symmetric=True)
    inequalities = [P >> one, *(P - A[k].T @ P @ A[k] >> STRICT * one for k in taken)]
    try:
        solve(cp.Problem(cp.Minimize(cp.trace(P)), inequalities), "", "", time_limit, TOLERANCE)
    except DesignError:
        return int(np.sum(held))
    return max(int(np.sum(held)), int(np.sum(_distance(P.value, A) > 0.0)))


def _distance(P: FloatArray, A: FloatArray) -> FloatArray:
    """Return the least eigenvalue of every P − A' P A."""
    return np.asarray(np.linalg.eigvalsh(P - np.swapaxes(A, 1, 2) @ P @ A)[:, 0])
