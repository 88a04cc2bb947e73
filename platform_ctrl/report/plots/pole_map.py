"""Poles and zeros of several systems over damping rays and frequency arcs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from platform_ctrl.analysis.arrays import ComplexArray, StateArrays, named_system, scaled
from platform_ctrl.analysis.poles import continuous_poles, damping_ratio
from platform_ctrl.analysis.singular_values import boundary_poles
from platform_ctrl.analysis.transfer_function import LinearSystem
from platform_ctrl.common.arguments import one_of, positive
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.errors import ArgumentError
from platform_ctrl.report.plots.label_placement import LabelPlacer
from platform_ctrl.report.plots.loci import s_plane, view_of, z_plane
from platform_ctrl.report.plots.panels import control_plot
from platform_ctrl.report.plots.systems import DrawnSystem, drawn_systems
from platform_ctrl.report.quantities import HZ, count
from platform_ctrl.report.quantities import plain as number
from platform_ctrl.report.style import INK, LIMIT, MARKERS, MUTED, SERIES, panels, standalone

if TYPE_CHECKING:
    import control


_HEIGHT = 4.85
# Poles of a system whose damping is written, at most, and up to which damping ratio.
_WRITTEN, _DAMPED = 3, 0.5
# A zero this much faster than all poles is at infinity, but for rounding.
_FAR = 1e6


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
    roots = [_in_plane(_zeros(system, s), system.dt, plane) for system, s in zip(drawn, poles, strict=True) if zeros]
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


def _zeros(system: DrawnSystem, poles: ComplexArray) -> ComplexArray:
    assert system.arrays is not None
    dt = system.dt
    balanced = StateArrays(*scaled(*system.arrays[:3]), system.arrays.D, dt)
    with np.errstate(all="ignore"):
        found = np.asarray(named_system(balanced, system.inputs, system.outputs).zeros(), dtype=np.complex128)
    found = found[np.isfinite(found)]
    largest = np.abs(poles[np.isfinite(poles)]).max(initial=0.0)
    return continuous_poles(found[np.abs(found) < _FAR * (1.0 if dt else largest)], dt)


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
