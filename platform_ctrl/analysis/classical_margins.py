"""Gain and phase margins of a sampled loop, one channel broken at the plant's input and all others closed.

With S_i, the entry (i, i) of the sensitivity at the input, the loop transfer of channel i is L_i = 1/S_i − 1. On the
unit circle L(1/z) is the conjugate of L(z), so that L is real where L(z) − L(1/z) has a zero and |L| = 1 where
L(z) L(1/z) − 1 has one: generalised eigenvalues, which no grid of frequencies can miss.
"""

from __future__ import annotations

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray, StateArrays
from platform_ctrl.analysis.response import frequency_response
from platform_ctrl.common.values import FloatArray

# Distance from the unit circle within which an eigenvalue may lie on it; L itself tells which does.
_ON_CIRCLE = 1e-4
# Distance from 0 and from the Nyquist frequency, where L is real, relative to the latter: L has poles there.
_END = 1e-8
# How far |L| may be from 1, and its angle from ±180°, at such a frequency, relative.
_AT = 1e-3


def margins_of_channel(sensitivity: StateArrays) -> tuple[float, float]:
    """Return the gain margin, a factor > 1, and the phase margin, rad, of a stable sampled loop, from its S_i.

    The gain margin is the least factor by which the gain may be raised or lowered, infinite where none ends stability.
    """
    L = _loop_transfer(sensitivity)
    gain = phase = np.inf
    w = _frequencies(_real_pencil(L), L.dt)
    values = frequency_response(L, w)[0, 0] if w.size else np.zeros(0, dtype=np.complex128)
    real = (values.real < 0.0) & (np.abs(values.imag) < _AT * np.abs(values.real))
    if real.any():
        gain = float(np.exp(np.abs(np.log(-values.real[real])).min()))
    w = _frequencies(_unit_pencil(L), L.dt)
    values = frequency_response(L, w)[0, 0] if w.size else np.zeros(0, dtype=np.complex128)
    unit = np.abs(np.abs(values) - 1.0) < _AT
    if unit.any():
        phase = float((np.pi - np.abs(np.angle(values[unit]))).min())
    return gain, phase


def _loop_transfer(S: StateArrays) -> StateArrays:
    """Return 1/S − 1."""
    A, B, C, D, dt = S
    inverse = 1.0 / D[0, 0]
    return StateArrays(A - inverse * (B @ C), inverse * B, -inverse * C, np.array([[inverse - 1.0]]), dt)


def _real_pencil(L: StateArrays) -> tuple[FloatArray, FloatArray]:
    """Return F, E with z E v = F v where L(z) = L(1/z); v = [x, adjoint, u]."""
    A, B, C, _, _ = L
    n = len(A)
    E, F = np.zeros((2 * n + 1, 2 * n + 1)), np.zeros((2 * n + 1, 2 * n + 1))
    E[:n, :n], E[n : 2 * n, n : 2 * n], E[n : 2 * n, 2 * n :] = np.eye(n), A.T, C.T
    F[:n, :n], F[:n, 2 * n :], F[n : 2 * n, n : 2 * n] = A, B, np.eye(n)
    F[2 * n :, :n], F[2 * n :, n : 2 * n] = C, -B.T
    return F, E


def _unit_pencil(L: StateArrays) -> tuple[FloatArray, FloatArray]:
    """Return F, E with z E v = F v where L(z) L(1/z) = 1; v = [x, adjoint, u]."""
    A, B, C, D, _ = L
    n, d = len(A), D[0, 0]
    E, F = np.zeros((2 * n + 1, 2 * n + 1)), np.zeros((2 * n + 1, 2 * n + 1))
    E[:n, :n] = np.eye(n)
    E[n : 2 * n, :n], E[n : 2 * n, n : 2 * n], E[n : 2 * n, 2 * n :] = C.T @ C, A.T, d * C.T
    F[:n, :n], F[:n, 2 * n :], F[n : 2 * n, n : 2 * n] = A, B, np.eye(n)
    F[2 * n :, :n], F[2 * n :, n : 2 * n], F[2 * n :, 2 * n :] = d * C, B.T, d * d - 1.0
    return F, E


def _frequencies(pencil: tuple[FloatArray, FloatArray], period: float) -> FloatArray:
    """Return the frequencies, rad/s, of the eigenvalues on the unit circle, and almost 0 and almost Nyquist's."""
    from scipy.linalg import eigvals

    with np.errstate(all="ignore"):
        z: ComplexArray = np.asarray(eigvals(*pencil), dtype=np.complex128)
        z = z[np.isfinite(z)]
        near = z[np.abs(np.abs(z) - 1.0) < _ON_CIRCLE]
    angles = np.angle(near)
    inside = angles[(angles > 0.0) & (angles < np.pi)]
    return np.concatenate([inside, [_END * np.pi, (1.0 - _END) * np.pi]]) / period
