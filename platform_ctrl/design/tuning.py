"""Moving a controller's parameters until the worst requirement is met with a reserve."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.analysis.loop_metrics import LoopMetrics, measure
from platform_ctrl.analysis.loop_set import LoopSet
from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.loop import LoopProblem
from platform_ctrl.job.requirements import LoopRequirement, loop_requirements

BoolArray = NDArray[np.bool_]
Builder = Callable[[dict[str, float]], StateArrays]

# How far options may move, as a factor: where nothing gets better the search would go on to infinity.
_LARGEST_FACTOR = 1e6
# Plants that are kept in view while searching: the worst ones. All are looked at again after each search.
_MOST_PLANTS = 8


def tuned(
    problem: LoopProblem,
    options: dict[str, float],
    tunable: Sequence[str],
    build: Builder,
    upper: dict[str, float],
) -> dict[str, float]:
    """Return the options of a design, with ``tune = true`` moved until its loop's limits are met: see `tune`."""
    spec, design = problem.spec, problem.design
    if not design.tune:
        return options
    return tune(
        options,
        [name for name in tunable if name in options],
        lambda numbers: problem.with_commands(build(numbers)),
        problem.plants,
        loop_requirements(spec.limits),
        upper=upper,
        progress=lambda ratio: problem.progress(
            f"{spec.name}: {design.name}, worst requirement at {ratio:.0%} of its limit"
        ),
    )


def worst_ratio(controller: StateArrays, plants: PlantSet, requirements: Sequence[LoopRequirement]) -> float:
    """Return the largest ratio of all requirements; beyond 10 for an unstable loop, more the faster it diverges."""
    return _worst(_on_grid(controller, plants, requirements), plants, requirements)


def _on_grid(controller: StateArrays, plants: PlantSet, requirements: Sequence[LoopRequirement]) -> LoopMetrics:
    return measure(plants, controller._replace(dt=plants.period), requirements, exact=False)


def _worst(measures: LoopMetrics, plants: PlantSet, requirements: Sequence[LoopRequirement]) -> float:
    growth = -float(measures.decay[_stable(measures, requirements)].min())
    if not growth < 0.0:
        return 10.0 + min(growth / plants.nutation, 1e6) * 100.0
    ratios = (r.ratios(measures).max() for r in requirements)
    return float(min(max(ratios, default=0.0), 10.0))


def tune(  # noqa: PLR0913, PLR0915 - the parts of one search
    start: dict[str, float],
    movable: Sequence[str],
    build: Builder,
    plants: PlantSet,
    requirements: Sequence[LoopRequirement],
    *,
    upper: dict[str, float] | None = None,
    reserve: float = 0.05,
    evaluations: int = 1500,
    progress: Callable[[float], None] | None = None,
) -> dict[str, float]:
    """Return `start` with the `movable` options changed so that the worst ratio is at most 1 − reserve, or least.

    A simplex search over the logarithms (Nelder and Mead, adaptive), on the nominal plant and the worst few of the set,
    repeated until the plants in view are the worst of all. What meets the limits on the grid of frequencies is measured
    exactly; where that exceeds a limit, the frequencies at which the figures are reached join the grid. Deterministic.
    `start` and `upper` bounds are positive; `build` makes the sampled controller; `progress` is called with the worst
    ratio so far.
    """
    from scipy.optimize import minimize

    bounds = np.array([np.log((upper or {}).get(name, np.inf)) for name in movable])
    best = np.minimum(np.log([start[name] for name in movable]), bounds)
    lower, bounds = best - np.log(_LARGEST_FACTOR), np.minimum(bounds, best + np.log(_LARGEST_FACTOR))

    def options(x: FloatArray) -> dict[str, float]:
        # What has not moved keeps its number to the last digit.
        ratios = np.exp(np.clip(x, lower, bounds) - [math.log(start[name]) for name in movable])
        return start | {name: start[name] * float(ratio) for name, ratio in zip(movable, ratios, strict=True)}

    def beyond(x: FloatArray) -> float:
        return float(np.maximum(np.maximum(x - bounds, lower - x), 0.0).max(initial=0.0))

    def ratio(x: FloatArray, on: PlantSet) -> float:
        return worst_ratio(build(options(x)), on, requirements) + beyond(x)

    target = 1.0 - reserve
    view = [0]
    left = evaluations
    best_ratio = np.inf
    current = best
    while left > 0:
        measures = _on_grid(build(options(current)), plants, requirements)
        overall = _worst(measures, plants, requirements) + beyond(current)
        refined = False
        if overall <= 1.0:
            exactly, finer = _exactly(build(options(current)), plants, requirements)
            if exactly > 1.0:
                plants, refined, overall = finer, True, exactly + beyond(current)
        if overall < best_ratio:
            best, best_ratio = current, overall
        if progress is not None:
            progress(best_ratio)
        if best_ratio <= target:
            break
        if refined:
            measures = _on_grid(build(options(current)), plants, requirements)
        added = [k for k in _worst_plants(measures, requirements) if k not in view]
        if current is not best and not added and not refined:
            break
        view = sorted({*view, *added[:_MOST_PLANTS]})
        near = plants.only(view)

        def stop(intermediate_result: object) -> None:
            if getattr(intermediate_result, "fun", np.inf) <= 0.995 * target:
                raise StopIteration

        found = minimize(
            ratio,
            current,
            args=(near,),
            method="Nelder-Mead",
            callback=stop,
            options={"maxfev": min(left, 60 * len(movable)), "adaptive": True, "xatol": 2e-3, "fatol": 2e-4},
        )
        left -= int(found.nfev) + 1
        current = np.asarray(found.x, dtype=np.float64)
    return options(best)


def _exactly(
    controller: StateArrays, plants: PlantSet, requirements: Sequence[LoopRequirement]
) -> tuple[float, PlantSet]:
    """Return the largest ratio over all frequencies, and the plants on a grid that has those that it is reached at."""
    loops = LoopSet(plants, controller._replace(dt=plants.period))
    measures = measure(plants, loops.controller, requirements, loops=loops)
    return _worst(measures, plants, requirements), plants.finer(loops.peak_frequencies)


def _worst_plants(measures: LoopMetrics, requirements: Sequence[LoopRequirement]) -> list[int]:
    """Return plant numbers, the worst first."""
    decay = np.where(_stable(measures, requirements), measures.decay, np.inf)
    if not np.all(decay > 0.0):
        return [int(k) for k in np.argsort(decay)]
    ratios = np.zeros(len(decay))
    for requirement in requirements:
        if requirement.beyond_nominal and requirement.metric.of != "controller":
            requested = measures.of(requirement.over)
            ratios[requested] = np.maximum(ratios[requested], requirement.ratios(measures))
    return [int(k) for k in np.argsort(-ratios)]


def _stable(measures: LoopMetrics, requirements: Sequence[LoopRequirement]) -> BoolArray:
    """Return which plants have to be stable, (N,): those with a fault only where something is required of them."""
    if any("faults" in requirement.over for requirement in requirements):
        return np.ones(len(measures.groups), dtype=np.bool_)
    out: BoolArray = np.logical_not(measures.of(("faults",)))
    return out
