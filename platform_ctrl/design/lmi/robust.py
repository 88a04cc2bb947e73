"""One controller for several plants, the vertices of a polytope, with one Lyapunov matrix for all of them.

Where y determines the state, the inequalities are linear and their optimum is the best with a common matrix. In general
output feedback they are not: the controller of the mean plant is improved in turns, the controller for a known matrix
and the matrix for a known controller; where the first controller fails on the vertices, these move outwards from the
mean as far as each turn allows.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.analysis.certificates.certificate import Certificate, proved
from platform_ctrl.common.arguments import positive
from platform_ctrl.common.signatures import check_arguments, short
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.lmi.conic import cp
from platform_ctrl.design.lmi.linearised import factors, in_states, lyapunov_matrix, state_feedback
from platform_ctrl.design.lmi.quadratic import mean_plant, rescaled, weighted_mean
from platform_ctrl.design.lmi.scheduled import require_alike, require_common
from platform_ctrl.design.lmi.search import CURE, FINE, Problem, constrained, direct, posed
from platform_ctrl.design.lmi.solutions import KnownMatrix, least_ratio, slackest, solutions
from platform_ctrl.design.lmi.tasks import checked, claimed_loop, tasks
from platform_ctrl.design.partition import (
    Partition,
    closed_loop,
    closed_loop_system,
    controller_system,
    partition,
)
from platform_ctrl.design.scaling import require_stabilisable, unscale
from platform_ctrl.errors import ArgumentError, DesignError, InfeasibleError, UnscalableError
from platform_ctrl.job.judging import CheckResult
from platform_ctrl.job.requirements import LoopRequirement

if TYPE_CHECKING:
    from control import StateSpace

WHERE = "robust, lmi"
# Largest number of turns, the least progress of one, and the share of the ratio that is traded for slack in between.
MOST_TURNS, LEAST_PROGRESS, TRADED = 40, 0.002, 0.03
# Strictness of the inequalities while the controller changes (scaled).
MARGIN = 1e-6


@value
class Robust:
    """A controller for several plants, and what it does with each.

    Attributes
    ----------
    plants
        The plants, alike in inputs [w, u] and outputs [z, y].
    nmeas, ncon
        Number of measurements y and of controls u.
    controller
        K, u = K y.
    outcomes
        For every plant every requirement with its value, recomputed from the closed loop, and its ratio.
    ratio
        Largest ratio to their limits of the norms that were minimised, proved by the common Lyapunov matrix for every
        plant of the polytope; nan where no norm is requested.
    certificate
        The common matrix, proved for the vertices: stability, or where one H-infinity norm is requested that norm, for
        every convex combination of the closed loops and every motion among them.
    method
        The route.
    """

    plants: tuple[StateSpace, ...]
    nmeas: int
    ncon: int
    controller: StateSpace
    outcomes: tuple[tuple[CheckResult, ...], ...]
    ratio: float
    certificate: Certificate
    method: str


class _Found(NamedTuple):
    """Scaled: the problem, its plants, the controller, the matrix, and the ratio that it proves."""

    problem: Problem
    plants: list[Partition]
    K: StateArrays
    V: FloatArray
    ratio: float


@check_arguments
def robust(
    plants: Sequence[StateSpace],
    nmeas: int,
    ncon: int,
    requirements: Sequence[LoopRequirement],
    *,
    backoff: float = 0.05,
    time_limit: float = 60.0,
) -> Robust:
    """One controller that meets requirements for every plant of a polytope.

    Parameters
    ----------
    plants
        Continuous plants with inputs [w, u] and outputs [z, y], the vertices.
    nmeas, ncon
        Number of measurements y and of controls u: the last outputs and the last inputs.
    requirements
        As in `multiobjective`, less "fastest controller pole". The certificate covers every convex combination of the
        closed loops, hence of the plants where B2 and C2 (with D12 and D21) are the same for all.
    backoff
        Relative distance from the least ratio, positive.
    time_limit
        Longest time that one call of the solver may take, s.

    Returns
    -------
    Robust
        The controller, each plant's results and the common certificate.

    Raises
    ------
    ArgumentError
        The arguments do not make sense.
    IllPosedError, NotStabilisableError
        An assumption does not hold; the message names it.
    InfeasibleError
        No controller with a common Lyapunov matrix was found.
    UnscalableError, TimeLimitError, NotCertifiedError
        The solver gave up or was ended, or a closed loop does not meet the limits.

    References
    ----------
    P. Gahinet, P. Apkarian, Int. J. Robust and Nonlinear Control 4, 1994.

    C. Scherer, P. Gahinet, M. Chilali, IEEE Trans. Automatic Control 42, 1997.

    See docs/lmi.md.
    """
    backoff, time_limit = positive(f"{WHERE}: backoff", backoff), positive(f"{WHERE}: time_limit", time_limit)
    if not isinstance(plants, (list, tuple)) or not plants:
        raise ArgumentError(f"{WHERE}: plants must be a list of at least one plant, got {short(plants)}")
    systems = list(plants)
    parts = [partition(system, nmeas, ncon) for system in systems]
    require_alike(systems, WHERE)
    require_common(parts, ("D22",), systems[0], WHERE)
    requested = [tasks(system, part, requirements, WHERE) for system, part in zip(systems, parts, strict=True)]
    if requested[0].controller:
        raise ArgumentError(f"{WHERE}: limits of controller poles are not supported; use multiobjective")
    for system, part in zip(systems, parts, strict=True):
        require_stabilisable(part, system, WHERE)
    extended = [one.plant for one in requested]
    problem = posed(dataclasses.replace(requested[0], plant=mean_plant(extended)), 0.0, WHERE, time_limit, systems)
    try:
        if _measures_state(extended):
            found, method = _state_feedback(problem, extended, backoff), "state feedback"
        else:
            found, method = _output_feedback(problem, extended, backoff), "output feedback"
    except np.linalg.LinAlgError as error:
        raise UnscalableError(f"{WHERE}: {str(error).lower()} within the scaled problem; {CURE}", systems) from None
    return _finished(found, systems, parts, extended, requirements, f"{WHERE}, {method}")


def _measures_state(parts: Sequence[Partition]) -> bool:
    C2 = parts[0].C2
    square = C2.shape[0] == C2.shape[1] and np.linalg.cond(C2 / np.maximum(np.abs(C2).max(axis=0), 1e-300)) < 1e8
    return bool(square) and all(np.array_equal(p.C2, C2) and not np.any(p.D21) for p in parts)


def _in_states(problem: Problem, parts: Sequence[Partition]) -> list[Partition]:
    scaled = problem.scaled
    return [in_states(rescaled(part, scaled), problem.T / scaled.state[:, None]) for part in parts]


def _state_feedback(problem: Problem, parts: Sequence[Partition], backoff: float) -> _Found:
    """Find the least ratio, then the least effort at the relaxed one: Z >= L X⁻¹ L'."""
    plants = _in_states(problem, parts)
    n, nu = len(plants[0].A), plants[0].B2.shape[1]

    def solved(ratio: Any, goal: str, tighter: float, margin: float) -> tuple[FloatArray, FloatArray, float]:
        X, L, Z = cp.Variable((n, n), symmetric=True), cp.Variable((nu, n)), cp.Variable((nu, nu), symmetric=True)
        ratios = [ratio if one else 1 / tighter for one in problem.goals]
        constraints = [cp.bmat([[X, L.T], [L, Z]]) >> 0]
        for plant in plants:
            constraints += constrained(problem, state_feedback(plant, X, L), ratios, tighter, margin)[0]
        if not problem.requested.norms:
            constraints.append(cp.trace(X) == n)
        objective = ratio if goal == "ratio" else cp.trace(Z)
        convex = cp.Problem(cp.Minimize(objective), constraints)
        problem.solver.solve(convex, (X, L), f"minimising the {goal}", FINE)
        return X.value, L.value, float(getattr(ratio, "value", ratio))

    least = float("nan")
    if problem.requested.norms:
        least = solved(cp.Variable(), "ratio", 1 + backoff, 0.0)[2]
        if not problem.soft and least >= 1:
            raise _missed(problem, least)
    ratio = (1 + backoff) * least if problem.requested.norms else 1.0
    X, L, _ = solved(ratio if problem.soft else min(ratio, 1.0), "effort", 1.0, MARGIN)
    C2 = plants[0].C2
    K = StateArrays(
        A=np.zeros((0, 0)), B=np.zeros((0, len(C2))), C=np.zeros((nu, 0)),
        D=np.linalg.solve(C2.T, np.linalg.solve(X, L.T)).T,
    )  # fmt: skip
    return _Found(problem, plants, K, np.asarray(np.linalg.inv(X), dtype=np.float64), ratio)


