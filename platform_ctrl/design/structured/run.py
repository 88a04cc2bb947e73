"""One search from one starting point: what a worker does."""

from __future__ import annotations

import dataclasses
import time
from typing import Any

import numpy as np

from platform_ctrl.design.partition import Partition
from platform_ctrl.design.structured.chart import Chart
from platform_ctrl.design.structured.minimax import Minimum, Pieces, minimise
from platform_ctrl.design.structured.objective import Parametrisation, WorstNorm
from platform_ctrl.design.structured.parametrised import Parametrised
from platform_ctrl.design.structured.power import WorstPower
from platform_ctrl.design.structured.rescaled import Rescaled, step_sizes
from platform_ctrl.frozen import FloatArray, value

# A hard norm that exceeds its limit by no more counts as kept.
_TOUCHING = 5e-4
# Most charts that a search without a pattern goes through, and the decrease that is worth another one.
_CHARTS, _WORTH = 6, 1e-7
# The gain may grow in stages: along the limit of one the search finds its way before it meets the next.
_COSINES = (1e-2, 1e-4, 1e-6)
# The same for a pattern in coordinates scaled anew, and the first trust region there.
_ROUNDS, _WORTHWHILE, _FIRST = 6, 2e-4, 0.1
# Most evaluations in one chart or scaling.
_EVALUATIONS = 1200


@value
class Goal:
    """A norm of every plant, in units of its limit.

    Attributes
    ----------
    plants
        Augmented, with the goal's own w and z.
    h2
        Whether it is the H2 norm.
    """

    plants: tuple[Partition, ...]
    h2: bool = False


@value
class Problem:
    """What is searched for.

    Attributes
    ----------
    plants
        Augmented by the controller's integrators; their poles have to be stable.
    soft, hard
        Norms to be minimised, and norms that must not exceed one.
    decay
        Least distance of every pole from the axis, rad/s.
    units : (left, right)
        M = left · M_scaled · right, for controllers without a pattern.
    structured
        The pattern; None: every entry of M is free.
    """

    plants: tuple[Partition, ...]
    soft: tuple[Goal, ...]
    hard: tuple[Goal, ...]
    decay: float
    units: tuple[FloatArray, FloatArray]
    structured: Parametrised | None


@value
class Outcome:
    """Where one search ended.

    Attributes
    ----------
    x
        Search coordinates, empty where there is no pattern.
    M
        [A_K, B_K; C_K, D_K].
    value, hard, stability
        As in `minimax.Minimum`.
    evaluations, seconds, finished, late
        What was spent, whether the search ended by itself, and whether the deadline ended it.
    """

    x: FloatArray
    M: FloatArray
    value: float
    hard: float
    stability: float
    evaluations: int
    seconds: float
    finished: bool
    late: bool

    @property
    def rank(self) -> tuple[float, float]:
        """The smaller the better: stability first, then hard limits, then the value."""
        if not self.stability < 0.0:
            return 2.0, self.stability
        if self.hard > 1.0 + _TOUCHING:
            return 1.0, self.hard
        return 0.0, self.value


@value
class Limits:
    """How far a search goes.

    Attributes
    ----------
    evaluations
        Most evaluations of the closed loops.
    deadline
        Time by `time.monotonic`, s.
    """

    evaluations: int
    deadline: float = np.inf

    def after(self, spent: int) -> Limits:
        """Return what is left."""
        return Limits(evaluations=min(_EVALUATIONS, self.evaluations - spent), deadline=self.deadline)


