"""The frequencies at which responses are drawn: close to every pole and zero, however little it is damped.

Around a pole at distance d from the stability boundary points stand at 0, d/3, ..., 4 d and then at distances that grow
by a factor: flanks and tip of the sharpest resonance have their shape. A pole or zero on the boundary itself, where the
response is infinite or 0, is come close to from both sides.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.analysis.arrays import ComplexArray, frequencies
from platform_ctrl.analysis.frequency_grids import around_resonances
from platform_ctrl.common.values import FloatArray
from platform_ctrl.errors import ArgumentError
from platform_ctrl.report.plots.systems import ON, DrawnSystem, sorted_data

# Relative distance up to which a pole or zero on the stability boundary is come close to.
CLOSEST = 1e-6
# The range without a single pole or zero, Hz.
_PLAIN = 2.0 * np.pi * np.array([0.01, 100.0])
# The highest frequency that is drawn of a sampled system, over the Nyquist frequency.
LAST = 0.9995


def grid(
    systems: Sequence[DrawnSystem],
    frequency: ArrayLike | None = None,
    *,
    name: str = "frequency",
    loops: bool = False,
    points: int = 400,
) -> FloatArray:
    """Return the ascending frequencies > 0, rad/s, at which the responses of all `systems` are drawn.

    `frequency` is None for a range that shows all poles and zeros (of loops also the crossings of gain 1; of sampled
    systems up to the Nyquist frequency), the two ends of a range, or the frequencies themselves. `points` counts those
    of the plain grid, before poles and zeros add theirs.
    """
    if frequency is None:
        low, high = _range(systems, loops)
    else:
        given = frequencies(frequency, name)
        if not np.any(given) or not np.all(np.diff(given) > 0.0) or (given.size == 2 and given[0] == 0.0):
            raise ArgumentError(
                f"{name}: frequency must be ascending numbers in rad/s, or the two ends of a range > 0 rad/s"
            )
        given = given[given > 0.0]
        low, high = float(given[0]), float(given[-1])
        if given.size != 2:
            _judge(systems, low, high, name)
            return given
    _judge(systems, low, high, name)
    own = [around_resonances(s, low, high, ON, CLOSEST) for one in systems for s in (one.poles, one.zeros)]
    edges = [np.array([LAST * one.nyquist]) for one in systems if low < LAST * one.nyquist < high]
    every = np.unique(np.concatenate([np.geomspace(low, high, points), *own, *edges]))
    every = every[(every >= low) & (every <= high)]
    for one in systems:
        for undamped in one.undamped:
            every = every[np.abs(every - undamped) > 0.5 * CLOSEST * undamped]
    return every


def _judge(systems: Sequence[DrawnSystem], low: float, high: float, name: str) -> None:
    for one in systems:
        first, last = (0.0, one.nyquist)
        if one.is_data:
            own = sorted_data(one.source)[0]
            first, last = float(own[0]), float(own[-1])
        if low > last * (1.0 + 1e-9) or high < first * (1.0 - 1e-9):
            raise ArgumentError(
                f"{name}: frequency: {low:.6g} to {high:.6g} rad/s is outside the range of "
                f"{one.label or 'the system'}, {first:.6g} to {last:.6g} rad/s"
            )


def _range(systems: Sequence[DrawnSystem], loops: bool) -> tuple[float, float]:
    ends: list[float] = []
    fixed: list[float] = []
    for one in systems:
        if one.is_data:
            own = sorted_data(one.source)[0]
            fixed += [float(own[0]), float(own[-1])]
            continue
        corners = np.abs(one.poles)
        corners = corners[corners > 1e-12 * corners.max(initial=0.0)]
        zeros = np.abs(one.zeros)
        if corners.size:
            zeros = zeros[(zeros > 1e-2 * corners.min()) & (zeros < 1e2 * corners.max())]
        else:
            zeros = zeros[zeros > 1e-12 * zeros.max(initial=0.0)]
        corners = np.concatenate([corners, zeros])
        own = _crossed(one, corners) if loops or not corners.size else np.zeros(0)
        shown = np.concatenate([corners, own])
        if shown.size:
            ends += [0.1 * float(shown.min()), min(10.0 * float(shown.max()), LAST * one.nyquist)]
        if one.dt:
            ends.append(LAST * one.nyquist)
            ends.append(min([1e-3 * one.nyquist, *ends]))
    if not ends and not fixed:
        return float(_PLAIN[0]), float(_PLAIN[1])
    if fixed:
        return min(fixed + ends), max(fixed + ends)
    return min(ends), max(ends)


def _crossed(one: DrawnSystem, corners: ComplexArray | FloatArray) -> FloatArray:
    """Return the frequencies where gains cross 1 next to a grid, as far out as four decades beyond all corners."""
    if corners.size:
        low, high = 1e-4 * float(np.min(corners)), 1e4 * float(np.max(corners))
    else:
        low, high = 1e-6, 1e6
    high = min(high, LAST * one.nyquist)
    if not low < high:
        return np.zeros(0)
    w = np.geomspace(low, high, 300)
    gain = np.abs(one.response(w))
    with np.errstate(invalid="ignore"):
        crossing = np.any(np.diff((gain > 1.0).astype(np.int8), axis=-1) != 0, axis=(0, 1))
    return np.asarray(w[:-1][crossing])