def _missed(problem: Problem, least: float) -> InfeasibleError:
    return InfeasibleError(
        f"{WHERE}: the least ratio to the limits of the norms with one Lyapunov matrix for all plants is {least:.4g}, "
        f"not below 1; {CURE}",
        problem.solver.P,
    )


def _output_feedback(problem: Problem, parts: Sequence[Partition], backoff: float) -> _Found:
    """Improve the controller of the mean plant in turns."""
    solution = next((one for one in solutions(problem, backoff) if not isinstance(one, DesignError)), None)
    if solution is None:
        raise UnscalableError(f"{WHERE}: no controller for the mean plant was found; {CURE}", problem.solver.P)
    best, K = solution.best, solution.made
    problem = solution.problem._replace(splits=best.splits)
    V = lyapunov_matrix(best.pair.X, best.pair.Y, *factors(best.pair.X, best.pair.Y))
    vertices = _in_states(problem, parts)
    centre, share, step = problem.plant, 1.0, 1.0
    ratio = float("inf")
    for _ in range(MOST_TURNS):
        plants = [weighted_mean([centre, vertex], [1 - share, share]) for vertex in vertices]
        try:
            found, new = least_ratio(problem, plants, V, K, backoff) if problem.requested.norms else (1.0, V)
            ratios = [(1 + TRADED) * found if goal else 1.0 for goal in problem.goals]
            new = slackest(problem, plants, ratios, new, K)
        except (InfeasibleError, UnscalableError):
            # Too far out for this controller.
            step *= 0.5
            share -= step
            if step < 1e-3 or share < 0:
                break
            continue
        before, ratio, V = ratio, found, new
        if share >= 1.0 and not ratio < (1 - LEAST_PROGRESS) * before:
            break
        try:
            K = _for_matrix(problem, plants, V)
        except (InfeasibleError, UnscalableError):
            if share >= 1.0:
                break
        if share < 1.0:
            share, ratio = min(1.0, share + step), float("inf")
    if share < 1.0:
        raise InfeasibleError(
            f"{WHERE}: one Lyapunov matrix was found only for plants up to {max(share, 0.0):.0%} of the way from their "
            f"mean to the given ones; {CURE}, or design.scheduled where the parameters are measured",
            problem.solver.P,
        )
    if problem.requested.norms and not problem.soft and ratio >= 1:
        raise _missed(problem, ratio)
    return _Found(problem, vertices, K, V, (1 + TRADED) * ratio if problem.requested.norms else float("nan"))


