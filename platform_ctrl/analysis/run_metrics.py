"""What the metrics of simulated runs are, and how they compare with limits; their table is `RUN_METRICS`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from platform_ctrl.analysis.metrics import RUN_METRICS
from platform_ctrl.common.values import FloatArray

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
