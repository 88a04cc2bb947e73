"""Bandwidth of a loop: the lowest frequency at which the largest singular value of S reaches 1/sqrt(2)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.analysis.feedback import At, closed_loop_with_sensitivity
from platform_ctrl.analysis.mu import search_grid
from platform_ctrl.analysis.norms import level_frequencies
from platform_ctrl.analysis.poles import continuous_poles, spectral_abscissa
from platform_ctrl.analysis.singular_values import FrequencyAxis, largest_singular_values
from platform_ctrl.analysis.system import ComplexArray, System
from platform_ctrl.common.values import FloatArray

if TYPE_CHECKING:
    import control

LEVEL = math.sqrt(0.5)
# Relative distance from the level up to which a gain is at it.
_ROUNDING = 1e-12
# Share of the highest frequency below which the response is rounding.
_ROUNDED = 1e-9


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