def _for_matrix(problem: Problem, plants: Sequence[Partition], V: FloatArray) -> StateArrays:
    """Return the controller of the least ratio for a known matrix; without norms, of the most slack."""
    known = KnownMatrix(plants, V, direct(problem))
    goal = cp.Variable()
    norms = bool(problem.requested.norms)
    ratios = [goal if one else 1.0 for one in problem.goals]
    constraints = [goal >= 0] if norms else [goal <= 1]
    for loop in known.loops:
        constraints += constrained(problem, loop, ratios, 1.0, MARGIN if norms else goal)[0]
    convex = cp.Problem(cp.Minimize(goal) if norms else cp.Maximize(goal), constraints)
    problem.solver.solve(convex, known.unknowns, "the controller for a matrix", FINE)
    return known.controller()


def _finished(
    found: _Found,
    systems: list[StateSpace],
    parts: Sequence[Partition],
    extended: Sequence[Partition],
    requirements: Sequence[LoopRequirement],
    method: str,
) -> Robust:
    problem, scaled = found.problem, found.problem.scaled
    K = unscale(found.K, scaled)
    controller = controller_system(systems[0], K)
    outcomes = [
        checked(
            requirements, closed_loop_system(system, closed_loop(part, K)), controller, problem.solver,
            1.01 * found.ratio, f"plant {number}",
        )
        for number, (system, part) in enumerate(zip(systems, parts, strict=True), 1)
    ]  # fmt: skip
    back = np.eye(len(found.V))
    n = len(problem.T)
    back[:n, :n] = np.linalg.inv(problem.T)
    V = back.T @ found.V @ back / scaled.rate
    loops = tuple(claimed_loop(p, K, f"plant {number + 1}") for number, p in enumerate(extended))
    norms = problem.requested.norms
    single = len(norms) == 1 and not norms[0].h2
    bound = norms[0].requested.limit * found.ratio if single else 0.0
    certificate = Certificate(
        claim="norm" if single else "stability",
        bound=bound,
        loops=loops,
        X=(bound if single else 1.0) * 0.5 * (V + V.T),
    )
    return Robust(
        plants=tuple(systems),
        nmeas=K.D.shape[1],
        ncon=K.D.shape[0],
        controller=controller,
        outcomes=tuple(outcomes),
        ratio=found.ratio,
        certificate=proved(certificate, systems),
        method=method,
    )
