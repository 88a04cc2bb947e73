"""The table of the metrics of simulated runs, and how they compare with limits."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from platform_ctrl.analysis.metrics import Quantity
from platform_ctrl.common.values import FloatArray, value


@value
class RunMetric(Quantity):
    """A metric of a simulated run; the limits are in ``[manoeuvre.limits]``."""

    on_demand: bool = False  # whether it is shown only where a manoeuvre limits it
    sight: bool = False  # whether the plant needs a line of sight
    commanded: bool = False  # whether the run needs a command in its unit


RUN_METRICS: dict[str, RunMetric] = {
    one.key: one
    for one in (
        RunMetric(
            name="largest gimbal angle",
            key="angle",
            unit="rad",
            meaning="largest magnitude of a gimbal's angle",
        ),
        RunMetric(
            name="largest platform angle",
            key="attitude",
            unit="rad",
            meaning="largest component of the platform's rotation vector",
        ),
        RunMetric(
            name="largest torque over its limit",
            key="torque_share",
            meaning="largest commanded torque over its torquer's limit",
        ),
        RunMetric(
            name="largest gimbal rate",
            key="gimbal_rate",
            unit="rad/s",
            meaning="largest magnitude of a gimbal's rate",
            on_demand=True,
        ),
        RunMetric(
            name="largest error behind a commanded angle",
            key="angle_following_error",
            unit="rad",
            meaning="largest magnitude of an angle that is read, without the sensor's bias and scale error, less its "
            "command after `settle`",
            on_demand=True,
            commanded=True,
        ),
        RunMetric(
            name="largest error behind a commanded rate",
            key="rate_following_error",
            unit="rad/s",
            meaning="largest magnitude of a rate that is read, without the sensor's bias and scale error, less its "
            "command after `settle`",
            on_demand=True,
            commanded=True,
        ),
        RunMetric(
            name="line-of-sight angle, rms",
            key="los_angle_rms",
            unit="rad",
            meaning="rms of `los_angle1` or `los_angle2` after `settle`, the larger: about zero, but about the mean in "
            "a run with commands",
            on_demand=True,
            sight=True,
        ),
        RunMetric(
            name="line-of-sight rate, rms",
            key="los_rate_rms",
            unit="rad/s",
            meaning="rms of `los_rate1` or `los_rate2` after `settle`, the larger: about zero, but about the mean in a "
            "run with commands",
            on_demand=True,
            sight=True,
        ),
        RunMetric(
            name="attenuation of base motion, simulated",
            key="attenuation_db",
            unit="dB",
            sense="at least",
            meaning="rms of the platform rate over that of `los_rate1` or `los_rate2`, the larger, both about their "
            "means, in dB, caged",
            on_demand=True,
            sight=True,
        ),
    )
}
# Beyond this ratio, 400 dB, what is left is rounding.
_NOTHING_LEFT = 1e20


def run_metrics(limits: Iterable[Mapping[str, float]]) -> tuple[str, ...]:
    """Return the keys of the metrics that are shown of runs with these limits, in the order of the table."""
    limited = {key for one in limits for key in one}
    return tuple(key for key, metric in RUN_METRICS.items() if not metric.on_demand or key in limited)


def over_limit(key: str, values: FloatArray, limits: FloatArray) -> FloatArray:
    """Return metrics of runs relative to their limits, (k,): above 1 the limit is violated."""
    if RUN_METRICS[key].sense == "at most":
        return np.asarray(values / limits)
    return np.asarray(np.divide(limits, values, out=np.full_like(values, np.inf), where=values > 0.0))


def worst_value(key: str) -> float:
    """Return the value of a run that diverged."""
    return np.inf if RUN_METRICS[key].sense == "at most" else -np.inf


def attenuation_db(base: FloatArray, sight: FloatArray) -> FloatArray:
    """Return the rms of base rates (..., 3) over the larger of two of the line of sight (..., 2), dB; 0 at rest."""
    moved = np.sqrt(np.sum(base * base, axis=-1))
    left = np.maximum(sight.max(axis=-1), moved / _NOTHING_LEFT)
    return np.asarray(20.0 * np.log10(np.divide(moved, left, out=np.ones_like(moved), where=moved > 0.0)))
