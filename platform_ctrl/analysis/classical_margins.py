"""Bandwidth, and gain and phase margins of a channel, all over all frequencies.

The bandwidth is the lowest frequency at which the largest singular value of S reaches 1/sqrt(2). Gain and phase margins
are of one channel broken at the plant's input, all others closed. With S_i, the entry (i, i) of the sensitivity at the
input, the loop transfer of channel i is L_i = 1/S_i − 1. On the unit circle L(1/z) is the conjugate of L(z), so that L
is real where L(z) − L(1/z) has a zero and |L| = 1 where L(z) L(1/z) − 1 has one: generalised eigenvalues. Next to
narrow resonances and to z = 1 rounding moves these; L changes its sign between points beside them, where it is followed
to the crossing.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.analysis.feedback import At, closed_loop_with_sensitivity, loop_of_sensitivity
from platform_ctrl.analysis.norms import level_frequencies
from platform_ctrl.analysis.poles import continuous_poles, poles, resonances, search_grid, spectral_abscissa
from platform_ctrl.analysis.response import frequency_response
from platform_ctrl.analysis.singular_values import FrequencyAxis, largest_singular_values, pencil_crossings
from platform_ctrl.analysis.system import ComplexArray, System
from platform_ctrl.common.values import FloatArray

if TYPE_CHECKING:
    import control

LEVEL = math.sqrt(0.5)
# Relative distance from the level up to which a gain is at it.
_ROUNDING = 1e-12
# Share of the highest frequency below which the response is rounding.
_ROUNDED = 1e-9

# Of margins: share of the slowest pole from which on L is followed, of Nyquist's below which a pole is one at 0; a gain
# like that of an integrator at 0.
_FIRST, _ZERO, _BEYOND = 1e-2, 1e-10, 1e8
# How far |L| may be from 1, and its angle from ±180°, at such a frequency, relative.
_AT = 1e-3
# Points of a grid beside the eigenvalues; parts into which an interval with a crossing is cut, and how often.
_GRID, _PARTS, _CUTS = 200, 16, 10


def bandwidth(plant: control.StateSpace, controller: control.StateSpace, at: At = "output") -> float:
    """Return the lowest frequency, rad/s, at which the largest singular value of S reaches 1/sqrt(2).

    Found among the crossings that the Hamiltonian of S shows, so that a narrow peak between grid points is not missed,
    and refined by root finding.

    Parameters
    ----------
    plant, controller
        Joined as u = K y (see `loop_transfer`).
    at
        Where S is taken: the plant's ``"input"`` or ``"output"``.

    Returns
    -------
    float
        rad/s. 0 if the closed loop is not stable or S is that large at the lowest frequencies already; the Nyquist
        frequency (infinity for a continuous loop) if S never gets there.

    References
    ----------
    S. Skogestad, I. Postlethwaite, Multivariable Feedback Control, 2005, ch. 2.

    S. Boyd, V. Balakrishnan, Systems & Control Letters 15, 1990.
    """
    return bandwidth_of_sensitivity(closed_loop_with_sensitivity(plant, controller, at))


def bandwidth_of_sensitivity(S: System, known: ComplexArray | None = None) -> float:
    """Return the bandwidth, as `bandwidth` does, of a loop with the sensitivity `S`, whose poles may be known."""
    from scipy.optimize import brentq

    axis = FrequencyAxis(S, known)
    s = continuous_poles(axis.poles(), S.dt)
    if S.A.shape[0] and spectral_abscissa(s) >= 0.0:
        return 0.0
    # Crossings, and frequencies between them: so fine that the first is in the first interval whose ends differ.
    w = np.union1d(search_grid(S, s), level_frequencies(axis, LEVEL))
    # An integrator in the loop makes S as small as the frequency; far below the fastest pole rounding rules.
    w = w[(w > _ROUNDED * w[np.isfinite(w)].max()) & (w <= axis.edge)]
    sizes = axis.gains(w)
    first = int(np.argmax(sizes >= LEVEL * (1.0 - _ROUNDING)))
    if sizes[first] < LEVEL * (1.0 - _ROUNDING):
        return axis.edge
    if first == 0:
        return 0.0
    if sizes[first] <= LEVEL * (1.0 + _ROUNDING):
        return float(w[first])
    return float(
        brentq(lambda x: axis.gains(np.array([x]))[0] - LEVEL, *w[first - 1 : first + 1], xtol=1e-300, rtol=1e-12)
    )


def bandwidth_of_response(frequency: FloatArray, S: ComplexArray) -> FloatArray:
    """Return the bandwidth, rad/s, from sensitivities (..., N, m, m) on a grid (N,), for a tuner: interpolated.

    The first frequency if S is that large there already, the last if it never gets there.
    """
    sizes = largest_singular_values(S) / LEVEL
    above = sizes >= 1.0
    first = np.argmax(above, axis=-1)
    never = ~np.any(above, axis=-1)
    right = np.clip(first, 1, None)
    y = np.log(np.maximum(sizes, np.finfo(float).tiny))
    y0 = np.take_along_axis(y, right[..., None] - 1, -1)[..., 0]
    y1 = np.take_along_axis(y, right[..., None], -1)[..., 0]
    x = np.log(frequency)
    share = np.where(first > 0, -y0 / np.where(y1 > y0, y1 - y0, 1.0), 0.0)
    out = np.exp(x[right - 1] + np.clip(share, 0.0, 1.0) * (x[right] - x[right - 1]))
    return np.asarray(np.where(never, frequency[-1], out), dtype=np.float64)


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

    The function is followed between `near` and the midpoints of known frequencies: each interval has one crossing.
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
