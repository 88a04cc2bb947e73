"""A loop with torque limits, and its response sample by sample, with which statements about all manoeuvres compare."""

from __future__ import annotations

import math
from dataclasses import dataclass

import control
import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.antiwindup.loop import LimitedLoop, limited_loop

J, PERIOD, LIMIT, STOP = 2e-4, 5e-4, 0.25, 0.0087
LOAD = 0.15  # N m for each rad/s


def pid(crossover: float = 350.0) -> control.StateSpace:
    """A sampled PID for an inertia: torque −J (ωc² angle + ...), with integral action."""
    gain = -J * crossover**2 * np.array([[0.6, 0.12 / crossover, 2.0 * PERIOD * crossover]])
    # Integral, and the derivative behind a low-pass.
    pole = 0.4
    A = np.array([[1.0, 0.0], [0.0, pole]])
    B = np.array([[PERIOD * crossover**2], [1.0]])
    C = np.array([[gain[0, 1], -((1.0 - pole) ** 2) * gain[0, 2] / (PERIOD * crossover) ** 2]])
    D = np.array([[gain[0, 0] + (1.0 - pole) * gain[0, 2] / (PERIOD * crossover) ** 2]])
    return control.StateSpace(A, B, C, D, PERIOD, inputs=["angle"], outputs=["torque"])


def gimbal() -> control.StateSpace:
    return control.StateSpace(
        [[0.0, 1.0 / J], [0.0, 0.0]],
        [[0.0, 0.0], [1.0, LOAD]],
        [[1.0, 0.0]],
        [[0.0, 0.0]],
        inputs=["torque", "Omega"],
        outputs=["angle"],
    )


def loop(rise: float = 0.5) -> LimitedLoop:
    return limited_loop(gimbal(), pid(), "Omega", limits=LIMIT, stops=STOP, delay=0.5 * PERIOD, lag=2e-4, rise=rise)


@dataclass(frozen=True)
class LimitedResponse:
    """What a limited loop did: a row a sample.

    Attributes
    ----------
    t : (N,)
        s.
    Omega : (N,)
        rad/s.
    state : (N, n)
        η.
    command, torque : (N, m)
        Before and after the limits, N m.
    angle : (N, p)
        rad.
    """

    t: FloatArray
    Omega: FloatArray
    state: FloatArray
    command: FloatArray
    torque: FloatArray
    angle: FloatArray


def limited_response(
    loop: LimitedLoop,
    Omega: float,
    b: ArrayLike,
    *,
    gain: ArrayLike | None = None,
    start: ArrayLike | None = None,
) -> LimitedResponse:
    """Return the response to a manoeuvre b (N,), |b| <= 1, of the size `Omega`, rad/s.

    Parameters
    ----------
    loop
        The loop.
    Omega
        Largest rate, rad/s; `loop.jerk` times it is one unit of b.
    b : (N,)
        Filtered acceleration, held between the samples.
    gain : (n_K, m), optional
        Anti-windup gain E; default none.
    start : (n,), optional
        η at the beginning; default rest.
    """
    wanted = np.asarray(b, dtype=np.float64)
    N, m = len(wanted), len(loop.controls)
    E = np.zeros((loop.R.shape[1], m)) if gain is None else np.asarray(gain, dtype=np.float64)
    correction = loop.B + loop.R @ E
    driven = Omega * loop.B_w[:, 0]
    # Ω⁺ = Ω + ∫Ω' dt, exactly: the filter's state falls towards b.
    decay = float(loop.A[-1, -1])
    h, rho = loop.period, loop.corner
    state, rate = np.zeros((N + 1, len(loop.A))), np.empty(N + 1)
    command = np.empty((N, m))
    state[0] = 0.0 if start is None else np.asarray(start, dtype=np.float64)
    rate[0] = 0.0
    for k in range(N):
        command[k] = loop.u_steady * rate[k] + loop.K @ state[k]
        excess = command[k] - np.clip(command[k], -loop.limits, loop.limits)
        state[k + 1] = loop.A @ state[k] - correction @ excess + driven * wanted[k]
        settled = Omega * loop.jerk * wanted[k]
        rate[k + 1] = rate[k] + settled * h + (state[k, -1] - settled) * (1.0 - decay) / rho
    return LimitedResponse(
        t=h * np.arange(N, dtype=np.float64),
        Omega=rate[:N],
        state=state[:N],
        command=command,
        torque=np.clip(command, -loop.limits, loop.limits),
        angle=rate[:N, None] * loop.angle_steady + state[:N] @ loop.C.T,
    )


def half_cosine(loop: LimitedLoop, hold: float, after: float) -> FloatArray:
    """Return b of a rise in `loop.rise` seconds, `hold` seconds at the full rate, the fall, `after` seconds at rest."""
    edges = np.cumsum([loop.rise, hold, loop.rise, after])
    t = (np.arange(math.ceil(edges[-1] / loop.period)) + 0.5) * loop.period
    turn = math.pi / loop.rise
    out = np.zeros(len(t))
    for start, sign in ((0.0, 1.0), (edges[1], -1.0)):
        inside = (t >= start) & (t < start + loop.rise)
        phase = turn * (t[inside] - start)
        out[inside] = sign * 0.5 * turn * (np.sin(phase) + turn / loop.corner * np.cos(phase))
    return out / loop.jerk
