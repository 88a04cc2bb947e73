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
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.fixed_structure.quadratic import Step, damped_update, least_maximum
from platform_ctrl.design.fixed_structure.quasi_newton import Stopped, descended

# Values (k,) and gradients (k, n) of smooth functions.
PieceValues = tuple[FloatArray, FloatArray]
# x -> the pieces near the maximum; [inf] where there is none.
Pieces = Callable[[FloatArray], PieceValues]

# Most rounds in which coinciding pieces are sharpened for a step, and most refused points whose pieces stay as cuts.
_SHARPER, _CUTS = 8, 6
# Decrease over the predicted one that a step needs to be accepted, to enlarge the region, and not to shrink it.
_ACCEPTED, _GOOD, _POOR = 1e-3, 0.7, 0.25
# Factor of the region after a poor step.
_POORER = 0.5
# Steps in a row that decrease the value by less than the tolerance, before the search ends; share of the tolerance at
# which a predicted decrease ends it at once.
_SMALL_STEPS, _PREDICTED = 5, 0.1
# Most iterations of the descent to stability.
SETTLING = 400


@value
class Objective:
    """What is minimised, over x (n,)."""

    soft: Pieces  # the largest is minimised; called only at stable x, inf as a value refuses the point
    hard: Pieces | None = None  # must not exceed one
    stability: Pieces | None = None  # must be negative (abscissas with a margin); they are brought there first
    # x, weights (k,) of the soft pieces at x → Hessian of the weighted sum.
    curvature: Callable[[FloatArray, FloatArray], FloatArray] | None = None
    walls: Pieces | None = None  # have to stay negative to first order in every step of the polish
    wall_curvature: Callable[[FloatArray, FloatArray], FloatArray] | None = None  # x, weights → Hessian of their sum
    # x, move → further soft pieces at x that the move makes large, where pieces nearly coincide; `curvature` counts
    # them behind the others.
    sharpened: Callable[[FloatArray, FloatArray], PieceValues] | None = None
    # x, refused point → soft pieces of that point as they are at x, likewise.
    watch: Callable[[FloatArray, FloatArray], PieceValues] | None = None
    # x → what the soft and then the hard pieces belong to, (k, labels): only pieces of one owner continue each other
    # from one point to the next. Without it any piece may continue any other.
    owners: Callable[[FloatArray], NDArray[np.intp]] | None = None

    def stable(self, x: FloatArray) -> bool:
        """Return whether the stability pieces are all negative."""
        return self.stability is None or bool(np.max(self.stability(x)[0]) < 0.0)


@value
class Region:
    """Trust region of a polish."""

    # radius, least: the first one, and the one at which the polish ends.
    radius: float = 1.0
    least: float = 1e-13
    # larger, smaller: its factors where a step of its length was good, and where a step was refused.
    larger: float = 2.5
    smaller: float = 0.5
    hessian: FloatArray | None = None  # curvature of an earlier search, where none is known in closed form


@value
class Effort:
    """How far a search goes."""

    evaluations: int = 4000  # most evaluations of pieces in all
    # descent, steps: most iterations of the descents on hard and soft pieces, and most steps of the polish.
    descent: int = 400
    steps: int = 10**6
    deadline: float = np.inf  # time by `time.monotonic`, s, at which the search ends in any case
    # target, excess: the search ends as soon as the largest soft piece is at most `target` and no hard piece above 1 +
    # `excess`.
    target: float = -np.inf
    excess: float = 0.0
    # tolerance, unit: decrease of a small step, in this unit; without one in units of the value itself.
    tolerance: float = 1e-7
    unit: float | None = None
    # Price of the largest excess of a hard piece; without one, ten times the largest soft piece, at least 10.
    penalty: float | None = None
    region: Region = Region()  # of the polish


@value
class Minimum:
    """Where the search ended."""

    x: FloatArray  # (n,): parameters, within the bounds
    value: float  # largest piece; inf where x is not stable
    hard: float  # largest hard piece; −inf without any
    stability: float  # largest stability piece, negative where x is stable; −inf without any
    evaluations: int  # how often pieces were requested
    finished: bool  # whether it ended by itself and not by its evaluations, its steps or its deadline
    late: bool  # whether the deadline ended it
    # radius, hessian: trust region and curvature of the polish, to go on with; the first ones where there was none.
    radius: float
    hessian: FloatArray | None

    @property
    def stable(self) -> bool:
        """Whether the stability pieces are all negative."""
        return self.stability < 0.0


