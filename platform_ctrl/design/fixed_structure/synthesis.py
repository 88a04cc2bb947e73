"""Synthesis of a controller of fixed structure: the least worst norm over several plants, from several starts.

The plants are augmented by the controller's integrators, so that all of the controller is one matrix (see `norm`); a
sampled plant is carried to the w-plane, where stability and H-infinity norm are the same. What the searches find is
measured on the closed loops of the plants as given, and compared with a controller of full order.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.common.arguments import whole as whole_number
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.fixed_structure.parametrised import Parametrised
from platform_ctrl.design.fixed_structure.result import Bound, StructuredDesign, full_order, measured_design, none_found
from platform_ctrl.design.fixed_structure.run import Goal, Limits, Outcome, Problem
from platform_ctrl.design.fixed_structure.side_by_side import best_found
from platform_ctrl.design.fixed_structure.starts import Fit, Orders, around, fits, scattered, truncated
from platform_ctrl.design.fixed_structure.structures import StateSpaceOrder, Structure, Units
from platform_ctrl.design.partition import Partition, augmented, in_w_plane, partition
from platform_ctrl.design.scaling import autoscale, require_stabilisable
from platform_ctrl.design.synthesis import require_time_limit
from platform_ctrl.errors import ArgumentError, TimeLimitWarning
from platform_ctrl.job.requirements import LoopRequirement

if TYPE_CHECKING:
    from control import StateSpace

# Share of the time limit that full-order bounds may take.
_FOR_BOUNDS = 0.25
# Share of a hard limit that the search keeps in reserve: it comes to rest on either side of a limit.
_RESERVE = 1e-3
# Bounds whose controllers starts are fitted to.
_FITTED = 2
# Largest order whose companion forms are tried where no start stabilises: entries are named by single digits.
_MOST_STATES = 9


@value
class _Task:
    """The plants in the w-plane and what is required of them."""

    plants: tuple[Partition, ...]
    soft: tuple[Goal, ...]
    hard: tuple[Goal, ...]
    decay: float


def structured(  # noqa: PLR0913, PLR0915 - options by keyword; one method, step by step
    plants: StateSpace | Sequence[StateSpace],
    nmeas: int,
    ncon: int,
    *,
    structure: Structure,
    requirements: Sequence[LoopRequirement] = (),
    starts: int = 16,
    seed: int = 0,
    evaluations: int = 40000,
    time_limit: float | None = None,
    processes: int | None = None,
    progress: Callable[[str], None] | None = None,
) -> StructuredDesign:
    """Controller of fixed structure with the least worst norm over several plants, measured on the actual closed loops.

    Non-smooth optimisation from several starts with first and second derivatives (after Apkarian and Noll 2006, Burke,
    Henrion, Lewis and Overton 2006): a local method, so that more starts may find more.

    Parameters
    ----------
    plants
        One plant, or several that one controller has to serve, with inputs [w, u] and outputs [z, y], as in
        `control.hinfsyn`; all continuous, or all sampled with one period.
    nmeas, ncon
        Number of measurements y and of controls u: the last outputs and the last inputs.
    structure
        What the controller looks like (see `structures`); its numbers may be bounded, tied and fixed.
    requirements
        Instead of the H-infinity norm from w to z: requirements of the kinds "H-infinity norm", "H2 norm" (of named,
        weighted channels) and "stability" (minimum decay rate). The largest soft ratio is minimised while every hard
        one is met; without soft ones the largest hard ratio.
    starts
        From how many points the search begins. The first ones are the structure's own values and fits to full-order
        controllers, the others scattered.
    seed
        Of the scatter.
    evaluations
        Most evaluations of the closed loops (poles, norms and their gradients, of all plants at once) over all starts,
        each of which gets the same number. The result depends on it, and not on the machine or its load. Where no start
        of a controller of free order stabilises, the search for one that does, and the one that begins there, may each
        spend as many again.
    time_limit
        Longest time for everything, s; default none. A search that it ends returns the best so far with a
        `TimeLimitWarning` and `StructuredDesign.cut`: at another load the result is another one.
    processes
        How many search side by side; default one for each processor. The result is the same for any number.
    progress
        Called with a line after every start.

    Returns
    -------
    StructuredDesign
        The best controller found, with its evidence.

    Raises
    ------
    ArgumentError
        The plants, numbers or requirements do not make sense together.
    NotStabilisableError
        No controller of any kind stabilises one of the plants; the message names the mode.
    NotFoundError
        No start led to a controller of this structure that stabilises every plant and meets every hard requirement,
        which does not show that there is none; the nearest is attached.
    TimeLimitError
        `time_limit` was over before any did.
    NotCertifiedError
        The closed loops do not confirm what the search found.

    References
    ----------
    P. Apkarian, D. Noll, IEEE Trans. Automatic Control 51, 2006.

    J. V. Burke, D. Henrion, A. S. Lewis, M. L. Overton, IFAC ROCOND 2006.

    See docs/structured.md.
    """
    given = _plants(plants)
    for name, number in (("starts", starts), ("evaluations", evaluations), ("processes", processes)):
        if number is not None or name != "processes":
            whole_number(f"structured: {name}", number, 1)
    whole_number("structured: seed", seed, 0)
    seconds = np.inf if time_limit is None else time_limit
    require_time_limit("structured", seconds)
    began = time.monotonic()
    parts = _partitions(given, nmeas, ncon)
    flat = tuple(in_w_plane(part) for part in parts)
    scaled = [autoscale(one) for one in flat]
    for P, part in zip(given, parts, strict=True):
        require_stabilisable(part, P, "structured")
    task = _task(given, parts, flat, requirements)
    report_line = progress or (lambda line: None)

    # Units by the first plant: the others are its neighbours.
    units = Units(
        gain=np.outer(np.linalg.norm(scaled[0].control, axis=1), np.linalg.norm(scaled[0].measurement, axis=0)),
        rate=scaled[0].rate,
    )
    order = structure.order(nmeas, ncon)
    whole = None if structure.free else Parametrised(structure, nmeas, ncon, units)
    one = np.eye(order)
    left = _diagonal(one * np.sqrt(scaled[0].rate), scaled[0].control)
    right = _diagonal(one * np.sqrt(scaled[0].rate), scaled[0].measurement)
    wide = tuple(augmented(plant, order) for plant in task.plants)

    def goals(requested: tuple[Goal, ...]) -> tuple[Goal, ...]:
        own = [
            wide if goal.plants is task.plants else tuple(augmented(p, order) for p in goal.plants)
            for goal in requested
        ]
        return tuple(Goal(plants=plants, h2=goal.h2) for plants, goal in zip(own, requested, strict=True))

    problem = Problem(
        plants=wide,
        soft=goals(task.soft),
        hard=goals(task.hard),
        decay=task.decay,
        units=(left, right),
        order=order,
        structured=whole,
    )
    each = _FOR_BOUNDS * seconds / _FITTED
    requested = [(plant, goal.h2) for goal in task.soft for plant in goal.plants]
    bounds = [full_order(plant, h2, each, k < _FITTED) for k, (plant, h2) in enumerate(requested)]
    points = _points(problem, flat, bounds, order, units, starts, np.random.default_rng(seed))

    def report(k: int, outcome: Outcome | None) -> None:
        if outcome is None:
            report_line(f"structured: start {k + 1} of {len(points)}: lost")
        elif not outcome.stable:
            report_line(f"structured: start {k + 1} of {len(points)}: not stable")
        else:
            report_line(f"structured: start {k + 1} of {len(points)}: {outcome.value:.6g}")

    limits = Limits(evaluations=evaluations, deadline=began + seconds)
    found = best_found(problem, points, limits, processes, report)
    tried = 0
    if isinstance(structure, StateSpaceOrder) and not any(one is not None and one.stable for one in found):
        further, tried = _of_orders(structure, task, units, whole, seed, limits)
        found += best_found(problem, further, limits, processes, report)
    ended = [one for one in found if one is not None]
    spent = tried + sum(one.evaluations for one in ended)
    cut = len(ended) < len(found) or any(one.late for one in ended) or any(one.cut for one in bounds)
    best = min(ended, key=lambda one: one.rank, default=None)
    if best is None or best.rank[0] > 0.0:
        raise none_found(best, len(ended), spent, cut, structure, parts, given, requirements)
    made = measured_design(
        given, parts, structure, requirements, best, ended, cut, whole, order, bounds, scaled[0].gain
    )
    if cut:
        warnings.warn(
            f"structured: time_limit = {seconds:g} s ended the search; the result depends on the load of the machine",
            TimeLimitWarning,
            stacklevel=2,
        )
    return made


def _plants(plants: StateSpace | Sequence[StateSpace]) -> tuple[StateSpace, ...]:
    given = tuple(plants) if isinstance(plants, list | tuple) else (plants,)
    if not given:
        raise ArgumentError("structured: there must be at least one plant, got no plants")
    return given


def _partitions(given: tuple[StateSpace, ...], nmeas: int, ncon: int) -> tuple[Partition, ...]:
    parts = tuple(partition(P, nmeas, ncon, sampled=True) for P in given)
    for k, one in enumerate(parts[1:], 2):
        if one.dt != parts[0].dt:
            raise ArgumentError(
                f"structured: plant {k} has dt = {one.dt:g} s, but the first {parts[0].dt:g} s; all must have the same"
            )
        if one.D11.shape != parts[0].D11.shape:
            shapes = f"{one.D11.shape[0]} z and {one.D11.shape[1]} w"
            raise ArgumentError(
                f"structured: plant {k} has {shapes}; all must have {parts[0].D11.shape}, as the first has"
            )
    return parts


def _task(
    given: tuple[StateSpace, ...],
    parts: tuple[Partition, ...],
    flat: tuple[Partition, ...],
    requirements: Sequence[LoopRequirement],
) -> _Task:
    if not requirements:
        return _Task(plants=flat, soft=(Goal(plants=flat),), hard=(), decay=0.0)
    from platform_ctrl.design.fixed_structure.requested import tasks

    requested = [tasks(P, part, requirements, "structured") for P, part in zip(given, parts, strict=True)]
    decay = 0.0
    for region in requested[0].regions:
        if region.kind != "stability":
            raise ArgumentError(
                "structured: requirements must be of kind 'H-infinity norm', 'H2 norm' or 'stability', got "
                f'{region.kind!r}; for pole regions use method = "structured" in a job'
            )
        period = parts[0].dt
        limit = region.limit if period == 0.0 else 2.0 / period * np.tanh(0.5 * region.limit * period)
        decay = max(decay, float(limit))
    if requested[0].controller:
        raise ArgumentError(
            "structured: requirements must be of kind 'H-infinity norm', 'H2 norm' or 'stability', got "
            "'fastest controller pole'; bound the structure's numbers instead"
        )
    if not requested[0].norms:
        raise ArgumentError(
            "structured: there is no norm among the requirements; give at least one that is to be made small"
        )
    every = [
        (norm.requested.hard,
         Goal(plants=tuple(_channel(one.plant, norm.w, norm.z, _aim(norm.requested)) for one in requested), h2=norm.h2))
        for norm in requested[0].norms
    ]  # fmt: skip
    soft = tuple(goal for hard, goal in every if not hard)
    hard = tuple(goal for hard, goal in every if hard)
    return _Task(plants=flat, soft=soft or hard, hard=hard if soft else (), decay=decay)


def _aim(requested: LoopRequirement) -> float:
    return requested.limit * (1.0 - _RESERVE) if requested.hard else requested.limit


def _channel(plant: Partition, w: Sequence[int], z: Sequence[int], limit: float) -> Partition:
    """Return the plant with some of its w and z, the latter in units of the limit."""
    w, z = list(w), list(z)
    return Partition(
        A=plant.A, B1=plant.B1[:, w], B2=plant.B2, C1=plant.C1[z] / limit, C2=plant.C2,
        D11=plant.D11[np.ix_(z, w)] / limit, D12=plant.D12[z] / limit, D21=plant.D21[:, w], D22=plant.D22,
    )  # fmt: skip


def _diagonal(first: FloatArray, second: FloatArray) -> FloatArray:
    out = np.zeros((len(first) + len(second), first.shape[1] + second.shape[1]))
    out[: len(first), : first.shape[1]] = first
    out[len(first) :, first.shape[1] :] = second
    return out


def _points(
    problem: Problem,
    flat: tuple[Partition, ...],
    bounds: Sequence[Bound],
    order: int,
    units: Units,
    starts: int,
    rng: np.random.Generator,
) -> list[FloatArray]:
    """Return the starting points: search coordinates, or matrices where there is no pattern."""
    whole = problem.structured
    known = [(flat[k % len(flat)], K) for k, bound in enumerate(bounds) for K in bound.controllers]
    if whole is not None:
        points: list[FloatArray] = [whole.start]
        fit: list[tuple[Fit | None, FloatArray]] = [*fits([p for p, _ in known], [K for _, K in known], whole)]
        points += [x for _, x in fit]
        fit = fit or [(None, whole.start)]
        for k in range(max(starts - len(points), 0)):
            points.append(around(fit[k % len(fit)][1], fit[k % len(fit)][0], rng, whole))
        return points[:starts]
    left, right = problem.units
    rows, columns = len(left), len(right)
    own = np.zeros((rows, columns))
    own[:order, :order] = -np.diag(units.rate * 2.0 ** (np.arange(order) - 0.5 * (order - 1)))
    points = [own]
    for _, K in known:
        short = truncated(K, order) if order else None
        if short is not None:
            points.append(np.block([[short.A, short.B], [short.C, short.D]]))
    scale = [left @ x.reshape(rows, columns) @ right for x in scattered(starts, rows * columns, rng)]
    return [*points, *(own + x for x in scale)][:starts]


def _of_orders(
    structure: StateSpaceOrder, task: _Task, units: Units, whole: Parametrised | None, seed: int, limits: Limits
) -> tuple[list[FloatArray], int]:
    """Return a start with enough decay, or the nearest, from companion forms and lower orders; evaluations spent."""
    if any(structure.given) or not 1 <= structure.states <= _MOST_STATES:
        return [], 0
    known = Orders(task.plants, task.decay, units, np.random.default_rng(seed), limits)
    best = known.best(structure.states, structure.strictly_proper)
    return [best.M if whole is None else whole.nearest(best.M)], known.spent
