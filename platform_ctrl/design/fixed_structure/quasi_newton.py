"""BFGS with a weak Wolfe line search, which passes through the kinks of a non-smooth function (Lewis and Overton 2013).

Only one slope is needed at a point: that of the piece which is largest there. What the search has learnt, its inverse
Hessian, can be kept, so that a search goes on where its first part of the work ended.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from platform_ctrl.common.values import FloatArray, value

# x, enough -> value and slope; where the value exceeds `enough` a lower bound of it above `enough` serves, without
# slope: the point is refused.
Slope = Callable[[FloatArray, float], tuple[float, FloatArray]]

# Line search: sufficient decrease, weak Wolfe curvature, most trials.
_DECREASE, _CURVED, _TRIALS = 1e-4, 0.5, 40
# The search ends where so many iterations together decrease the value by no more than this, relative.
_PATIENCE, _PROGRESS = 30, 1e-5
# First step in search coordinates.
_FIRST = 0.3


class Stopped(Exception):
    """The evaluations are used up, or the deadline is over."""


@value
class Descent:
    """Where a descent ended."""

    # x, level: the best point within the bounds, and its value.
    x: FloatArray
    level: float
    inverse: FloatArray | None  # (n, n) or None: inverse Hessian there; None before the first step
    finished: bool  # whether it ended by itself


class _Bounded:
    """The function, continued outside the bounds with a slope back into them."""

    def __init__(self, function: Slope, low: FloatArray, high: FloatArray) -> None:
        self.function, self.low, self.high, self.slope = function, low, high, 0.0

    def at(self, y: FloatArray, enough: float) -> tuple[float, FloatArray, FloatArray]:
        inside = np.minimum(np.maximum(y, self.low), self.high)
        level, gradient = self.function(inside, enough)
        out = y - inside
        if np.any(out):
            gradient = np.where(out == 0.0, gradient, 0.0) + self.slope * np.sign(out)
            level += self.slope * float(np.sum(np.abs(out)))
        return level, gradient, inside


def descended(
    function: Slope,
    x: FloatArray,
    low: FloatArray,
    high: FloatArray,
    *,
    target: float = -np.inf,
    iterations: int = 100000,
    progress: float = _PROGRESS,
    inverse: FloatArray | None = None,
) -> Descent:
    """Return what a descent from x finds within bounds (n,).

    It ends at the value `target`, or where the `function`, which is made small, raises `Stopped`, or where some tens of
    iterations together decrease the value by no more than `progress`, relative. `inverse` is of an earlier descent that
    ended at x.
    """
    bounded = _Bounded(function, low, high)
    best, lowest = np.clip(x, low, high), np.inf
    try:
        level, gradient, best = bounded.at(x, np.inf)
        lowest = level
        if level <= target or not np.isfinite(level):
            return Descent(x=best, level=level, inverse=inverse, finished=True)
        bounded.slope = 1.0 + 2.0 * float(np.linalg.norm(gradient))
        recent = [level]
        for _ in range(iterations):
            direction, inverse = _direction(gradient, inverse)
            if direction is None:
                break
            found = _searched(bounded, x, level, direction, float(gradient @ direction), target)
            if found is None:
                # Along a direction of no decrease the inverse Hessian is of no more use.
                break
            y, new_level, new_gradient, inside, wolfe = found
            inverse = _updated(inverse, y - x, new_gradient - gradient)
            x, level, gradient = y, new_level, new_gradient
            if level < lowest:
                best, lowest = inside, level
            if level <= target or not wolfe:
                break
            recent.append(level)
            if len(recent) > _PATIENCE and recent[-_PATIENCE] - level < progress * abs(level):
                break
    except Stopped:
        return Descent(x=best, level=lowest, inverse=inverse, finished=False)
    return Descent(x=best, level=lowest, inverse=inverse, finished=True)


def _direction(gradient: FloatArray, inverse: FloatArray | None) -> tuple[FloatArray | None, FloatArray | None]:
    """Return a direction of descent, None where there is none, and the inverse Hessian that it came from."""
    size = float(np.linalg.norm(gradient))
    if not size > 1e-300 or not np.isfinite(size):
        return None, inverse
    if inverse is not None:
        direction = -inverse @ gradient
        if float(gradient @ direction) < 0.0:
            return direction, inverse
    return -gradient * (_FIRST / max(size, _FIRST)), None


def _searched(
    bounded: _Bounded, x: FloatArray, level: float, direction: FloatArray, along: float, target: float
) -> tuple[FloatArray, float, FloatArray, FloatArray, bool] | None:
    """Return a point with sufficient decrease, and whether its slope is weak Wolfe; None where there is no decrease."""
    near, far, t = 0.0, np.inf, 1.0
    found = None
    for _ in range(_TRIALS):
        y = x + t * direction
        enough = level + _DECREASE * t * along
        new_level, gradient, inside = bounded.at(y, enough)
        if not new_level < enough:
            far = t
        else:
            wolfe = not float(gradient @ direction) < _CURVED * along
            found = y, new_level, gradient, inside, wolfe
            if wolfe or new_level <= target:
                return found
            near = t
        t = 0.5 * (near + far) if np.isfinite(far) else 2.0 * near
        if t == near:
            break
    return found


def _updated(inverse: FloatArray | None, s: FloatArray, change: FloatArray) -> FloatArray | None:
    """Return the BFGS update of the inverse Hessian."""
    sy = float(s @ change)
    if not sy > 1e-14 * float(np.linalg.norm(s) * np.linalg.norm(change)):
        return inverse
    if inverse is None:
        inverse = np.eye(len(s)) * (sy / float(change @ change))
    hy = inverse @ change
    crossed = np.outer(hy, s)
    return np.asarray(inverse + (1.0 + float(change @ hy) / sy) / sy * np.outer(s, s) - (crossed + crossed.T) / sy)
