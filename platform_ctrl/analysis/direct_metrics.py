"""Metrics of a sampled loop that are measured in one step: margins of a channel, following of commands, noise.

Gain and phase margins are of one channel broken at the plant's input, all others closed. With S_i, the entry (i, i) of
the sensitivity at the input, the loop transfer of channel i is L_i = 1/S_i − 1. On the unit circle L(1/z) is the
conjugate of L(z), so that L is real where L(z) − L(1/z) has a zero and |L| = 1 where L(z) L(1/z) − 1 has one:
generalised eigenvalues. Next to narrow resonances and to z = 1 rounding moves these; L changes its sign between points
beside them, where it is followed to the crossing. Overshoot, settling and errors behind commands are of the samples.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from platform_ctrl.analysis.drift import drifting_rms
from platform_ctrl.analysis.feedback import loop_of_sensitivity
from platform_ctrl.analysis.loop import Loop
from platform_ctrl.analysis.measuring import Request
from platform_ctrl.analysis.norms import noise_rms
from platform_ctrl.analysis.poles import continuous_poles, poles, resonances
from platform_ctrl.analysis.response import frequency_response
from platform_ctrl.analysis.singular_values import pencil_crossings
from platform_ctrl.analysis.system import ComplexArray, System, state_scaling
from platform_ctrl.analysis.time_responses import time_response
from platform_ctrl.common.values import FloatArray

# Share of the slowest pole from which on L is followed, of Nyquist's below which a pole is one at 0; a gain like that
# of an integrator at 0.
_FIRST, _ZERO, _BEYOND = 1e-2, 1e-10, 1e8
# How far |L| may be from 1, and its angle from ±180°, at such a frequency, relative.
_AT = 1e-3
# Points of a grid beside the eigenvalues; parts into which an interval with a crossing is cut, and how often.
_GRID, _PARTS, _CUTS = 200, 16, 10


def margins_of_channel(sensitivity: System) -> tuple[float, float]:
    """Return the gain margin, a factor > 1, and the phase margin, rad, of a stable sampled loop, from its S_i.

    The gain margin is the least factor by which the gain may be raised or lowered, infinite where none ends stability.
    """
    loop = loop_of_sensitivity(sensitivity)

    def L(w: FloatArray) -> ComplexArray:
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(1.0 / frequency_response(sensitivity, w)[0, 0] - 1.0)

    own = np.concatenate([poles(sensitivity.A), poles(loop.A)])
    near = resonances(continuous_poles(own, loop.dt))
    real = _crossings(L, lambda x: x.imag, _real_frequencies(loop), near, np.pi / loop.dt)
    # L is real at zero frequency and at Nyquist's, too.
    real = np.concatenate([real, L(np.array([0.0, np.pi / loop.dt]))])
    real = real[(real.real < 0.0) & (np.abs(real) < _BEYOND) & (np.abs(real.imag) < _AT * np.abs(real.real))]
    unit = _crossings(L, lambda x: np.abs(x) - 1.0, pencil_crossings(*loop), near, np.pi / loop.dt)
    unit = unit[np.abs(np.abs(unit) - 1.0) < _AT]
    gain = float(np.exp(np.abs(np.log(-real.real)).min(initial=np.inf)))
    return gain, float((np.pi - np.abs(np.angle(unit))).min(initial=np.inf))


def _crossings(
    L: Callable[[FloatArray], ComplexArray],
    of: Callable[[ComplexArray], FloatArray],
    known: FloatArray,
    near: FloatArray,
    nyquist: float,
) -> ComplexArray:
    """Return L where a function of it changes its sign, and at `known` frequencies, rad/s.

    It is followed between `near` and the middles of what is known, in which each crossing stands alone.
    """
    low = _FIRST * near[near > _ZERO * nyquist].min(initial=nyquist)
    w = np.unique(np.concatenate([known, near, np.geomspace(low, nyquist, _GRID)]))
    w = w[(w >= low) & (w < nyquist)]
    w = np.unique(np.concatenate([0.5 * (w[1:] + w[:-1]), w]))
    signs = np.sign(of(L(w)))
    at = np.flatnonzero(signs[1:] * signs[:-1] < 0.0)
    low_ends, high_ends = w[at], w[at + 1]
    every = np.arange(len(at))
    for _ in range(_CUTS if len(at) else 0):
        points = low_ends[:, None] + (high_ends - low_ends)[:, None] * np.linspace(0.0, 1.0, _PARTS + 1)
        same = np.sign(of(L(points.ravel()))).reshape(points.shape) == signs[at, None]
        last = np.clip(_PARTS - np.argmax(same[:, ::-1], axis=1), 0, _PARTS - 1)
        low_ends, high_ends = points[every, last], points[every, last + 1]
    return L(np.concatenate([known, low_ends]))


def _real_frequencies(L: System) -> FloatArray:
    """Return frequencies, rad/s, that contain all where L(z) = L(1/z): z E v = F v with v = [x, adjoint, u]."""
    from scipy.linalg import eigvals

    A, B, C, _, dt = L
    n = len(A)
    E, F = np.zeros((2 * n + 1, 2 * n + 1)), np.zeros((2 * n + 1, 2 * n + 1))
    E[:n, :n], E[n : 2 * n, n : 2 * n], E[n : 2 * n, 2 * n :] = np.eye(n), A.T, C.T
    F[:n, :n], F[:n, 2 * n :], F[n : 2 * n, n : 2 * n] = A, B, np.eye(n)
    F[2 * n :, :n], F[2 * n :, n : 2 * n] = C, -B.T
    with np.errstate(all="ignore"):
        z: ComplexArray = np.asarray(eigvals(F, E), dtype=np.complex128)
    angles = np.angle(z[np.isfinite(z)])
    return np.asarray(angles[angles > 0.0] / dt)


# Band about the final value that a response has to stay in.
SETTLED = 0.02
# Decay times of the slowest pole over which a response is followed; samples after which every second one is left out.
_DECAYS, _SAMPLES = 12.0, 2**14
_NO_INSTANTS = np.zeros(0)
# Time after which the noise of a loop that drifts counts, s: a random walk has no rms.
DRIFT_TIME = 3600.0
# An error below this share of a step is rounding.
_NO_ERROR = 1e-8


# Returns a value of each channel, (p,), of a loop from commands to what is measured.
Measure = Callable[[System], FloatArray]


def of_following(function: Measure) -> Callable[[Loop, Request], FloatArray]:
    """Return the measure of the worst channel of each plant; infinite of an unstable loop."""
    return _worst(lambda loops, k: function(loops.settled(loops.following.at(k).part(slice(loops.p), slice(None)))))


def of_steps(which: int) -> Callable[[Loop, Request], FloatArray]:
    """Return the same of the overshoot (0) or the settling time (1): steps are computed once for both."""

    def measured(loops: Loop, k: int) -> FloatArray:
        if k not in loops.of_steps:
            time, steps = step_responses(
                loops.settled(loops.following.at(k)), float(loops.decay[k]), loops.plants.between
            )
            loops.of_steps[k] = overshoot(time, steps), settling_time(time, steps)
        return loops.of_steps[k][which]

    return _worst(measured)


def _worst(measured: Callable[[Loop, int], FloatArray]) -> Callable[[Loop, Request], FloatArray]:
    def worst(loops: Loop, request: Request) -> FloatArray:
        out = np.full(len(loops.plants.labels), np.inf)
        for k in np.flatnonzero(loops.decay > 0.0):
            out[k] = float(measured(loops, int(k)).max(initial=0.0))
        return out

    return worst


def overshoot(time: FloatArray, steps: FloatArray) -> FloatArray:
    """Return by how much the step response of each channel exceeds its step, relative: between samples by parabolas."""
    out = []
    for one in steps:
        k = int(np.clip(one.argmax(), 1, len(one) - 2))
        x, y = time[k - 1 : k + 2] - time[k], one[k - 1 : k + 2]
        bend, slope, _ = np.polyfit(x, y, 2)
        top = -0.5 * slope / bend if bend < 0.0 else np.inf
        out.append(max(float(y.max()), float(y[1] + 0.5 * slope * top) if x[0] < top < x[2] else 0.0))
    return np.maximum(np.array(out) - 1.0, 0.0)


def settling_time(time: FloatArray, steps: FloatArray) -> FloatArray:
    """Return after which time each channel's step response stays within 2 % of the step, s; infinite: never."""
    error = np.abs(steps - 1.0)
    outside = error > SETTLED
    last = outside.shape[1] - 1 - np.argmax(outside[:, ::-1], axis=1)
    out = []
    for one, i, moved in zip(error, last, np.any(outside, axis=1), strict=True):
        if not moved:
            out.append(0.0)
        elif i == len(time) - 1:
            out.append(np.inf)
        else:
            share = (one[i] - SETTLED) / (one[i] - one[i + 1])
            out.append(float(time[i] + share * (time[i + 1] - time[i])))
    return np.array(out)


