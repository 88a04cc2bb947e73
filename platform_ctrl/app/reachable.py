"""How far a pole or the crossover may be dragged before a limit or the change of the sliders holds it: an estimate.

Places and limits are linear in the logarithms of the sliders near the present ones: linear programmes find the steps
that go farthest. Each is then shortened until the limits hold at its end, where the place is computed again.
"""

from __future__ import annotations

import math

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray, StateArrays
from platform_ctrl.app.dragging import (
    FreeParameters,
    Limits,
    crossover_residual,
    limit_slopes,
    nearest_pole,
    slopes,
)
from platform_ctrl.common.values import FloatArray

# Relative way of the drag for which the region is estimated, and the directions of its corners.
DISTANCE = 0.25
# Directions, and shares of a step that are tried: of quick limits, and of those whose evaluation takes long.
_QUICK = 16, (1.0, 0.8, 0.6, 0.45, 0.3, 0.2, 0.1, 0.05, 0.02)
_LONG = 8, (1.0, 0.5, 0.2, 0.05)
# By how much a ratio may be beyond its limit at the end of a step.
_SLACK = 1e-3
# Relative step of the slope of the gain over frequency.
_STEP = 1e-4


def reachable_poles(parameters: FreeParameters, plant: StateArrays, pole: complex, limits: Limits) -> ComplexArray:
    """Return the corners of the region that the closed-loop pole nearest to `pole` may be dragged to, rad/s."""
    x = np.log(parameters.start)
    here = nearest_pole(parameters, plant, x, pole)

    def place(x: FloatArray) -> FloatArray:
        now = nearest_pole(parameters, plant, x, here)
        return np.array([now.real, now.imag])

    J = slopes(parameters, x, place, place(x))
    count = _tried(limits)[0]
    turns = 2.0 * np.pi * np.arange(count) / count
    if abs(here.imag) < 1e-9 * abs(here):
        J[1], turns = 0.0, np.array([0.0, np.pi])
    steps = _farthest(parameters, limits, x, np.stack([np.cos(turns), np.sin(turns)], axis=-1) @ J)
    corners = np.array([nearest_pole(parameters, plant, x + dx, here + complex(*(J @ dx))) for dx in steps])
    return np.asarray(corners[np.argsort(np.angle(corners - here))])


def _tried(limits: Limits) -> tuple[int, tuple[float, ...]]:
    return _QUICK if limits.steps > 1 else _LONG


def reachable_crossovers(
    parameters: FreeParameters, plant: StateArrays, channel: int, now: float, limits: Limits
) -> tuple[float, float]:
    """Return the lowest and the highest crossover that it may be dragged to, rad/s."""
    x = np.log(parameters.start)
    gain = crossover_residual(parameters, plant, channel)
    by_sliders = slopes(parameters, x, gain(now), gain(now)(x))
    by_frequency = float((gain(now * (1.0 + _STEP))(x) - gain(now * (1.0 - _STEP))(x))[0]) / (2.0 * _STEP)
    way = -by_sliders[0] / by_frequency
    moves = _farthest(parameters, limits, x, np.stack([-way, way])) @ way
    return now * math.exp(moves[0]), now * math.exp(moves[1])


def _farthest(parameters: FreeParameters, limits: Limits, x: FloatArray, directions: FloatArray) -> FloatArray:
    """Return steps (D, k) within all limits that go far in each direction (D, k)."""
    from scipy.optimize import linprog

    ratios, G = limit_slopes(parameters, limits, x)
    near = parameters.within(DISTANCE)
    ends = np.stack([np.log(near.low) - x, np.log(near.high) - x], axis=-1)
    ends[parameters.weights <= 0.0] = 0.0
    room = np.maximum(limits.bound - ratios, 0.0)
    out = np.zeros_like(directions)
    for k, direction in enumerate(directions):
        found = linprog(-direction, A_ub=G if len(G) else None, b_ub=room if len(G) else None, bounds=ends)
        if found.status != 0:
            continue
        # As often as that a limit that bends is met on the way.
        share = next((share for share in _tried(limits)[1] if _holds(parameters, limits, x + share * found.x)), 0.0)
        out[k] = share * found.x
    return out


def _holds(parameters: FreeParameters, limits: Limits, x: FloatArray) -> bool:
    return not limits.broken(limits.local, parameters.numbers(x), _SLACK)