class _Search:
    """One run: the functions, the bounds, what was spent, and the phases before the polish."""

    def __init__(self, objective: Objective, bounds: tuple[FloatArray, FloatArray], effort: Effort) -> None:
        self.objective, self.effort = objective, effort
        self.lower, self.upper = bounds
        self.spent, self.late = 0, False
        self.radius, self.hessian = effort.region.radius, effort.region.hessian

    def evaluate(self, function: Pieces, x: FloatArray) -> PieceValues:
        """Return the pieces at x, counted."""
        self.late = self.late or time.monotonic() > self.effort.deadline
        if self.late or self.spent >= self.effort.evaluations:
            raise Stopped
        self.spent += 1
        return function(x)

    def descended(self, function: Pieces, x: FloatArray, target: float, iterations: int) -> FloatArray:
        """Return where BFGS on the largest piece of a function leads."""

        def largest(y: FloatArray, _: float) -> tuple[float, FloatArray]:
            values, gradients = self.evaluate(function, y)
            i = int(np.argmax(values))
            return float(values[i]), gradients[i]

        found = descended(largest, x, self.lower, self.upper, target=target, iterations=iterations)
        if not found.finished:
            raise Stopped(found.x)
        return found.x

    def excess(self, x: FloatArray) -> PieceValues:
        """Return the hard pieces where x is stable, inf elsewhere."""
        if self.objective.hard is None or not self.objective.stable(x):
            return np.array([np.inf]), np.zeros((1, len(x)))
        found = self.objective.hard(x)
        return found if len(found[0]) else (np.zeros(1), np.zeros((1, len(x))))

    def allowed(self, x: FloatArray) -> PieceValues:
        """Return the soft pieces where x is stable and the hard ones hold, inf elsewhere."""
        hard = self.objective.hard
        if not self.objective.stable(x) or (hard is not None and np.max(hard(x)[0], initial=0.0) > 1.0):
            return np.array([np.inf]), np.zeros((1, len(x)))
        return self.objective.soft(x)

    def result(self, x: FloatArray, finished: bool) -> Minimum:
        """Return what the search came to."""
        of = self.objective
        abscissa = -np.inf if of.stability is None else float(np.max(of.stability(x)[0]))
        level = float(np.max(of.soft(x)[0])) if abscissa < 0.0 else np.inf
        limit = -np.inf
        if of.hard is not None:
            limit = float(np.max(of.hard(x)[0], initial=-np.inf)) if abscissa < 0.0 else np.inf
        return Minimum(
            x=x,
            value=level,
            hard=limit,
            stability=abscissa,
            evaluations=self.spent,
            finished=finished,
            late=self.late,
            radius=self.radius,
            hessian=self.hessian,
        )


class _Point(NamedTuple):
    """A stable point with its soft and hard pieces; hard ones are empty where there are none."""

    x: FloatArray
    soft: PieceValues
    hard: PieceValues

    def merit(self, penalty: float) -> float:
        """Return the largest soft piece and the price of the largest excess of a hard one."""
        return float(np.max(self.soft[0])) + penalty * max(0.0, float(np.max(self.hard[0], initial=0.0)) - 1.0)


def _with(one: PieceValues, *others: PieceValues) -> PieceValues:
    return np.concatenate([one[0], *(o[0] for o in others)]), np.vstack([one[1], *(o[1] for o in others)])


