"""Responses over time, exact for inputs that are held or linear between the samples, and what steps show of a loop.

Overshoot, settling and errors behind commands are of the samples.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.analysis.response import StateSystem, is_rational, linear_arrays
from platform_ctrl.analysis.sampling import input_steps
from platform_ctrl.analysis.system import System, state_scaling
from platform_ctrl.common.arguments import one_of, real_numbers
from platform_ctrl.common.values import FloatArray
from platform_ctrl.errors import ArgumentError

Hold = Literal["zoh", "foh"]

# Steps that differ by less than this are equal: of the step, and of the times, which are rounded.
EQUAL, ROUNDING = 1e-9, 1e-15

# Band about the final value that a response has to stay in.
SETTLED = 0.02
# Decay times of the slowest pole over which a response is followed; samples after which every second one is left out.
_DECAYS, _SAMPLES = 12.0, 2**14
_NO_INSTANTS = np.zeros(0)
# An error below this share of a step is rounding.
_NO_ERROR = 1e-8


def time_response(
    system: StateSystem,
    timepts: ArrayLike,
    inputs: ArrayLike,
    hold: Hold = "foh",
    initial_state: ArrayLike | None = None,
    squeeze: bool | None = None,
) -> FloatArray:
    """Return the outputs at `timepts`, as `control.forced_response`: exact to rounding for inputs linear between them.

    Rounding is that of exp(A h) for steps h, about 1e-15 (1 + |A| h) of the largest output, |A| in balanced states.

    Parameters
    ----------
    system
        Continuous, or discrete with the sample period that `timepts` have. A transfer function gets states of its own.
    timepts : (N,)
        Increasing times, s, with equal steps: those of a discrete system are its sample period.
    inputs : (m, N), or (N,) for one input
        Inputs at those times, in the system's units.
    hold
        ``"foh"``: linear between samples; ``"zoh"``: held from each sample to the next. Without meaning for a discrete
        system, whose inputs are samples.
    initial_state : (n,), optional
        State at the first time, in the system's units; default zero. Not of a transfer function.
    squeeze
        As in python-control. None: as ``control.squeeze_time_response`` of its configuration says, which by default
        is None there, too: one input and one output give (N,); True: axes of length one are left out; False:
        always (p, N).

    Returns
    -------
    (p, N), or (N,)
        In the units of the outputs; see `squeeze`.

    Raises
    ------
    ArgumentError
        If shapes do not fit, times do not increase in equal steps, those of a discrete system's sample period, or the
        system is improper or data.
    """
    A, B, C, D, dt = linear_arrays(system, "time_response")
    times, step = _times(timepts, dt)
    u = real_numbers("time_response: inputs", inputs)
    u = u[None, :] if u.ndim == 1 else u
    if u.shape != (B.shape[1], times.size) or not np.isfinite(u).all():
        raise ArgumentError(
            f"time_response: inputs must be finite, ({B.shape[1]}, {times.size}), got shape {np.shape(inputs)}"
        )
    if initial_state is not None and is_rational(system):
        raise ArgumentError(
            "time_response: initial_state: a transfer function has no states of its own; convert it first"
        )
    x0 = np.zeros(len(A)) if initial_state is None else real_numbers("time_response: initial_state", initial_state)
    if x0.shape != (len(A),) or not np.isfinite(x0).all():
        raise ArgumentError(f"time_response: initial_state must be finite, ({len(A)},), got shape {x0.shape}")
    one_of("time_response: hold", hold, ("foh", "zoh"))
    if not (squeeze is None or isinstance(squeeze, bool)):
        raise ArgumentError(f"time_response: squeeze must be None, True or False, got {squeeze!r}")
    y = _outputs(System(A, B, C, D, dt), step, u, x0, hold)
    if squeeze is None:
        # As there; a system is one of python-control's, which is loaded then.
        import control

        squeeze = control.config.defaults["control.squeeze_time_response"]
    if squeeze:
        return np.squeeze(y)
    return y[0] if squeeze is None and D.shape == (1, 1) else y


def _outputs(system: System, step: float, u: FloatArray, x0: FloatArray, hold: Hold) -> FloatArray:
    A, B, C, D, dt = system
    if not len(A):
        return np.asarray(D @ u)
    # In balanced states no small state is lost beside large ones.
    s = state_scaling(A, B, C)
    A, B, C, x0 = A * s / s[:, None], B / s[:, None], C * s, x0 / s
    if dt > 0.0:
        return _at_samples(A, B, C, D, u, x0)
    transition, driven = input_steps(A, B, step, ramp=hold == "foh")
    if hold == "zoh":
        return _at_samples(transition, driven, C, D, u, x0)
    held, rise = driven[:, : len(u)], driven[:, len(u) :]
    # x - rise u in place of x: its next value needs no input but the present one.
    return _at_samples(transition, held - rise + transition @ rise, C, D + C @ rise, u, x0 - rise @ u[:, 0])


def _times(timepts: ArrayLike, dt: float) -> tuple[FloatArray, float]:
    """Return the times and the step between them."""
    times = real_numbers("time_response: timepts", timepts)
    if times.ndim != 1 or times.size < 2 or not np.isfinite(times).all():
        raise ArgumentError(f"time_response: timepts must be at least two finite times, got shape {times.shape}")
    steps = times[1:] - times[:-1]
    if steps.min() <= 0.0:
        raise ArgumentError("time_response: timepts must increase")
    step = float(times[-1] - times[0]) / steps.size
    uneven = steps.max() - steps.min() > EQUAL * step + ROUNDING * max(abs(times[0]), abs(times[-1]))
    if np.abs(steps - dt).max() > 1e-6 * dt if dt > 0.0 else uneven:
        own = f" of the system's dt = {dt:g} s" if dt else ""
        raise ArgumentError(
            f"time_response: timepts must have equal steps{own}, got steps of {steps.min():g} to {steps.max():g} s"
        )
    return times, step


def _at_samples(
    A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, u: FloatArray, x0: FloatArray
) -> FloatArray:
    """Return y[k] = C x[k] + D u[k] with x[k+1] = A x[k] + B u[k], (p, N)."""
    x = np.empty((u.shape[1], len(A)))
    x[0], x[1:] = x0, (B @ u[:, :-1]).T
    _compiled_recurrence()(np.ascontiguousarray(A), x)
    return C @ x.T + D @ u


@cache
def _compiled_recurrence() -> Callable[[FloatArray, FloatArray], None]:
    """Return the recurrence of states, compiled: blocks of samples in NumPy take twice the time."""
    import numba

    @numba.njit(cache=True, fastmath={"contract", "reassoc"})  # type: ignore[untyped-decorator]
    def states(A: FloatArray, x: FloatArray) -> None:
        """Turn what drives each step, x[1:] (N - 1, n), into x[k+1] = A x[k] + x[k+1]."""
        n = x.shape[1]
        for k in range(1, len(x)):
            for i in range(n):
                total = x[k, i]
                for j in range(n):
                    total += A[i, j] * x[k - 1, j]
                x[k, i] = total

    return states  # type: ignore[no-any-return]


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
