"""Minimising the largest of smooth pieces: a non-smooth function of few parameters, with bounds and hard limits.

Three phases, all deterministic:

1. to stability: the largest `stability` piece (a spectral abscissa) is brought below zero;
2. descent: BFGS with a weak Wolfe line search on the largest piece (Lewis and Overton, Mathematical Programming 141,
   2013), which is robust far from the minimum and stalls where several pieces are active;
3. polish: all pieces near the maximum are linearised and their least maximum over a trust region is found by a
   quadratic program (sequential quadratic programming in epigraph form); pieces of refused trial points stay as cuts.
   With the `curvature` of the weighted pieces it converges quadratically, without it a quasi-Newton matrix serves.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.fixed_structure.quadratic import damped_update, least_maximum
from platform_ctrl.design.fixed_structure.quasi_newton import Stopped, descended

# x -> values (k,) and gradients (k, n) of the pieces near the maximum; [inf] where there is none.
Pieces = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
# x, move -> further pieces at x.
Sharpened = Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]
# x, weights (k,) of the pieces at x -> Hessian (n, n) of the weighted sum.
Curvature = Callable[[FloatArray, FloatArray], FloatArray]

# Most rounds in which coinciding pieces are sharpened for a step.
_SHARPER = 8


@value
class Minimum:
    """Where the search ended.

    Attributes
    ----------
    x : (n,)
        Parameters, within the bounds.
    value
        Largest piece; inf where x is not stable.
    hard
        Largest hard piece; −inf without any.
    stability
        Largest stability piece, negative where x is stable; −inf without any.
    evaluations
        How often pieces were requested.
    finished
        Whether it ended by itself and not by its evaluations or its deadline.
    late
        Whether the deadline ended it.
    history
        Largest piece after every accepted step.
    """

    x: FloatArray
    value: float
    hard: float
    stability: float
    evaluations: int
    finished: bool
    late: bool
    history: tuple[float, ...]

    @property
    def stable(self) -> bool:
        """Whether the stability pieces are all negative."""
        return self.stability < 0.0


class _Search:
    """One run: the functions, the bounds, what was spent and the best point seen."""

    def __init__(
        self,
        pieces: Pieces,
        lower: FloatArray,
        upper: FloatArray,
        hard: Pieces | None,
        stability: Pieces | None,
        curvature: Curvature | None,
        walls: Pieces | None,
        wall_curvature: Curvature | None,
        sharpened: Sharpened | None,
        watch: Sharpened | None,
        evaluations: int,
        deadline: float,
        target: float,
        progress: Callable[[float], None] | None,
    ) -> None:
        self.soft, self.hard_pieces, self.stability_pieces = pieces, hard, stability
        self.curvature, self.walls, self.wall_curvature = curvature, walls, wall_curvature
        self.lower, self.upper = lower, upper
        self.sharpened, self.watch = sharpened, watch
        self.left, self.spent, self.deadline, self.late = evaluations, 0, deadline, False
        self.target = target
        self.progress = progress
        self.history: list[float] = []

    def ask(self, function: Pieces, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        self.late = self.late or time.monotonic() > self.deadline
        if self.late or self.spent >= self.left:
            raise Stopped
        self.spent += 1
        return function(x)

    def stable(self, x: FloatArray) -> bool:
        if self.stability_pieces is None:
            return True
        values, _ = self.stability_pieces(x)
        return bool(np.max(values) < 0.0)

    def note(self, level: float) -> None:
        self.history.append(level)
        if self.progress is not None:
            self.progress(level)


def minimise(
    pieces: Pieces,
    x0: FloatArray,
    lower: FloatArray | None = None,
    upper: FloatArray | None = None,
    *,
    hard: Pieces | None = None,
    stability: Pieces | None = None,
    curvature: Curvature | None = None,
    walls: Pieces | None = None,
    wall_curvature: Curvature | None = None,
    sharpened: Sharpened | None = None,
    watch: Sharpened | None = None,
    target: float = -np.inf,
    tolerance: float = 1e-7,
    evaluations: int = 4000,
    settling: int = 400,
    descent: int = 400,
    radius: float = 1.0,
    deadline: float = np.inf,
    progress: Callable[[float], None] | None = None,
) -> Minimum:
    """Minimise the largest of `pieces` where every `stability` piece is negative and every `hard` piece at most one.

    Parameters
    ----------
    pieces
        x → values (k,) and gradients (k, n) of the smooth pieces near the maximum. Called only at stable x; inf as a
        value refuses the point.
    x0 : (n,)
        Start, in units where a change of one is large.
    lower, upper : (n,), optional
        Bounds.
    hard
        Pieces that must not exceed one.
    stability
        Pieces that must be negative (spectral abscissas with a margin); they are brought there first.
    curvature
        Hessian of the weighted pieces at x.
    walls
        Pieces that have to stay negative to first order in every step of the polish, with
    wall_curvature
        the Hessian of their weighted sum.
    sharpened
        x and a move → further pieces at x that the move makes large, where pieces nearly coincide; `curvature` counts
        them behind the others.
    watch
        x and a refused point → pieces of that point as they are at x, likewise.
    target
        End as soon as the largest piece is not above it (and no hard piece above one).
    tolerance
        Relative decrease, predicted by the model, at which the search ends.
    evaluations, settling, descent
        Most evaluations in all, most iterations of the phases to stability and of descent.
    deadline
        Time by `time.monotonic`, s, at which the search ends in any case.
    radius
        First trust region of the polish.
    progress
        Called with the largest piece after every accepted step.

    Returns
    -------
    Minimum
        The best point found, also where limits ended the search; `Minimum.stable` says whether it is usable.
    """
    n = len(x0)
    low = np.full(n, -np.inf) if lower is None else np.asarray(lower, dtype=np.float64)
    high = np.full(n, np.inf) if upper is None else np.asarray(upper, dtype=np.float64)
    search = _Search(
        pieces,
        low,
        high,
        hard,
        stability,
        curvature,
        walls,
        wall_curvature,
        sharpened,
        watch,
        evaluations,
        deadline,
        target,
        progress,
    )
    x = np.clip(np.asarray(x0, dtype=np.float64), low, high)
    best = x
    finished = True
    try:
        if stability is not None:
            x = best = _descended(search, stability, x, -1e-300, settling, None)
        if search.stable(x):
            if hard is not None:
                x = best = _descended(search, _within(search, hard), x, 1.0, descent, None)
            if hard is None or np.max(hard(x)[0]) <= 1.0:
                x = best = _descended(search, _priced(search), x, target, descent, search.note)
            x = best = _polished(search, x, tolerance, radius)
    except Stopped as ended:
        finished = False
        best = ended.args[0] if ended.args else best
    return _judged(search, best, finished)


def _judged(search: _Search, x: FloatArray, finished: bool) -> Minimum:
    abscissa = -np.inf if search.stability_pieces is None else float(np.max(search.stability_pieces(x)[0]))
    level = float(np.max(search.soft(x)[0])) if abscissa < 0.0 else np.inf
    limit = -np.inf
    if search.hard_pieces is not None:
        limit = float(np.max(search.hard_pieces(x)[0])) if abscissa < 0.0 else np.inf
    return Minimum(
        x=x,
        value=level,
        hard=limit,
        stability=abscissa,
        evaluations=search.spent,
        finished=finished,
        late=search.late,
        history=tuple(search.history),
    )


def _within(search: _Search, function: Pieces) -> Pieces:
    """`function` where the loop is stable, inf elsewhere."""

    def inside(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        if not search.stable(x):
            return np.array([np.inf]), np.zeros((1, len(x)))
        return function(x)

    return inside


def _priced(search: _Search) -> Pieces:
    """The soft pieces where the loop is stable and the hard ones hold, inf elsewhere."""

    def inside(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        refused = np.array([np.inf]), np.zeros((1, len(x)))
        if not search.stable(x):
            return refused
        if search.hard_pieces is not None and np.max(search.hard_pieces(x)[0]) > 1.0:
            return refused
        return search.soft(x)

    return inside


def _descended(
    search: _Search,
    function: Pieces,
    x: FloatArray,
    target: float,
    iterations: int,
    note: Callable[[float], None] | None,
) -> FloatArray:
    """BFGS on the largest piece."""

    def largest(y: FloatArray, _: float) -> tuple[float, FloatArray]:
        values, gradients = search.ask(function, y)
        i = int(np.argmax(values))
        return float(values[i]), gradients[i]

    found = descended(largest, x, search.lower, search.upper, target=target, iterations=iterations, note=note)
    if not found.finished:
        raise Stopped(found.x)
    return found.x


def _polished(search: _Search, x: FloatArray, tolerance: float, radius: float) -> FloatArray:
    """Trust-region quadratic programs over all pieces near the maximum."""
    n = len(x)
    hard = search.hard_pieces
    try:
        values, gradients = search.ask(search.soft, x)
        hard_values, hard_gradients = (None, None) if hard is None else search.ask(hard, x)
        penalty = 10.0 * max(1.0, abs(float(np.max(values))))
        H = np.zeros((n, n))
        if search.curvature is None:
            H = np.eye(n) * 1e-2 * max(abs(float(np.max(values))), 1e-12)
        weights, wall_weights = None, np.zeros(0)
        cuts: list[tuple[FloatArray, FloatArray]] = []
        small = 0
        limits = _limits(search, x)
        flat = 1e-8 * np.eye(n)
        while True:
            merit = _merit(values, hard_values, penalty)
            if search.target > -np.inf and np.max(values) <= search.target and merit <= search.target:
                break
            low = np.maximum(search.lower - x, -radius)
            high = np.minimum(search.upper - x, radius)
            all_values = np.concatenate([values, *(c[0] for c in cuts)])
            all_gradients = np.vstack([gradients, *(c[1] for c in cuts)])
            step = None
            for _ in range(2):
                if search.curvature is not None:
                    if weights is None:
                        first = least_maximum(
                            all_values, all_gradients, flat, low, high, hard_values, hard_gradients, penalty, limits
                        )
                        if first is None:
                            break
                        weights, wall_weights = first.weights[: len(values)], first.wall_weights
                    H = search.curvature(x, weights)
                    if search.wall_curvature is not None and np.any(wall_weights > 0.0):
                        H = H + search.wall_curvature(x, wall_weights)
                    H = _convex(H)
                step = least_maximum(
                    all_values, all_gradients, H, low, high, hard_values, hard_gradients, penalty, limits
                )
                if step is None or search.curvature is None or weights is None:
                    break
                changed = float(np.abs(step.weights[: len(values)] - weights).sum())
                weights, wall_weights = step.weights[: len(values)], step.wall_weights
                if changed < 0.2:
                    break
            if step is None:
                radius *= 0.25
                weights = None
                if radius < 1e-12:
                    break
                continue
            solved = len(values)
            for _ in range(_SHARPER):
                if search.sharpened is None:
                    break
                more, slopes = search.sharpened(x, step.move)
                if more.size == 0:
                    break
                values, gradients = np.concatenate([values, more]), np.vstack([gradients, slopes])
                at = float(np.max(more + slopes @ step.move))
                if at <= step.level + 0.02 * max(merit - step.level, 0.0):
                    break
                all_values = np.concatenate([values, *(c[0] for c in cuts)])
                all_gradients = np.vstack([gradients, *(c[1] for c in cuts)])
                again = least_maximum(
                    all_values, all_gradients, H, low, high, hard_values, hard_gradients, penalty, limits
                )
                if again is None:
                    break
                step, solved = again, len(values)
            weights = np.concatenate([step.weights[:solved], np.zeros(len(values) - solved)])
            wall_weights = step.wall_weights
            d = step.move
            curved = 0.5 * float(d @ H @ d)
            predicted = merit - (step.level + penalty * step.violation + curved)
            if predicted <= tolerance * abs(merit) * 1e-2 or radius < 1e-13:
                break
            y = x + d
            trial = np.inf
            if search.stable(y):
                new_values, new_gradients = search.ask(search.soft, y)
                new_hard = (None, None) if hard is None else search.ask(hard, y)
                trial = _merit(new_values, new_hard[0], penalty)
            else:
                search.spent += 1
            ratio = (merit - trial) / predicted if np.isfinite(trial) else -1.0
            length = float(np.max(np.abs(d)))
            if ratio > 1e-3:
                if search.curvature is None:
                    H = _updated(H, d, values, gradients, new_values, new_gradients, step.weights)
                x, values, gradients, weights, cuts = y, new_values, new_gradients, None, []
                hard_values, hard_gradients = new_hard
                limits = _limits(search, x)
                search.note(float(np.max(values)))
                small = small + 1 if merit - trial <= tolerance * abs(merit) else 0
                if small >= 3:
                    break
                if ratio > 0.7 and length > 0.7 * radius:
                    radius *= 2.5
                elif ratio < 0.25:
                    radius = max(0.5 * length, 1e-14)
                continue
            radius = 0.3 * length if not np.isfinite(trial) else min(0.5 * length, radius)
            if np.isfinite(trial) and search.watch is not None:
                more, slopes = search.watch(x, y)
                values, gradients = np.concatenate([values, more]), np.vstack([gradients, slopes])
                weights = np.concatenate([weights, np.zeros(len(more))])
            if np.isfinite(trial) and hard is None and len(cuts) < 6:
                # The pieces of the refused point, as they look from x; never above what x itself has.
                seen = new_values - new_gradients @ d
                near = new_values > merit - 0.5 * predicted
                shift = np.maximum(seen - float(np.max(values)), 0.0)
                cuts.append(((seen - shift)[near], new_gradients[near]))
    except Stopped:
        raise Stopped(x) from None
    return x


def _limits(search: _Search, x: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Return rows and limits of the step."""
    if search.walls is None:
        return None
    values, gradients = search.walls(x)
    return gradients, -values