class Polish:
    """Trust-region quadratic programs over all pieces near the maximum."""

    def __init__(self, search: _Search) -> None:
        self.search, self.of, self.effort = search, search.objective, search.effort

    def run(self, x: FloatArray) -> tuple[FloatArray, bool]:
        """Return where the programs lead from x, and whether they came to an end by themselves."""
        self.here = _Point(x, (np.zeros(0), np.zeros((0, len(x)))), (np.zeros(0), np.zeros((0, len(x)))))
        try:
            self._move_to(self._at(x))
            size = abs(float(np.max(self.here.soft[0])))
            self.penalty = self.effort.penalty or 10.0 * max(1.0, size)
            if self.search.hessian is None:
                self.search.hessian = np.eye(len(x)) * 1e-2 * max(size, 1e-12)
            self.small = 0
            for _ in range(self.effort.steps):
                if self._step():
                    return self.here.x, True
        except Stopped:
            raise Stopped(self.here.x) from None
        return self.here.x, False

    def _at(self, x: FloatArray) -> _Point:
        soft = self.search.evaluate(self.of.soft, x)
        hard = (np.zeros(0), np.zeros((0, len(x)))) if self.of.hard is None else self.search.evaluate(self.of.hard, x)
        return _Point(x, soft, hard)

    def _move_to(self, point: _Point) -> None:
        self.here, self.wall_weights = point, np.zeros(0)
        self.weights: FloatArray | None = None
        self.cuts: list[PieceValues] = []
        self.walls: PieceValues | None = None
        if self.of.walls is not None:
            values, gradients = self.of.walls(point.x)
            self.walls = gradients, -values

    def _step(self) -> bool:
        """Try a step; return whether the search has come to its end."""
        search, here, effort = self.search, self.here, self.effort
        merit = here.merit(self.penalty)
        if np.max(here.soft[0]) <= effort.target and np.max(here.hard[0], initial=0.0) <= 1.0 + effort.excess:
            return True
        step, H = self._solved()
        if step is None:
            search.radius *= 0.25
            self.weights = None
            return search.radius < effort.region.least
        step = self._sharper(step, H, merit)
        move = step.move
        predicted = merit - (step.level + self.penalty * step.violation + 0.5 * float(move @ H @ move))
        small = effort.tolerance * (effort.unit or abs(merit))
        if predicted <= _PREDICTED * small or search.radius < effort.region.least:
            return True
        there = None
        if self.of.stable(here.x + move):
            there = self._at(here.x + move)
        else:
            search.spent += 1
        trial = np.inf if there is None else there.merit(self.penalty)
        length = float(np.max(np.abs(move)))
        if there is not None and self.of.curvature is None and np.isfinite(trial):
            search.hessian = self._learned(there, step)
        ratio = (merit - trial) / predicted if np.isfinite(trial) else -1.0
        if there is not None and ratio > _ACCEPTED:
            self._move_to(there)
            self.small = self.small + 1 if merit - trial < small else 0
            if ratio > _GOOD and length > _GOOD * search.radius:
                search.radius *= effort.region.larger
            elif ratio < _POOR:
                search.radius = _POORER * length
            return self.small >= _SMALL_STEPS
        search.radius = effort.region.smaller * length
        if there is not None and np.isfinite(trial):
            self._refused(there, merit - 0.5 * predicted)
        return False

    def _program(self, H: FloatArray) -> Step | None:
        """Return the least maximum of the linearised pieces and cuts within the trust region."""
        search, x = self.search, self.here.x
        box = np.maximum(search.lower - x, -search.radius), np.minimum(search.upper - x, search.radius)
        hard = None if self.of.hard is None or not len(self.here.hard[0]) else self.here.hard
        return least_maximum(_with(self.here.soft, *self.cuts), H, box, hard, self.penalty, self.walls)

    def _solved(self) -> tuple[Step | None, FloatArray]:
        """Return the step, and the curvature that belongs to its own weights."""
        assert self.search.hessian is not None
        H, x, count = self.search.hessian, self.here.x, len(self.here.soft[0])
        if self.of.curvature is None:
            return self._program(H), H
        step = None
        for _ in range(2):
            if self.weights is None:
                first = self._program(1e-8 * np.eye(len(x)))
                if first is None:
                    break
                self.weights, self.wall_weights = first.weights[:count], first.wall_weights
            H = self.of.curvature(x, self.weights)
            if self.of.wall_curvature is not None and np.any(self.wall_weights > 0.0):
                H = H + self.of.wall_curvature(x, self.wall_weights)
            H = _convex(H)
            step = self._program(H)
            if step is None:
                break
            changed = float(np.abs(step.weights[:count] - self.weights).sum())
            self.weights, self.wall_weights = step.weights[:count], step.wall_weights
            if changed < 0.2:
                break
        return step, H

    def _sharper(self, step: Step, H: FloatArray, merit: float) -> Step:
        """Return the step once more with the pieces that it makes large, where some nearly coincide."""
        solved = len(self.here.soft[0])
        for _ in range(_SHARPER if self.of.sharpened is not None else 0):
            assert self.of.sharpened is not None
            more, slopes = self.of.sharpened(self.here.x, step.move)
            if more.size == 0:
                break
            self.here = self.here._replace(soft=_with(self.here.soft, (more, slopes)))
            if float(np.max(more + slopes @ step.move)) <= step.level + 0.02 * max(merit - step.level, 0.0):
                break
            again = self._program(H)
            if again is None:
                break
            step, solved = again, len(self.here.soft[0])
        if self.of.curvature is not None:
            self.weights = np.append(step.weights[:solved], np.zeros(len(self.here.soft[0]) - solved))
            self.wall_weights = step.wall_weights
        return step

    def _refused(self, there: _Point, level: float) -> None:
        """Keep what a refused point shows: peaks to be watched, and its pieces as cuts."""
        if self.of.watch is not None:
            more = self.of.watch(self.here.x, there.x)
            self.here = self.here._replace(soft=_with(self.here.soft, more))
            if self.weights is not None:
                self.weights = np.append(self.weights, np.zeros(len(more[0])))
        if self.of.hard is None and len(self.cuts) < _CUTS:
            # The pieces of the refused point, as they look from here; never above what is here itself.
            values, gradients = there.soft
            seen = values - gradients @ (there.x - self.here.x)
            shift = np.maximum(seen - float(np.max(self.here.soft[0])), 0.0)
            near = values > level
            self.cuts.append(((seen - shift)[near], gradients[near]))

    def _learned(self, there: _Point, step: Step) -> FloatArray:
        """Return the damped BFGS update of the curvature by the change of the weighted gradient.

        Each old piece is compared with the new piece that continues it best.
        """
        assert self.search.hessian is not None
        here, count = self.here, len(self.here.soft[0])
        old, new = _with(here.soft, here.hard), _with(there.soft, there.hard)
        weights = np.append(step.weights[:count], step.hard_weights)
        may = np.ones((len(old[0]), len(new[0])), dtype=np.bool_)
        if self.of.owners is not None:
            one, other = self.of.owners(here.x), self.of.owners(there.x)
            may = np.all(one[:, None] == other[None], axis=-1)
        expected, change = old[0] + old[1] @ step.move, np.zeros(len(here.x))
        scale = self.effort.unit or max(float(np.max(np.abs(new[0]))), 1e-300)
        if not np.any(may):
            return self.search.hessian
        for i in np.flatnonzero((weights > 1e-6) & np.any(may, axis=1)):
            same = np.flatnonzero(may[i])
            size = float(np.linalg.norm(old[1][i])) or 1.0
            far = np.linalg.norm(new[1][same] - old[1][i], axis=1) / size
            far += 10.0 * np.abs(new[0][same] - expected[i]) / scale
            change += weights[i] * (new[1][same[int(np.argmin(far))]] - old[1][i])
        return damped_update(self.search.hessian, step.move, change)


