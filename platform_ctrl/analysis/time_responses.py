"""Responses over time, exact for inputs that are held or linear between the samples."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.analysis.response import StateSystem, is_rational, linear_arrays
from platform_ctrl.analysis.system import System, all_finite, state_scaling
from platform_ctrl.common.arguments import one_of, real_numbers
from platform_ctrl.common.values import FloatArray
from platform_ctrl.errors import ArgumentError

Hold = Literal["zoh", "foh"]

# Steps that differ by less than this are equal: of the step, and of the times, which are rounded.
EQUAL, ROUNDING = 1e-9, 1e-15


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
    if u.shape != (B.shape[1], times.size) or not all_finite(u):
        raise ArgumentError(
            f"time_response: inputs must be finite, ({B.shape[1]}, {times.size}), got shape {np.shape(inputs)}"
        )
    if initial_state is not None and is_rational(system):
        raise ArgumentError(
            "time_response: initial_state: a transfer function has no states of its own; convert it first"
        )
    x0 = np.zeros(len(A)) if initial_state is None else real_numbers("time_response: initial_state", initial_state)
    if x0.shape != (len(A),) or not all_finite(x0):
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
    # In balanced states none is lost in a product beside larger ones.
    s = state_scaling(A, B, C)
    A, B, C, x0 = A * s / s[:, None], B / s[:, None], C * s, x0 / s
    if dt > 0.0:
        return _at_samples(A, B, C, D, u, x0)
    transition, now, next_ = step_matrices(A, B, step, hold)
    # x - next_ u in place of x: its next value needs no input but the present one.
    return _at_samples(transition, now + transition @ next_, C, D + C @ next_, u, x0 - next_ @ u[:, 0])


def _times(timepts: ArrayLike, dt: float) -> tuple[FloatArray, float]:
    """Return the times and the step between them."""
    times = real_numbers("time_response: timepts", timepts)
    if times.ndim != 1 or times.size < 2 or not all_finite(times):
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


def step_matrices(A: FloatArray, B: FloatArray, step: float, hold: Hold) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return Phi, E0 and E1 of x[k+1] = Phi x[k] + E0 u[k] + E1 u[k+1] for balanced A.

    The inputs are states of the exponential's matrix, and with ``"foh"`` their rise during the step as well.
    """
    from scipy.linalg import expm

    n, m = B.shape
    # A power of two that makes the input matrix as large as A is exact to undo.
    size, gain = np.abs(A).max(initial=0.0), np.abs(B).max(initial=0.0)
    unit = 2.0 ** round(math.log2(gain / size)) if size > 0.0 and gain > 0.0 else 1.0
    whole = np.zeros((n + 2 * m, n + 2 * m))
    whole[:n, :n], whole[:n, n : n + m] = A * step, B / unit * step
    if hold == "foh":
        whole[n : n + m, n + m :] = np.eye(m)
    power = unit * expm(whole)
    held, rise = power[:n, n : n + m], power[:n, n + m :]
    return power[:n, :n] / unit, held - rise, rise


def _at_samples(
    A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, u: FloatArray, x0: FloatArray
) -> FloatArray:
    """Return y[k] = C x[k] + D u[k] with x[k+1] = A x[k] + B u[k], (p, N)."""
    from platform_ctrl.analysis.recurrence import states

    x = np.empty((u.shape[1], len(A)))
    x[0] = x0
    x[1:] = (B @ u[:, :-1]).T
    states(np.ascontiguousarray(A.T), x)
    return C @ x.T + D @ u
