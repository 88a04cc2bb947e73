"""One search from one starting point: what a worker does."""

from __future__ import annotations

import dataclasses
import time
from typing import Any

import numpy as np

from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.fixed_structure.minimax import SETTLING, Effort, Minimum, Objective, Pieces, Region, minimise
from platform_ctrl.design.fixed_structure.objective import Parametrisation, Rescaled, WorstNorm, WorstPower, step_sizes
from platform_ctrl.design.fixed_structure.parametrised import Chart, Entries, Parametrised
from platform_ctrl.design.fixed_structure.quasi_newton import Descent, Stopped, descended
from platform_ctrl.design.partition import Partition

# A hard norm that exceeds its limit by no more counts as kept.
_TOUCHING = 5e-4
# Most charts that a search without a pattern goes through, and the decrease that is worth another one.
_CHARTS, _WORTH = 6, 1e-7
# The gain may grow in stages: along the limit of one the search finds its way before it meets the next.
_COSINES = (1e-2, 1e-4, 1e-6)
# The same for a pattern in coordinates scaled anew, and the first trust region there.
_ROUNDS, _WORTHWHILE, _FIRST = 6, 2e-4, 0.1
# What an evaluation of the polish costs, in evaluations of a descent.
POLISH_COST = 20
# Largest entries of M, in their units, in the first part of a descent and when it goes on: where the infimum lies at
# infinite gain a descent without limit runs there on a way of its own, and stops at a kink.
_GAINS = (1e2, 1e4)
# Decrease for which a descent begins afresh once more, relative.
_AGAIN = 1e-4
# Most evaluations in one chart or scaling.
_EVALUATIONS = 1200


@value
class Goal:
    """A norm of every plant, in units of its limit."""

    plants: tuple[Partition, ...]  # augmented, with the goal's own w and z
    h2: bool = False  # whether it is the H2 norm


@value
class Problem:
    """What is searched for."""

    plants: tuple[Partition, ...]  # augmented by the controller's integrators; their poles have to be stable
    # soft, hard: norms to be minimised, and norms that must not exceed one.
    soft: tuple[Goal, ...]
    hard: tuple[Goal, ...]
    decay: float  # least distance of every pole from the axis, rad/s
    # (left, right): M = left · M_scaled · right, for controllers without a pattern.
    units: tuple[FloatArray, FloatArray]
    order: int  # states of the controller, the first rows and columns of M
    structured: Parametrised | None  # the pattern; None: every entry of M is free


@value
class Limits:
    """How far a search goes."""

    # Most evaluations of the closed loops: one counts a norm with its slope, `POLISH_COST` all its peaks with their
    # curvature and a quadratic program.
    evaluations: int
    deadline: float = np.inf  # time by `time.monotonic`, s


@value
class Outcome:
    """What a search has reached."""

    x: FloatArray  # search coordinates; where there is no pattern the entries of M in their units, row by row
    M: FloatArray  # [A_K, B_K; C_K, D_K]
    # value, hard: as in `minimax.Minimum`.
    value: float
    hard: float
    # stable, abscissa: whether every loop is stable by the decay requested, and the largest real part of their poles,
    # rad/s.
    stable: bool
    abscissa: float
    # evaluations, seconds, finished, late: what was spent, whether the search ended by itself, and whether the deadline
    # ended it.
    evaluations: int
    seconds: float
    finished: bool
    late: bool
    at_limit: bool = False  # whether the largest gain that the search allows keeps the controller where it is
    inverse: FloatArray | None = None  # what a descent has learnt, to go on with

    @property
    def rank(self) -> tuple[float, float]:
        """The smaller the better: stability first, then hard limits, then the value."""
        if not self.stable:
            return 2.0, self.abscissa
        if self.hard > 1.0 + _TOUCHING:
            return 1.0, self.hard
        return 0.0, self.value


