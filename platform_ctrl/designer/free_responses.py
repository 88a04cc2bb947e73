"""How the free platform turns under torques, with all loops closed: over time and over frequency."""

from __future__ import annotations

import math

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray, StateArrays
from platform_ctrl.analysis.feedback import closed_loop_arrays
from platform_ctrl.analysis.response import ON_A_GRID, frequency_response_arrays
from platform_ctrl.designer.curves import held_responses, sample_times
from platform_ctrl.designer.free_loop import StabilisedLoop
from platform_ctrl.designer.free_plants import ATTITUDE, FreePlants
from platform_ctrl.designer.parts import POINTS, around_in_time, settling, step_size
from platform_ctrl.designer.pictures import FrequencyGain, TimeResponse
from platform_ctrl.designer.values import Settings
from platform_ctrl.frozen import FloatArray
from platform_ctrl.report.quantities import signal_series


def turning(
    loop: StabilisedLoop,
    settings: Settings,
    K: StateArrays,
    at: list[int],
    grid: FloatArray,
    s: ComplexArray,
    stable: bool,
    banded: bool,
) -> tuple[TimeResponse, FrequencyGain]:
    """Return how a torque on the platform turns it: over time after a step, and over the frequencies of `grid`."""
    axis, period = settings.axis, loop.shown.period
    size, title, limit = _acting(loop, axis)
    slow = s[np.isfinite(s) & (np.abs(s) < math.pi / period)]
    t, every = sample_times(settling(slow, 50.0 / period, period, stable), period, POINTS)
    u = np.full(every * (len(t) - 1) + 1, size)
    own = _responses(loop.shown, K, at, axis, u, every)[0]
    low, high = around_in_time(_responses(loop.plants, K, at, axis, u, every) if banded else None, own)
    torquers = [loop.shown.torquers[k] for k in at]
    rates = [name for name in loop.shown.sensors if name not in loop.job.platform.angle_names]
    signals, colour = (*ATTITUDE, *loop.shown.sensors, *torquers), signal_series(loop.job.platform)
    step = TimeResponse(
        title=title,
        t=t,
        signals=signals,
        series=tuple(colour[name] for name in signals),
        units=("rad",) * 3
        + tuple("rad/s" if name in rates else "rad" for name in loop.shown.sensors)
        + ("N m",) * len(torquers),
        values=own,
        low=low,
        high=high,
        drive=np.ones(len(t)),
        limit=limit,
    )
    m, p, k = len(loop.shown.torquers), len(loop.shown.sensors), len(at)
    column = slice(m + axis - 1, m + axis)

    def attitude(one: int, w: FloatArray, plants: FreePlants) -> FloatArray:
        A, B, C, D, dt = plants.turned
        a, b, c, d = closed_loop_arrays(A[one], B[one], C[one], D[one], *K[:4], torques=at, angles=list(range(p)))
        found = frequency_response_arrays(a, b[:, column], c[k + p :], d[k + p :, column], dt, w, ON_A_GRID)
        return np.asarray(np.linalg.norm(found[..., 0], axis=-1))

    none = np.zeros(0)
    w_band, low_gain, high_gain = none, none, none
    if banded:
        w_band = loop.plants.frequency
        whole = loop.plants.response
        # What acts moves the sensors, these the torques, and both the attitude.
        k_at = frequency_response_arrays(*K, w_band, ON_A_GRID)
        seen, acting = whole[..., :p, at], whole[..., :p, column]
        torque = np.linalg.solve(np.eye(k) - k_at @ seen, k_at @ acting)
        moved = whole[..., p:, column] + whole[..., p:, at] @ torque
        gains = np.linalg.norm(moved[..., 0], axis=-1)
        low_gain, high_gain = gains.min(axis=0), gains.max(axis=0)
    return step, FrequencyGain(
        title=f"torque M{axis} on the platform → attitude",
        unit="rad/(N m)",
        frequency=grid,
        gain=attitude(0, grid, loop.shown),
        band_frequency=w_band,
        low=low_gain,
        high=high_gain,
    )


def rate_step(
    loop: StabilisedLoop, settings: Settings, K: StateArrays, at: list[int], s: ComplexArray, stable: bool, banded: bool
) -> TimeResponse:
    """The attitude after an impulse of torque that would turn the free platform by 1 mrad/s about the axis."""
    axis, period = settings.axis, loop.shown.period
    t, every = sample_times(settling(s, 50.0 / period, period, stable), period, POINTS)
    u = np.zeros(every * (len(t) - 1) + 1)
    u[0] = 1e-3 * float(loop.model.root_inertia[axis - 1, axis - 1]) / period
    own = _responses(loop.shown, K, at, axis, u, every)[0]
    low, high = around_in_time(_responses(loop.plants, K, at, axis, u, every) if banded else None, own)
    kept = slice(0, 3 + len(loop.shown.sensors))
    rates = [name for name in loop.shown.sensors if name not in loop.job.platform.angle_names]
    drive = np.zeros(len(t))
    drive[0] = 1.0
    signals, colour = (*ATTITUDE, *loop.shown.sensors), signal_series(loop.job.platform)
    return TimeResponse(
        title=f"impulse of torque: 1 mrad/s about axis {axis}",
        t=t,
        signals=signals,
        series=tuple(colour[name] for name in signals),
        units=("rad",) * 3 + tuple("rad/s" if name in rates else "rad" for name in loop.shown.sensors),
        values=own[kept],
        low=low[kept],
        high=high[kept],
        drive=drive,
    )


def _responses(plants: FreePlants, K: StateArrays, at: list[int], axis: int, u: FloatArray, every: int) -> FloatArray:
    """Return attitude (3), angles and torques after a torque on the platform about `axis`."""
    A, B, C, D, _ = plants.turned
    m, p = len(plants.torquers), len(plants.sensors)
    loops = closed_loop_arrays(A, B, C, D, *K[:4], torques=at, angles=list(range(p)))
    a, b, c, d = loops
    k = len(at)
    order = [*range(k + p, k + p + 3), *range(k, k + p), *range(k)]
    column = slice(m + axis - 1, m + axis)
    return held_responses(a, b[..., column], c[..., order, :], d[..., order, column], u, every)


def _acting(loop: StabilisedLoop, axis: int) -> tuple[float, str, float | None]:
    """Return the torque step of the job's stabilised manoeuvre about an axis, or one that the torquer can hold."""
    for one in loop.job.manoeuvres:
        if one.mode == "stabilised" and one.axis == axis and one.torque:
            return one.torque, one.name, one.limits.get("attitude")
    limits = [t.limit for t in loop.job.platform.torquers if t.root_axis == axis]
    size = step_size(math.inf if not limits or limits[0] is None else limits[0])
    return size, f"{1e3 * size:g} mN m step about axis {axis}", None
