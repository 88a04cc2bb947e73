"""What bounds the bandwidth of a loop: how far its gain may rise, and how that changes with delay, modes and limits."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Collection, Iterator, Sequence

import numpy as np
from scipy import optimize

from platform_ctrl.analysis.loop_metrics import LoopMetrics, measure
from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.analysis.system import System
from platform_ctrl.common.values import replaced, value
from platform_ctrl.design.cases import changed, modes_of
from platform_ctrl.design.loop import LoopOutcome, with_commands
from platform_ctrl.design.plants import plants_of, tracking_plants
from platform_ctrl.design.tuning import deciding
from platform_ctrl.errors import ArgumentError, NotFoundError
from platform_ctrl.job.job import Job
from platform_ctrl.job.requirements import LoopRequirement
from platform_ctrl.plant.platform import Platform, sensor_tables

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
def loop_bounds(job: Job, outcome: LoopOutcome, inner: LoopOutcome | None = None) -> LoopBounds | None:
    """Return what bounds a loop; None where it has no plants of its own, or nothing ends the rise of its gain.

    A tracking loop needs `inner`, the rate loop that it commands, and has that loop's gain among its parameters.

    The gain is raised with the nominal plant and those that are worst for each requirement, at the start or the end,
    until one of the requirements that a larger gain makes worse is no longer met; then again with each parameter eased
    by a tenth.
    """
    design = outcome.closed
    plants = design.plants
    if plants is None or design.measures is None:
        return None
    found = _reached(outcome, _quick(outcome, plants))
    if found is None:
        return None
    gain, bandwidth, one = found
    bounds = []
    for name, moved, eased in _eased(job, outcome, inner):
        # With what another requirement alone depends on, the end of the rise stays where it is.
        again = moved() if _ALONE.get(name, one.kind) == one.kind else plants
        end = found if again is plants else None if again is None else _reached(outcome, _quick(outcome, again), gain)
        if end is not None:
            bounds.append(Bound(parameter=name, sensitivity=math.log(end[1] / bandwidth) / math.log(eased) + 0.0))
    bounds.sort(key=lambda bound: -abs(bound.sensitivity))
    return LoopBounds(gain=gain, bandwidth=bandwidth, requirement=one.name, bounds=tuple(bounds))


def _eased(
    job: Job, outcome: LoopOutcome, inner: LoopOutcome | None
) -> Iterator[tuple[str, Callable[[], PlantSet | None], float]]:
    """Yield parameters by name, what makes the plants with each of them eased, and the factor of the parameter."""
    spec, plants, less, more = outcome.spec, outcome.closed.plants, 1.0 - _SHARE, 1.0 + _SHARE
    assert plants is not None, "the loop has plants"

    def of(other: Job, gain: float = 1.0) -> Callable[[], PlantSet | None]:
        return functools.partial(_plants_in, other, outcome, inner, gain)

    if job.sampling.delay:
        sooner = dataclasses.replace(job.sampling, delay=less * job.sampling.delay)
        yield "delay", of(replaced(job, {"sampling": sooner})), less
    # Linear models round the age of a reading up to whole sample periods: it is changed by one of these.
    read, period = {*spec.read_by(spec.closed).sensors, *plants.angles}, job.sampling.period
    ages = [one.periods_late(period, job.every(spec)) for one in job.platform.sensors if one.name in read]
    age = max(ages, default=0)
    if age:
        later = _read_later(job.platform, read, period)
        yield "delay of its sensors", of(replaced(job, {"platform": later})), (age + 1) / age
    moving = outcome if inner is None else inner
    assert moving.closed.plants is not None, "a rate loop has plants"
    for name in modes_of(job, moving.spec.gimbals, moving.closed.plants.torques):
        faster = changed(job.platform, {"frequency": {name: _SHARE}})
        yield f"frequency of {name}", of(replaced(job, {"platform": faster})), more
    if inner is not None:
        yield f"gain of {inner.spec.name}", of(job, more), more
    kinds = {one.kind for one in spec.requirements}
    if "torque noise" in kinds:
        yield "noise", lambda: dataclasses.replace(plants, noise=less * plants.noise), less
    if "torque limit" in kinds:
        yield "torque limit", lambda: dataclasses.replace(plants, torque_limit=more * plants.torque_limit), more


def _read_later(platform: Platform, names: Collection[str], time: float) -> Platform:
    kinds = {kind: getattr(platform, kind) for kind in sensor_tables().values()}
    late = {
        kind: tuple(replaced(one, {"delay": one.delay + time}) if one.name in names else one for one in own)
        for kind, own in kinds.items()
    }
    return replaced(platform, late)


def _plants_in(job: Job, outcome: LoopOutcome, inner: LoopOutcome | None, gain: float = 1.0) -> PlantSet | None:
    """Return a loop's plants in another job; those of a tracking loop with `gain` times the gain of the loop inside."""
    if inner is not None:
        inside, K = _plants_in(job, inner, None), inner.closed.controller
        if inside is None:
            return None
        return tracking_plants(job, outcome.spec, inner.spec, inside, _times(gain, with_commands(inside, K)))[0]
    plants, made = outcome.closed.plants, plants_of(job, outcome.spec.read_by(outcome.spec.closed))
    if plants is None or made is None:
        return None
    if plants.feedforward is not None:
        made = made.fed_forward(plants.feedforward)
    if plants.sight_budget is None:
        return made
    return dataclasses.replace(made, sight_budget=replaced(plants.sight_budget, {"job": job, "plants": made}))


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