def searched(problem: Problem, start: FloatArray | Outcome, limits: Limits, polish: bool = False) -> Outcome:
    """Return what a search finds that begins at `start`, or goes on from there.

    `start`: search coordinates, M where there is no pattern, or what an earlier part of the search found. With `polish`
    it works with all peaks and their curvature, which is dear and ends at a minimum; else it descends.
    """
    began = time.monotonic()
    if isinstance(start, Outcome):
        x, inverse, spent, seconds = start.x, start.inverse, start.evaluations, start.seconds
        inverse = None if start.finished else inverse
    else:
        x = start if problem.structured is not None else Entries(problem.units, problem.order).coordinates(start)
        inverse, spent, seconds = None, 0, 0.0
    if polish or not divides(problem):
        found = _polished(problem, x, limits)
        if isinstance(start, Outcome) and start.rank < found.rank:
            found = dataclasses.replace(start, finished=found.finished, late=found.late, evaluations=found.evaluations)
    else:
        found = _approached(problem, x, inverse, limits, isinstance(start, Outcome))
    return dataclasses.replace(found, evaluations=found.evaluations + spent, seconds=seconds + time.monotonic() - began)


def divides(problem: Problem) -> bool:
    """Whether a search is done in parts: free matrices, and one H-infinity norm to be made small."""
    return _curved(problem) and not problem.hard and problem.structured is None


def _curved(problem: Problem) -> bool:
    """Whether curvatures are known: one norm is made small, and it is the H-infinity norm."""
    return len(problem.soft) == 1 and not problem.soft[0].h2


def _approached(problem: Problem, x: FloatArray, inverse: FloatArray | None, limits: Limits, again: bool) -> Outcome:
    """Descend to stability and then on the norm, in the entries of M: BFGS goes through kinks there.

    On a chart it would not: there a way to infinite gain is short, and it goes it before the norm is small. A descent
    that goes on begins afresh where it ends, without what it has learnt, as long as that is worth it.
    """
    whole = problem.structured
    controller = Entries(problem.units, problem.order) if whole is None else whole
    gain = max(_GAINS[again], 2.0 * float(np.abs(x).max(initial=0.0)))
    low = np.full(x.size, -gain) if whole is None else whole.lower
    high = np.full(x.size, gain) if whole is None else whole.upper
    loops = WorstNorm(problem.plants, controller, margin=problem.decay)
    spent, late = 0, False

    def count() -> None:
        nonlocal spent, late
        late = late or time.monotonic() > limits.deadline
        if late or spent >= limits.evaluations:
            raise Stopped
        spent += 1

    def rightmost(y: FloatArray, _: float) -> tuple[float, FloatArray]:
        count()
        values, gradients = loops.stability(y)
        i = int(np.argmax(values))
        return float(values[i]), gradients[i]

    def norm(y: FloatArray, enough: float) -> tuple[float, FloatArray]:
        count()
        return loops.top(y, enough)

    found = Descent(x=x, level=np.inf, inverse=inverse, finished=True)
    if not loops.stable(x):
        found = descended(rightmost, x, low, high, target=-1e-300, iterations=SETTLING)
        found = dataclasses.replace(found, inverse=None)
    stable = loops.stable(found.x)
    while stable and found.finished:
        last, found = found.level, descended(norm, found.x, low, high, inverse=found.inverse)
        # Larger gains are followed to their limit: an infimum at infinite gain is to be seen as one.
        if not again or not (found.finished and found.level < last * (1.0 - _AGAIN)):
            break
        found = dataclasses.replace(found, inverse=None)
    at_limit = whole is None and bool(np.any(np.abs(found.x) >= 0.99 * gain))
    return Outcome(
        x=found.x,
        M=controller.matrix(found.x),
        value=found.level if stable else np.inf,
        hard=-np.inf,
        stable=stable,
        abscissa=loops.abscissa(found.x),
        evaluations=spent,
        seconds=0.0,
        finished=found.finished and not (at_limit and gain < _GAINS[1]),
        late=late,
        at_limit=at_limit,
        inverse=found.inverse,
    )


def _polished(problem: Problem, x: FloatArray, limits: Limits) -> Outcome:
    """Go on with all peaks near the highest at once, each with its curvature, to a minimum."""
    if problem.structured is not None:
        return _patterned(problem, problem.structured, x, limits)
    entries = Entries(problem.units, problem.order)
    M, best, spent, at_limit = entries.matrix(x), None, 0, False
    for cosine in _COSINES:
        last = np.inf
        for _ in range(_CHARTS):
            chart = Chart(M, *problem.units, cosine)
            least, moved = _minimised(problem, chart, np.zeros(M.size), None, limits, spent)
            spent += least.evaluations
            M = chart.matrix(least.x)
            if best is None or not best[0].stable or least.value < best[0].value:
                best = least, M
            if not (least.finished and least.stable and moved) or not least.value < last * (1.0 - _WORTH):
                break
            last = least.value
        at_limit = least.stable and chart.near_limit(least.x)
        if not (least.finished and at_limit):
            break
    assert best is not None
    return _outcome(problem, entries, entries.coordinates(best[1]), best[0], spent, at_limit)


