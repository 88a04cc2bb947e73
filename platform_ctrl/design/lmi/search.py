"""The search behind `multiobjective`: the least ratio with one Lyapunov matrix, in good states, units and splits.

The constraint of a norm on V depends on how its bound is split between its input and its output, and only one norm's
split is free. The others' splits are products; a tangent to the product makes them linear, and solving again with the
tangent at the last result never makes the bound worse.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.lmi.conic import Solver, cp, solved
from platform_ctrl.design.lmi.linearised import (
    LinearLoop,
    Pair,
    balancing,
    h2_below,
    hinf_below,
    in_states,
    output_feedback,
    poles_in,
    separated,
)
from platform_ctrl.design.lmi.tasks import NormTask, Tasks, region, require_movable
from platform_ctrl.design.partition import Partition
from platform_ctrl.design.scaling import ScaledPlant, autoscale
from platform_ctrl.errors import IllPosedError, InfeasibleError, UnscalableError

CURE = "relax a limit, give a larger backoff, or use design.structured, which needs no common Lyapunov matrix"
# Tolerances: of the first solve, which finds the right states, of those that improve them, and of the last ones.
ROUGH, MEDIUM, FINE = 1e-4, 1e-6, 1e-7
# Norms in scaled units stay within 1/8 .. 8.
RANGE, LEAST_GAIN = 8.0, 1e-12
# Largest number of rounds that improve states, units and splits, and the least progress of a round.
MOST_ROUNDS, LEAST_PROGRESS = 20, 0.005
# Largest mean eigenvalue of X and of Y, and its least multiple of what the bounds alone need.
LARGEST_MEAN, LEAST_ROOM = 100.0, 10.0


class Problem(NamedTuple):
    """The scaled problem: plant in states T, what is requested, and the splits."""

    plant: Partition
    scaled: ScaledPlant
    T: FloatArray
    requested: Tasks
    splits: tuple[float, ...]
    period: float
    solver: Solver

    def limit(self, task: NormTask) -> float:
        """Return the limit of a norm in scaled units; time enters the H2 norm."""
        gain = self.scaled.gain * (np.sqrt(self.scaled.rate) if task.h2 else 1.0)
        return float(task.requested.limit / gain)

    @property
    def soft(self) -> bool:
        """Whether one of the norms is soft."""
        return any(not task.requested.hard for task in self.requested.norms)

    @property
    def goals(self) -> tuple[bool, ...]:
        """Which norms are minimised: the soft ones, or all where none is soft."""
        return tuple(not (task.requested.hard and self.soft) for task in self.requested.norms)


class Found(NamedTuple):
    """A result of the solver: X, Y and the controller, the ratio, the ratios of all norms, where tangents touch."""

    pair: Pair
    hats: StateArrays
    ratio: float
    ratios: tuple[float, ...]
    splits: tuple[float, ...]


def posed(requested: Tasks, period: float, where: str, time_limit: float, P: object) -> Problem:
    """Return the problem in units in which the limits of the norms are near one."""
    limits = [task.requested.limit for task in requested.norms]
    scaled = autoscale(requested.plant, float(np.exp(np.mean(np.log(limits)))) if limits else 1.0)
    require_movable(scaled, [region(one, period, scaled.rate) for one in requested.regions], where, P)
    T, splits = np.diag(scaled.state), (1.0,) * len(limits)
    solver = Solver(where=where, cure=CURE, time_limit=time_limit, P=P)
    return Problem(scaled.plant, scaled, T, requested, splits, period, solver)


def improved_problem(problem: Problem, found: Found, stride: float = 1.0) -> Problem:
    """Return the problem in better states and units, with the splits moved along the tangents, `stride` times."""
    splits = [old * (new / old) ** stride for old, new in zip(problem.splits, found.splits, strict=True)]
    # H2 norms have another unit of time.
    sizes = [problem.limit(task) * ratio for task, ratio in zip(problem.requested.norms, found.ratios, strict=True)]
    gain = problem.scaled.gain * float(np.clip(np.exp(np.mean(np.log(sizes))), 1e-3, 1e6)) if sizes else 1.0
    gain = float(np.clip(gain, LEAST_GAIN, 1 / LEAST_GAIN))
    scaled, T = autoscale(problem.requested.plant, gain), problem.T @ balancing(found.pair)
    plant = in_states(scaled.plant, T / scaled.state[:, None])
    return problem._replace(plant=plant, scaled=scaled, T=T, splits=tuple(splits))


def best_ratio(problem: Problem, backoff: float) -> tuple[Problem, Found]:
    """Return the problem in good states, units and splits, and a first result."""
    try:
        return _descended(problem, problem.goals, backoff)
    except (InfeasibleError, UnscalableError):
        # With other splits than those to begin with the hard norms may be met.
        hard = tuple(not goal for goal in problem.goals)
        if sum(hard) == 0 or len(hard) < 2:
            raise
    enough = 1 / (1 + backoff)
    problem, found = _descended(problem, hard, backoff, enough, others=False)
    if found.ratio > enough:
        names = ", ".join(task.requested.name for task, one in zip(problem.requested.norms, hard, strict=True) if one)
        raise InfeasibleError(
            f"{problem.solver.where}: {names}: the least ratio to the limits with one Lyapunov matrix for all "
            f"requirements is {found.ratio:.4g}, more than {enough:.4g}; {CURE}",
            problem.solver.P,
        )
    return _descended(improved_problem(problem, found), problem.goals, backoff)


def _descended(
    problem: Problem, goals: tuple[bool, ...], backoff: float, enough: float = 0.0, others: bool = True
) -> tuple[Problem, Found]:
    """Solve again in better states and units, with better splits, until the ratio is small enough or constant."""
    found = minimised(problem, goals, backoff, ROUGH, others)
    stride = 1.0
    for _ in range(MOST_ROUNDS):
        if not any(goals) or found.ratio <= enough:
            break
        better = improved_problem(problem, found, stride)
        settled = 1 / RANGE <= better.scaled.gain / problem.scaled.gain <= RANGE
        try:
            again = minimised(better, goals, backoff, MEDIUM, others)
        except (InfeasibleError, UnscalableError):
            if settled and stride == 1.0:
                break
            stride = 1.0
            continue
        progress = 1 - again.ratio / found.ratio
        if progress > 0 or not settled:
            problem, found = better, again
        # Tangents are conservative: longer steps in their direction, until one fails.
        if progress > LEAST_PROGRESS:
            stride *= 2.0
        elif stride > 1.0:
            stride = 1.0
        elif settled:
            break
    return problem, found


def _unknowns(problem: Problem) -> tuple[Any, Any, StateArrays]:
    p = problem.plant
    n, nu, ny = len(p.A), p.B2.shape[1], len(p.C2)
    X, Y = cp.Variable((n, n), symmetric=True), cp.Variable((n, n), symmetric=True)
    hats = StateArrays(A=cp.Variable((n, n)), B=cp.Variable((n, ny)), C=cp.Variable((nu, n)), D=direct(problem))
    return X, Y, hats


def direct(problem: Problem) -> Any:
    """D̂, such that the channels of H2 norms have no direct term."""
    p = problem.plant
    shape = p.D12.shape[1], p.D21.shape[0]
    rows, right = [np.zeros((0, shape[0] * shape[1]))], [np.zeros(0)]
    for task in problem.requested.norms:
        if task.h2:
            w, z = list(task.w), list(task.z)
            rows.append(np.kron(p.D12[z], p.D21[:, w].T))  # of the rows of D̂ one after the other
            right.append(-p.D11[np.ix_(z, w)].ravel())
    equations, wanted = np.vstack(rows), np.concatenate(right)
    if not len(equations):
        return cp.Variable(shape)
    U, sigma, Vt = np.linalg.svd(equations)
    rank = int(np.sum(sigma > 1e-9 * max(1.0, sigma[0])))
    base = Vt[:rank].T @ ((U.T @ wanted)[:rank] / sigma[:rank])
    if np.linalg.norm(equations @ base - wanted) > 1e-9 * max(1.0, float(np.linalg.norm(wanted))):
        names = ", ".join(task.requested.name for task in problem.requested.norms if task.h2)
        raise IllPosedError(
            f"{problem.solver.where}: {names}: the H2 norm is infinite, since D11 + D12 D_K D21 = 0 for no D_K; choose "
            "another channel, or a weight that rolls off",
            problem.solver.P,
        )
    if rank == equations.shape[1]:
        return np.round(base.reshape(shape), 15)
    free = cp.Variable(equations.shape[1] - rank)
    return cp.reshape(base + Vt[rank:].T @ free, shape, order="C")


def constrained(
    problem: Problem, loop: LinearLoop, ratios: Sequence[Any], tighter: float, margin: float
) -> tuple[list[Any], list[Any]]:
    """Return the constraints, norms at `ratios` (None: left out) times their limits, regions tighter; and levels."""
    out: list[Any] = []
    pairs: list[Any] = []
    for number, (task, ratio, split) in enumerate(zip(problem.requested.norms, ratios, problem.splits, strict=True)):
        if ratio is None:
            pairs.append(None)
            continue
        level = problem.limit(task) * ratio
        levels = (level, level) if number == 0 else (cp.Variable(), cp.Variable())
        if number:
            # split s1 + s2/split >= 2 √(s1 s2)
            out.append(split * levels[0] + levels[1] / split <= 2 * level)
        pairs.append(levels)
        out += (h2_below if task.h2 else hinf_below)(loop, task.w, task.z, levels, margin)
    for one in problem.requested.regions:
        out += poles_in(loop, region(one, problem.period, problem.scaled.rate, tighter), margin)
    if not out:
        out += [loop.VA + loop.VA.T << -margin * np.eye(loop.VA.shape[0])]
    return out, pairs


def tangents(problem: Problem, pairs: Sequence[Any]) -> tuple[float, ...]:
    """Return where the next tangents touch."""
    out = list(problem.splits)
    for number, levels in enumerate(pairs):
        if number and levels is not None:
            out[number] = float(np.sqrt(max(levels[1].value, 1e-12) / max(levels[0].value, 1e-12)))
    return tuple(out)


def minimised(
    problem: Problem, goals: tuple[bool, ...], backoff: float, tolerance: float, others: bool = True
) -> Found:
    """Return the least ratio of the goals, other requirements tighter by the back-off, or without other norms."""
    X, Y, hats = _unknowns(problem)
    n = len(problem.plant.A)
    loop = output_feedback(problem.plant, X, Y, hats)
    ratio = cp.Variable()
    size = (cp.trace(X) + cp.trace(Y)) / n
    ratios = [ratio if goal else (1 / (1 + backoff) if others else None) for goal in goals]
    constraints, pairs = constrained(problem, loop, ratios, 1 + backoff, 0.0)
    goal = cp.Minimize(ratio if any(goals) else size)
    convex = cp.Problem(goal, [loop.V >> 0, ratio >= 0, *constraints])
    problem.solver.solve(convex, (X, Y, *_variables(hats)), "minimising the largest ratio", tolerance)
    least = float(ratio.value) if any(goals) else float("nan")
    pair = Pair(gamma=least, X=X.value, Y=Y.value, separation=1.0)
    shown = tuple(least if goal else 1.0 for goal in goals)
    return Found(pair=pair, hats=solved(hats), ratio=least, ratios=shown, splits=tangents(problem, pairs))


def farthest(problem: Problem, found: Found, backoff: float, margin: float) -> Found:
    """Return X, Y and the transformed controller farthest from X Y = I at the relaxed bounds."""
    X, Y, hats = _unknowns(problem)
    n = len(problem.plant.A)
    loop = output_feedback(problem.plant, X, Y, hats)
    ratio = (1 + backoff) * found.ratio if problem.requested.norms else float("nan")
    if not problem.soft and ratio > 1:
        ratio = 1.0
    ratios = [ratio if goal else 1.0 for goal in problem.goals]
    required, pairs = constrained(problem, loop, ratios, 1.0, margin)
    own = float(np.sqrt(np.trace(found.pair.X @ found.pair.Y) / n))
    bound = max(LARGEST_MEAN, LEAST_ROOM * own)
    t = separated(X, Y, required, bound, problem.solver, f"separating X and Y at the ratio {ratio:.6g}", FINE)
    pair = Pair(gamma=ratio, X=X.value, Y=Y.value, separation=t)
    return Found(pair=pair, hats=solved(hats), ratio=ratio, ratios=tuple(ratios), splits=tangents(problem, pairs))


def _variables(hats: StateArrays) -> tuple[Any, ...]:
    return tuple(part for part in hats if hasattr(part, "value"))
