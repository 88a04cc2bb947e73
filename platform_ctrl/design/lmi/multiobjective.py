"""Output feedback for several requirements at once: norms of channels, pole regions, poles of the controller.

Scherer, Gahinet and Chilali (1997): all inequalities share one Lyapunov matrix, which makes them linear in X, Y and the
transformed controller. That costs something: the bounds of the inequalities lie above the norms that the controller
reaches, so both are reported. With one norm alone nothing is lost.

How much a norm asks of V depends on how its bound is split between its input and its output, and only one of the
norms may choose freely. The others' splits enter as products; a tangent to the product makes them linear, and
solving again with the tangent at the last answer never makes the bound worse.

The largest soft ratio is minimised while every hard one stays below 1. Then the bounds are relaxed by the back-off and
X, Y are moved away from X Y = I, where controllers have arbitrarily fast poles.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray
from platform_ctrl.arguments import positive
from platform_ctrl.design.lmi.bounded_real import (
    LARGEST_SEPARATION,
    Pair,
    balancing,
    factors,
    from_linearised,
    lyapunov_matrix,
    turned,
)
from platform_ctrl.design.lmi.conic import solve
from platform_ctrl.design.lmi.linearised import (
    Hats,
    LinearLoop,
    cvxpy,
    h2_below,
    hinf_below,
    output_feedback,
    poles_in,
)
from platform_ctrl.design.lmi.regions import region, require_movable
from platform_ctrl.design.lmi.tasks import NormTask, Tasks, judged, tasks
from platform_ctrl.design.partition import Partition, Realisation, closed_loop, out_of_w_plane, partition
from platform_ctrl.design.scaling import ScaledPlant, autoscale, require_stabilisable, unscale
from platform_ctrl.errors import (
    ArgumentError,
    DesignError,
    IllPosedError,
    InfeasibleError,
    NotCertifiedError,
    TimeLimitError,
    UnscalableError,
)
from platform_ctrl.frozen import FloatArray, value
from platform_ctrl.requirements import CheckResult, LoopRequirement

if TYPE_CHECKING:
    from control import StateSpace

WHERE = "multiobjective, lmi"
CURE = "ask for less, give a larger backoff, or take design.structured, which needs no common Lyapunov matrix"
# Tolerances: of the first solve, which finds the right states, and of the others.
ROUGH, MEDIUM, FINE = 1e-4, 1e-6, 1e-7
# Norms in scaled units stay within 1/8 .. 8.
RANGE, LEAST_GAIN = 8.0, 1e-12
# Rounds in which states, units and splits are improved, and what a round must bring.
MOST_ROUNDS, LEAST_PROGRESS = 20, 0.005
# Strictness of the inequalities in the last step (scaled): until everything holds.
MARGINS = (1e-4, 1e-5, 1e-6)
# Largest mean eigenvalue of X and of Y, and its least multiple of what the bounds alone need.
LARGEST_MEAN, LEAST_ROOM = 100.0, 10.0


@value
class Multiobjective:
    """A controller and what its closed loop does for every requirement.

    Attributes
    ----------
    plant, nmeas, ncon
        The plant P with inputs [w, u] and outputs [z, y].
    controller, closed_loop
        K, u = K y (positive feedback), and the loop from w to z.
    outcomes
        Every requirement with its value, recomputed from the closed loop, and its ratio, at most 1 when met.
    ratio_optimal
        Least common bound of the soft (or, without soft ones, hard) norms over their limits that the inequalities allow;
        nan where no norm is asked.
    backoff
        Relative distance from it.
    poles
        Poles of the closed loop: rad/s, or in z where the plant is sampled.
    method
        The route.
    residual
        Figures of merit by name, in scaled units.
    """

    plant: StateSpace
    nmeas: int
    ncon: int
    controller: StateSpace
    closed_loop: StateSpace
    outcomes: tuple[CheckResult, ...]
    ratio_optimal: float
    backoff: float
    poles: ComplexArray
    method: str
    residual: dict[str, float]

    @property
    def ratio(self) -> float:
        """Largest recomputed ratio of what was minimised."""
        soft = [outcome.ratio for outcome in self.outcomes if not outcome.hard]
        return max(soft or [outcome.ratio for outcome in self.outcomes], default=0.0)


class Problem(NamedTuple):
    """The scaled problem, in some states: plant, the states T that lead back, what is asked, and the splits."""

    plant: Partition
    scaled: ScaledPlant
    T: FloatArray
    asked: Tasks
    splits: tuple[float, ...]
    period: float
    where: str
    time_limit: float
    P: Any

    def limit(self, task: NormTask) -> float:
        """Return the limit of a norm in scaled units; time enters the H2 norm."""
        gain = self.scaled.gain * (np.sqrt(self.scaled.rate) if task.h2 else 1.0)
        return float(task.asked.limit / gain)

    @property
    def goals(self) -> tuple[bool, ...]:
        """Which norms are minimised: the soft ones, or all where none is soft."""
        soft = tuple(not task.asked.hard for task in self.asked.norms)
        return soft if any(soft) else (True,) * len(soft)


class Found(NamedTuple):
    """An answer of the solver: X, Y and the controller, the ratio, the ratios of all norms, where tangents touch."""

    pair: Pair
    hats: Realisation
    ratio: float
    ratios: tuple[float, ...]
    splits: tuple[float, ...]


def multiobjective(
    P: StateSpace,
    nmeas: int,
    ncon: int,
    requirements: Sequence[LoopRequirement],
    *,
    backoff: float = 0.05,
    time_limit: float = 60.0,
) -> Multiobjective:
    """Full-order output feedback that meets several requirements, certified by the actual closed loop.

    Parameters
    ----------
    P
        Plant with inputs [w, u] and outputs [z, y]. A sampled one (dt > 0) is carried to the w-plane, and its controller is
        sampled, too.
    nmeas, ncon
        Number of measurements y and of controls u: the last outputs and the last inputs.
    requirements
        `requirements.requirement` of kind "H-infinity norm" or "H2 norm" (of a channel of w and z, with weights),
        "stability", "damping", "fastest pole" (of the closed loop) or "controller poles". Soft norms (``hard=False``) are
        minimised: the largest of their ratios to their limits. Where none is soft, all norms are.
    backoff
        Relative distance from the least ratio and from the hard limits, positive.
    time_limit
        Longest time that one call of the solver may take, s.

    Raises
    ------
    ArgumentError
        The arguments do not make sense, or a kind of requirement that has no matrix inequality.
    IllPosedError
        A mode that no controller moves violates a pole region (the message names it), or an H2 norm is infinite
        whatever the controller.
    NotStabilisableError
        No controller stabilises the plant.
    InfeasibleError
        No controller was found for the hard requirements with a common Lyapunov matrix.
    TimeLimitError, UnscalableError, NotCertifiedError
        The solver was ended or gave up; or the closed loop does not do what was promised.
    """
    backoff, time_limit = positive(f"{WHERE}: backoff", backoff), positive(f"{WHERE}: time_limit", time_limit)
    plant = partition(P, nmeas, ncon, sampled=True)
    asked = tasks(P, plant, requirements, WHERE)
    require_stabilisable(asked.plant, P, "multiobjective", autoscale(asked.plant))
    limits = [task.asked.limit for task in asked.norms]
    gain = float(np.exp(np.mean(np.log(limits)))) if limits else 1.0
    problem, found = _rough(_posed(asked, gain, plant.dt, time_limit, P), backoff)
    failure: DesignError | None = None
    for margin in MARGINS:
        try:
            problem = _next(problem, found)
            found = _minimised(problem, problem.goals, backoff, FINE)
            best = _separated(problem, found, backoff, margin)
            return _finished(problem, best, found.ratio, plant, requirements, backoff)
        except TimeLimitError:
            raise
        except (DesignError, np.linalg.LinAlgError) as error:
            failure = failure or (
                error if isinstance(error, DesignError) else NotCertifiedError(f"{WHERE}: {error}; {CURE}", P)
            )
    assert failure is not None
    raise failure


def _posed(
    asked: Tasks, gain: float, period: float, time_limit: float, P: StateSpace, last: Problem | None = None
) -> Problem:
    """The problem in units in which norms of the size `gain` are near one, in the states of the `last` one."""
    scaled = autoscale(asked.plant, gain)
    require_movable(scaled, [region(one, period, scaled.rate) for one in asked.regions], WHERE, P)
    plant, T, splits = scaled.plant, np.diag(scaled.state), (1.0,) * len(asked.norms)
    if last is not None:
        plant, T, splits = turned(plant, last.T / scaled.state[:, None]), last.T, last.splits
    return Problem(plant, scaled, T, asked, splits, period, WHERE, time_limit, P)


def _next(problem: Problem, found: Found, stride: float = 1.0) -> Problem:
    """The same problem in better states and units, with the splits moved as far as the tangents say, times `stride`."""
    change = balancing(found.pair)
    splits = [old * (new / old) ** stride for old, new in zip(problem.splits, found.splits, strict=True)]
    problem = problem._replace(T=problem.T @ change, splits=tuple(splits))
    # H2 norms have another unit of time.
    sizes = [problem.limit(task) * ratio for task, ratio in zip(problem.asked.norms, found.ratios, strict=True)]
    gain = problem.scaled.gain * float(np.clip(np.exp(np.mean(np.log(sizes))), 1e-3, 1e6)) if sizes else 1.0
    gain = float(np.clip(gain, LEAST_GAIN, 1 / LEAST_GAIN))
    return _posed(problem.asked, gain, problem.period, problem.time_limit, problem.P, problem)


def _rough(problem: Problem, backoff: float) -> tuple[Problem, Found]:
    """Good states, units and splits, and a first answer."""
    try:
        return _improved(problem, problem.goals, backoff)
    except (InfeasibleError, UnscalableError):
        # With other splits than those to begin with the hard norms may be met.
        hard = tuple(not goal for goal in problem.goals)
        if sum(hard) == 0 or len(hard) < 2:
            raise
    enough = 1 / (1 + backoff)
    problem, found = _improved(problem, hard, backoff, enough, others=False)
    if found.ratio > enough:
        names = ", ".join(task.asked.name for task, one in zip(problem.asked.norms, hard, strict=True) if one)
        raise InfeasibleError(
            f"{problem.where}: {names}: with one Lyapunov matrix for all requirements {found.ratio:.4g} times the limits "
            f"can be reached; expected {enough:.4g} or less; {CURE}",
            problem.P,
        )
    return _improved(_next(problem, found), problem.goals, backoff)


def _improved(
    problem: Problem, goals: tuple[bool, ...], backoff: float, enough: float = 0.0, others: bool = True
) -> tuple[Problem, Found]:
    """Solve again in better states and units, with better splits, until the ratio is small enough or stays."""
    found = _minimised(problem, goals, backoff, ROUGH, others)
    stride = 1.0
    for _ in range(MOST_ROUNDS):
        if not any(goals) or found.ratio <= enough:
            break
        better = _next(problem, found, stride)
        settled = 1 / RANGE <= better.scaled.gain / problem.scaled.gain <= RANGE
        try:
            again = _minimised(better, goals, backoff, MEDIUM, others)
        except (InfeasibleError, UnscalableError):
            if settled and stride == 1.0:
                break
            stride = 1.0
            continue
        progress = 1 - again.ratio / found.ratio
        if progress > 0 or not settled:
            problem, found = better, again
        # Tangents are cautious: further along the way that they point, until that fails.
        if progress > LEAST_PROGRESS:
            stride *= 2.0
        elif stride > 1.0:
            stride = 1.0
        elif settled:
            break
    return problem, found


def _unknowns(problem: Problem) -> tuple[Any, Any, Hats]:
    cp, p = cvxpy(), problem.plant
    n, nu, ny = len(p.A), p.B2.shape[1], len(p.C2)
    X, Y = cp.Variable((n, n), symmetric=True), cp.Variable((n, n), symmetric=True)
    hats = Hats(A=cp.Variable((n, n)), B=cp.Variable((n, ny)), C=cp.Variable((nu, n)), D=_direct(problem))
    return X, Y, hats


def _direct(problem: Problem) -> Any:
    """D̂, such that the channels of H2 norms have no direct term."""
    cp, p = cvxpy(), problem.plant
    shape = p.D12.shape[1], p.D21.shape[0]
    rows, right = [np.zeros((0, shape[0] * shape[1]))], [np.zeros(0)]
    for task in problem.asked.norms:
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
        names = ", ".join(task.asked.name for task in problem.asked.norms if task.h2)
        raise IllPosedError(
            f"{problem.where}: {names}: no controller makes the direct term from w to z vanish, so that the H2 norm is "
            "infinite; expected D11 + D12 D_K D21 = 0 for some D_K: take another channel, or a weight that rolls off",
            problem.P,
        )
    if rank == equations.shape[1]:
        return np.round(base.reshape(shape), 15)
    free = cp.Variable(equations.shape[1] - rank)
    return cp.reshape(base + Vt[rank:].T @ free, shape, order="C")


def _constraints(
    problem: Problem, loop: LinearLoop, ratios: Sequence[Any], tighter: float, margin: float
) -> tuple[list[Any], list[Any]]:
    """The requirements, norms at `ratios` (None: left out) times their limits, regions tighter; and the levels."""
    cp = cvxpy()
    out, pairs = [], []
    for number, (task, ratio, split) in enumerate(zip(problem.asked.norms, ratios, problem.splits, strict=True)):
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
    for one in problem.asked.regions:
        out += poles_in(loop, region(one, problem.period, problem.scaled.rate, tighter), margin)
    if not out:
        out += [loop.VA + loop.VA.T << -margin * np.eye(loop.VA.shape[0])]
    return out, pairs


def _splits(problem: Problem, pairs: Sequence[Any]) -> tuple[float, ...]:
    """Where the next tangents touch."""
    out = list(problem.splits)
    for number, levels in enumerate(pairs):
        if number and levels is not None:
            out[number] = float(np.sqrt(max(levels[1].value, 1e-12) / max(levels[0].value, 1e-12)))
    return tuple(out)


def _minimised(
    problem: Problem, goals: tuple[bool, ...], backoff: float, tolerance: float, others: bool = True
) -> Found:
    """The least ratio of the goals, with the other requirements tighter by the back-off, or without the other norms."""
    cp = cvxpy()
    X, Y, hats = _unknowns(problem)
    n = len(problem.plant.A)
    loop = output_feedback(problem.plant, X, Y, hats)
    ratio = cp.Variable()
    size = (cp.trace(X) + cp.trace(Y)) / n
    ratios = [ratio if goal else (1 / (1 + backoff) if others else None) for goal in goals]
    constraints, pairs = _constraints(problem, loop, ratios, 1 + backoff, 0.0)
    solve(
        cp.Problem(cp.Minimize(ratio if any(goals) else size), [loop.V >> 0, ratio >= 0, *constraints]),
        (X, Y, *_variables(hats)),
        what=f"{problem.where}: minimising the largest ratio", time_limit=problem.time_limit, P=problem.P,
        tolerance=tolerance, cure=CURE,
    )  # fmt: skip
    least = float(ratio.value) if any(goals) else float("nan")
    pair = Pair(gamma=least, X=X.value, Y=Y.value, separation=1.0)
    shown = tuple(least if goal else 1.0 for goal in goals)
    return Found(pair=pair, hats=hats.values(), ratio=least, ratios=shown, splits=_splits(problem, pairs))


def _separated(problem: Problem, found: Found, backoff: float, margin: float) -> Found:
    """X, Y and the transformed controller farthest from X Y = I at the relaxed bounds."""
    cp = cvxpy()
    X, Y, hats = _unknowns(problem)
    n = len(problem.plant.A)
    t, one = cp.Variable(), np.eye(n)
    loop = output_feedback(problem.plant, X, Y, hats)
    ratio = (1 + backoff) * found.ratio if problem.asked.norms else float("nan")
    ratios = [ratio if goal else 1.0 for goal in problem.goals]
    required, pairs = _constraints(problem, loop, ratios, 1.0, margin)
    own = float(np.sqrt(np.trace(found.pair.X @ found.pair.Y) / n))
    bound = max(LARGEST_MEAN, LEAST_ROOM * own)
    constraints = [
        cp.bmat([[X, t * one], [t * one, Y]]) >> 0,
        t <= LARGEST_SEPARATION,
        cp.trace(X) <= n * bound,
        cp.trace(Y) <= n * bound,
        *required,
    ]
    solve(
        cp.Problem(cp.Maximize(t), constraints), (X, Y, *_variables(hats)),
        what=f"{problem.where}: separating X and Y at the ratio {ratio:.6g}", time_limit=problem.time_limit, P=problem.P,
        tolerance=FINE, cure=CURE,
    )  # fmt: skip
    pair = Pair(gamma=ratio, X=X.value, Y=Y.value, separation=float(t.value))
    return Found(pair=pair, hats=hats.values(), ratio=ratio, ratios=tuple(ratios), splits=_splits(problem, pairs))


def _variables(hats: Hats) -> tuple[Any, ...]:
    return tuple(part for part in hats if hasattr(part, "value"))


def _finished(
    problem: Problem,
    best: Found,
    least: float,
    plant: Partition,
    requirements: Sequence[LoopRequirement],
    backoff: float,
) -> Multiobjective:
    """The controller in the plant's units, with the judgement of its actual closed loop."""
    import control

    made = from_linearised(problem.plant, best.pair.X, best.pair.Y, best.hats)
    K = out_of_w_plane(unscale(made, problem.scaled), plant.dt)
    P = problem.P
    u, y = P.input_labels[-plant.B2.shape[1] :], P.output_labels[-len(plant.C2) :]
    w, z = P.input_labels[: -len(u)], P.output_labels[: -len(y)]
    loop = closed_loop(plant, K)
    size = np.linalg.norm(plant.D11) + np.linalg.norm(plant.D12) * np.linalg.norm(K.D) * np.linalg.norm(plant.D21)
    D = np.where(np.abs(loop.D) > 1e-12 * size, loop.D, 0.0)
    controller = control.StateSpace(K.A, K.B, K.C, K.D, plant.dt, inputs=y, outputs=u)
    system = control.StateSpace(loop.A, loop.B, loop.C, D, plant.dt, inputs=w, outputs=z)
    outcomes = judged(requirements, system, controller, WHERE)
    goals = [task.asked for task, goal in zip(problem.asked.norms, problem.goals, strict=True) if goal]
    for outcome, asked in zip(outcomes, requirements, strict=True):
        minimised = any(asked is goal for goal in goals)
        allowed = (1 + backoff + 0.01) * least if minimised else 1.0
        if asked.hard and minimised:
            allowed = min(allowed, 1.0) if least <= 1 else 1.0
        if not outcome.ratio <= allowed:
            raise NotCertifiedError(
                f"{WHERE}: {outcome.name} is {outcome.value:.6g} {outcome.unit}; expected {outcome.sense} "
                f"{outcome.limit * allowed if outcome.sense == 'at most' else outcome.limit / allowed:.6g}; {CURE}",
                P,
            )
    return Multiobjective(
        plant=P,
        nmeas=len(y),
        ncon=len(u),
        controller=controller,
        closed_loop=system,
        outcomes=outcomes,
        ratio_optimal=least,
        backoff=backoff,
        poles=np.linalg.eigvals(loop.A).astype(np.complex128),
        method=WHERE,
        residual={"separation of X and Y": best.pair.separation},
    )
