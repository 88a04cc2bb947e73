"""Drag a closed-loop pole or the crossover somewhere: the sliders that may move follow, as little as they can.

The logarithms of the sliders take Gauss-Newton steps of least norm, dx = W Jᵀ (J W Jᵀ)⁻¹ r, along a straight path from
where the pole is to its target, so that it stays the same pole. Where a requirement would become violated, steps that
keep its linearisation go on along the limit.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray, StateArrays
from platform_ctrl.analysis.feedback import closed_loop, sensitivity_functions
from platform_ctrl.analysis.poles import continuous_poles, poles
from platform_ctrl.analysis.response import frequency_response
from platform_ctrl.app.curves import channel_response
from platform_ctrl.app.least_squares import constrained_least_squares
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import DesignError, PlatformCtrlError

Build = Callable[[Mapping[str, float]], StateArrays]
Ratios = Callable[[Mapping[str, float]], FloatArray]
# Of the sliders' logarithms.
Residual = Callable[[FloatArray], FloatArray]

# Most steps along a path, and the relative length of a step if fewer suffice.
_MAX_STEPS, _STEP = 8, 0.05
# Most Gauss-Newton iterations for each, and the largest change of a logarithm in one: a parameter may cross its whole
# range, a factor of 20 to both sides and as much again below, and needs some more to converge.
_MAX_ITERATIONS, _MAX_CHANGE = 45, 0.3
# A full step that reduces the distance by a smaller share: the target cannot be reached.
_STALLED = 1e-3
# Relative distance at which the target counts as reached.
_TARGET_TOLERANCE = 1e-9
# Relative deviation of a gain that still counts as 1, and bisections between a reachable and an unreachable crossover.
_GAIN_TOLERANCE, _BISECTIONS = 1e-6, 5
# Relative distance to both sides at which the gain has to be above and below 1.
_SIDE_STEP = 1e-3
# Largest change of a slider's logarithm relative to the relative way of what is dragged, beside a small one: a pole
# that hardly moves with the sliders does not carry them off.
REACH, _LEAST_REACH = 2.0, 0.02
# What such a drag is limited by, in the words of the page.
SLIDERS = "the change of the sliders"
# Step of finite differences, in logarithms.
_DIFFERENCE = 1e-6
# Share of the distance to the target that a step along a limit has to make for another to follow, and the relative
# distance that cannot be seen.
_PROGRESS, _INVISIBLE = 0.02, 5e-4
# Error of a ratio on a frequency grid.
_GRID_ERROR = 0.02
# Weight of a relative distance to the target against the logarithm of a slider.
_PLACE_WEIGHT = 100.0
# Distance that a step along a limit keeps from it, for its curvature, and how often it is halved if that is not enough.
_INSIDE, _MAX_HALVINGS = 1e-3, 4


@value
class FreeParameters:
    """The sliders that may move, and the sampled controller that `build` makes of them.

    `start` (k,) are their values, `low` and `high` the ends, and `weights` (k,) how easily each moves. `origin` (k,)
    are their values when the drag began.
    """

    names: tuple[str, ...]
    start: FloatArray
    low: FloatArray
    high: FloatArray
    weights: FloatArray
    build: Build
    origin: FloatArray

    def controller(self, x: FloatArray) -> StateArrays:
        """Return the controller for logarithms of the sliders."""
        return self.build(self.numbers(x))

    def within(self, distance: float) -> FreeParameters:
        """Return the sliders with ends as far from their origin as a drag over a relative `distance` may move them."""
        reach = math.exp(min(REACH * distance + _LEAST_REACH, 700.0))
        low, high = np.maximum(self.low, self.origin / reach), np.minimum(self.high, self.origin * reach)
        return dataclasses.replace(self, low=np.minimum(low, self.start), high=np.maximum(high, self.start))

    def at_end(self, x: FloatArray) -> bool:
        """Return whether a slider stands at one of its ends."""
        return bool(np.any((x <= np.log(self.low) + 1e-9) | (x >= np.log(self.high) - 1e-9)))

    def numbers(self, x: FloatArray) -> dict[str, float]:
        """Return the values of logarithms `x`; one that has not moved has exactly the value that it started with."""
        moved = self.start * np.exp(x - np.log(self.start))
        return {name: float(v) for name, v in zip(self.names, moved, strict=True)}


@value
class Limits:
    """The requirements that are met at the start of a drag, and that it must keep.

    `bound` (k,) are the ratios up to which they count as met. Functions of the sliders give their ratios (k,): `exact`
    as the page shows them; `rough` on a frequency grid, which misses peaks between its points; `near` on a grid,
    corrected by its error at the start; `local` the same for the deciding plants alone, for slopes. `steps` is the
    largest number of steps along a limit: dragging calls again and again.
    """

    names: tuple[str, ...]
    bound: FloatArray
    exact: Ratios
    rough: Ratios
    near: Ratios
    local: Ratios
    steps: int = 2

    def broken(self, ratios: Ratios, numbers: Mapping[str, float], slack: float = 0.0) -> tuple[str, ...]:
        """Return the names of the requirements that these sliders violate; all of them if the loop cannot be built."""
        if not self.names:
            return ()
        try:
            beyond = ~(ratios(numbers) <= self.bound + slack)
        except PlatformCtrlError:
            return self.names
        return tuple(name for name, one in zip(self.names, beyond, strict=True) if one)


NO_LIMITS = Limits(
    names=(),
    bound=np.zeros(0),
    exact=lambda _: np.zeros(0),
    rough=lambda _: np.zeros(0),
    near=lambda _: np.zeros(0),
    local=lambda _: np.zeros(0),
)


@value
class DragResult:
    """Where a drag has brought the sliders, and which requirements kept it from going all the way."""

    numbers: dict[str, float]
    limited_by: tuple[str, ...] = ()


def dragged_pole(
    parameters: FreeParameters, plant: StateArrays, pole: complex, target: complex, limits: Limits = NO_LIMITS
) -> DragResult:
    """Return the sliders that bring the closed-loop pole nearest to `pole` to `target`, or as near as they can.

    Poles are s-plane equivalents ln(z)/T, rad/s. No requirement of `limits` is missed on the way: where one would be,
    the pole goes on along the limit.
    """
    _expect_sliders(parameters)

    def poles(x: FloatArray) -> ComplexArray:
        return _poles(parameters.controller(x), plant)

    low, high = np.log(parameters.low), np.log(parameters.high)
    x = np.log(parameters.start)
    here = _nearest(poles(x), pole)
    real = abs(here.imag) < 1e-9 * abs(here)
    goal = complex(target.real, 0.0 if real else abs(target.imag))
    here = here if here.imag >= 0.0 else here.conjugate()
    scale = max(abs(here), abs(goal), 1e-12)

    def residual(place: complex) -> Residual:
        def of(x: FloatArray) -> FloatArray:
            away = _nearest(poles(x), place) - place
            return np.array([away.real] if real else [away.real, away.imag]) / scale

        return of

    what = f"the pole at {here:.4g} rad/s"
    path, first, limited_by = [x], here, NO_LIMITS.names
    shares = _shares(abs(goal - here) / scale)
    for share in shares:
        last = share == shares[-1]
        place = first + (goal - first) * share
        new = _reached(parameters, path[-1], residual(place), low, high, what, _TARGET_TOLERANCE if last else 1e-3)
        numbers = parameters.numbers(new)
        limited_by = limits.broken(limits.rough, numbers, _GRID_ERROR)
        if last and not limited_by:
            # As the page judges it, which then need not be done again.
            limited_by = limits.broken(limits.exact, numbers)
        if limited_by:
            path += _along(parameters, limits, path[-1], goal, residual, poles, here)
            break
        path.append(new)
        here = place
    result = _met(parameters, limits, path, limited_by)
    short = abs(_nearest(poles(path[-1]), goal) - goal) > _INVISIBLE * scale
    if short and not result.limited_by and parameters.at_end(path[-1]):
        return dataclasses.replace(result, limited_by=(SLIDERS,))
    return result


def dragged_slider(parameters: FreeParameters, name: str, target: float, limits: Limits = NO_LIMITS) -> DragResult:
    """Return the sliders with the one called `name` at `target`, or as near as it may come.

    It moves alone; where a requirement would be missed the others follow as little as keeps it.
    """
    if name not in parameters.names:
        raise DesignError(f"{name}: the slider is fixed; free it to drag it")
    k = parameters.names.index(name)
    x = np.log(parameters.start)
    goal = float(np.clip(math.log(target), math.log(parameters.low[k]), math.log(parameters.high[k])))
    path, first, limited_by = [x], x[k], NO_LIMITS.names
    shares = _shares(abs(goal - first))
    for share in shares:
        new = path[-1].copy()
        new[k] = first + share * (goal - first)
        limited_by = limits.broken(limits.exact if share == shares[-1] else limits.near, parameters.numbers(new))
        if limited_by:
            path.append(_last_within(parameters, limits, path[-1], new))
            break
        path.append(new)
    for _ in range(limits.steps if limited_by else 0):
        found = _kept_step(parameters, limits, path[-1], lambda x: np.array([x[k] - goal]))
        if found is None:
            break
        path.append(found)
    return _met(parameters, limits, path, limited_by)


def _last_within(parameters: FreeParameters, limits: Limits, good: FloatArray, beyond: FloatArray) -> FloatArray:
    """Return the last place from a good one on the way to one beyond a limit that keeps all of them, by bisection."""
    for _ in range(_BISECTIONS):
        middle = 0.5 * (good + beyond)
        if limits.broken(limits.exact, parameters.numbers(middle)):
            beyond = middle
        else:
            good = middle
    return good


def _along(
    parameters: FreeParameters,
    limits: Limits,
    x: FloatArray,
    goal: complex,
    residual: Callable[[complex], Residual],
    poles: Callable[[FloatArray], ComplexArray],
    here: complex,
) -> list[FloatArray]:
    """Return the values, one step after another, with which the pole comes nearer to the goal within all limits."""
    out: list[FloatArray] = []
    here = _nearest(poles(x), here)
    for _ in range(limits.steps):
        away = abs(goal - here)
        target = here + (goal - here) * min(1.0, _STEP * abs(goal) / max(away, 1e-300))
        found = _kept_step(parameters, limits, x, residual(target))
        if found is None:
            break
        x, here = found, _nearest(poles(found), target)
        out.append(x)
        if abs(goal - here) < _INVISIBLE * abs(goal) or abs(goal - here) > (1.0 - _PROGRESS) * away:
            break
    return out


def _met(parameters: FreeParameters, limits: Limits, path: list[FloatArray], limited_by: tuple[str, ...]) -> DragResult:
    """Return the last place of a path at which every limit is met as the page measures it, and what holds it there."""
    while len(path) > 1 and (narrow := limits.broken(limits.exact, parameters.numbers(path[-1]))):
        # A peak between the points of a grid.
        limited_by = narrow
        path.pop()
    numbers = parameters.numbers(path[-1])
    if limited_by:
        # A long step breaks much at once: what is next to its limit is what holds.
        tight = limits.local(numbers) > limits.bound - 5.0 * _INSIDE
        limited_by = tuple(name for name, one in zip(limits.names, tight, strict=True) if one) or limited_by
    return DragResult(numbers=numbers, limited_by=limited_by)


def _kept_step(parameters: FreeParameters, limits: Limits, x: FloatArray, residual: Residual) -> FloatArray | None:
    """Return a step towards a smaller residual that keeps all limits, by their slopes and then in truth, or None."""
    numbers = parameters.numbers
    r = residual(x)
    J = slopes(parameters, x, residual, r)
    ratios, G = limit_slopes(parameters, limits, x)
    low, high = np.log(parameters.low), np.log(parameters.high)
    reach = (np.clip(way, 0.0, _MAX_CHANGE) for way in (high - x, x - low))
    A = np.vstack([_PLACE_WEIGHT * J, np.diag(1.0 / np.sqrt(np.maximum(parameters.weights, 1e-12)))])
    b = np.concatenate([-_PLACE_WEIGHT * r, np.zeros(len(x))])
    within = np.vstack([G, np.eye(len(x)), -np.eye(len(x))])
    room = np.concatenate([np.maximum(limits.bound - _INSIDE - ratios, 0.0), *reach])
    dx = constrained_least_squares(A, b, within, room)
    for _ in range(_MAX_HALVINGS):
        new = np.clip(x + dx, low, high)
        try:
            nearer = bool(np.linalg.norm(residual(new)) < np.linalg.norm(r))
        except PlatformCtrlError:
            nearer = False
        if nearer and not limits.broken(limits.near, numbers(new)):
            return new
        dx = 0.5 * dx
    return None


def limit_slopes(parameters: FreeParameters, limits: Limits, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the ratios (m,) at `x` and their slopes (m, k)."""

    def local(x: FloatArray) -> FloatArray:
        return limits.local(parameters.numbers(x))

    ratios = local(x)
    return ratios, slopes(parameters, x, local, ratios)


