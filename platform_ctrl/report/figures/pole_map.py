"""The upper half of the s-plane with its scales."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from platform_ctrl.analysis.system import ComplexArray
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.job.quantities import HZ
from platform_ctrl.report.figures.panels import LabelPlacer
from platform_ctrl.report.style import BAND, FRAME, REFERENCE, linear_axis

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
    across = (1.0 + _BELOW) * reach * whole.width / whole.height / view.stretch
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


def view_of(ends: ComplexArray, between: ComplexArray, nyquist: float) -> View:
    """Return a view of the s-plane that shows the poles `ends`, 1/s, and those `between` that are no faster.

    Very fast poles are left out, and of a sampled system those beyond half the Nyquist frequency: delay and roll-off.
    """
    every = np.concatenate([ends, between])
    s = every[np.isfinite(every) & (np.abs(every) <= _bound(ends, nyquist))]
    up, left, right = (_BEYOND * float(np.max(x, initial=0.0)) for x in (np.abs(s.imag), -s.real, s.real))
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