def _patterned(problem: Problem, whole: Parametrised, x: FloatArray, limits: Limits) -> Outcome:
    """Return the outcome of a search among the numbers of a structure, in coordinates that are scaled anew."""
    bounds = whole.lower, whole.upper
    spent, last = 0, np.inf
    # First to stability, as far as there is no slope to scale by.
    curved = _curved(problem)
    least = _minimised(problem, whole, x, bounds, limits, 0, np.inf if curved else -np.inf)[0]
    for _ in range(_ROUNDS if curved else 0):
        level = least.value if least.hard <= 1.0 + _TOUCHING else np.inf
        if not (least.finished and least.stable) or not (level < last * (1.0 - _WORTHWHILE) or level == np.inf):
            break
        spent, x, last = spent + least.evaluations, least.x, level
        inner = Rescaled(whole, x, step_sizes(*WorstNorm(problem.soft[0].plants, whole).pieces(x)))
        found = _minimised(problem, inner, np.zeros(x.size), inner.within(*bounds), limits, spent, radius=_FIRST)[0]
        least = dataclasses.replace(found, x=np.clip(inner.outer(found.x), *bounds))
    return _outcome(problem, whole, least.x, least, spent + least.evaluations)


def _outcome(
    problem: Problem, controller: Parametrisation, x: FloatArray, least: Minimum, spent: int, at_limit: bool = False
) -> Outcome:
    return Outcome(
        x=x,
        M=controller.matrix(x),
        value=least.value,
        hard=least.hard,
        stable=least.stable,
        abscissa=WorstNorm(problem.plants, controller).abscissa(x),
        evaluations=POLISH_COST * spent,
        seconds=0.0,
        finished=least.finished,
        late=least.late,
        at_limit=at_limit,
    )


def _minimised(
    problem: Problem,
    controller: Parametrisation,
    start: FloatArray,
    bounds: tuple[FloatArray, FloatArray] | None,
    limits: Limits,
    spent: int,
    target: float = -np.inf,
    radius: float = 1.0,
) -> tuple[Minimum, bool]:
    """Return the minimum, and whether it lies away from the start."""
    loops = WorstNorm(problem.plants, controller, margin=problem.decay)
    soft, curved = _pieces(problem.soft, controller, loops)
    hard = _pieces(problem.hard, controller, loops)[0] if problem.hard else None
    objective = Objective(
        soft=soft,
        hard=hard,
        stability=loops.stability,
        curvature=None if curved is None else curved.curvature,
        walls=loops.walls,
        wall_curvature=loops.wall_curvature,
        sharpened=None if curved is None else curved.sharpened,
        watch=None if curved is None else curved.watch,
    )
    effort = Effort(
        evaluations=min(_EVALUATIONS, limits.evaluations // POLISH_COST - spent),
        descent=200 if curved is None else 0,
        deadline=limits.deadline,
        target=target,
        region=Region(radius=radius),
    )
    least = minimise(objective, start, bounds, effort)
    return least, bool(np.any(least.x != start))


def _pieces(goals: tuple[Goal, ...], controller: Parametrisation, loops: WorstNorm) -> tuple[Pieces, WorstNorm | None]:
    """Return the pieces of all goals, and the norm that gives their curvature, None without one."""
    if len(goals) == 1 and not goals[0].h2:
        only = loops if goals[0].plants is loops.plants else WorstNorm(goals[0].plants, controller)
        return only.pieces, only
    parts: list[WorstNorm | WorstPower] = [
        WorstPower(goal.plants, controller) if goal.h2 else WorstNorm(goal.plants, controller) for goal in goals
    ]

    def pieces(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        found = [part.pieces(x) for part in parts]
        return np.concatenate([one[0] for one in found]), np.vstack([one[1] for one in found])

    return pieces, None


def answered(question: dict[str, Any]) -> Outcome:
    """Search in another process: the question holds the arguments of `searched`."""
    return searched(**question)