def dragged_crossover(
    parameters: FreeParameters, plant: StateArrays, channel: int, now: float, target: float, limits: Limits = NO_LIMITS
) -> DragResult:
    """Return the sliders that bring the gain of one channel, all others closed, to 1 at `target` rad/s.

    It stops where a requirement of `limits` would be missed.
    """
    _expect_sliders(parameters)
    nyquist = math.pi / plant.dt
    if not 0.0 < target < nyquist:
        raise DesignError(f"crossover: {target:.4g} rad/s is not below the Nyquist frequency of {nyquist:.4g} rad/s")

    residual = crossover_residual(parameters, plant, channel)
    what = f"the gain at {target:.4g} rad/s"
    limited_by: tuple[str, ...] = ()

    def crossing(x: FloatArray, w: float) -> FloatArray | None:
        nonlocal limited_by
        found = _crossing(parameters, x, residual, w, what)
        broken = () if found is None else limits.broken(limits.near, parameters.numbers(found))
        limited_by = broken or limited_by
        return None if broken else found

    path, here, beyond = [np.log(parameters.start)], now, math.nan
    for share in _shares(abs(math.log(target / now))):
        w = now * (target / now) ** share
        found = crossing(path[-1], w)
        if found is None:
            beyond = w
            break
        path.append(found)
        here = w
    # Where it cannot go all the way it goes as far as it can: a gain that passes 1 nowhere is not taken hold of again.
    for _ in range(0 if math.isnan(beyond) else _BISECTIONS):
        middle = math.sqrt(here * beyond)
        found = crossing(path[-1], middle)
        if found is None:
            beyond = middle
        else:
            path.append(found)
            here = middle
    result = _met(parameters, limits, path, limited_by)
    if not math.isnan(beyond) and not result.limited_by:
        return dataclasses.replace(result, limited_by=(SLIDERS,))
    return result


