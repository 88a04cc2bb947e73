"""One Lyapunov matrix for the sampled closed loops of a nominal plant and its variations.

    P > 0 with A_i' P A_i − P < 0 for the closed loops A_i of as many plants as possible

Such loops stay stable however fast the plant changes from one to another. The plants whose inequalities hold least are
taken into the problem in rounds, so that it stays small.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_discrete_lyapunov

from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.lmi.inequalities import cp, solve
from platform_ctrl.errors import DesignError

# Plants that are taken into the problem in a round, and most rounds. With more states than this the matrix of the
# nominal loop alone is tried: the effort grows with the sixth power.
ADDED, ROUNDS, MOST_STATES = 3, 2, 24
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
    P, taken, most = one, [0], 0
    for k in range(ROUNDS + 1):
        distance = np.linalg.eigvalsh(P - np.swapaxes(A, 1, 2) @ P @ A)[:, 0]
        most = max(most, int(np.sum(distance > 0.0)))
        if most == len(A) or k == ROUNDS or n > MOST_STATES:
            break
        taken += [int(k) for k in np.argsort(distance)[:ADDED] if k not in taken]
        unknown = cp.Variable((n, n), symmetric=True)
        inequalities = [unknown >> one, *(unknown - M.T @ unknown @ M >> STRICT * one for M in A[taken])]
        try:
            solve(cp.Problem(cp.Minimize(cp.trace(unknown)), inequalities), "", "", time_limit, TOLERANCE)
        except DesignError:
            break
        P = unknown.value
    return most
