"""Minimising the largest of smooth functions: a non-smooth function of few parameters, with bounds and hard limits.

All functions near the largest are linearised, and their least maximum over a trust region is found by a quadratic
program (sequential quadratic programming in epigraph form); its curvature is a damped BFGS matrix of the weighted
functions. Where the point is not stable, its functions are growth rates, and the same steps make it stable first.
Deterministic.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.common.values import FloatArray, value

# Decrease over the predicted one that a step needs to be accepted, to enlarge the region, and not to shrink it.
_ACCEPTED, _GOOD, _POOR = 1e-3, 0.7, 0.25
# Factors of the region after a step that was accepted although poor, and where the program has no solution.
_POORER, _UNSOLVED = 0.5, 0.25
# Curvature at first: a step of the trust region's length costs half this share of the value.
_FIRST_CURVATURE = 1e-4
# Steps in a row that decrease the value by less than the tolerance, before the search ends; share of the tolerance at
# which a predicted decrease ends it at once.
_SMALL_STEPS, _PREDICTED = 5, 0.1


@value
class Evaluation:
    """The functions near the largest at a point."""

    values: FloatArray  # (k,)
    gradients: FloatArray  # (k, n)
    hard: NDArray[np.bool_]  # (k,): must not exceed one; the largest of the others is minimised
    # (k, labels): what a function belongs to. Only functions of one owner continue each other from point to point.
    owner: NDArray[np.intp]
    stable: bool  # where not, all functions are growth rates, and none is hard

    def largest(self, hard: bool) -> float:
        """Return the largest of the hard or of the other functions; 0 for no hard one."""
        chosen = self.values[self.hard == hard]
        return float(np.max(chosen, initial=0.0)) if hard else float(np.max(chosen))

    def only(self, chosen: NDArray[np.bool_]) -> Evaluation:
        """Return some of the functions."""
        return Evaluation(
            values=self.values[chosen],
            gradients=self.gradients[chosen],
            hard=self.hard[chosen],
            owner=self.owner[chosen],
            stable=self.stable,
        )


Function = Callable[[FloatArray], Evaluation]


@value
class Effort:
    """How far a search goes."""

    evaluations: int = 4000  # most evaluations of the functions
    steps: int = 10**6  # most trial steps
    # target, excess: the search ends as soon as the largest function is at most `target` and no hard one above 1 +
    # `excess`.
    target: float = -np.inf
    excess: float = 0.0
    # tolerance, unit: decrease of a small step, in this unit; without one in units of the value itself.
    tolerance: float = 1e-7
    unit: float | None = None
    # Price of the largest excess of a hard function; without one, ten times the largest of the others, at least 10.
    penalty: float | None = None
    # radius, least: of the trust region, the first one, and the one at which the search ends.
    radius: float = 1.0
    least: float = 1e-13
    # larger, smaller: factors of the region where a step of its length was good, and where a step was refused.
    larger: float = 2.5
    smaller: float = 0.5
    hessian: FloatArray | None = None  # curvature of an earlier search
    start: Evaluation | None = None  # the functions at the start, where they are known


@value
class Minimum:
    """Where the search ended."""

    x: FloatArray  # (n,): parameters, within the bounds
    at: Evaluation  # the functions there
    finished: bool  # whether it ended by itself and not by its evaluations or steps
    evaluations: int  # how often the functions were evaluated
    # radius, hessian: trust region and curvature at the end, to go on with.
    radius: float
    hessian: FloatArray


def minimise(function: Function, x0: FloatArray, bounds: tuple[FloatArray, FloatArray], effort: Effort) -> Minimum:
    """Minimise the largest function where the point is stable and every hard function at most one.

    It starts at `x0` (n,), in units where a change of one is large, and ends at the best point found, also where limits
    ended the search.
    """
    search = _Search(function, np.clip(np.asarray(x0, dtype=np.float64), *bounds), bounds, effort)
    finished = False
    for _ in range(effort.steps):
        if search.spent >= effort.evaluations:
            break
        finished = search.step()
        if finished:
            break
    return Minimum(
        x=search.x,
        at=search.here,
        finished=finished,
        evaluations=search.spent,
        radius=search.radius,
        hessian=search.hessian,
    )


class _Search:
    """A point with its functions, the trust region and the curvature."""

    def __init__(
        self, function: Function, x: FloatArray, bounds: tuple[FloatArray, FloatArray], effort: Effort
    ) -> None:
        self.function, self.effort, self.x = function, effort, x
        self.lower, self.upper = bounds
        self.here, self.spent = (effort.start, 0) if effort.start is not None else (function(x), 1)
        self.small, self.radius = 0, effort.radius
        size = abs(self.here.largest(hard=False))
        self.penalty = effort.penalty or 10.0 * max(1.0, size)
        first = _FIRST_CURVATURE * max(size, 1e-12) / effort.radius**2 * np.eye(len(x))
        self.hessian: FloatArray = first if effort.hessian is None else effort.hessian

    def merit(self, at: Evaluation) -> float:
        """Return the largest function and the price of the largest excess of a hard one."""
        if at.stable and not self.here.stable:
            return 0.0
        if self.here.stable and not at.stable:
            return np.inf
        return at.largest(hard=False) + self.penalty * max(0.0, at.largest(hard=True) - 1.0)

    def step(self) -> bool:
        """Try a step; return whether the search has come to its end."""
        here, effort, H = self.here, self.effort, self.hessian
        if here.stable and here.largest(hard=False) <= effort.target and here.largest(hard=True) <= 1.0 + effort.excess:
            return True
        merit = self.merit(here)
        box = np.maximum(self.lower - self.x, -self.radius), np.minimum(self.upper - self.x, self.radius)
        step = least_maximum(here, H, box, self.penalty)
        if step is None:
            self.radius *= _UNSOLVED
            return self.radius < effort.least
        move = step.move
        predicted = merit - (step.level + self.penalty * step.violation + 0.5 * float(move @ H @ move))
        small = effort.tolerance * (effort.unit or abs(merit))
        if predicted <= _PREDICTED * small or self.radius < effort.least:
            return True
        there = self.function(self.x + move)
        self.spent += 1
        trial = self.merit(there)
        length = float(np.max(np.abs(move)))
        if np.isfinite(trial):
            self.hessian = self._learned(there, step)
        if not np.isfinite(trial) or (merit - trial) / predicted <= _ACCEPTED:
            self.radius = effort.smaller * length
            return False
        ratio = (merit - trial) / predicted
        self.x, self.here = self.x + move, there
        self.small = self.small + 1 if merit - trial < small else 0
        if ratio > _GOOD and length > _GOOD * self.radius:
            self.radius *= effort.larger
        elif ratio < _POOR:
            self.radius = _POORER * length
        return self.small >= _SMALL_STEPS

    def _learned(self, there: Evaluation, step: ModelStep) -> FloatArray:
        """Return the damped BFGS update of the curvature by the change of the weighted gradient.

        Each old function is compared with the new one of its owner that continues it best.
        """
        old = self.here
        expected, change = old.values + old.gradients @ step.move, np.zeros(len(self.x))
        scale = self.effort.unit or max(float(np.max(np.abs(there.values))), 1e-300)
        may = np.all(old.owner[:, None] == there.owner[None], axis=-1)
        if not np.any(may):
            return self.hessian
        for i in np.flatnonzero((step.weights > 1e-6) & np.any(may, axis=1)):
            same = np.flatnonzero(may[i])
            size = float(np.linalg.norm(old.gradients[i])) or 1.0
            far = np.linalg.norm(there.gradients[same] - old.gradients[i], axis=1) / size
            far += 10.0 * np.abs(there.values[same] - expected[i]) / scale
            change += step.weights[i] * (there.gradients[same[int(np.argmin(far))]] - old.gradients[i])
        return damped_update(self.hessian, step.move, change)


@value
class ModelStep:
    """Minimiser of the model."""

    move: FloatArray  # (n,): the step d
    level: float  # the largest function of the model at d that is not hard, without the curvature
    violation: float  # by how much the model's hard functions still exceed one
    weights: FloatArray  # (k,): multipliers of the functions, not negative; those that are not hard add up to one


def least_maximum(
    at: Evaluation, H: FloatArray, box: tuple[FloatArray, FloatArray], penalty: float
) -> ModelStep | None:
    """Minimise max(values + gradients d) + penalty max(0, hard values + hard gradients d − 1) + d'Hd/2 over the box.

    `penalty` is the price of the largest excess of a hard function over one; the box (lower, upper) holds zero. None
    where the solver found no solution.
    """
    lower, upper = box
    values, gradients = at.values[~at.hard], at.gradients[~at.hard]
    hard_values, hard_gradients = at.values[at.hard], at.gradients[at.hard]
    n, k, m = len(lower), len(values), len(hard_values)
    # Values are measured from the largest, in units of the range that the box allows: the solver sees numbers near 1.
    top = float(np.max(values))
    unit = float(np.max(np.abs(gradients) @ np.maximum(upper, -lower), initial=0.0)) or 1.0
    width = np.maximum(np.maximum(upper, -lower), 1e-300)
    columns = n + 1 + (1 if m else 0)
    rows = [np.hstack([gradients * width / unit, -np.ones((k, 1)), np.zeros((k, columns - n - 1))])]
    limits = [(top - values) / unit]
    scale = np.maximum(np.max(np.abs(hard_gradients) * width, axis=1, initial=0.0), 1.0)
    if m:
        rows.append(np.hstack([hard_gradients * width / scale[:, None], np.zeros((m, 1)), -1.0 / scale[:, None]]))
        rows.append(-np.eye(columns)[-1:])
        limits += [(1.0 - hard_values) / scale, np.zeros(1)]
    sides = np.eye(n, columns)
    rows += [sides, -sides]
    limits += [upper / width, -lower / width]
    P = np.zeros((columns, columns))
    P[:n, :n] = H * width[:, None] * width / unit
    q = np.zeros(columns)
    q[n:] = 1.0, *[penalty / unit] * (columns - n - 1)
    found = _solved(P, q, np.vstack(rows), np.concatenate(limits))
    if found is None:
        return None
    move = np.clip(found[0][:n] * width, lower, upper)
    dual, weights = found[1], np.empty(len(at.values))
    total = float(np.sum(dual[:k]))
    weights[~at.hard] = dual[:k] / total if total > 0.0 else 1.0 / k
    weights[at.hard] = dual[k : k + m] / scale * unit
    return ModelStep(
        move=move,
        level=float(np.max(values + gradients @ move)),
        violation=max(0.0, float(np.max(hard_values + hard_gradients @ move, initial=0.0)) - 1.0),
        weights=weights,
    )


def _solved(P: FloatArray, q: FloatArray, A: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Minimise x'Px/2 + q'x over A x <= b; return x and the multipliers, None where the solver found no solution."""
    import clarabel
    from scipy.sparse import csc_matrix

    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_iter = 60
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-10
    cones = [clarabel.NonnegativeConeT(len(b))]
    solution = clarabel.DefaultSolver(csc_matrix(np.triu(P)), q, csc_matrix(A), b, cones, settings).solve()
    if str(solution.status) not in ("Solved", "AlmostSolved", "InsufficientProgress", "MaxIterations"):
        return None
    x, dual = np.asarray(solution.x), np.maximum(np.asarray(solution.z), 0.0)
    return (x, dual) if np.all(np.isfinite(x)) and np.all(np.isfinite(dual)) else None


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
