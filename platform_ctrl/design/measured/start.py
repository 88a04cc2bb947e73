"""Where the iterations begin: a weak controller that stabilises, read from the data.

A gimballed platform obeys M q̈ + G q̇ + K q = Q behind its dead time; the three matrices and the dead time are fitted
to the inverse of the measured response. Then

    Q = −(G + d M) ωc y − d M ẏ − (small integral action)

makes nutation decay at about d − ωc and precession at ωc, for pairs as for directions that no gyro stiffens, whatever
G is.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray
from platform_ctrl.frozen import FloatArray, value

_DELAYS = 60
# d over the largest rate that dead time and data allow; ωc over d; ωi over ωc.
_RATES = np.geomspace(1.0, 1e-3, 10)
_CROSSOVERS = (0.4, 0.2, 0.1)
_INTEGRAL = 0.1


@value
class Mechanics:
    """M q̈ + G q̇ + K q = Q delayed by `dead_time`, fitted.

    Attributes
    ----------
    M, G, K : (n, n)
        Inertia, gyroscopic action with friction, stiffness.
    dead_time
        s.
    error
        Rms of P P_fit⁻¹ − I.
    """

    M: FloatArray
    G: FloatArray
    K: FloatArray
    dead_time: float
    error: float


def fitted_mechanics(frequency: FloatArray, P: ComplexArray) -> Mechanics:
    """Return the mechanics that P (N, n, n) comes nearest to, by least squares of the relative error."""
    inside = frequency <= 0.5 * frequency[-1]
    w, H = frequency[inside], P[inside]
    return min(
        (_fit(w, H, tau) for tau in np.linspace(0.0, 2.0 * np.pi / frequency[-1], _DELAYS)), key=lambda m: m.error
    )


def _fit(w: FloatArray, H: ComplexArray, dead_time: float) -> Mechanics:
    n = H.shape[-1]
    turned = H * np.exp(1j * w * dead_time)[:, None, None]
    # P e^{jωτ} (−ω² M + jω G + K) = I, column by column of the unknown matrices; ω in units of the highest.
    unit = w[-1]
    x = (w / unit)[:, None, None]
    rows = np.concatenate([-(x**2) * turned, 1j * x * turned, turned], axis=-1).reshape(-1, 3 * n)
    right = np.tile(np.eye(n), (len(w), 1))
    A = np.concatenate([rows.real, rows.imag])
    b = np.concatenate([right, np.zeros_like(right)])
    size = np.linalg.norm(A, axis=0)
    found = np.linalg.lstsq(A / size, b, rcond=None)[0] / size[:, None]
    error = float(np.linalg.norm(A @ found - b) / np.sqrt(len(w) * n))
    M, G, K = found[:n] / unit**2, found[n : 2 * n] / unit, found[2 * n :]
    return Mechanics(M=0.5 * (M + M.T), G=G, K=K, dead_time=dead_time, error=error)


def candidates(frequency: FloatArray, P: ComplexArray) -> Iterator[FloatArray]:
    """Yield gains (3, n, n) that may stabilise, strong ones first."""
    fit = fitted_mechanics(frequency, P)
    fastest = 1.0 / max(fit.dead_time, 3.0 / frequency[-1])
    for rate, share in product(_RATES, _CROSSOVERS):
        d = rate * fastest
        crossover = share * d
        slow = (fit.G + d * fit.M) * crossover
        yield np.array([-slow, -_INTEGRAL * crossover * (slow + fit.K), -d * fit.M])
    # A plant at rest under integral action alone.
    at_rest = np.linalg.pinv(P[0].real)
    for rate in _RATES:
        yield np.array([0.0 * at_rest, -rate * frequency[-1] * at_rest, 0.0 * at_rest])
