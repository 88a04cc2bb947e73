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

import numpy as np

from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.fixed_structure.quasi_newton import Stopped, descended
from platform_ctrl.design.fixed_structure.trust_region import Effort, Objective, Pieces, PieceValues, Polish, Run

# Most iterations of the descent to stability.
SETTLING = 400


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


class _Search(Run):
    """A run with the phases before the polish."""

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