def crossover_residual(parameters: FreeParameters, plant: StateArrays, channel: int) -> Callable[[float], Residual]:
    """Return the function from a frequency, rad/s, to the logarithm of the channel's gain there."""

    def residual(w: float) -> Residual:
        grid = np.array([w])
        P = frequency_response(plant, grid, -3)

        def of(x: FloatArray) -> FloatArray:
            K = parameters.controller(x)
            L = channel_response(sensitivity_functions(-frequency_response(K, grid, -3) @ P)[0], channel)
            return np.log(np.maximum(np.abs(L), 1e-300))

        return of

    return residual


def nearest_pole(parameters: FreeParameters, plant: StateArrays, x: FloatArray, place: complex) -> complex:
    """Return the closed-loop pole nearest to a place, rad/s."""
    return _nearest(_poles(parameters.controller(x), plant), place)


def _poles(K: StateArrays, plant: StateArrays) -> ComplexArray:
    return continuous_poles(poles(closed_loop(plant, K).A), plant.dt)


def _nearest(s: ComplexArray, target: complex) -> complex:
    return complex(s[int(np.nanargmin(_distance(s, target)))])


def _shares(distance: float) -> list[float]:
    """Return the steps along a path as shares of it: while dragging each call is a short one."""
    count = min(_MAX_STEPS, max(1, math.ceil(distance / _STEP)))
    return [(k + 1) / count for k in range(count)]


