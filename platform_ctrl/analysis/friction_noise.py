"""The part of dry friction that is in no proportion to a rate: a noise with a spectrum.

See `platform_ctrl.analysis.dry_friction` for what it belongs to, and the sources.

The remainder is a noise with a spectrum: r is uncorrelated with v at all lags (Bussgang, 1952). In Hermite polynomials
f(σ x) = Σ f_n He_n(x)/√n! the correlation of f is Σ f_n² ρ(τ)^n with ρ that of v (Price, IRE Trans. Information Theory
4, 1958), and r has the terms but n = 0 and 1: for a sign, (2/π) F² (asin ρ − ρ). Of what a drive feeds forward the
remainder s follows r as w follows v, late and filtered: the correlation of f(v) with g(w) is Σ f_n g_n ρ_vw(τ)^n with
that of the rates, and r − s has

    Σ over n ≥ 2 of f_n² ρ_vv(τ)^n + g_n² ρ_ww(τ)^n − f_n g_n (ρ_vw(τ)^n + ρ_vw(−τ)^n).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from platform_ctrl.analysis.dry_friction import gaussian, torques
from platform_ctrl.analysis.dry_torques import DryTorque, FedFriction
from platform_ctrl.analysis.hybrid_plant import Density
from platform_ctrl.analysis.system import ComplexArray
from platform_ctrl.common.values import FloatArray, value

# Terms of the series that are computed. Of a step they fall with n to the power -3/2: what is left goes, in that
# proportion, to groups of terms whose ends grow by a factor.
_TERMS, _GROWTH, _GROUPS = 60, 1.6, 16
# Points of the correlation, and points to an octave of the result.
_POINTS, _PER_OCTAVE = 2**18, 6
# Highest frequency, in that below which the rate has 99 % of its variance: lags resolve what a drive is late.
_BEYOND = 128.0


class Remainder(NamedTuple):
    """The torque that is not in proportion to a rate: rms, N m, and spectrum, (N m)²/Hz."""

    rms: float
    spectrum: Density


@value
class FoundRate:
    """The rate w that a drive finds of a bearing that turns with v, as it acts on the bearing; k frequencies."""

    drive: FedFriction  # what is fed forward by it
    rms: float  # of w, rad/s
    # alone, together, filtered: (k,): variances of w, of w + v and of w + x up to the frequencies, (rad/s)²; x is v
    # behind a low-pass of first order: the three of them tell the cross spectrum.
    alone: FloatArray
    together: FloatArray
    filtered: FloatArray
    corner: float  # of the low-pass, rad/s


def friction_noise(
    friction: DryTorque,
    rms: float,
    edges: FloatArray,
    cumulative: FloatArray,
    lowest: float,
    found: FoundRate | None = None,
) -> Remainder | None:
    """Return the remainder of a dry friction, with a smooth spectrum; None where nothing moves.

    `rms` is of the rate, rad/s, `cumulative` (k,) its variance, (rad/s)², up to the frequencies `edges`, rad/s, rising;
    below `lowest` the spectrum is left out. `found` is what a drive finds of the rate, and feeds forward. Sources: J.
    J. Bussgang, MIT RLE Report 216, 1952; R. Price, IRE Transactions on Information Theory 4, 1958.
    """
    total = float(cumulative[-1])
    if not (rms > 0.0 and total > 0.0):
        return None
    # Harmonics of the rate reach well beyond it.
    high = _BEYOND * float(edges[np.searchsorted(cumulative, 0.99 * total)])
    grid = high / _POINTS * np.arange(_POINTS + 1, dtype=np.float64)

    def bins(of: FloatArray) -> FloatArray:
        return np.diff(np.interp(grid, edges, of), prepend=0.0)

    v = bins(cumulative)
    near = [friction.coulomb_rate / rms, friction.stribeck_rate / rms]
    x, weight = gaussian(near if found is None or not found.rms else [*near, found.drive.coulomb_rate / found.rms])
    f = _coefficients(friction, rms, x, weight)
    correlation = _powers(_correlation(v, v)[: _POINTS + 1], f[0] * f[0], float(weight @ f[1] ** 2))
    if found is not None and found.rms > 0.0:
        w = bins(found.alone)
        g = _coefficients(found.drive, found.rms, x, weight)
        cross = _cross(v, w, bins(found.together), bins(found.filtered), grid / found.corner)
        correlation += _powers(_correlation(w, w)[: _POINTS + 1], g[0] * g[0], float(weight @ g[1] ** 2))
        both = _correlation(v, w, cross)
        common, lag = _powers(both, f[0] * g[0], float(weight @ (f[1] * g[1]))), np.arange(_POINTS + 1)
        correlation -= common[lag] + common[-lag]
    return Remainder(math.sqrt(max(correlation[0], 0.0)), _smooth(correlation, grid, lowest))


def _cross(v: FloatArray, w: FloatArray, together: FloatArray, filtered: FloatArray, turns: FloatArray) -> ComplexArray:
    """Return the cross spectrum of v and w by bins, from those of w + v and of w + L v, L = 1/(1 + j turns)."""
    low = 1.0 / (1.0 + 1j * turns)
    real = 0.5 * (together - v - w)
    behind = 0.5 * (filtered - np.abs(low) ** 2 * v - w)  # the real part of L times the cross spectrum
    imaginary = np.zeros_like(real)
    imaginary[1:] = (low.real[1:] * real[1:] - behind[1:]) / low.imag[1:]
    cross = real + 1j * imaginary
    # No more than Schwarz's inequality allows: rounding is small against large bins alone.
    size, most = np.abs(cross), np.sqrt(np.maximum(v * w, 0.0))
    return cross * np.divide(most, size, out=np.ones_like(size), where=size > most)


def _correlation(v: FloatArray, w: FloatArray, cross: FloatArray | ComplexArray | None = None) -> FloatArray:
    """Return the correlation over all lags, 1 where both are the same, of variances and what they have in common."""
    scale = math.sqrt(float(v.sum()) * float(w.sum()))
    return np.clip(np.fft.irfft(_POINTS * (v if cross is None else cross), 2 * _POINTS) / scale, -1.0, 1.0)


def _powers(rho: FloatArray, products: FloatArray, whole: float) -> FloatArray:
    """Return Σ products ρ^n without n = 0 and 1; `whole` is the sum of all products, those beyond included."""
    correlation, power, squared, last = np.zeros_like(rho), rho.copy(), rho * rho, 1
    for n in (2 + np.flatnonzero(np.abs(products[2:]) > 1e-20 * abs(whole))).tolist():
        # Torques that are alike to both sides have the odd terms alone.
        for step in (*[squared] * ((n - last) // 2), *[rho] * ((n - last) % 2)):
            power *= step
        correlation += products[n] * power
        last = n
    rest = whole - float(products.sum())
    ends = _TERMS * _GROWTH ** np.arange(_GROUPS + 1)
    weights = ends[:-1] ** -0.5 - ends[1:] ** -0.5
    weights[-1] = ends[-2] ** -0.5
    # High powers of small correlations count as zero.
    large = np.flatnonzero(np.abs(rho) > 0.5)
    sign, logarithm = np.sign(rho[large]), np.log(np.abs(rho[large]))
    for n, weight in zip(np.sqrt(ends[1:] * ends[:-1]), weights / weights.sum(), strict=True):
        correlation[large] += rest * weight * sign * np.exp(n * logarithm)
    return correlation


def _smooth(correlation: FloatArray, grid: FloatArray, lowest: float) -> Density:
    """Return the spectrum of a correlation from lag zero on, in the square of its unit per Hz."""
    from scipy.interpolate import PchipInterpolator

    step, high = float(grid[1]), float(grid[-1])
    # One-sided variance of each bin; all together are the remainder's.
    share = np.maximum(np.fft.irfft(correlation, 2 * _POINTS)[: _POINTS + 1], 0.0) * 2.0
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
    return Density(knots=octaves, density=lambda w: np.exp(law(np.log(w))))


def _coefficients(torque: DryTorque, rms: float, x: FloatArray, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the Hermite coefficients n = 0, 1, ... of a torque at a Gaussian rate, and the torque at the points."""
    values = torques(torque, rms, x)
    before, now = np.ones_like(x), x
    out = [float(weight @ values), float(weight @ (values * x))]
    for n in range(2, _TERMS + 1):
        before, now = now, (x * now - math.sqrt(n - 1.0) * before) / math.sqrt(n)
        out.append(float(weight @ (values * now)))
    return np.array(out), values
