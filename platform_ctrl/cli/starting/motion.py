"""The motion of the base that a loop keeps from the body it holds: a run, and what may be left of the motion."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.analysis.loop_metrics import measure
from platform_ctrl.analysis.measuring import MetricRequest
from platform_ctrl.job.requirements import WORST_CASE

if TYPE_CHECKING:
    from platform_ctrl.analysis.arrays import StateArrays
    from platform_ctrl.analysis.plant_set import PlantSet
    from platform_ctrl.cli.starting.loops import StartingLoop, StartingRun
    from platform_ctrl.job.job import Job

# The attenuation is that at this share of the crossover and below.
_LOW = 0.1
# What a job asks for is so much less than the linear model gives, dB: of a loop, and of a run, in which friction is no
# describing function. Factor from the angles that the linear model gives to the limit of a run.
_LINEAR_SPARE, _RUN_SPARE, _ANGLE_SPARE = 1.0, 6.0, 2.0
# Least attenuation that is worth a limit, dB.
_LEAST = 3.0


def motion_of_the_base(
    job: Job, loop: StartingLoop, plants: PlantSet, controller: StateArrays, axes: tuple[int, ...]
) -> tuple[StartingLoop, StartingRun]:
    """Return a loop with limits on what the motion of the base does to it, and the run that shows it.

    `plants` are those of `controller`, `axes` the root axes about which the base moves.
    """
    from platform_ctrl.cli.starting.loops import StartingRun, rounded

    crossover = min(x for name, x in loop.options.items() if name.endswith("crossover_hz"))
    low = float(f"{_LOW * crossover:.2g}")
    limits: dict[str, float] = {}
    allowed: dict[str, float] = {}
    frequency = max(rounded(low, up=False), _SLOWEST)
    if loop.plan.still and plants.sight:
        reached = _attenuation(plants, controller, low) - _LINEAR_SPARE
        if reached >= _LEAST:
            limits = {"attenuation_db_worst_case": float(math.floor(reached)), "attenuation_hz": low}
        reached = _attenuation(plants, controller, frequency) - _RUN_SPARE
        allowed = {"attenuation_db": float(math.floor(reached))} if reached >= _LEAST else {}
    else:
        bandwidth = _value(plants, controller, "bandwidth", ("nominal",)) / (2.0 * math.pi)
        limits = {"bandwidth_hz": rounded(bandwidth, up=False)}
        dry = {one.gimbal for one in job.platform.frictions if max(one.breakaway) > 0.0}
        if not loop.plan.still and dry.isdisjoint(loop.plan.gimbals):
            gain = _value(plants, controller, "Omega rejection", ("nominal",))
            angle = _ANGLE_SPARE * gain * float(np.max(job.Omega)) * math.sqrt(len(axes))
            allowed = {"angle": rounded(angle, up=True)}
    balanced = not job.platform.unbalances or not np.any(job.platform.specific_force)
    run = StartingRun(
        name="motion of the base",
        form="motion",
        axes=axes,
        size=float(np.max(job.Omega)),
        frequency_hz=frequency,
        balanced=balanced,
        limits=allowed | {"torque_share": 1.0},
    )
    return replace(loop, limits=loop.limits | limits), run


# Slowest motion of the base in a run, Hz: it has to last for periods.
_SLOWEST = 0.5


def _attenuation(plants: PlantSet, controller: StateArrays, hz: float) -> float:
    """Return the attenuation up to a frequency, dB, dry friction and all angles included."""
    return 20.0 * math.log10(max(_value(plants, controller, "attenuation", WORST_CASE, 2.0 * math.pi * hz), 1e-3))


def _value(
    plants: PlantSet, controller: StateArrays, kind: str, over: tuple[str, ...], frequency: float | None = None
) -> float:
    """Return the worst value of a metric, in SI units: exact, since a limit is put right below it."""
    request = MetricRequest(kind=kind, over=over, frequency=frequency)
    metrics = measure(plants, controller._replace(dt=plants.period), [request], exact=True)
    values = metrics.values(request)
    return float(values.max() if kind == "Omega rejection" else values.min())
