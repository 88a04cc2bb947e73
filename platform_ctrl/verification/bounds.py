"""What bounds the bandwidth of a loop: how far its gain may rise, and how that changes with delay, modes and limits."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Iterator

import numpy as np
from scipy import optimize

from platform_ctrl.analysis.loop_metrics import LoopMetrics, measure
from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.common.values import replaced, value
from platform_ctrl.design.cases import changed, modes_of
from platform_ctrl.design.loop import LoopOutcome, with_commands
from platform_ctrl.design.plants import plants_of
from platform_ctrl.design.tuning import deciding
from platform_ctrl.errors import ArgumentError, NotFoundError
from platform_ctrl.job.job import Job
from platform_ctrl.job.requirements import LoopRequirement

# By how much a parameter is eased, the range of gains that are tried, their steps, and how well the last one is found.
_SHARE, _RANGE, _STEPS, _FOUND = 0.1, 8.0, 32, 1e-3
# Parameters on which no more than one kind of requirement depends.
_ALONE = {"noise": "torque noise", "torque limit": "torque limit"}


@value
class Bound:
    """How the largest bandwidth of a loop changes with a parameter."""

    parameter: str  # "delay", "frequency of arms", "noise", "torque limit"
    sensitivity: float  # d ln(bandwidth)/d ln(parameter)


@value
class LoopBounds:
    """How far the gain of a loop may rise within its limits, everything else of the controller as it is."""

    gain: float  # factor of the gain at the end
    bandwidth: float  # nominal there, rad/s
    requirement: str  # the one that ends it
    bounds: tuple[Bound, ...]  # the largest effect first


@functools.lru_cache(maxsize=32)
def loop_bounds(job: Job, outcome: LoopOutcome) -> LoopBounds | None:
    """Return what bounds a loop; None where it has no plants of its own, or nothing ends the rise of its gain.

    The gain is raised with the nominal plant and those that are worst for each requirement, at the start or the end,
    until one of the requirements that a larger gain makes worse is no longer met; then again with each parameter eased
    by a tenth.
    """
    design, spec = outcome.closed, outcome.spec
    plants = design.plants
    if plants is None or design.measures is None or spec.kind == "tracking":
        return None
    found = _reached(outcome, _quick(outcome, plants))
    if found is None:
        return None
    gain, bandwidth, one = found
    bounds = []
    for name, moved, eased in _eased(job, outcome):
        # With what another requirement alone depends on, the end of the rise stays where it is.
        again = moved() if _ALONE.get(name, one.kind) == one.kind else plants
        end = found if again is plants else None if again is None else _reached(outcome, _quick(outcome, again), gain)
        if end is not None:
            bounds.append(Bound(parameter=name, sensitivity=math.log(end[1] / bandwidth) / math.log(eased) + 0.0))
    bounds.sort(key=lambda bound: -abs(bound.sensitivity))
    return LoopBounds(gain=gain, bandwidth=bandwidth, requirement=one.name, bounds=tuple(bounds))


def _eased(job: Job, outcome: LoopOutcome) -> Iterator[tuple[str, Callable[[], PlantSet | None], float]]:
    """Yield parameters by name, what makes the plants with each of them eased, and the factor of the parameter."""
    design, spec = outcome.closed, outcome.spec.read_by(outcome.spec.closed)
    plants, less, more = design.plants, 1.0 - _SHARE, 1.0 + _SHARE
    assert plants is not None, "the loop has plants"

    def of(other: Job) -> PlantSet | None:
        made = plants_of(other, spec)
        if made is not None and plants.feedforward is not None:
            made = made.fed_forward(plants.feedforward)
        if made is None or plants.sight_budget is None:
            return made
        return dataclasses.replace(made, sight_budget=replaced(plants.sight_budget, {"job": other, "plants": made}))

    if job.sampling.delay:
        sooner = dataclasses.replace(job.sampling, delay=less * job.sampling.delay)
        yield "delay", functools.partial(of, replaced(job, {"sampling": sooner})), less
    for name in modes_of(job, spec.gimbals, plants.torques):
        faster = changed(job.platform, {"frequency": {name: _SHARE}})
        yield f"frequency of {name}", functools.partial(of, replaced(job, {"platform": faster})), more
    kinds = {one.kind for one in outcome.spec.requirements}
    if "torque noise" in kinds:
        yield "noise", lambda: dataclasses.replace(plants, noise=less * plants.noise), less
    if "torque limit" in kinds:
        yield "torque limit", lambda: dataclasses.replace(plants, torque_limit=more * plants.torque_limit), more


def _quick(outcome: LoopOutcome, plants: PlantSet) -> PlantSet:
    """Return plants whose line of sight is that of forms, the friction as it is now, not of a budget at every gain."""
    try:
        return plants.with_sight(plants.joined(outcome.closed.controller))
    except (ArgumentError, NotFoundError):  # an unstable loop has no budget, whatever its gain
        return plants


def _reached(outcome: LoopOutcome, plants: PlantSet, near: float = 1.0) -> tuple[float, float, LoopRequirement] | None:
    """Return the end of the rise, as `_risen`, with all plants that are worst for a requirement at its start or end."""
    chosen: list[int] = []
    more, found = deciding(_raised(outcome, plants, near), outcome.spec.requirements), None
    while more != chosen:
        chosen = more
        found = _risen(outcome, plants.only(chosen), near)
        end = _raised(outcome, plants, _RANGE if found is None else found[0])
        more = sorted({*chosen, *deciding(end, outcome.spec.requirements)})
    return found


def _raised(outcome: LoopOutcome, plants: PlantSet, gain: float) -> LoopMetrics:
    K = with_commands(plants, outcome.closed.controller)
    return measure(plants, K._replace(C=gain * K.C, D=gain * K.D), outcome.spec.requirements, exact=False)


def _risen(outcome: LoopOutcome, plants: PlantSet, near: float) -> tuple[float, float, LoopRequirement] | None:
    """Return the largest gain with which all is met that a larger gain makes worse, its bandwidth, and what ends it.

    It is looked for from `near` on.
    """
    requirements, measured = outcome.spec.requirements, functools.partial(_raised, outcome, plants)

    def ratios(metrics: LoopMetrics) -> list[float]:
        unstable = not metrics.decay.min(initial=np.inf) > 0.0
        return [np.inf if unstable else float(one.ratios(metrics).max(initial=0.0)) for one in requirements]

    before, after = ratios(measured(1.0 - 0.5 * _SHARE)), ratios(measured(1.0 + 0.5 * _SHARE))
    rising = [k for k, (one, other) in enumerate(zip(before, after, strict=True)) if other > one]

    def worst(gain: float) -> tuple[float, int]:
        found = ratios(measured(gain))
        return max(((found[k], k) for k in rising), default=(0.0, 0))

    rise = _RANGE ** (1.0 / _STEPS if worst(near)[0] <= 1.0 else -1.0 / _STEPS)
    low = near
    for high in near * rise ** np.arange(1.0, _STEPS + 1.0):
        if (worst(high)[0] > 1.0) != (rise < 1.0):
            break
        low = float(high)
    else:
        return None
    low, high = sorted((low, float(high)))
    # Where the loop is unstable nothing is measured: any ratio above 1 stands for it.
    gain = float(optimize.brentq(lambda x: min(worst(x)[0], 2.0) - 1.0, low, high, xtol=_FOUND * low))
    return gain, measured(gain).bandwidth, requirements[worst(high)[1]]
