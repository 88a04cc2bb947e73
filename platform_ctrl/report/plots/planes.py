"""The s-plane and the z-plane as panels: damping rays, frequency arcs, the unstable side shaded; upper halves."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from platform_ctrl.analysis.arrays import ComplexArray
from platform_ctrl.frozen import FloatArray
from platform_ctrl.report.plots.places import Places
from platform_ctrl.report.style import BAND, FRAME, REFERENCE, linear_axis

DAMPINGS = (0.05, 0.1, 0.2, 0.4, 0.6, 0.8)
_HZ = 1.0 / (2.0 * np.pi)
_BELOW, _RIGHT = 0.05, 0.17
_DASHES = (0, (1.2, 1.8))


def round_steps(top: float, number: int = 4) -> FloatArray:
    """Return `number` or so round numbers up to `top`, equally spaced, without 0."""
    rough = top / number
    decade = 10.0 ** np.floor(np.log10(rough))
    step = decade * min((1.0, 2.0, 2.5, 5.0, 10.0), key=lambda unit: abs(np.log(unit * decade / rough)))
    return np.asarray(np.arange(1, int(top / step + 1e-9) + 1) * step)


def s_plane(axes: Axes, reach: float) -> Places:
    """Make `axes` the upper half of the s-plane up to `reach` rad/s, with damping rays and frequency arcs.

    Both axes have the same scale, so that a ray's direction is the damping ratio.
    """
    whole = axes.get_window_extent()
    width, height = whole.width, whole.height
    span = (1.0 + _BELOW) * reach
    across = span * width / height
    left, right = -(1.0 - _RIGHT) * across, _RIGHT * across
    axes.set_xlim(left, right)
    axes.set_ylim(-_BELOW * reach, reach)
    axes.grid(False)
    axes.axvspan(0.0, right, color=BAND, linewidth=0, zorder=0)
    axes.axvline(0.0, color=REFERENCE, linewidth=0.9, zorder=1)
    axes.axhline(0.0, color=REFERENCE, linewidth=0.6, zorder=1)
    turn = np.linspace(0.5 * np.pi, np.pi, 181)
    places = Places(axes)
    for hz in round_steps(reach * _HZ):
        radius = hz / _HZ
        axes.plot(radius * np.cos(turn), radius * np.sin(turn), color=FRAME, linewidth=0.6, linestyle=_DASHES, zorder=1)
        if radius < 0.97 * reach:
            places.later(f"{hz:g} Hz", 0.0, radius, (0,))
    for ratio in DAMPINGS:
        slope = ratio / np.sqrt(1.0 - ratio**2)
        end = min(reach, -left / slope)
        axes.plot([0.0, -slope * end], [0.0, end], color=FRAME, linewidth=0.7, zorder=1)
        at = 0.955 * end
        text = f"{ratio:g}" if ratio != DAMPINGS[1] else f"damping {ratio:g}"
        places.later(text, -slope * at, at, (180, 0))
    linear_axis(axes.xaxis, 8)
    linear_axis(axes.yaxis, 6)
    axes.set_xlabel("real part, 1/s")
    axes.set_ylabel("imaginary part, rad/s")
    return places


def z_plane(axes: Axes, period: float) -> Places:
    """Make `axes` the upper half of the z-plane with the unit circle, damping spirals and frequency rays."""
    axes.set_aspect("equal")
    axes.set_xlim(-1.55, 1.55)
    axes.set_ylim(-0.06, 1.12)
    axes.grid(False)
    turn = np.linspace(0.0, np.pi, 361)
    circle = np.exp(1j * turn)
    x = np.linspace(-1.6, 1.6, 641)
    rim = np.where(np.abs(x) < 1.0, np.sqrt(np.maximum(1.0 - x**2, 0.0)), -0.06)
    axes.fill_between(x, rim, 1.2, color=BAND, linewidth=0, zorder=0)
    axes.plot(circle.real, circle.imag, color=REFERENCE, linewidth=0.9, zorder=1)
    axes.axhline(0.0, color=REFERENCE, linewidth=0.6, zorder=1)
    places = Places(axes)
    for hz in round_steps(0.5 / period, 5):
        angle = hz / _HZ * period
        ray = np.array([0.0, np.exp(1j * angle)])
        axes.plot(ray.real, ray.imag, color=FRAME, linewidth=0.6, linestyle=_DASHES, zorder=1)
        at = np.exp(1j * min(angle, 0.985 * np.pi))
        places.later(f"{hz:g} Hz", at.real, at.imag, (int(np.degrees(angle)), 60, 120))
    for ratio in DAMPINGS[1:]:
        spiral = np.exp(turn * (-ratio / np.sqrt(1.0 - ratio**2) + 1j))
        axes.plot(spiral.real, spiral.imag, color=FRAME, linewidth=0.7, zorder=1)
        at = spiral[150]
        text = f"{ratio:g}" if ratio != DAMPINGS[1] else f"damping {ratio:g}"
        places.later(text, at.real, at.imag, (-90, 90))
    linear_axis(axes.xaxis, 8)
    linear_axis(axes.yaxis, 6)
    axes.set_xlabel("real part of z")
    axes.set_ylabel("imaginary part of z")
    return places


def reach_of(poles: ComplexArray, nyquist: float) -> float:
    """Return how far, rad/s, a view of the s-plane has to go to show `poles`, the very fast ones left out.

    Parameters
    ----------
    poles
        In the s-plane.
    nyquist
        Nyquist frequency of a sampled system, infinite otherwise: what lies beyond its half is delay and roll-off.
    """
    size = np.abs(poles[np.isfinite(poles)])
    size = size[size > 0.0]
    if not size.size:
        return 1.0
    slow = size[size <= 0.5 * nyquist]
    slow = slow if slow.size else size
    # Where a gap of a decade parts the poles, the fast side is left out.
    ordered = np.sort(slow)
    turning = poles[np.isfinite(poles) & (np.abs(poles.imag) > 0.1 * np.abs(poles)) & (np.abs(poles) <= ordered[-1])]
    least = float(np.abs(turning).max(initial=0.0))
    gaps = np.flatnonzero(ordered[1:] > 8.0 * ordered[:-1])
    for gap in gaps[::-1]:
        if ordered[gap] >= least and ordered[gap] > 0.0 and least > 0.0:
            return 1.3 * float(max(ordered[gap], least))
    return 1.3 * float(ordered[-1])
