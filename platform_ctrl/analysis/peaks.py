"""The largest gain of one system within a band of frequencies: exact from above, or held against a level.

A grid of frequencies misses a peak that is narrower than its spacing. Between two frequencies at which the gain crosses
a level it stays on one side of it, and the eigenvalues of a Hamiltonian matrix show all crossings (Boyd and
Balakrishnan, Systems & Control Letters 15, 1990).
"""

from __future__ import annotations

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray, StateArrays
from platform_ctrl.analysis.norms import hinf_norm, level_frequencies, resonances
from platform_ctrl.analysis.poles import continuous_poles, poles
from platform_ctrl.analysis.singular_values import FrequencyAxis
from platform_ctrl.common.values import FloatArray

# Relative error of a peak: what is returned is the upper end.
TOLERANCE = 5e-10

Band = tuple[float, float]
WHOLE: Band = (0.0, np.inf)


def peak(system: StateArrays, band: Band = WHOLE) -> tuple[float, float]:
    """Return an upper bound of the largest singular value over `band`, rad/s, within 5e-10, and the peak's frequency.

    Parameters
    ----------
    system
        One system; stable where the band is the whole axis. Poles may lie anywhere outside of the band.
    band
        From and to, rad/s; at most up to the Nyquist frequency.
    """
    if band == WHOLE:
        norm, frequency = hinf_norm(system, allow_unstable=True, tolerance=TOLERANCE)
        return norm * (1.0 + TOLERANCE), frequency
    axis = FrequencyAxis(system)
    own = resonances(continuous_poles(poles(system.A), system.dt))
    level, frequency = 0.0, 0.0
    for _ in range(60):
        found, at = _largest(axis, own, band)
        if found <= level:
            break
        level, frequency = found * (1.0 + TOLERANCE), at
        own = level_frequencies(axis, level)
    return level, frequency


def exceeds(system: StateArrays, level: float, s: ComplexArray, band: Band = WHOLE) -> bool:
    """Return whether the largest singular value is above `level` anywhere in `band`, or may be.

    Parameters
    ----------
    system
        One system without poles in the band.
    level
        In the units of the outputs per unit of the inputs.
    s : complex (n,)
        Its continuous(-equivalent) poles.
    band
        From and to, rad/s.
    """
    axis = FrequencyAxis(system)
    crossings = level_frequencies(axis, level)
    if not crossings.size and level > 0.0 and axis.system.A.size:
        # The Hamiltonian leaves floating point: nothing is shown.
        return True
    # The poles' own frequencies too: next to a narrow peak a crossing is as inexact as the pole.
    own = np.concatenate([np.abs(s.imag[np.isfinite(s)]), crossings])
    return _largest(axis, own, band)[0] > level


def _largest(axis: FrequencyAxis, own: FloatArray, band: Band) -> tuple[float, float]:
    low, top = band[0], min(band[1], axis.edge)
    return axis.largest(np.concatenate([[low, top], own[(own > low) & (own < top)]])) if low <= top else (0.0, low)
