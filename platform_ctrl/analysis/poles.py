"""Poles and their damping, of continuous and of sampled systems alike.

A pole z of a sampled system counts as the continuous pole s = ln(z)/T with |Im s| <= pi/T that its samples
cannot be told from. So a pole at z = 0 (a delay) is infinitely fast and fully damped, and one on the negative real
axis of z oscillates at the Nyquist frequency: z = -0.5 has the damping ratio 0.22, z = -0.9 only 0.03.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray, scaled, state_arrays
from platform_ctrl.frozen import FloatArray, value

if TYPE_CHECKING:
    import control


@value
class Damping:
    """Damping ratio of every pole, slowest pole first.

    Attributes
    ----------
    poles : complex (n,)
        Continuous-equivalent poles s, rad/s; ``-inf`` for z = 0.
    natural_frequency : (n,)
        |s|, rad/s.
    ratio : (n,)
        -Re(s)/|s|: 1 for real stable poles and for z = 0, -1 for real unstable ones, 0 at s = 0.
    """

    poles: ComplexArray
    natural_frequency: FloatArray
    ratio: FloatArray


def poles(system: control.StateSpace) -> ComplexArray:
    """Return the poles of `system` in its own plane (s or z), computed in balanced states, (n,)."""
    A, B, C, _, _ = state_arrays(system, "poles")
    return pole_arrays(scaled(A, B, C)[0])


def pole_arrays(A: FloatArray) -> ComplexArray:
    """Return the eigenvalues of a stack of matrices (..., n, n) as complex (..., n)."""
    return np.asarray(np.linalg.eigvals(A), dtype=np.complex128)


def continuous_poles(poles: ComplexArray, dt: float) -> ComplexArray:
    """Return s = ln(z)/dt for the poles of a discrete system; those of a continuous one (dt = 0) as they are."""
    if dt == 0.0:
        return np.asarray(poles, dtype=np.complex128)
    z = np.asarray(poles, dtype=np.complex128)
    # By parts: no complex infinities with undefined angles, and no digits lost next to z = 1.
    with np.errstate(divide="ignore"):
        growth = np.where(
            np.abs(z - 1.0) < 0.5,
            0.5 * np.log1p(np.maximum((z.real - 1.0) * (z.real + 1.0) + z.imag**2, -1.0)),
            np.log(np.abs(z)),
        )
    out = np.empty(z.shape, dtype=np.complex128)
    out.real = growth / dt
    out.imag = np.where(z == 0.0, 0.0, np.angle(z) / dt)
    return out


def damping_ratio(poles: ComplexArray) -> FloatArray:
    """Return -Re(s)/|s| of continuous(-equivalent) poles; 1 for infinitely fast ones, 0 for s = 0."""
    s = np.asarray(poles, dtype=np.complex128)
    size = np.abs(s)
    plain = np.isfinite(size) & (size > 0.0)
    out = np.where(np.isinf(size), 1.0, 0.0)
    out[plain] = -s.real[plain] / size[plain]
    return out


def damping(system: control.StateSpace) -> Damping:
    """Return natural frequency and damping ratio of every pole of `system`, slowest first."""
    dt = state_arrays(system, "damping").dt
    s = continuous_poles(poles(system), dt)
    s = s[np.argsort(np.abs(s), kind="stable")]
    return Damping(poles=s, natural_frequency=np.abs(s), ratio=damping_ratio(s))


def minimum_damping(poles: ComplexArray, above: float = 0.0, dt: float = 0.0) -> FloatArray:
    """Return the smallest damping ratio of the poles faster than `above`.

    Parameters
    ----------
    poles : complex (..., n)
        In the s-plane (dt = 0), or in the z-plane of a system with sample period `dt`.
    above
        rad/s. Poles with a smaller magnitude do not count, unless they are unstable: those always count.
    dt
        Sample period, s.

    Returns
    -------
    (...)
        In [-1, 1]; 1 where no pole is that fast.
    """
    s = continuous_poles(poles, dt)
    counts = (np.abs(s) > above) | (s.real > 0.0)
    out: FloatArray = np.where(counts, damping_ratio(s), 1.0).min(axis=-1, initial=1.0)
    return out


def spectral_radius(poles: ComplexArray) -> FloatArray:
    """Return the largest magnitude along the last axis; 0 without poles."""
    out: FloatArray = np.abs(poles).max(axis=-1, initial=0.0)
    return out


def spectral_abscissa(poles: ComplexArray) -> FloatArray:
    """Return the largest real part along the last axis; -inf without poles."""
    out: FloatArray = np.real(poles).max(axis=-1, initial=-np.inf)
    return out


def is_stable(system: control.StateSpace, margin: float = 0.0) -> bool:
    """Whether every pole lies strictly inside the stability region.

    Parameters
    ----------
    system
        Continuous or discrete.
    margin
        Decay rate in 1/s that every pole must exceed.
    """
    dt = state_arrays(system, "is_stable").dt
    return bool(spectral_abscissa(continuous_poles(poles(system), dt)) < -margin)
