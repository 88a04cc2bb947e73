"""The part of a dry friction's torque that is not in proportion to the rate, as a noise with a spectrum.

A memoryless torque f(v) of a stationary Gaussian rate v is b v + r with r uncorrelated with v at all lags (Bussgang,
1952). In Hermite polynomials f(σ x) = Σ c_n He_n(x)/√n! the correlation of f is Σ c_n² ρ(τ)^n with ρ that of v (Price,
IRE Trans. Information Theory 4, 1958), and r has the terms but n = 0 and 1: for a sign, (2/π) F² (asin ρ − ρ). In a
loop r acts like a torque from outside.
"""

from __future__ import annotations

import math

import numpy as np

from platform_ctrl.analysis.disturbances import Spectrum
from platform_ctrl.common.values import FloatArray
from platform_ctrl.plant.force_elements import Friction

# Terms of the series that are computed. Of a step they fall with n to the power -3/2: what is left goes, in that
# proportion, to groups of terms whose ends grow by a factor.
_TERMS, _GROWTH, _GROUPS = 60, 1.6, 16
# Points of the correlation, and points to an octave of the result.
_POINTS, _PER_OCTAVE = 2**16, 6
# Highest frequency, in that below which the rate has 99 % of its variance.
_BEYOND = 32.0
# The series is summed in this many σ, on so many points.
_FAR, _QUADRATURE = 9.0, 4001


def friction_noise(
    friction: Friction, rms: float, edges: FloatArray, cumulative: FloatArray, lowest: float
) -> Spectrum | None:
    """Return the spectrum of the remainder of a dry friction, (N m)²/Hz; None where nothing moves.

    Parameters
    ----------
    friction
        Its viscous part does not count.
    rms
        Of the rate, rad/s.
    edges : (k,)
        Frequencies, rad/s, rising.
    cumulative : (k,)
        Variance of the rate up to these, (rad/s)².
    lowest
        Below this frequency, rad/s, the result is left out.

    Returns
    -------
    Spectrum
        Smooth.

    References
    ----------
    J. J. Bussgang, MIT RLE Report 216, 1952.

    R. Price, IRE Transactions on Information Theory 4, 1958.
    """
    from scipy.interpolate import PchipInterpolator

    total = float(cumulative[-1])
    if not (rms > 0.0 and total > 0.0):
        return None
    # Harmonics of the rate reach well beyond it.
    high = _BEYOND * float(edges[np.searchsorted(cumulative, 0.99 * total)])
    step, count = high / _POINTS, 2 * _POINTS
    grid = step * np.arange(_POINTS + 1)
    bins = np.diff(np.interp(grid, edges, cumulative), prepend=0.0)
    # Correlations are even: the first half has all of it.
    half = slice(0, _POINTS + 1)
    rho = np.clip(np.fft.irfft(0.5 * count * bins, count)[half] / float(bins.sum()), -1.0, 1.0)
    squares, rest = _hermite_squares(friction, rms)
    correlation, power = np.zeros_like(rho), rho.copy()
    for square in squares:
        power = power * rho
        if square > 1e-20 * sum(squares):
            correlation += square * power
    ends = _TERMS * _GROWTH ** np.arange(_GROUPS + 1)
    weights = ends[:-1] ** -0.5 - ends[1:] ** -0.5
    weights[-1] = ends[-2] ** -0.5
    # High powers of small correlations are none.
    large = np.flatnonzero(np.abs(rho) > 0.5)
    sign, logarithm = np.sign(rho[large]), np.log(np.abs(rho[large]))
    for n, weight in zip(np.sqrt(ends[1:] * ends[:-1]), weights / weights.sum(), strict=True):
        correlation[large] += rest * weight * sign * np.exp(n * logarithm)
    # One-sided variance of each bin; all together are the remainder's.
    share = np.maximum(np.fft.irfft(correlation, count)[half], 0.0) * 2.0
    sums = np.concatenate([[0.0], np.cumsum(share)])
    first = max(lowest, 2.0 * step)
    knots = first * 2.0 ** (np.arange(math.ceil(_PER_OCTAVE * math.log2(high / first)) + 1) / _PER_OCTAVE)
    within = np.interp(knots, np.append(grid, high + step), sums)
    level = np.diff(within) / (np.diff(knots) / (2.0 * math.pi))
    # In the middle of each interval; a smooth curve on logarithmic scales.
    middle: FloatArray = np.concatenate([knots[:1], np.sqrt(knots[1:-2] * knots[2:-1]), knots[-1:]])
    law = PchipInterpolator(np.log(middle), np.log(np.maximum(level, 1e-12 * level.max())))
    # The curve is smooth: integrals need no panel for each point.
    octaves = np.array([*middle[:-1:_PER_OCTAVE], middle[-1]], dtype=np.float64)
    return Spectrum(knots=octaves, density=lambda w: np.exp(law(np.log(w))))


def _hermite_squares(friction: Friction, rms: float) -> tuple[list[float], float]:
    """Return the squares of the coefficients n = 2, 3, ..., and what they leave of the variance."""
    # Midpoints, dense where the torque turns about: the middle of the smoothing lies at zero.
    near = min(friction.coulomb_rate / rms, 1.0)
    s = np.linspace(-1.0, 1.0, _QUADRATURE)
    bend = math.asinh(_FAR / near)
    x = near * np.sinh(bend * s)
    weight = near * bend * np.cosh(bend * s) * (s[1] - s[0]) * np.exp(-0.5 * x * x) / math.sqrt(2.0 * math.pi)
    f = np.array([friction.dry(float(rms * one)) for one in x])
    before, now = np.ones_like(x), x
    left = float(weight @ f**2) - float(weight @ f) ** 2 - float(weight @ (f * x)) ** 2
    squares = []
    for n in range(2, _TERMS + 1):
        before, now = now, (x * now - math.sqrt(n - 1.0) * before) / math.sqrt(n)
        squares.append(float(weight @ (f * now)) ** 2)
        left -= squares[-1]
    return squares, max(left, 0.0)
