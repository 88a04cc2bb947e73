"""The s-plane and the z-plane with their scales, and poles and zeros of several systems in them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from platform_ctrl.analysis.arrays import ComplexArray, scaled
from platform_ctrl.analysis.poles import damping_ratio
from platform_ctrl.analysis.response import LinearSystem
from platform_ctrl.analysis.singular_values import boundary_poles
from platform_ctrl.common.arguments import one_of, positive
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.quantities import HZ, count
from platform_ctrl.job.quantities import plain as number
from platform_ctrl.report.plots.label_placement import LabelPlacer
from platform_ctrl.report.plots.panels import control_plot
from platform_ctrl.report.plots.systems import DrawnSystem, drawn_systems, transmission_zeros
from platform_ctrl.report.style import (
    BAND,
    FRAME,
    INK,
    LIMIT,
    MARKERS,
    MUTED,
    REFERENCE,
    SERIES,
    linear_axis,
    panels,
    standalone,
)

if TYPE_CHECKING:
    import control


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


@check_arguments
@standalone
def pole_map(
    systems: LinearSystem | Sequence[LinearSystem] | Mapping[str, LinearSystem],
    *,
    labels: Sequence[str] | None = None,
    zeros: bool = False,
    plane: Literal["s", "z"] = "s",
    reach: float | None = None,
) -> control.ControlPlot:
    """Poles of one or several systems, continuous and sampled ones together, with damping rays and frequency arcs.

    A sampled system's poles are drawn at s = ln(z)/T; those of a delay, z = 0, are infinitely far to the left.
    Damping and frequency of the least damped poles are written beside them. The lower half plane is the mirror image.

    Parameters
    ----------
    systems
        `control.StateSpace` or `TransferFunction`; several in a list or under their labels in a mapping.
    labels
        What the legend calls them.
    zeros
        Whether to draw the transmission zeros too, of systems with as many inputs as outputs.
    plane
        ``"z"``: the plane of sampled systems as it is; all with the same sample period then.
    reach
        How far the view of the s-plane goes, rad/s; default as far as the slow poles need.

    Returns
    -------
    control.ControlPlot
        One panel; ``lines`` the poles, then the zeros.

    Raises
    ------
    ArgumentError
        Something that has no poles, or an option without sense.
    """
    one_of("pole_map: plane", plane, ("s", "z"))
    drawn = drawn_systems("pole_map", systems, labels, data=False)
    for system in drawn:
        if system.arrays is None:
            raise ArgumentError("pole_map: an improper transfer function has more zeros than poles; add poles")
        if zeros and system.shape[0] != system.shape[1]:
            raise ArgumentError(
                "pole_map: zeros need as many inputs as outputs, "
                f"got {system.shape[1]} inputs and {system.shape[0]} outputs; "
                "choose signals, for example system[['alpha9'], ['Q9']]"
            )
    periods = {system.dt for system in drawn}
    if plane == "z" and (0.0 in periods or len(periods) > 1):
        raise ArgumentError(f"pole_map: plane 'z' needs one sample period > 0 for all systems, got {sorted(periods)} s")
    poles = [_poles(system) for system in drawn]
    every = np.concatenate(poles)
    nyquist = max((system.nyquist for system in drawn if system.dt), default=np.inf)
    nothing = np.zeros(0, dtype=np.complex128)
    view = view_of(every, nothing, nyquist, None if reach is None else positive("pole_map: reach", reach))
    roots = [_in_plane(_zeros(system), system.dt, plane) for system in drawn if zeros]
    names = [system.label or "poles" for system in drawn] + (["zeros"] if any(map(len, roots)) else [])
    _, axes_grid = panels(1, 1, _HEIGHT, names, titles=False)
    axes: Axes = axes_grid[0, 0]
    places = z_plane(axes, periods.pop()) if plane == "z" else s_plane(axes, view)
    lines: list[Line2D] = []
    drawn_zeros: list[Line2D] = []
    for k, (system, s) in enumerate(zip(drawn, poles, strict=True)):
        own: dict[str, Any] = {
            "color": SERIES[k % len(SERIES)],
            "linestyle": "none",
            "markerfacecolor": "none",
            "markeredgewidth": 1.3,
        }
        shown = _in_plane(s, system.dt, plane)
        marker = "x" if k == 0 else MARKERS[k % len(MARKERS)]
        lines += axes.plot(shown.real, shown.imag, marker=marker, markersize=6.5, zorder=4, **own)
        for at in shown:
            places.reserve(at.real, at.imag, 3.5)
        for shown in roots[k : k + 1]:
            circle = own | {"marker": "o", "markersize": 5.0, "markeredgewidth": 0.9}
            drawn_zeros += axes.plot(shown.real, shown.imag, zorder=3, **circle) if len(shown) else []
            for at in shown:
                places.reserve(at.real, at.imag, 3.0)
    for system, s in zip(drawn, poles, strict=True):
        _written(places, system, s, plane)
    places.write_remaining()
    _outside(axes, every, plane)
    handles: list[Any] = list(lines)
    handles += [tuple(drawn_zeros)] if drawn_zeros else []
    return control_plot(axes_grid, [lines], handles, names)


def _poles(system: DrawnSystem) -> ComplexArray:
    """Return the poles, s-plane, those on the stability boundary exactly there; infinite ones for z = 0."""
    assert system.arrays is not None
    A, B, C, _, dt = system.arrays
    if not len(A):
        return np.zeros(0, dtype=np.complex128)
    s, on = boundary_poles(scaled(A, B, C)[0], dt)
    return np.asarray(np.where(on, 1j * s.imag, s), dtype=np.complex128)


def _zeros(system: DrawnSystem) -> ComplexArray:
    assert system.arrays is not None
    A, B, C, D, dt = system.arrays
    return transmission_zeros(*scaled(A, B, C), D, dt)


def _in_plane(s: ComplexArray, dt: float, plane: str) -> ComplexArray:
    """Return poles of the closed upper half plane as they are drawn."""
    with np.errstate(invalid="ignore"):
        upper = s[s.imag >= -1e-9 * np.abs(np.where(np.isfinite(s), s, 1.0))]
    if plane == "s":
        return np.asarray(upper[np.isfinite(upper)])
    return np.asarray(np.where(np.isfinite(upper), np.exp(np.where(np.isfinite(upper), upper, 0.0) * dt), 0.0))


def _written(places: LabelPlacer, system: DrawnSystem, s: ComplexArray, plane: str) -> None:
    """Write damping and frequency of the least damped poles, growth of the unstable ones."""
    upper = s[np.isfinite(s) & (s.imag >= 0.0)]
    ratio = damping_ratio(upper)
    for k in np.argsort(ratio, kind="stable")[:_WRITTEN]:
        pole = upper[k]
        if (ratio[k] > _DAMPED and pole.real <= 0.0) or pole == 0.0:
            continue
        at = np.exp(pole * system.dt) if plane == "z" else pole
        hz = f"{number(abs(pole) * HZ, 3)} Hz"
        if pole.real > 0.0:
            text = f"grows by {number(pole.real, 3)}/s" + (f", {hz}" if pole.imag else "")
            places.write(text, at.real, at.imag, colour=LIMIT, bold=True, required=True)
        else:
            text = f"damping {number(ratio[k], 2)}, {hz}" if pole.real else f"undamped, {hz}"
            places.write(text, at.real, at.imag, colour=INK)


def _outside(axes: Axes, s: ComplexArray, plane: str) -> None:
    """Write how many poles are beyond the view."""
    if plane == "z":
        return
    (left, right), (_, top) = axes.get_xlim(), axes.get_ylim()
    upper = s[~(s.imag < 0.0)]
    inside = (upper.real > left) & (upper.real < right) & (upper.imag < top)
    missing = int(np.count_nonzero(~inside))
    if missing:
        text = f"{count(missing, 'faster pole')} beyond the view"
        axes.annotate(text, (0.0, 0.0), (4, 4), "axes fraction", "offset points", color=MUTED, fontsize=7)
