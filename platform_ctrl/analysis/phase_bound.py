"""How high a gain can rise between two frequencies at which it is known.

On the frequency axis every entry u* H v of a response is a rational function with the poles of the system. Along the
phase of the all-pass function that has the same n poles, phi = sum 2 atan((w - Im p)/|Re p|), its square |u* H v|^2
is as steep as a cosine at most: where it is the share cos^2(alpha/2) of its largest value, |d alpha/d phi| <= 1
(inequality of Bernstein and Szegö for rational functions: P. Borwein, T. Erdélyi, Polynomials and Polynomial
Inequalities, 1995, sec. 7.1). So where the largest gain lies between two frequencies, the gains there are not far below
it, in phase. If a level is exceeded, then between the two where the largest gain lies this holds for the level all
the more: where it holds nowhere, nothing exceeds the level. That takes no eigenvalues of a Hamiltonian matrix.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis.arrays import ComplexArray
from platform_ctrl.frozen import FloatArray

# Poles are known to a few digits at least: phases are granted this factor.
GRANTED = 1.05
# Ratio of neighbouring distances from a peak.
STEP = 2.5


class AxisPhase:
    """The phase of the all-pass function with a system's poles, along the frequency axis.

    Parameters
    ----------
    s : complex (n,)
        Continuous(-equivalent) poles, none of them on the stability boundary.
    dt
        Sample period, s; 0: continuous. A sampled system is seen from the plane of (z - 1)/(z + 1).
    """

    def __init__(self, s: ComplexArray, dt: float) -> None:
        self._dt = dt
        if dt > 0.0:
            poles = np.full(len(s), -1.0 + 0j)
            finite = np.isfinite(s)
            poles[finite] = np.tanh(0.5 * dt * s[finite])
            s = poles
        # Of the side of the axis on which a pole stands the gain knows nothing.
        self._centre, self._width = s.imag, np.abs(s.real)

    def at(self, w: FloatArray) -> FloatArray:
        """Return the phase, rad, at sorted frequencies (N,), rad/s; infinite ones are the end of the axis."""
        w = self._mapped(w)
        out: FloatArray = 2.0 * np.arctan((w[:, None] - self._centre) / self._width).sum(axis=1)
        return out

    def around(self, w: float, tolerance: float) -> FloatArray:
        """Return frequencies on both sides of a peak at w, from where its gain differs by `tolerance` of itself on."""
        at = float(self._mapped(np.array([w]))[0])
        least = 0.5 * math.sqrt(8.0 * tolerance)
        distance = least * STEP ** np.arange(math.ceil(math.log(1.5 / least) / math.log(STEP)))
        if math.isinf(at):
            out: FloatArray = 2.0 * self._width.sum() / distance
        else:
            distance /= (2.0 * self._width / ((at - self._centre) ** 2 + self._width**2)).sum()
            out = np.concatenate([at - distance, at + distance])
        return 2.0 / self._dt * np.arctan(out) if self._dt > 0.0 else out

    def doubtful(self, w: FloatArray, gain: FloatArray, level: float) -> NDArray[np.int64]:
        """Return between which sorted frequencies, k and k + 1, the largest gain may lie if it exceeds `level`.

        Between others the gain may exceed it too, but not be the largest.
        """
        share = np.minimum(gain / level, 1.0)
        alpha = 2.0 * np.arccos(share)
        return np.flatnonzero(alpha[1:] + alpha[:-1] <= GRANTED * np.diff(self.at(w)))

    def _mapped(self, w: FloatArray) -> FloatArray:
        if self._dt == 0.0:
            return w
        half = 0.5 * self._dt * w
        return np.where(half >= 0.5 * math.pi, math.inf, np.tan(half))


def middles(low: FloatArray, high: FloatArray, edge: float) -> FloatArray:
    """Return a frequency between each two, 0 and the end of the axis, `edge`, among them."""
    with np.errstate(invalid="ignore"):
        out = np.where(high > 4.0 * low, np.sqrt(low * high), 0.5 * (low + high))
    out = np.where(np.isinf(high), 4.0 * low, np.where((high == edge) & np.isfinite(high), 0.5 * (low + high), out))
    return np.where(low == 0.0, np.where(np.isinf(high), 1.0, 0.25 * high), out)
