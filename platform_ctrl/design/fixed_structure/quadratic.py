"""The small convex problem inside the optimiser: the least maximum of linear pieces plus one curvature, in a box."""

from __future__ import annotations

from typing import Any

import numpy as np

from platform_ctrl.common.values import FloatArray, value


@value
class Step:
    """Minimiser of the model."""

    move: FloatArray  # (n,): the step d
    level: float  # the largest soft piece of the model at d, without the curvature
    violation: float  # by how much the model's hard pieces still exceed one
    # weights, hard_weights, wall_weights: multipliers of the soft pieces, the hard pieces and the walls, not negative;
    # those of the soft ones add up to one.
    weights: FloatArray
    hard_weights: FloatArray
    wall_weights: FloatArray


def least_maximum(  # noqa: PLR0915 - one active-set method
    soft: tuple[FloatArray, FloatArray],
    H: FloatArray,
    box: tuple[FloatArray, FloatArray],
    hard: tuple[FloatArray, FloatArray] | None = None,
    penalty: float = 0.0,
    walls: tuple[FloatArray, FloatArray] | None = None,
) -> Step | None:
    """Minimise max(values + gradients d) + penalty max(0, hard values + hard gradients d − 1) + d'Hd/2 over the box.

    `soft` and `hard` are values (k,) and gradients (k, n) at d = 0; `penalty` is the price of the largest excess of a
    hard piece over one. The box (lower, upper) holds zero, `walls` are rows (r, n) and limits (r,), rows @ d <= limits.
    None where the solver found no solution.
    """
    import clarabel

    (values, gradients), (lower, upper) = soft, box
    n, k = len(lower), len(values)
    hard_values, hard_gradients = hard or (np.zeros(0), np.zeros((0, n)))
    # Values are measured from the largest, in units of the spread that the box allows: the solver sees numbers near 1.
    top = float(np.max(values))
    unit = float(np.max(np.abs(gradients) @ np.maximum(upper, -lower), initial=0.0)) or 1.0
    width = np.maximum(np.maximum(upper, -lower), 1e-300)
    G = gradients * width / unit
    m = len(hard_values)
    columns = n + 1 + (1 if m else 0)
    rows = [np.hstack([G, -np.ones((k, 1)), np.zeros((k, columns - n - 1))])]
    limits = [(top - values) / unit]
    if m:
        scale = np.maximum(np.max(np.abs(hard_gradients) * width, axis=1), 1.0)
        rows.append(np.hstack([hard_gradients * width / scale[:, None], np.zeros((m, 1)), -1.0 / scale[:, None]]))
        limits.append((1.0 - hard_values) / scale)
        last = np.zeros((1, columns))
        last[0, -1] = -1.0
        rows.append(last)
        limits.append(np.zeros(1))
    if walls is not None and len(walls[1]):
        reach = np.sum(np.abs(walls[0]) * width, axis=1)
        # Walls beyond the box are left out: their limits, in units of their reach, would be huge.
        near = (reach > walls[1]) & (reach > 0.0)
        reach = np.where(near, reach, 1.0)
        rows.append(np.hstack([walls[0] * width / reach[:, None], np.zeros((len(reach), columns - n))])[near])
        # What is beyond a wall has to come back, but not further than half the box.
        limits.append(np.maximum(walls[1] / reach, -0.5)[near])
    sides = np.zeros((2 * n, columns))
    sides[:n, :n], sides[n:, :n] = np.eye(n), -np.eye(n)
    rows.append(sides)
    limits.append(np.concatenate([upper / width, -lower / width]))
    A, b = np.vstack(rows), np.concatenate(limits)
    P = np.zeros((columns, columns))
    P[:n, :n] = H * width[:, None] * width / unit
    q = np.zeros(columns)
    q[n] = 1.0
    if m:
        q[n + 1] = penalty / unit
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_iter = 60
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-10
    solver = clarabel.DefaultSolver(
        _sparse(np.triu(P)), q, _sparse(A), b, [clarabel.NonnegativeConeT(len(b))], settings
    )
    solution = solver.solve()
    if str(solution.status) not in ("Solved", "AlmostSolved", "InsufficientProgress", "MaxIterations"):
        return None
    z, dual = np.asarray(solution.x), np.maximum(np.asarray(solution.z), 0.0)
    if not (np.all(np.isfinite(z)) and np.all(np.isfinite(dual))):
        return None
    move = np.clip(z[:n] * width, lower, upper)
    weights = dual[:k]
    total = float(np.sum(weights))
    wall_weights = np.zeros(0)
    if walls is not None and len(walls[1]):
        behind = k + (m + 1 if m else 0)
        wall_weights = np.zeros(len(walls[1]))
        wall_weights[near] = dual[behind : behind + int(near.sum())] / reach[near] * unit
    excess, hard_weights = 0.0, np.zeros(m)
    if m:
        excess = max(0.0, float(np.max(hard_values + hard_gradients @ move)) - 1.0)
        hard_weights = dual[k : k + m] / scale * unit
    return Step(
        move=move,
        level=float(np.max(values + gradients @ move)),
        violation=excess,
        weights=weights / total if total > 0.0 else np.full(k, 1.0 / k),
        hard_weights=hard_weights,
        wall_weights=wall_weights,
    )


def _sparse(matrix: FloatArray) -> Any:
    """Return a matrix by its columns; scipy's conversion of a dense one takes as long as a small program."""
    from scipy.sparse import csc_matrix

    column, row = np.nonzero(matrix.T)
    starts = np.searchsorted(column, np.arange(matrix.shape[1] + 1))
    return csc_matrix((matrix[row, column], row.astype(np.int32), starts.astype(np.int32)), shape=matrix.shape)


def damped_update(H: FloatArray, move: FloatArray, change: FloatArray) -> FloatArray:
    """Return the BFGS update of H for a move that changed the gradient by `change`, damped so that H > 0 (Powell 1978).

    H is returned as it is where it does not curve upwards along the move or `change` is not finite.
    """
    curved = H @ move
    bend, slope = float(move @ curved), float(move @ change)
    if not bend > 0.0 or not np.all(np.isfinite(change)):
        return H
    if slope < 0.2 * bend:
        share = 0.8 * bend / (bend - slope)
        change = share * change + (1.0 - share) * curved
        slope = float(move @ change)
    return np.asarray(H - np.outer(curved, curved) / bend + np.outer(change, change) / slope)
