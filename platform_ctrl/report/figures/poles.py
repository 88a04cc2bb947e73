"""The s-plane of one loop: the poles of its designs over all plants, and those of the closed one over its gain."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from platform_ctrl.common.arguments import positive
from platform_ctrl.job.job import LoopSpec
from platform_ctrl.report.figures.limit_lines import damping_lines, fastest_pole_line
from platform_ctrl.report.figures.loop import design_names
from platform_ctrl.report.loop_responses import LoopResponses, RootLocus
from platform_ctrl.report.plots.loci import upper_half_plane
from platform_ctrl.report.style import (
    BAND,
    INK,
    MARKERS,
    REFERENCE,
    SERIES,
    legend_above,
    legend_rows,
    linear_axis,
    panels,
)

_LABELLED_GAINS = (0.0, 0.5, 1.0, 1.5, 2.0)


def pole_figure(responses: LoopResponses, spec: LoopSpec, nutation: float, period: float) -> Figure:
    """Closed-loop poles of the nominal plant (strong), of uncertain plants (faint) and with faults (crosses)."""
    names = design_names(responses)
    figure, [[wide, close]] = panels(1, 2, 3.7, legend=legend_rows(names))
    nyquist = np.pi / period
    handles = []
    for axes in (wide, close):
        for k, one in enumerate(responses.designs):
            varied, faults, own = (upper_half_plane(s) for s in (one.varied_poles, one.fault_poles, one.poles))
            style: dict[str, Any] = {"color": SERIES[k % 8], "linestyle": "none", "marker": MARKERS[k % 8]}
            axes.plot(varied.real, varied.imag, **style | {"markersize": 1.8, "alpha": 0.35, "markeredgewidth": 0})
            crossed = {"marker": "x", "markersize": 2.6, "alpha": 0.75, "markeredgewidth": 0.7}
            axes.plot(faults.real, faults.imag, **style | crossed)
            drawn = axes.plot(
                own.real, own.imag, **style | {"markersize": 6, "markerfacecolor": "none", "markeredgewidth": 1.3}
            )
            handles += drawn if axes is wide else []
    _s_plane(wide, -1.1 * nyquist, 0.12 * nyquist, 1.02 * nyquist, spec, period, named=False)
    extent = 1.7 * positive("nutation", nutation)
    _s_plane(close, -1.2 * extent, 0.18 * extent, extent, spec, period, named=True)
    wide.set_title("all poles up to the Nyquist frequency")
    close.set_title("closer to the origin")
    legend_above(figure, handles, names)
    return figure


def root_locus_figure(locus: RootLocus, spec: LoopSpec, nutation: float, period: float) -> Figure:
    """Poles of the closed design while its gain goes from 0 to twice its value."""
    figure, [[wide, close]] = panels(1, 2, 3.9, legend=1)
    nyquist = np.pi / period
    handles: list[Any] = []
    marks = [int(np.argmin(np.abs(locus.gains - g))) for g in _LABELLED_GAINS if g <= locus.gains[-1]]
    for axes in (wide, close):
        for branch in locus.branches.T:
            shown = np.where(branch.imag > -1e-6 * nyquist, branch, np.nan)
            if np.isfinite(shown.real).any():
                axes.plot(shown.real, shown.imag, "-", color=SERIES[0], linewidth=1.1)
        for n, k in enumerate(marks):
            points = upper_half_plane(locus.branches[k])
            nominal = abs(locus.gains[k] - 1.0) < 1e-9
            drawn = axes.plot(
                points.real,
                points.imag,
                linestyle="none",
                marker=MARKERS[n % 8],
                markersize=6.5 if nominal else 4.0,
                color=SERIES[1] if nominal else SERIES[0],
                markerfacecolor="none",
            )
            handles += drawn if axes is wide else []
    _s_plane(wide, -1.1 * nyquist, 0.12 * nyquist, 1.02 * nyquist, spec, period, named=False)
    extent = 1.7 * positive("nutation", nutation)
    _s_plane(close, -1.2 * extent, 0.18 * extent, extent, spec, period, named=True)
    _label_gains(close, locus, marks, extent)
    legend_above(figure, handles, [f"{locus.gains[k]:g} × gain" for k in marks])
    wide.set_title("all branches up to the Nyquist frequency")
    close.set_title("closer to the origin")
    return figure


def _label_gains(axes: Axes, locus: RootLocus, marks: list[int], extent: float) -> None:
    """Write the gains along the two branches that matter: the least damped one and the slowest oscillating one."""
    at_one = locus.branches[int(np.argmin(np.abs(locus.gains - 1.0)))]
    inside = (at_one.imag > 0.02 * extent) & (at_one.imag < extent) & (at_one.real > -1.2 * extent)
    if not inside.any():
        return
    ratio = np.where(inside, -at_one.real / np.abs(at_one), np.inf)
    branch = locus.branches[:, int(np.argmin(ratio))]
    last: complex | None = None
    for k in marks:
        s = branch[k]
        visible = 0.0 <= s.imag < extent and -1.2 * extent < s.real < 0.18 * extent
        if visible and (last is None or abs(s - last) > 0.045 * extent):
            axes.annotate(
                f"{locus.gains[k]:g}", (s.real, s.imag), (6, 3), textcoords="offset points", fontsize=7.5, color=INK
            )
            last = s


def _s_plane(axes: Axes, left: float, right: float, top: float, spec: LoopSpec, period: float, *, named: bool) -> None:
    """Make axes of the upper half plane; fast poles to the right of a damping line are damped too little."""
    damping_lines(axes, spec, top, named)
    fastest_pole_line(axes, spec, period)
    half_plane_axes(axes, left, right, 0.0, top)
    axes.set_ylabel("imaginary part, rad/s")


def half_plane_axes(axes: Axes, left: float, right: float, bottom: float, top: float) -> None:
    """Set the limits of axes that show the upper half plane, with its unstable half shaded."""
    axes.axvline(0.0, color=REFERENCE, linewidth=0.8)
    axes.axvspan(0.0, right, color=BAND, linewidth=0, zorder=0)
    axes.set_xlim(left, right)
    axes.set_ylim(bottom, top)
    linear_axis(axes.xaxis, 6)
    linear_axis(axes.yaxis, 6)
    axes.set_xlabel("real part, 1/s")
