"""The scheme that the plots of systems share.

A plot checks its arguments, gets its systems from `systems.drawn_systems` and their frequencies from
`systems.grid`, gets a figure from `blocks`, draws each panel (`gain_curves` where it shows gains), and returns
`control_plot`, which adds the legend.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, MaxNLocator
from numpy.typing import ArrayLike, NDArray

from platform_ctrl.analysis.arrays import ComplexArray
from platform_ctrl.common.arguments import real_numbers
from platform_ctrl.common.signatures import short
from platform_ctrl.common.values import FloatArray
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.quantities import HZ, plain
from platform_ctrl.report.plots.systems import DrawnSystem, near
from platform_ctrl.report.style import (
    BEYOND,
    DASHED,
    DASHES,
    LIMIT,
    MARKERS,
    MUTED,
    REFERENCE,
    SERIES,
    frequency_axes,
    gain_limits,
    legend,
    log_axis,
)

if TYPE_CHECKING:
    import control

# Series that differ by their dashes alone; more have markers.
_DIFFERENT = 6
# A gain below this share of the largest one is rounding and not shown.
_DEEPEST = 1e-14


def curve_style(k: int) -> dict[str, Any]:
    """Return the look of the k-th curve: no two of the first 24 alike, also in grey."""
    style: dict[str, Any] = {"color": SERIES[k % len(SERIES)], "linestyle": DASHES[k % _DIFFERENT]}
    if k >= _DIFFERENT:
        style |= {"marker": MARKERS[k % len(MARKERS)], "markersize": 3.8}
    return style


def draw(axes: Axes, frequency: FloatArray, y: FloatArray, k: int, **more: Any) -> Any:
    """Draw a curve over frequency, rad/s, in Hz and in the style of the k-th, and return its line."""
    style = curve_style(k) | more
    known = np.concatenate([[False], np.isfinite(y), [False]])
    alone = np.flatnonzero(known[1:-1] & ~known[:-2] & ~known[2:])
    if alone.size:
        # Between gaps there is no line to see.
        style |= {"marker": style.get("marker") or "o", "markersize": 3.8, "markevery": alone.tolist()}
    elif style.get("marker"):
        # A handful of markers, equally far from each other on the paper and beside those of the next curve.
        places = np.geomspace(frequency[0], frequency[-1], 25)[2 + k % 3 :: 3]
        style["markevery"] = [int(i) for i in np.unique(np.searchsorted(frequency, places[:-1]))]
    [line] = axes.plot(frequency * HZ, y, **style)
    return line


def frequency_panels(axes: Sequence[Axes], low: float, high: float, systems: Sequence[DrawnSystem]) -> None:
    """Give the panels of a block, from the top, their frequency axis from `low` to `high` rad/s; mark Nyquist."""
    nyquist = sorted({one.nyquist for one in systems if math.isfinite(one.nyquist)})
    # Lines at the very edge would hide in the frame.
    right = max([high, *(1.06 * w for w in nyquist if w <= 1.06 * high)])
    left, right = (low, right) if right > low else (low / 3.0, low * 3.0)
    for k, one in enumerate(axes):
        frequency_axes(one, left * HZ, right * HZ, log_gain=False, label=k == len(axes) - 1)
        if k < len(axes) - 1:
            one.tick_params(labelbottom=False)
        for w in nyquist:
            if left < w <= right:
                one.axvline(w * HZ, color=MUTED, linewidth=0.9, linestyle=DASHES[2], zorder=1)
    if right < 30.0 * left:
        _few_decades(axes, left * HZ, right * HZ)
    for w in nyquist[:3]:
        if left < w <= right:
            axes[0].annotate(
                f"Nyquist {plain(w * HZ, 3)} Hz",
                (w * HZ, 1.0),
                (2, 0),
                xycoords=("data", "axes fraction"),
                textcoords="offset points",
                rotation=90,
                ha="left",
                va="top",
                fontsize=6.5,
                color=MUTED,
            )


def _few_decades(axes: Sequence[Axes], low: float, high: float) -> None:
    """Put more than decades on a short axis."""
    subs = (1.0, 2.0, 5.0) if high / low > 4.0 else (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0)
    ticks = np.asarray(LogLocator(subs=subs).tick_values(low, high))
    ticks = ticks[(ticks >= low) & (ticks <= high)]
    for one in axes:
        one.xaxis.set_major_locator(FixedLocator(ticks.tolist() if ticks.size > 1 else [low, high]))
        one.xaxis.set_major_formatter(FuncFormatter(lambda f, _: plain(f, 3)))


def gains(response: ComplexArray | FloatArray, dB: bool) -> FloatArray:
    """Return |response|, in decibels if `dB`; NaN where it is 0 or NaN."""
    size = np.abs(response)
    size = np.where(size > 0.0, size, math.nan)
    return np.asarray(20.0 * np.log10(size) if dB else size, dtype=np.float64)


class GainCurve(NamedTuple):
    """A gain (N,) over frequency (N,), rad/s, drawn in the style of the k-th curve."""

    system: DrawnSystem
    frequency: FloatArray
    gain: FloatArray
    k: int
    style: dict[str, Any] = {}  # noqa: RUF012  # never changed


Level = tuple[FloatArray, FloatArray] | None


def gain_curves(
    panel: Axes,
    curves: Sequence[GainCurve],
    *,
    dB: bool,
    below: Sequence[Axes] = (),
    upper: Level = None,
    lower: Level = None,
    unity: bool = False,
) -> list[Any]:
    """Draw gains with their axes, a line at 1 if `unity`, and limits from `bound`; return the lines.

    `below` are panels under this one that share its frequency axis.
    """
    lines = [draw(panel, one.frequency, gains(one.gain, dB=dB), one.k, **one.style) for one in curves]
    ends = [one.frequency[k] for one in curves for k in (0, -1) if len(one.frequency)]
    frequency_panels([panel, *below], min(ends), max(ends), [one.system for one in curves])
    more = [0.5, 2.0] if unity else []
    more += [share * float(gain) for level, share in ((upper, 2.0), (lower, 0.5)) if level for gain in level[1]]
    gain_panel(panel, curves, dB=dB, more=more)
    if unity:
        panel.axhline(0.0 if dB else 1.0, color=REFERENCE, linewidth=0.9, zorder=1)
    if any(np.isfinite(one.gain).any() for one in curves):
        shade(panel, upper, dB=dB)
        shade(panel, lower, dB=dB, below=True)
    else:
        panel.text(0.5, 0.5, "no response", transform=panel.transAxes, ha="center", va="center", color=MUTED)
        panel.tick_params(axis="y", labelleft=False)
    return lines


def gain_panel(axes: Axes, curves: Sequence[GainCurve], *, dB: bool, more: Sequence[float] = ()) -> None:
    """Give a panel a gain axis that shows `curves` and the gains `more`.

    Poles without damping run through the upper edge, lightly damped zeros through the lower one.
    """
    high: list[float] = list(more)
    low: list[float] = list(more)
    for system, frequency, gain, *_ in curves:
        fine = np.isfinite(gain) & (gain > 0.0)
        off = fine & ~near(system.undamped, frequency, 0.01)
        light = system.zeros[np.abs(system.zeros.real) < 0.01 * np.abs(system.zeros.imag)]
        deep = off & ~near(np.unique(np.abs(light.imag)), frequency, 0.03)
        off = off if off.any() else fine
        deep = deep if deep.any() else off
        if fine.any():
            high.append(float(gain[off].max()))
            low.append(float(gain[deep].min()))
    top = max(high, default=1.0)
    values = np.array([*high, *(max(g, _DEEPEST * top) for g in low)])
    if dB:
        levels = 20.0 * np.log10(values) if values.size else np.zeros(1)
        ticks = MaxNLocator(7, steps=[1, 2, 4, 5, 10], integer=True).tick_values(levels.min(), levels.max())
        axes.set_ylim(ticks[0], ticks[-1])
        axes.set_yticks(ticks)
    else:
        axes.set_yscale("log")
        log_axis(axes.yaxis)
        gain_limits(axes, [values])
        bottom, upper = axes.get_ylim()
        if upper / bottom < 1.5:
            axes.set_ylim(bottom / 10.0, upper)


def phase_panel(axes: Axes, phases: Sequence[FloatArray], *, critical: bool) -> None:
    """Give a panel its phase axis in right angles; `critical`: lines at the odd multiples of 180°."""
    known = np.concatenate([np.zeros(0), *(phase[np.isfinite(phase)] for phase in phases)])
    known = known if known.size else np.zeros(1)
    low, high = float(known.min()), float(known.max())
    if critical and low < 0.0:
        low, high = min(low, -180.0), max(high, -180.0)
    step = next((step for step in (45.0, 90.0, 180.0, 360.0) if high - low <= 5.0 * step), None)
    step = step or 360.0 * math.ceil((high - low) / 2160.0)
    low, high = step * math.floor((low - 4.0) / step), step * math.ceil((high + 4.0) / step)
    axes.set_ylim(low, high)
    axes.set_yticks(np.arange(low, high + 1.0, step))
    if critical:
        odd = 360.0 * np.arange(math.ceil((low + 180.0) / 360.0), math.floor((high + 180.0) / 360.0) + 1) - 180.0
        for level in odd[:: max(1, len(odd) // 4)]:
            axes.axhline(level, color=REFERENCE, linewidth=0.9, zorder=1)


def control_plot(
    axes: NDArray[Any], lines: Sequence[Sequence[Any]], handles: Sequence[Any] = (), names: Sequence[str] = ()
) -> control.ControlPlot:
    """Return a plot with the lines of each of its axes, in the order of `axes.flat`, and a legend of any names."""
    import control

    listed = np.empty(axes.shape, dtype=object)
    for at, own in zip(np.ndindex(axes.shape), lines, strict=True):
        listed[at] = list(own)
    figure = axes.flat[0].figure
    return control.ControlPlot(listed, axes, figure, legend=legend(figure, handles, names))


def bound(name: str, given: ArrayLike | tuple[ArrayLike, ArrayLike] | None) -> Level:
    """Return a level over frequency, (frequency, level): a number holds everywhere, two vectors are a polyline."""
    if given is None:
        return None
    pair = isinstance(given, Sequence | np.ndarray) and not isinstance(given, str) and len(given) == 2
    both: Any = given if pair else ([0.0, math.inf], given)
    w, level = (np.atleast_1d(real_numbers(name, item)) for item in both)
    level = np.full(w.shape, level.item()) if level.size == 1 else level
    fine = w.ndim == 1 and w.shape == level.shape and w.size > 1 and bool(np.isfinite(level).all())
    fine = fine and not np.isnan(w).any() and not (pair and np.isinf(w).any())
    if not fine or w[0] < 0.0 or np.any(np.diff(w) < 0.0) or level.min() <= 0.0:
        raise ArgumentError(
            f"{name} must be a number > 0, or a pair of ascending frequencies in rad/s and positive levels, "
            f"got {short(given)}"
        )
    return w, level


def shade(axes: Axes, level: Level, *, dB: bool = False, below: bool = False) -> None:
    """Draw a level from `bound`, and shade what lies above it (or below) and is not allowed; axes have their limits."""
    if level is None:
        return
    left, right = axes.get_xlim()
    w, y = np.clip(level[0] * HZ, left, right), 20.0 * np.log10(level[1]) if dB else level[1]
    if not w[-1] > w[0]:
        return
    edge = axes.get_ylim()[0 if below else 1]
    axes.fill_between(w, y, edge, color=BEYOND, linewidth=0, zorder=0.5)
    axes.plot(w, y, color=LIMIT, linewidth=1.0, linestyle=DASHED, zorder=1.5)
    level_words = f" {plain(float(y[0]), 3)}{' dB' if dB else ''}" if np.all(y == y[0]) else ""
    # At the end from which the line goes away from the words.
    at, turn = (0, 1) if (y[0] >= y[-1]) != below or level_words else (-1, -1)
    axes.annotate(
        f"limit{level_words}",
        (float(w[at]), float(y[at])),
        (3 * turn, -2 if below else 2),
        textcoords="offset points",
        ha="left" if turn > 0 else "right",
        va="top" if below else "bottom",
        fontsize=7,
        color=LIMIT,
        annotation_clip=True,
    )


def gain_label(words: str, unit: str, dB: bool) -> str:
    """Return the label of a gain axis."""
    if dB:
        return f"{words}, dB" + (f" of {unit}" if unit not in ("", "1") else "")
    return words if unit in ("", "1") else f"{words}, {unit}"


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
