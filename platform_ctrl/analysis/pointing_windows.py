"""Pointing within an exposure: displacement, smear and jitter, and what they cost in contrast.

Over a window of length T a motion x(t) is split by least squares into its mean (displacement), a linear trend (smear)
and the rest (jitter). The parts are orthogonal. Of a component at the frequency ω, averaged over its phase, they hold
the shares, with a = ωT/2 and the spherical Bessel functions j_n,

    displacement j₀(a)²,        smear 3 j₁(a)²,        jitter Σ (2 n + 1) j_n(a)²,  n = 2, 3, ...,

the coefficients of exp(jωt) in Legendre polynomials; they add up to one. j₀(a) = sin(a)/a and 3 j₁(a)² = 3 (sin a −
a cos a)²/a⁴ are the weighting functions of the literature. Its jitter, one minus the other two, loses all digits for
short windows (the share is a⁴/45); the sum does not.

References
----------
S. W. Sirlin, A. M. San Martin, A new definition of pointing stability, JPL EM 343-1189, 1990.

R. L. Lucke, S. W. Sirlin, A. M. San Martin, New definitions of pointing stability: ac and dc effects, Journal of the
Astronautical Sciences 40, 1992.

M. E. Pittelkau, W. G. McKinley, Optical transfer functions, weighting functions, and metrics for images with
two-dimensional line-of-sight motion, Optical Engineering 55, 2016.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.common.arguments import positive, real_numbers
from platform_ctrl.common.values import FloatArray

# Below this a the jitter is summed; above it one minus the other two has lost less than a digit.
_SUMMED = 2.0
# Terms of the sum: the next one is below 1e-20 of the first.
_ORDERS = np.arange(2, 14)


class WindowShares(NamedTuple):
    """Shares of a component's mean square that are displacement, smear and jitter; each has the frequencies' shape."""

    displacement: FloatArray
    smear: FloatArray
    jitter: FloatArray


def window_shares(frequency: ArrayLike, exposure: float) -> WindowShares:
    """Return what of a component's mean square is displacement, smear and jitter in a window of length `exposure`, s.

    At frequencies in rad/s, of any shape; each share is right to rounding. The smear is the mean square of the fitted
    line about its middle: a line of extent E, end to end, has E²/12.
    """
    from scipy.special import spherical_jn

    a = (
        0.5
        * positive("window_shares: exposure", exposure)
        * np.abs(real_numbers("window_shares: frequency", frequency))
    )
    displacement, smear = spherical_jn(0, a) ** 2, 3.0 * spherical_jn(1, a) ** 2
    jitter = 1.0 - displacement - smear
    short = a < _SUMMED
    if np.any(short):
        orders = _ORDERS.reshape(-1, *(1,) * np.ndim(a[short]))
        jitter[short] = np.sum((2 * orders + 1) * spherical_jn(orders, a[short]) ** 2, axis=0)
    return WindowShares(displacement, smear, jitter)


def motion_transfer(spatial_frequency: ArrayLike, jitter: float, smear: float = 0.0) -> FloatArray:
    """Return the modulation transfer function of image motion along one axis; 1 at ν = 0.

    `spatial_frequency` ν is in cycles per radian, of any shape. Gaussian jitter of rms σ, rad: the factor exp(−2 π² σ²
    ν²). `smear` is the rms of the fitted line within the window, rad: its extent is Gaussian with the standard
    deviation √12 `smear`, and the mean factor over many exposures is E[sin(πνE)/(πνE)] = √(2π)/k erf(k/√8), k = 2 πν
    √12 `smear` (Pittelkau and McKinley, Optical Engineering 55, 2016).
    """
    from scipy.special import erf

    nu = np.abs(real_numbers("motion_transfer: spatial_frequency", spatial_frequency))
    k = 2.0 * math.pi * math.sqrt(12.0) * smear * nu
    # Below, the next term of 1 − k²/24 is under rounding.
    with np.errstate(divide="ignore", invalid="ignore"):
        drawn = np.where(k > 1e-4, math.sqrt(2.0 * math.pi) / k * erf(k / math.sqrt(8.0)), 1.0 - k * k / 24.0)
    return np.asarray(np.exp(-2.0 * (math.pi * jitter * nu) ** 2) * drawn)