def steady_error(loop: System) -> FloatArray:
    """Return the error of each channel that a step leaves, relative."""
    A, B, C, D, _ = loop
    left = np.abs(1.0 - np.diag(D + C @ _solved(A, B)))
    return np.where(left > _NO_ERROR, left, 0.0)


def ramp_error(loop: System) -> FloatArray:
    """Return the error of each channel behind a ramp, over its slope, s; infinite where it grows."""
    A, B, C, _, dt = loop
    # With y = G(z) r the error behind r = k dt tends to dt G'(1), G' = −C (zI − A)⁻² B, where G(1) = 1.
    behind = dt * np.abs(np.diag(C @ _solved(A, _solved(A, B))))
    return np.where(steady_error(loop) > 0.0, np.inf, behind)


def _solved(A: FloatArray, B: FloatArray) -> FloatArray:
    """Return (I − A)⁻¹ B, in balanced states."""
    s = state_scaling(A, B, np.zeros((0, len(A))))
    return np.asarray(np.linalg.solve(np.eye(len(A)) - A * s / s[:, None], B / s[:, None]) * s[:, None])


def step_responses(loop: System, decay: float, between: FloatArray = _NO_INSTANTS) -> tuple[FloatArray, FloatArray]:
    """Return the times (N,), s, and the response (p, N) of each channel to a step of its own reference.

    `decay`: of the slowest pole, 1/s. The loop's outputs are p signals at the samples, then, if there are some, at
    instants `between` (k,), s, after them; the first of these is the sample itself.
    """
    count, p, dt = max(math.ceil(_DECAYS / (decay * loop.dt)), 100), loop.B.shape[-1], loop.dt
    times, out = [], list[list[FloatArray]]([[] for _ in range(p)])
    first, stride = 0, 1
    while True:
        k = np.arange(min(math.ceil(count / stride), _SAMPLES))
        times.append(stride * dt * k[first:])
        for i in range(p):
            rows = [i] if not len(between) else [p + j * p + i for j in range(len(between))]
            one = loop.part(rows, [i])._replace(dt=1.0)
            out[i].append(time_response(one, k, np.ones((1, len(k))), squeeze=False).T[first:].ravel())
        if stride * _SAMPLES >= count:
            break
        # The same response at every second of these samples, on from where they end.
        loop = loop._replace(A=loop.A @ loop.A, B=loop.A @ loop.B + loop.B)
        first, stride = _SAMPLES // 2, 2 * stride
    time = np.add.outer(np.concatenate(times), between if len(between) else np.zeros(1)).ravel()
    return time, np.array([np.concatenate(one) for one in out])