def _convex(H: FloatArray) -> FloatArray:
    """The nearest matrix whose curvatures are positive: negative ones change sign."""
    values, vectors = np.linalg.eigh(0.5 * (H + H.T))
    size = float(np.max(np.abs(values), initial=0.0)) or 1.0
    return np.asarray((vectors * np.maximum(np.abs(values), 1e-9 * size)) @ vectors.T)


def minimise(
    objective: Objective,
    x0: FloatArray,
    bounds: tuple[FloatArray, FloatArray] | None = None,
    effort: Effort | None = None,
) -> Minimum:
    """Minimise the largest soft piece where every `stability` piece is negative and every `hard` piece at most one.

    It starts at `x0` (n,), in units where a change of one is large, and ends at the best point found, also where limits
    ended the search; `Minimum.stable` says whether it is usable.
    """
    effort = effort or Effort()
    n = len(x0)
    lower, upper = bounds or (np.full(n, -np.inf), np.full(n, np.inf))
    search = _Search(objective, (lower, upper), effort)
    x = np.clip(np.asarray(x0, dtype=np.float64), lower, upper)
    best = x
    finished = True
    try:
        if objective.stability is not None:
            x = best = search.descended(objective.stability, x, -1e-300, SETTLING)
        if objective.stable(x):
            if objective.hard is not None:
                x = best = search.descended(search.excess, x, 1.0, effort.descent)
            if objective.hard is None or np.max(objective.hard(x)[0], initial=0.0) <= 1.0:
                x = best = search.descended(search.allowed, x, effort.target, effort.descent)
            best, finished = Polish(search).run(x)
    except Stopped as ended:
        finished = False
        best = ended.args[0] if ended.args else best
    return search.result(best, finished)
