"""Pulling a closed-loop pole or the crossover somewhere: the knobs that may move follow, as little as they can.

The logarithms of the knobs take Gauss-Newton steps of least norm, dx = W Jᵀ (J W Jᵀ)⁻¹ r, along a straight path from
where the pole is to where it is wanted, so that it stays the same pole.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray, StateArrays
from platform_ctrl.analysis.feedback import closed_loop_arrays
from platform_ctrl.analysis.poles import continuous_poles, pole_arrays
from platform_ctrl.analysis.response import frequency_response_arrays
from platform_ctrl.analysis.sensitivity import sensitivities
from platform_ctrl.designer.curves import channel_response
from platform_ctrl.errors import DesignError, PlatformCtrlError
from platform_ctrl.frozen import FloatArray, value

Build = Callable[[Mapping[str, float]], StateArrays]
Residual = Callable[[StateArrays], FloatArray]

# Most steps along the way, and the share of a frequency that one of fewer may be.
_WAY, _STRIDE = 8, 0.05
# Gauss-Newton steps for each, and the largest change of a logarithm in one.
_MOST, _LONGEST = 12, 0.3
# Relative distance to the target that counts as there.
_THERE = 1e-9
# Relative gain that still counts as 1, and halvings between a frequency where it can be and one where it cannot.
_CROSSED, _HALVINGS = 1e-6, 5
# Relative distance at which it is above on one side and below on the other.
_BESIDE = 1e-3
_DIFFERENCE = 1e-6


@value
class Reins:
    """The knobs that may move, and what they make.

    Attributes
    ----------
    names
        Of the knobs.
    start, low, high : (k,)
        Where they stand, and as far as they may go.
    weights : (k,)
        How readily each moves.
    build
        Knobs → sampled controller.
    """

    names: tuple[str, ...]
    start: FloatArray
    low: FloatArray
    high: FloatArray
    weights: FloatArray
    build: Build

    def controller(self, x: FloatArray) -> StateArrays:
        """Return the controller for logarithms of the knobs."""
        return self.build(self.numbers(x))

    def numbers(self, x: FloatArray) -> dict[str, float]:
        """Return the knobs for their logarithms; one that has not moved has exactly the number that it started with."""
        moved = self.start * np.exp(x - np.log(self.start))
        return {name: float(v) for name, v in zip(self.names, moved, strict=True)}


def pole_pulled(reins: Reins, plant: StateArrays, pole: complex, target: complex) -> dict[str, float]:
    """Return the knobs that bring the closed-loop pole nearest to `pole` to `target`, or as near as they can.

    Poles are s-plane equivalents ln(z)/T, rad/s.

    Raises
    ------
    DesignError
        No knob may move, or the pole does not move with any.
    """
    _expect_knobs(reins)

    def poles(K: StateArrays) -> ComplexArray:
        A = closed_loop_arrays(*plant[:4], *K[:4])[0]
        return continuous_poles(pole_arrays(A), plant.dt)

    start = poles(reins.controller(np.log(reins.start)))
    here = complex(start[int(np.nanargmin(_distance(start, pole)))])
    real = abs(here.imag) < 1e-9 * abs(here)
    goal = complex(target.real, 0.0 if real else abs(target.imag))
    here = here if here.imag >= 0.0 else here.conjugate()
    scale = max(abs(here), abs(goal), 1e-12)

    def residual(wanted: complex) -> Residual:
        def of(K: StateArrays) -> FloatArray:
            s = poles(K)
            nearest = complex(s[int(np.nanargmin(_distance(s, wanted)))]) - wanted
            return np.array([nearest.real] if real else [nearest.real, nearest.imag]) / scale

        return of

    way = [residual(here + (goal - here) * share) for share in _shares(abs(goal - here) / scale)]
    return reins.numbers(_followed(reins, way, f"the pole at {here:.4g} rad/s"))


def crossover_pulled(reins: Reins, plant: StateArrays, channel: int, now: float, target: float) -> dict[str, float]:
    """Return the knobs that bring the gain of one channel, all others closed, to 1 at `target` rad/s.

    Raises
    ------
    DesignError
        No knob may move, or the gain does not move with any.
    """
    _expect_knobs(reins)
    nyquist = math.pi / plant.dt
    if not 0.0 < target < nyquist:
        raise DesignError(f"crossover: pulled to {target:.4g} rad/s; expected up to {nyquist:.4g} rad/s, Nyquist's")

    def residual(w: float) -> Residual:
        grid = np.array([w])
        P = frequency_response_arrays(*plant, grid)

        def of(K: StateArrays) -> FloatArray:
            L = channel_response(sensitivities(-frequency_response_arrays(*K, grid) @ P)[0], channel)
            return np.log(np.maximum(np.abs(L), 1e-300))

        return of

    what = f"the gain at {target:.4g} rad/s"
    x, here, beyond = np.log(reins.start), now, math.nan
    for share in _shares(abs(math.log(target / now))):
        w = now * (target / now) ** share
        found = _crossing(reins, x, residual, w, what)
        if found is None:
            beyond = w
            break
        x, here = found, w
    # Where it cannot go all the way it goes as far as it can: a gain that passes 1 nowhere is not taken hold of again.
    for _ in range(0 if math.isnan(beyond) else _HALVINGS):
        middle = math.sqrt(here * beyond)
        found = _crossing(reins, x, residual, middle, what)
        if found is None:
            beyond = middle
        else:
            x, here = found, middle
    return reins.numbers(x)


def _shares(distance: float) -> list[float]:
    """Return the shares of a way at which to be in turn: a hand that drags asks for a little again and again."""
    count = min(_WAY, max(1, math.ceil(distance / _STRIDE)))
    return [(k + 1) / count for k in range(count)]


def _crossing(
    reins: Reins, x: FloatArray, residual: Callable[[float], Residual], w: float, what: str
) -> FloatArray | None:
    """Return where the gain passes 1 at w, from x on; None where it does not get there, or only touches 1."""
    found = _reached(reins, x, residual(w), np.log(reins.low), np.log(reins.high), what, _THERE)
    K = reins.controller(found)
    below, at, above = (float(residual(w * share)(K)[0]) for share in (1.0 - _BESIDE, 1.0, 1.0 + _BESIDE))
    return found if abs(at) <= _CROSSED and below * above < 0.0 else None


def _distance(s: ComplexArray, wanted: complex) -> FloatArray:
    return np.asarray(np.where(np.isfinite(s), np.abs(s - wanted), np.nan))


def _expect_knobs(reins: Reins) -> None:
    if not reins.names:
        raise DesignError("no knob may move: all are fixed, or the design has none; expected at least one that is free")


def _followed(reins: Reins, way: Sequence[Residual], what: str) -> FloatArray:
    x = np.log(reins.start)
    low, high = np.log(reins.low), np.log(reins.high)
    for step, residual in enumerate(way):
        last = step == len(way) - 1
        x = _reached(reins, x, residual, low, high, what, _THERE if last else 1e-3)
    return x


def _reached(
    reins: Reins, x: FloatArray, residual: Residual, low: FloatArray, high: FloatArray, what: str, near: float
) -> FloatArray:
    r = residual(reins.controller(x))
    for _ in range(_MOST):
        if np.abs(r).max() <= near:
            break
        J = _slopes(reins, x, residual, r)
        # A knob at its end does not move further out.
        free = reins.weights.copy()
        for _ in range(len(x)):
            W = J * free
            normal = W @ J.T
            ridge = 1e-12 * np.trace(normal)
            if not ridge > 0.0:
                raise DesignError(f"{what} does not move with any knob that is free; expected others to be freed")
            dx = -W.T @ np.linalg.solve(normal + ridge * np.eye(len(r)), r)
            out = ((x + dx < low) & (x <= low + 1e-12)) | ((x + dx > high) & (x >= high - 1e-12))
            out &= free > 0.0
            if not out.any():
                break
            free[out] = 0.0
        dx *= min(1.0, _LONGEST / max(float(np.abs(dx).max()), 1e-300))
        better = False
        for _ in range(6):
            new = np.clip(x + dx, low, high)
            try:
                found = residual(reins.controller(new))
            except PlatformCtrlError:
                found = np.full(len(r), np.inf)
            if np.linalg.norm(found) < np.linalg.norm(r):
                x, r, better = new, found, True
                break
            dx = 0.5 * dx
        if not better:
            break
    return x


def _slopes(reins: Reins, x: FloatArray, residual: Residual, r: FloatArray) -> FloatArray:
    out = np.zeros((len(r), len(x)))
    for k in np.flatnonzero(reins.weights > 0.0):
        moved = x.copy()
        moved[k] += _DIFFERENCE
        out[:, k] = (residual(reins.controller(moved)) - r) / _DIFFERENCE
    return np.nan_to_num(out, nan=0.0, posinf=0.0, neginf=0.0)