def _merit(values: FloatArray, hard_values: FloatArray | None, penalty: float) -> float:
    excess = 0.0 if hard_values is None else max(0.0, float(np.max(hard_values)) - 1.0)
    return float(np.max(values)) + penalty * excess


def _convex(H: FloatArray) -> FloatArray:
    """The nearest matrix whose curvatures are positive: negative ones change sign."""
    values, vectors = np.linalg.eigh(0.5 * (H + H.T))
    size = float(np.max(np.abs(values), initial=0.0)) or 1.0
    return np.asarray((vectors * np.maximum(np.abs(values), 1e-9 * size)) @ vectors.T)


def _updated(
    H: FloatArray,
    d: FloatArray,
    values: FloatArray,
    gradients: FloatArray,
    new_values: FloatArray,
    new_gradients: FloatArray,
    weights: FloatArray,
) -> FloatArray:
    """Damped BFGS on the weighted gradient, each old piece compared with the new piece that continues it best."""
    old = weights[: len(values)]
    change = np.zeros(len(d))
    expected = values + gradients @ d
    size = float(np.linalg.norm(gradients, axis=1).max()) or 1.0
    spread = max(float(np.ptp(new_values)), 1e-3 * abs(float(np.max(new_values))), 1e-300)
    for i in np.flatnonzero(old > 1e-6):
        far = np.linalg.norm(new_gradients - gradients[i], axis=1) / size + np.abs(new_values - expected[i]) / spread
        change += old[i] * (new_gradients[int(np.argmin(far))] - gradients[i])
    return damped_update(H, d, change)
