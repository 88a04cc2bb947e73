"""The PID controllers u = K y with one gain matrix for each action, continuous or sampled.

    K = Kp + Ki / s + Kd s / (filter_time s + 1)

Sampled by Tustin's rule, s = (2/T) (z − 1)/(z + 1); responses are then taken at z = exp(jωT), exactly. All channels
of one pick-off share their integrator and their filter.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.analysis.arrays import ComplexArray, StateArrays
from platform_ctrl.analysis.sampling import from_w_plane
from platform_ctrl.common.arguments import one_of
from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.fixed_structure.pid import PID
from platform_ctrl.errors import ArgumentError

Pattern = Literal["full", "diagonal", "cross-axis"]


def basis(s: ComplexArray, filter_time: float, period: float) -> ComplexArray:
    """Return the responses of the three actions at points s, complex (N, 3)."""
    p = s
    if period > 0.0:
        # Half the sample rate itself is infinity in Tustin's plane: kept a little below.
        half = 0.5 * s * period
        near = half.real + 1j * np.minimum(half.imag, 0.5 * np.pi * (1.0 - 1e-9))
        p = np.asarray(2.0 / period * np.tanh(near), dtype=np.complex128)
    return np.stack([np.ones_like(p), 1.0 / p, p / (filter_time * p + 1.0)], axis=-1)


def controller_response(gains: FloatArray, actions: ComplexArray) -> ComplexArray:
    """Return K, complex (N, n, n), from `gains` (3, n, n) and the responses of the actions (N, 3)."""
    return np.asarray(np.einsum("kb,bij->kij", actions, gains), dtype=np.complex128)


def realisation(gains: FloatArray, filter_time: float, period: float) -> StateArrays:
    """Return the controller's state-space arrays: two states for each pick-off."""
    n = gains.shape[-1]
    # The gains and the bandwidth of each pick-off's filter, as `PID` orders its parameters.
    parameters = np.append(gains, np.full(n, 1.0 / filter_time))
    K = PID(filter_order=1, filtered="derivative").block(parameters, n, n)
    return K if period == 0.0 else from_w_plane(K, period)


def masks(pattern: Pattern | ArrayLike, n: int) -> FloatArray:
    """Return which gains are free, (3, n, n) of zeros and ones.

    ``"cross-axis"`` is that of a caged gyro: integral action across, rate action along, proportional action in both.
    """
    eye, full = np.eye(n), np.ones((n, n))
    if isinstance(pattern, str):
        one_of("measured_pid: pattern", pattern, ("full", "diagonal", "cross-axis"))
        if pattern == "cross-axis" and n != 2:
            raise ArgumentError(f"measured_pid: pattern 'cross-axis' needs two angles, got {n}; give zeros and ones")
        chosen: dict[str, tuple[FloatArray, FloatArray, FloatArray]] = {
            "full": (full, full, full),
            "diagonal": (eye, eye, eye),
            "cross-axis": (full, full - eye, eye),
        }
        return np.array(chosen[pattern])
    given = np.asarray(pattern)
    if (
        given.shape not in ((n, n), (3, n, n))
        or given.dtype.kind not in "biuf"
        or not np.all((given == 0) | (given == 1))
    ):
        raise ArgumentError(
            "measured_pid: pattern must be 'full', 'diagonal', 'cross-axis', or zeros and ones of shape "
            f"({n}, {n}) or (3, {n}, {n}), got an array of shape {given.shape}"
        )
    out = np.broadcast_to(given.astype(np.float64), (3, n, n)).copy()
    random = out[1] * np.random.default_rng(0).uniform(1.0, 2.0, (n, n))
    if np.linalg.matrix_rank(random) < n:
        raise ArgumentError(
            "measured_pid: pattern makes the integral gain singular; free integral action on every angle"
        )
    return out