def _raised(
    outcome: LoopOutcome, plants: PlantSet, gain: float, requirements: Sequence[LoopRequirement] | None = None
) -> LoopMetrics:
    """Return what the requirements are about, by default all of them, with the controller's gain times `gain`."""
    K = with_commands(plants, outcome.closed.controller)
    requirements = outcome.spec.requirements if requirements is None else requirements
    return measure(plants, _times(gain, K), requirements, exact=False)


def _times(gain: float, K: System) -> System:
    return K._replace(C=gain * K.C, D=gain * K.D)


def _ratios(metrics: LoopMetrics, requirements: Sequence[LoopRequirement]) -> list[float]:
    unstable = not metrics.decay.min(initial=np.inf) > 0.0
    return [np.inf if unstable else float(one.ratios(metrics).max(initial=0.0)) for one in requirements]


def _risen(outcome: LoopOutcome, plants: PlantSet, near: float) -> tuple[float, float, LoopRequirement] | None:
    """Return the largest gain with which all is met that a larger gain makes worse, its bandwidth, and what ends it.

    It is looked for from `near` on.
    """
    every = outcome.spec.requirements
    before, after = (_ratios(_raised(outcome, plants, 1.0 + k * 0.5 * _SHARE), every) for k in (-1.0, 1.0))
    rising = [one for one, less, more in zip(every, before, after, strict=True) if more > less]
    measured = functools.partial(_raised, outcome, plants, requirements=rising)

    def worst(metrics: LoopMetrics) -> tuple[float, int]:
        return max(((ratio, k) for k, ratio in enumerate(_ratios(metrics, rising))), default=(0.0, 0))

    rise = _RANGE ** (1.0 / _STEPS if worst(measured(near))[0] <= 1.0 else -1.0 / _STEPS)
    low = near
    for high in near * rise ** np.arange(1.0, _STEPS + 1.0):
        if (worst(measured(high))[0] > 1.0) != (rise < 1.0):
            break
        low = float(high)
    else:
        return None
    low, high = sorted((low, float(high)))
    # Where the loop is unstable nothing is measured: any ratio above 1 stands for it.
    gain = float(optimize.brentq(lambda x: min(worst(measured(x))[0], 2.0) - 1.0, low, high, xtol=_FOUND * low))
    end = measured(gain)
    return gain, end.bandwidth, rising[worst(end)[1]]
