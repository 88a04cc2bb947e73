"""The s-plane and the z-plane with their scales."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from platform_ctrl.analysis.arrays import ComplexArray
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.job.quantities import HZ
from platform_ctrl.report.plots.label_placement import LabelPlacer
from platform_ctrl.report.style import (
    BAND,
    FRAME,
    REFERENCE,
    linear_axis,
)

if TYPE_CHECKING:
    pass


DAMPINGS = (0.05, 0.1, 0.2, 0.4, 0.6, 0.8)
_BELOW, _RIGHT, _MOST_RIGHT = 0.05, 0.17, 0.75
# Width of a panel over the height above the real axis, about; room beyond the outermost pole; a gap between poles.
_ASPECT, _BEYOND, _GAP = 1.95, 1.2, 8.0
# Poles within this share of the width are drawn stretched, so much at most; within 1/_FLAT they are on the axis.
_SLIM, _STRETCH, _FLAT = 0.35, 12.0, 400.0
_DASHES = (0, (1.2, 1.8))


@value
class View:
    """How much of the s-plane is shown."""

    reach: float  # Up to which imaginary part, rad/s
    right: float = _RIGHT  # Share of the panel to the right of the imaginary axis
    stretch: float = 1.0  # How much longer a real part is drawn than an imaginary one


def round_steps(top: float) -> FloatArray:
    """Return at most six round numbers up to `top`, equally spaced, without 0."""
    steps = np.asarray(MaxNLocator(6, steps=[1, 2, 2.5, 5, 10]).tick_values(0.0, top))
    return steps[(steps > 0.0) & (steps <= top * (1.0 + 1e-9))]


def s_plane(axes: Axes, view: View) -> LabelPlacer:
    """Make `axes` the upper half of the s-plane, with damping rays and frequency arcs.

    Both axes have the same scale, so that a ray's direction is the damping ratio; unless all poles lie close to the
    imaginary axis, where rays and arcs are stretched with them.
    """
    reach = view.reach
    whole = axes.get_window_extent()
    width, height = whole.width, whole.height
    span = (1.0 + _BELOW) * reach
    across = span * width / height / view.stretch
    left, right = -(1.0 - view.right) * across, view.right * across
    axes.set_xlim(left, right)
    axes.set_ylim(-_BELOW * reach, reach)
    axes.grid(False)
    axes.axvspan(0.0, right, color=BAND, linewidth=0, zorder=0)
    axes.axvline(0.0, color=REFERENCE, linewidth=0.9, zorder=1)
    axes.axhline(0.0, color=REFERENCE, linewidth=0.6, zorder=1)
    turn = np.linspace(0.5 * np.pi, np.pi, 181)
    places = LabelPlacer(axes)
    for hz in round_steps(reach * HZ):
        radius = hz / HZ
        axes.plot(radius * np.cos(turn), radius * np.sin(turn), color=FRAME, linewidth=0.6, linestyle=_DASHES, zorder=1)
        if radius < 0.97 * reach:
            places.write_later(f"{hz:g} Hz", 0.0, radius, (0,))
    for ratio in DAMPINGS:
        slope = ratio / np.sqrt(1.0 - ratio**2)
        end = min(reach, -left / slope)
        axes.plot([0.0, -slope * end], [0.0, end], color=FRAME, linewidth=0.7, zorder=1)
        at = 0.955 * end
        text = f"{ratio:g}" if ratio != DAMPINGS[1] else f"damping {ratio:g}"
        places.write_later(text, -slope * at, at, (180, 0))
    linear_axis(axes.xaxis, 8)
    linear_axis(axes.yaxis, 6)
    axes.set_xlabel("real part, 1/s")
    axes.set_ylabel("imaginary part, rad/s")
    return places


def z_plane(axes: Axes, period: float) -> LabelPlacer:
    """Make `axes` the upper half of the z-plane with the unit circle, damping spirals and frequency rays."""
    axes.set_aspect("equal")
    axes.set_xlim(-1.25, 1.25)
    axes.set_ylim(-0.06, 1.12)
    axes.grid(False)
    turn = np.linspace(0.0, np.pi, 361)
    circle = np.exp(1j * turn)
    x = np.linspace(-1.6, 1.6, 641)
    rim = np.where(np.abs(x) < 1.0, np.sqrt(np.maximum(1.0 - x**2, 0.0)), -0.06)
    axes.fill_between(x, rim, 1.2, color=BAND, linewidth=0, zorder=0)
    axes.plot(circle.real, circle.imag, color=REFERENCE, linewidth=0.9, zorder=1)
    axes.axhline(0.0, color=REFERENCE, linewidth=0.6, zorder=1)
    places = LabelPlacer(axes)
    for hz in round_steps(0.5 / period):
        angle = hz / HZ * period
        ray = np.array([0.0, np.exp(1j * angle)])
        axes.plot(ray.real, ray.imag, color=FRAME, linewidth=0.6, linestyle=_DASHES, zorder=1)
        at = np.exp(1j * min(angle, 0.985 * np.pi))
        places.write_later(f"{hz:g} Hz", at.real, at.imag, (int(np.degrees(angle)), 60, 120))
    for ratio in DAMPINGS[1:]:
        spiral = np.exp(turn * (-ratio / np.sqrt(1.0 - ratio**2) + 1j))
        axes.plot(spiral.real, spiral.imag, color=FRAME, linewidth=0.7, zorder=1)
        at = spiral[150]
        text = f"{ratio:g}" if ratio != DAMPINGS[1] else f"damping {ratio:g}"
        places.write_later(text, at.real, at.imag, (-90, 90))
    linear_axis(axes.xaxis, 8)
    linear_axis(axes.yaxis, 6)
    axes.set_xlabel("real part of z")
    axes.set_ylabel("imaginary part of z")
    return places


def view_of(ends: ComplexArray, between: ComplexArray, nyquist: float, reach: float | None = None) -> View:
    """Return a view of the s-plane that shows the poles `ends`, 1/s, and those `between` that are no faster.

    Very fast poles are left out, and of a sampled system those beyond half the Nyquist frequency: delay and roll-off.
    """
    bound = _bound(ends, nyquist)
    every = np.concatenate([ends, between])
    s = every[np.isfinite(every) & (np.abs(every) <= bound)]
    up, left, right = (_BEYOND * float(np.max(x, initial=0.0)) for x in (np.abs(s.imag), -s.real, s.real))
    if reach is None:
        reach = max(up, (left + right) / _ASPECT) or 1.0
        share = float(np.clip(right / (_ASPECT * reach), _RIGHT, _MOST_RIGHT))
        reach = max(reach, left / ((1.0 - share) * _ASPECT))
    across = whole = _ASPECT * reach
    if whole / _FLAT < left + right < _SLIM * whole:
        # Little damping: what there is to see lies in a narrow strip.
        across = max(left + right, whole / _STRETCH)
    share = float(np.clip(right / across, _RIGHT, _MOST_RIGHT))
    across = max(across, min(max(left / (1.0 - share), right / share), whole))
    return View(reach=reach, right=share, stretch=whole / across)


def _bound(poles: ComplexArray, nyquist: float) -> float:
    """Return the largest |s| that is worth showing."""
    size = np.abs(poles[np.isfinite(poles)])
    size = size[size > 0.0]
    if not size.size:
        return 1.0
    slow = size[size <= 0.5 * nyquist]
    ordered = np.sort(slow if slow.size else size)
    turning = np.isfinite(poles) & (np.abs(poles.imag) > 0.1 * np.abs(poles)) & (np.abs(poles) <= ordered[-1])
    least = float(np.abs(poles[turning]).max(initial=0.0))
    # Where most of a decade parts the poles and nothing swings beyond, the fast side is left out.
    for gap in np.flatnonzero(ordered[1:] > _GAP * ordered[:-1])[::-1]:
        if ordered[gap] >= least > 0.0:
            return float(ordered[gap]) * (1.0 + 1e-9)
    return float(ordered[-1]) * (1.0 + 1e-9)


def upper_half_plane(z: ComplexArray) -> ComplexArray:
    """Return the finite poles of the closed upper half plane."""
    return np.asarray(z[np.isfinite(z.real) & (z.imag >= -1e-9 * np.maximum(np.abs(z), 1e-12))])


_HEIGHT = 4.85
# Poles of a system whose damping is written, at most, and up to which damping ratio.
_WRITTEN, _DAMPED = 3, 0.5
