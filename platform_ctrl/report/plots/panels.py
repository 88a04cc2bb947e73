"""What the plots of systems share: the look of curves, a phase axis, the plot with its legend, and windows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from platform_ctrl.analysis.system import ComplexArray
from platform_ctrl.common.arguments import short
from platform_ctrl.common.values import FloatArray
from platform_ctrl.errors import ArgumentError
from platform_ctrl.report.style import DASHES, MARKERS, REFERENCE, SERIES, legend

if TYPE_CHECKING:
    import control

# Series that differ by their dashes alone; more have markers.
_DIFFERENT = 6
# A step of the phase beyond which a pole or zero without damping is taken for its cause, degrees.
_JUMP = 135.0


def curve_style(k: int) -> dict[str, Any]:
    """Return the look of the k-th curve: no two of the first 24 alike, also in grey."""
    style: dict[str, Any] = {"color": SERIES[k % len(SERIES)], "linestyle": DASHES[k % _DIFFERENT]}
    if k >= _DIFFERENT:
        style |= {"marker": MARKERS[k % len(MARKERS)], "markersize": 3.8}
    return style


def decibels(response: ComplexArray) -> FloatArray:
    """Return |response| in decibels; NaN where it is 0 or NaN."""
    size = np.abs(response)
    return np.asarray(20.0 * np.log10(np.where(size > 0.0, size, math.nan)))


def loop_phase(loop: ComplexArray) -> FloatArray:
    """Return the phase of a loop transfer, degrees, in the turn in which it comes closest to the critical point.

    Across a pole on the stability boundary the phase falls by 180°, across a zero there it rises, as with the least
    damping. NaN where the response is 0 or NaN.
    """
    out = np.full(len(loop), np.nan)
    known = np.flatnonzero(np.isfinite(loop) & (loop != 0.0))
    if not known.size:
        return out
    h = loop[known]
    level, angle = np.log(np.abs(h)), np.degrees(np.angle(h))
    step = (np.diff(angle) + 180.0) % 360.0 - 180.0
    for k in np.flatnonzero(np.abs(step) > _JUMP).tolist():
        # The gain distinguishes pole and zero: it has a peak, or a dip, between the two points.
        bend = level[min(k + 2, len(h) - 1)] - level[k + 1] - (level[k] - level[max(k - 1, 0)])
        if bend * step[k] < 0.0:
            step[k] += np.copysign(360.0, bend)
    phase = angle[0] + np.concatenate([[0.0], np.cumsum(step)])
    closest = phase[np.argmin(np.abs(1.0 + h))]
    out[known] = phase - 360.0 * np.round((closest + 180.0) / 360.0)
    return out


def phase_panel(axes: Axes, phases: Sequence[FloatArray]) -> None:
    """Give a panel its phase axis in right angles, with lines at the odd multiples of 180°."""
    known = np.concatenate([np.zeros(0), *(phase[np.isfinite(phase)] for phase in phases)])
    known = known if known.size else np.zeros(1)
    low, high = float(known.min()), float(known.max())
    if low < 0.0:
        low, high = min(low, -180.0), max(high, -180.0)
    step = next((step for step in (45.0, 90.0, 180.0, 360.0) if high - low <= 5.0 * step), None)
    step = step or 360.0 * math.ceil((high - low) / 2160.0)
    low, high = step * math.floor((low - 4.0) / step), step * math.ceil((high + 4.0) / step)
    axes.set_ylim(low, high)
    axes.set_yticks(np.arange(low, high + 1.0, step))
    odd = 360.0 * np.arange(math.ceil((low + 180.0) / 360.0), math.floor((high + 180.0) / 360.0) + 1) - 180.0
    for level in odd[:: max(1, len(odd) // 4)]:
        axes.axhline(level, color=REFERENCE, linewidth=0.9, zorder=1)


def control_plot(
    axes: NDArray[Any], lines: Sequence[Any], handles: Sequence[Any], names: Sequence[str]
) -> control.ControlPlot:
    """Return a plot with one panel, its lines, and a legend."""
    import control

    listed = np.empty((1, 1), dtype=object)
    listed[0, 0] = list(lines)
    figure = axes[0, 0].figure
    return control.ControlPlot(listed, axes, figure, legend=legend(figure, handles, names))


def show(*plots: Figure | control.ControlPlot) -> None:
    """Open a window for each plot, by pyplot's current backend, and wait until they are closed.

    In a notebook they appear below the cell instead, and nothing waits. Until this is called no plot of this package
    is known to pyplot.

    Parameters
    ----------
    *plots
        Figures, and whatever has one as ``figure``: `control.ControlPlot`.

    Raises
    ------
    ArgumentError
        Something else, nothing at all, or a backend that opens no windows: use ``figure.savefig`` there.
    """
    figures = [_figure(plot) for plot in plots]
    if not figures:
        raise ArgumentError("show: no plot was given; give at least one Figure or control.ControlPlot")
    from matplotlib import pyplot

    backend = pyplot.get_backend()
    if _is_silent(backend):
        raise ArgumentError(
            f"show: Matplotlib's backend {backend!r} opens no windows; "
            "save the figure with figure.savefig('plot.png'), or choose another with matplotlib.use('TkAgg')"
        )
    for figure in figures:
        _attached(pyplot, figure)
    pyplot.show()


def _figure(plot: object) -> Figure:
    figure = plot if isinstance(plot, Figure) else getattr(plot, "figure", None)
    if not isinstance(figure, Figure):
        raise ArgumentError(f"show: a plot must be a Figure or a control.ControlPlot, got {short(plot)}")
    return figure


def _is_silent(backend: str) -> bool:
    from matplotlib.backends.registry import BackendFilter, backend_registry

    names: list[str] = backend_registry.list_builtin(BackendFilter.NON_INTERACTIVE)  # type: ignore[no-untyped-call]
    return backend.lower() in {name.lower() for name in names}


def _attached(pyplot: Any, figure: Figure) -> None:
    """Give `figure` the window of a figure that pyplot makes: in a way that works with every version of Matplotlib."""
    manager = figure.canvas.manager
    if manager is not None and pyplot.fignum_exists(manager.num):
        return
    manager = pyplot.figure(figsize=figure.get_size_inches(), dpi=figure.dpi).canvas.manager
    manager.canvas.figure = figure
    figure.set_canvas(manager.canvas)
