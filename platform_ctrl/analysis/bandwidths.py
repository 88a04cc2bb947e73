"""Bandwidth of a loop: the lowest frequency at which the largest singular value of S reaches 1/sqrt(2)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray, StateArrays, frequencies, square_responses
from platform_ctrl.analysis.feedback import At, closed_loop_with_sensitivity
from platform_ctrl.analysis.poles import continuous_poles, resonances, spectral_abscissa
from platform_ctrl.analysis.singular_values import FrequencyAxis, largest_singular_values
from platform_ctrl.common.values import FloatArray
from platform_ctrl.errors import ArgumentError

if TYPE_CHECKING:
    import control

LEVEL = math.sqrt(0.5)


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


def bandwidth_of_sensitivity(S: StateArrays) -> float:
    """Return the bandwidth, as `bandwidth` does, of a loop with the sensitivity `S`."""
    from scipy.optimize import brentq

    axis = FrequencyAxis(S)
    s = continuous_poles(axis.poles(), S.dt)
    if S.A.shape[0] and spectral_abscissa(s) >= 0.0:
        return 0.0
    w = _grid(axis, s)

    sizes = axis.gains(w)
    above = np.flatnonzero(sizes >= LEVEL)
    if not above.size:
        return math.inf if S.dt == 0.0 else math.pi / S.dt
    first = int(above[0])
    if first == 0:
        return 0.0
    if sizes[first] <= LEVEL * (1.0 + 1e-12):
        return float(w[first])

    def beyond(x: float) -> float:
        return math.log(axis.gains(np.array([math.exp(x)]))[0] / LEVEL)

    low, high = math.log(w[first - 1]), math.log(w[first])
    # Where an end is a crossing itself, rounding decides on which side of it exp(log(w)) lies.
    for end, wrong in ((low, 1.0), (high, -1.0)):
        if wrong * beyond(end) >= 0.0:
            return math.exp(end)
    return math.exp(brentq(beyond, low, high, rtol=1e-12))


def _grid(axis: FrequencyAxis, s: ComplexArray) -> FloatArray:
    """Return frequencies fine enough that the first crossing lies between the first pair that differs in sign."""
    crossings = axis.crossings(LEVEL)
    own = np.concatenate([crossings, resonances(s)])
    own = own[own > 0.0]
    if own.size == 0:
        own = np.ones(1)
    low, high = 1e-3 * float(own.min()), 1e3 * float(own.max())
    # An integrator in the loop makes S as small as the frequency; below 1e-9 of the fastest pole rounding rules.
    low = max(low, 1e-9 * float(own.max()))
    if math.isfinite(axis.edge):
        high = axis.edge
        low = min(low, 1e-3 * high)
    decades = math.log10(high / low)
    grid = np.concatenate([own, np.geomspace(low, high, 2 + int(20 * decades))])
    grid = np.unique(grid[(grid >= low) & (grid <= high)])
    # Midpoints, so that a peak between two crossings shows.
    return np.unique(np.concatenate([grid, np.sqrt(grid[1:] * grid[:-1])]))


def bandwidth_of_response(frequency: FloatArray, S: ComplexArray) -> FloatArray:
    """Return the bandwidth, rad/s, from sensitivities (..., N, m, m) on a grid (N,), for a tuner: interpolated.

    The first frequency if S is that large there already, the last if it never gets there.
    """
    frequency = frequencies(frequency, "bandwidth_of_response")
    S = square_responses("bandwidth_of_response: S", S)
    if S.ndim < 3 or S.shape[-3] != frequency.size or frequency.size < 2:
        raise ArgumentError(
            f"bandwidth_of_response: S must be (..., {max(frequency.size, 2)}, m, m), a matrix for each frequency, "
            f"got {S.shape}"
        )
    if frequency[0] <= 0.0 or not (np.diff(frequency) > 0.0).all():
        raise ArgumentError("bandwidth_of_response: frequency must be above zero and rise")
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