def searched(problem: Problem, start: FloatArray, limits: Limits) -> Outcome:
    """Return what the search from `start` (search coordinates, or M where there is no pattern) finds."""
    began = time.monotonic()
    if problem.structured is not None:
        return _patterned(problem, problem.structured, start, began, limits)
    M, best, spent = start, None, 0
    for cosine in _COSINES:
        last = np.inf
        for _ in range(_CHARTS):
            chart = Chart(M, *problem.units, cosine)
            least, moved = _minimised(problem, chart, np.zeros(M.size), None, limits.after(spent))
            spent += least.evaluations
            M = chart.matrix(least.x)
            if best is None or not best[0].stable or least.value < best[0].value:
                best = least, M
            if not (least.finished and least.stable and moved) or not least.value < last * (1.0 - _WORTH):
                break
            last = least.value
        if not (least.finished and least.stable and chart.near_limit(least.x)):
            break
    assert best is not None
    return _outcome(best[1], best[0], spent, began, plain=True)


def _patterned(problem: Problem, whole: Parametrised, start: FloatArray, began: float, limits: Limits) -> Outcome:
    """Return the outcome of a search among the numbers of a structure, in coordinates that are scaled anew."""
    bounds = whole.lower, whole.upper
    x, spent, last = start, 0, np.inf
    # First to stability, as far as there is no slope to scale by.
    curved = _curved(problem)
    least = _minimised(problem, whole, x, bounds, limits.after(0), np.inf if curved else -np.inf)[0]
    for _ in range(_ROUNDS if curved else 0):
        level = least.value if least.hard <= 1.0 + _TOUCHING else np.inf
        if not (least.finished and least.stable) or not (level < last * (1.0 - _WORTHWHILE) or level == np.inf):
            break
        spent, x, last = spent + least.evaluations, least.x, level
        inner = Rescaled(whole, x, step_sizes(*WorstNorm(problem.soft[0].plants, whole).pieces(x)))
        left = limits.after(spent)
        found = _minimised(problem, inner, np.zeros(x.size), inner.within(*bounds), left, radius=_FIRST)[0]
        least = dataclasses.replace(found, x=np.clip(inner.outer(found.x), *bounds))
    return _outcome(whole.matrix(least.x), least, spent + least.evaluations, began)


def _curved(problem: Problem) -> bool:
    """Whether curvatures are known: one norm is made small, and it is the H-infinity norm."""
    return len(problem.soft) == 1 and not problem.soft[0].h2


def _outcome(M: FloatArray, least: Minimum, evaluations: int, began: float, plain: bool = False) -> Outcome:
    return Outcome(
        x=np.zeros(0) if plain else least.x,
        M=M,
        value=least.value,
        hard=least.hard,
        stability=least.stability,
        evaluations=evaluations,
        seconds=time.monotonic() - began,
        finished=least.finished,
        late=least.late,
    )


def _minimised(
    problem: Problem,
    controller: Parametrisation,
    start: FloatArray,
    bounds: tuple[FloatArray, FloatArray] | None,
    limits: Limits,
    target: float = -np.inf,
    radius: float = 1.0,
) -> tuple[Minimum, bool]:
    """Return the minimum, and whether it lies away from the start."""
    loops = WorstNorm(problem.plants, controller, margin=problem.decay)
    soft, curved = _pieces(problem.soft, controller, loops)
    hard = _pieces(problem.hard, controller, loops)[0] if problem.hard else None
    lower, upper = bounds or (None, None)
    least = minimise(
        soft,
        start,
        lower,
        upper,
        hard=hard,
        stability=loops.stability,
        curvature=None if curved is None else curved.curvature,
        walls=loops.walls,
        wall_curvature=loops.wall_curvature,
        sharpened=None if curved is None else curved.sharpened,
        watch=None if curved is None else curved.watch,
        target=target,
        deadline=limits.deadline,
        descent=200 if curved is None else 0,
        evaluations=limits.evaluations,
        radius=radius,
    )
    return least, bool(np.any(least.x != start))


def _pieces(goals: tuple[Goal, ...], controller: Parametrisation, loops: WorstNorm) -> tuple[Pieces, WorstNorm | None]:
    """Return the pieces of all goals, and what knows their curvature, if anything does."""
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


def answered(question: dict[str, Any]) -> dict[str, Any]:
    """Search in a process of its own: the question holds the arguments of `searched`."""
    return {"status": "searched", "outcome": searched(**question)}
