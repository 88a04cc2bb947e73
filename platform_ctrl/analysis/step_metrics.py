"""How a loop follows its commands: overshoot, settling, errors that remain. Of the samples."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays, named_system
from platform_ctrl.analysis.loop_set import LoopSet
from platform_ctrl.analysis.measuring import Request
from platform_ctrl.analysis.time_responses import time_response
from platform_ctrl.common.values import FloatArray

# Band about the final value that a response has to stay in.
SETTLED = 0.02
# Decay times of the slowest pole over which a response is followed, and samples at most.
_DECAYS, _MOST = 12.0, 300_000
# An error below this share of a step is rounding.
_NO_ERROR = 1e-8


# Returns a value of each channel, (p,), of a loop from commands to what is measured.
Measure = Callable[[StateArrays], FloatArray]


def of_following(function: Measure) -> Callable[[LoopSet, Request], FloatArray]:
    """Return the measure of the worst channel of each plant; infinite of an unstable loop."""
    return _worst(lambda loops, k: function(_following(loops, k)))


def of_steps(which: int) -> Callable[[LoopSet, Request], FloatArray]:
    """Return the same of the overshoot (0) or the settling time (1): steps are computed once for both."""

    def measured(loops: LoopSet, k: int) -> FloatArray:
        if k not in loops.of_steps:
            steps = step_responses(_following(loops, k), float(loops.decay[k]))
            loops.of_steps[k] = overshoot(steps), settling_time(steps, loops.period)
        return loops.of_steps[k][which]

    return _worst(measured)


def _worst(measured: Callable[[LoopSet, int], FloatArray]) -> Callable[[LoopSet, Request], FloatArray]:
    def worst(loops: LoopSet, request: Request) -> FloatArray:
        out = np.full(len(loops.plants.labels), np.inf)
        for k in np.flatnonzero(loops.decay > 0.0):
            out[k] = float(measured(loops, int(k)).max(initial=0.0))
        return out

    return worst


def _following(loops: LoopSet, k: int) -> StateArrays:
    A, B, C, D, dt = loops.following
    return StateArrays(A[k], B[k], C[k], D[k], dt)


def overshoot(steps: FloatArray) -> FloatArray:
    """Return by how much the step response of each channel exceeds its step, relative."""
    return np.asarray(np.maximum(steps.max(axis=1) - 1.0, 0.0))


def settling_time(steps: FloatArray, period: float) -> FloatArray:
    """Return after which time each channel's step response stays within 2 % of the step, s; infinite: never."""
    outside = np.abs(steps - 1.0) > SETTLED
    last = outside.shape[1] - np.argmax(outside[:, ::-1], axis=1)
    time = np.where(outside.any(axis=1), last, 0) * period
    return np.where(outside[:, -1], np.inf, time)


def steady_error(loop: StateArrays) -> FloatArray:
    """Return the error of each channel that a step leaves, relative."""
    A, B, C, D, _ = loop
    left = np.abs(1.0 - np.diag(D + C @ np.linalg.solve(np.eye(len(A)) - A, B)))
    return np.where(left > _NO_ERROR, left, 0.0)


def ramp_error(loop: StateArrays) -> FloatArray:
    """Return the error of each channel behind a ramp, over its slope, s; infinite where it grows."""
    A, B, C, _, dt = loop
    inverse = np.linalg.inv(np.eye(len(A)) - A)
    # With y = G(z) r the error behind r = k dt tends to dt G'(1), G' = −C (zI − A)⁻² B, where G(1) = 1.
    behind = dt * np.abs(np.diag(C @ inverse @ inverse @ B))
    return np.where(steady_error(loop) > 0.0, np.inf, behind)


def step_responses(loop: StateArrays, decay: float) -> FloatArray:
    """Return the response of each channel to a step of its own reference, (p, N); `decay`: of the slowest pole, 1/s."""
    A, B, C, D, dt = loop
    count = int(np.clip(np.ceil(_DECAYS / (decay * dt)), 100, _MOST))
    time, step = dt * np.arange(count), np.ones((1, count))
    out = []
    for i in range(len(C)):
        channel = named_system(StateArrays(A, B[:, [i]], C[[i]], D[[i]][:, [i]], dt), ["reference"], ["measured"])
        out.append(time_response(channel, time, step, squeeze=False)[0])
    return np.array(out)
