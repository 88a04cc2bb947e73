"""From the least ratio to controllers: back off, separate X and Y, reconstruct, and slow down where that is asked."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from platform_ctrl.design.lmi.bounded_real import from_linearised
from platform_ctrl.design.lmi.search import (
    CURE,
    FINE,
    Found,
    Problem,
    best_ratio,
    improved_problem,
    minimised,
    separated,
)
from platform_ctrl.design.lmi.slow_controller import slowed
from platform_ctrl.design.partition import Realisation
from platform_ctrl.errors import DesignError, IllPosedError, InfeasibleError, TimeLimitError, UnscalableError

# Strictness of the inequalities in the last step (scaled): until everything holds.
MARGINS = (1e-4, 1e-5, 1e-6)


class Solution(NamedTuple):
    """What the search found, in scaled units: the problem, X and Y, the least ratio and the controller."""

    problem: Problem
    best: Found
    least: float
    made: Realisation


def solutions(problem: Problem, backoff: float) -> Iterator[Solution | DesignError]:
    """Yield controllers, or why there is none, for inequalities that are less and less strict.

    Raises
    ------
    InfeasibleError, IllPosedError, TimeLimitError, UnscalableError
        There is no use in going on.
    """
    asked = problem.asked
    problem, found = best_ratio(problem, backoff)
    for margin in MARGINS:
        try:
            problem = improved_problem(problem, found)
            found = minimised(problem, problem.goals, backoff, FINE)
            if asked.norms and not problem.soft and found.ratio >= 1:
                raise InfeasibleError(
                    f"{problem.where}: {found.ratio:.4g} times the limits of the norms can be reached with one "
                    f"Lyapunov matrix for all requirements; expected less than 1; {CURE}",
                    problem.P,
                )
            best = separated(problem, found, backoff, margin)
            made = from_linearised(problem.plant, best.pair.X, best.pair.Y, best.hats)
            if asked.controller:
                bound = min(one.limit for one in asked.controller) / problem.scaled.rate
                made = slowed(problem, best, made, bound)
            yield Solution(problem, best, found.ratio, made)
        except (TimeLimitError, InfeasibleError, IllPosedError):
            raise
        except DesignError as error:
            yield error
        except np.linalg.LinAlgError as error:
            yield UnscalableError(f"{problem.where}: {str(error).lower()}; {CURE}", problem.P)
