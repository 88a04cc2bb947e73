"""Disturbances of a sampled loop, the part of a motion that counts within an exposure, and the loop's budget.

Spectra, sines and noise of samples: frequencies in rad/s, densities one-sided per hertz. Over a window of length T a
motion x(t) is split by least squares into its mean (displacement), a linear trend (smear) and the rest (jitter). The
parts are orthogonal. Of a component at the frequency ω, averaged over its phase, they hold the shares, with a = ωT/2
and the spherical Bessel functions j_n,

    displacement j₀(a)²,        smear 3 j₁(a)²,        jitter Σ (2 n + 1) j_n(a)²,  n = 2, 3, ...,

the coefficients of exp(jωt) in Legendre polynomials; they add up to one. Its jitter, one minus the other two, loses all
digits for short windows (the share is a⁴/45); the sum does not.

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
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.analysis.system import ComplexArray
from platform_ctrl.common.arguments import positive, real_numbers
from platform_ctrl.common.values import FloatArray, value


@value
class Density:
    """A one-sided power spectral density: its integral over frequency in hertz is the variance."""

    # (n,): frequencies, rad/s, >= 0, rising: where the density changes its law. It is zero below the first and above
    # the last.
    knots: FloatArray
    # In the square of the signal's unit per Hz, of frequencies (N,), rad/s; smooth between the knots.
    density: Callable[[FloatArray], FloatArray]

    def at(self, frequency: FloatArray) -> FloatArray:
        """Return the density at frequencies of any shape, rad/s, of any sign."""
        w = np.abs(frequency)
        out = np.zeros(w.shape)
        inside = (w >= self.knots[0]) & (w <= self.knots[-1])
        out[inside] = self.density(w[inside])
        return out


@value
class RandomDisturbance:
    """A stationary random disturbance on one input or, correlated, on several."""

    name: str  # of the source
    inputs: tuple[int, ...]  # indices among the disturbance inputs
    spectra: tuple[Density, ...]  # one for each of them
    # complex (n, n): Hermitian, positive semidefinite, ones on the diagonal: the cross spectral density of inputs i and
    # j is coherence[i, j] √(S_i S_j). Default: uncorrelated.
    coherence: ComplexArray | None = None

    def columns(self, frequency: FloatArray, inputs: int) -> ComplexArray:
        """Return F (..., inputs, n), F F' the cross spectral density at frequencies (...) with their signs."""
        n = len(self.inputs)
        root = np.sqrt(np.stack([one.at(frequency) for one in self.spectra], axis=-1))
        factor = np.eye(n, dtype=np.complex128)
        if self.coherence is not None:
            values, vectors = np.linalg.eigh(self.coherence)
            factor = vectors * np.sqrt(np.maximum(values, 0.0))
        signed = np.where((frequency < 0.0)[..., None, None], factor.conj(), factor)
        out = np.zeros((*frequency.shape, inputs, n), dtype=np.complex128)
        for i, at in enumerate(self.inputs):
            out[..., at, :] += root[..., i, None] * signed[..., i, :]
        return out


@value
class SineDisturbance:
    """A sine amplitude · sin(frequency · t + phase) on one or several inputs."""

    name: str  # of the source
    inputs: tuple[int, ...]  # indices among the disturbance inputs
    frequency: float  # rad/s, > 0
    amplitude: FloatArray  # (n,): of each input, in its unit
    # (n,), optional: rad. Sines of one frequency whose phases are given add as they come; without a phase a sine is
    # independent of all others, and its inputs are in phase.
    phase: FloatArray | None = None

    def vector(self, inputs: int) -> ComplexArray:
        """Return the complex amplitude of every disturbance input (inputs,)."""
        out = np.zeros(inputs, dtype=np.complex128)
        phase = np.zeros(len(self.inputs)) if self.phase is None else self.phase
        np.add.at(out, list(self.inputs), self.amplitude * np.exp(1j * phase))
        return out


@value
class SampleNoise:
    """White noise that every sample of a measured output adds: of the sensor, its quantisation (step/√12), its bits."""

    name: str  # of the source
    measured: int  # index of the measured output
    rms: float  # standard deviation of a sample, in the output's unit


Disturbance = RandomDisturbance | SineDisturbance | SampleNoise


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
    """Return a component's shares of mean square in displacement, smear and jitter in a window of length `exposure`, s.

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


@value
class Window:
    """Displacement, smear and jitter within an exposure; root mean squares over its instants and over exposures."""

    exposure: float  # s
    # displacement, smear, jitter: (q,): of all sources together, in the outputs' units.
    displacement: FloatArray
    smear: FloatArray
    jitter: FloatArray


@value
class BudgetResult:
    """What each of G sources does to each of q outputs."""

    names: tuple[str, ...]  # of the sources
    rms: FloatArray  # (G, q): in the outputs' units
    total: FloatArray  # (q,): of all sources together; sines that add coherently are not the root of the sum of squares
    lowest: float  # motion below this frequency, rad/s, does not count in `rms`, `total` and displacements
    windows: tuple[Window, ...]  # one for each exposure
    edges: FloatArray  # (E,): frequencies, rad/s, rising, up to which `cumulative` sums
    cumulative: FloatArray  # (G, q, E): variance of each source up to the edges, sines included
    total_cumulative: FloatArray  # (q, E): the same of all sources
    error: float  # bound on the error of integration, the largest relative to a variance
    # Bound on the share of an integrated output's variance that images beyond those kept would add; what they add to
    # other outputs is included.
    remaining: float