def _crossing(
    parameters: FreeParameters, x: FloatArray, residual: Callable[[float], Residual], w: float, what: str
) -> FloatArray | None:
    """Return where the gain passes 1 at w, from x on; None where it does not get there, or only touches 1."""
    found = _reached(
        parameters, x, residual(w), np.log(parameters.low), np.log(parameters.high), what, _TARGET_TOLERANCE
    )
    below, at, above = (float(residual(w * share)(found)[0]) for share in (1.0 - _SIDE_STEP, 1.0, 1.0 + _SIDE_STEP))
    return found if abs(at) <= _GAIN_TOLERANCE and below * above < 0.0 else None


def _distance(s: ComplexArray, target: complex) -> FloatArray:
    return np.asarray(np.where(np.isfinite(s), np.abs(s - target), np.nan))


def _expect_sliders(parameters: FreeParameters) -> None:
    if not parameters.names:
        raise DesignError("no slider may move: all are fixed, or the design has none; free at least one")


def _reached(
    parameters: FreeParameters,
    x: FloatArray,
    residual: Residual,
    low: FloatArray,
    high: FloatArray,
    what: str,
    near: float,
) -> FloatArray:
    r = residual(x)
    for _ in range(_MAX_ITERATIONS):
        if np.abs(r).max() <= near:
            break
        J = slopes(parameters, x, residual, r)
        # A slider at its end does not move further out.
        free = parameters.weights.copy()
        for _ in range(len(x)):
            W = J * free
            normal = W @ J.T
            ridge = 1e-12 * np.trace(normal)
            if not ridge > 0.0 and not np.array_equal(free, parameters.weights):
                return x  # whatever moves it stands at its end
            if not ridge > 0.0:
                raise DesignError(f"{what} does not move with any slider that is free; free others")
            dx = -W.T @ np.linalg.solve(normal + ridge * np.eye(len(r)), r)
            out = ((x + dx < low) & (x <= low + 1e-12)) | ((x + dx > high) & (x >= high - 1e-12))
            out &= free > 0.0
            if not out.any():
                break
            free[out] = 0.0
        share = min(1.0, _MAX_CHANGE / max(float(np.abs(dx).max()), 1e-300))
        dx *= share
        before, better = float(np.linalg.norm(r)), False
        for _ in range(6):
            new = np.clip(x + dx, low, high)
            try:
                found = residual(new)
            except PlatformCtrlError:
                found = np.full(len(r), np.inf)
            if np.linalg.norm(found) < before:
                x, r, better = new, found, True
                break
            dx = 0.5 * dx
        if not better or (share == 1.0 and np.linalg.norm(r) > (1.0 - _STALLED) * before):
            break
    return x


def slopes(parameters: FreeParameters, x: FloatArray, residual: Residual, r: FloatArray) -> FloatArray:
    """Return the slopes (m, k) of a function of the sliders' logarithms that is `r` (m,) at `x`."""
    out = np.zeros((len(r), len(x)))
    for k in np.flatnonzero(parameters.weights > 0.0):
        moved = x.copy()
        moved[k] += _DIFFERENCE
        out[:, k] = (residual(moved) - r) / _DIFFERENCE
    return np.nan_to_num(out, nan=0.0, posinf=0.0, neginf=0.0)