def torque_noise(loops: Loop, plants: slice = slice(None)) -> FloatArray:
    """Return the rms of every torque from the noise of the sensors, N m, (k, m); infinite of an unstable loop."""
    m, everything = loops.m, slice(None)
    to_torque = loops.own_arrays.at(plants).part(slice(m), everything)
    out = _rms(loops, to_torque.part(everything, slice(m, None)), loops.plants.noise)
    fed = loops.plants.feedforward
    if fed is not None:
        out = np.hypot(out, _rms(loops, fed.noise_of_torques(to_torque), np.ones(len(fed.sensors))))
    return out


def _rms(loops: Loop, systems: System, rms: FloatArray) -> FloatArray:
    """Return the rms (k, m) of outputs from white samples, of a loop that drifts after an hour."""
    if not loops.plants.drifting:
        return noise_rms(systems, rms, allow_unstable=True)
    return np.array([drifting_rms(systems.at(k), rms, DRIFT_TIME) for k in range(len(systems.A))])


def of_margins(which: int) -> Callable[[Loop, Request], FloatArray]:
    """Return the measure of the gain margin, a factor (0), or of the phase margin, rad (1), of the worst channel."""

    def measured(loops: Loop, request: Request) -> FloatArray:
        out = np.full(len(loops.plants.labels), 1.0 - which)
        for k in np.flatnonzero(loops.decay > 0.0):
            alone = [loops.settled(loops.own_arrays.at(k).part([i], [i])) for i in range(loops.m)]
            out[k] = min(margins_of_channel(one._replace(D=one.D + 1.0))[which] for one in alone)
        return out

    return measured


def channel_h2_norm(loops: Loop, request: Request) -> FloatArray:
    """Return the H2 norm between the signals of the request's channel, of each plant."""
    part = loops.channel(request.channel)
    rms = noise_rms(part, np.ones(part.B.shape[-1]), allow_unstable=True)
    with np.errstate(over="ignore"):
        return np.asarray(np.sqrt(np.sum(rms * rms, axis=-1)), dtype=np.float64)
