"""Nichols plots, with the regions that disk margins keep free.

All factors (1 + δ α/2) / (1 − δ α/2) with |δ| < 1 on a loop's gain are safe; −1 over one of them is a value that L
never takes: it is in the region.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator
from numpy.typing import ArrayLike

from platform_ctrl.analysis.curves import decibels, loop_phase
from platform_ctrl.analysis.metrics import METRICS
from platform_ctrl.analysis.norms import peak
from platform_ctrl.analysis.poles import continuous_poles, poles, spectral_abscissa
from platform_ctrl.analysis.system import ComplexArray
from platform_ctrl.common.arguments import short
from platform_ctrl.common.text import greek
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.loop import LoopOutcome
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.quantities import HZ, plain
from platform_ctrl.report.curves import broken_loops
from platform_ctrl.report.figures.panels import LabelPlacer, control_plot, curve_style
from platform_ctrl.report.figures.systems import DrawnSystem, Systems, channels, drawn_systems, sensitivity
from platform_ctrl.report.style import BAND, DOTTED, LIMIT, MUTED, REFERENCE, panels, standalone

if TYPE_CHECKING:
    import control

# What is shown at most above and below a gain of 1, and from which gain on all phases are shown, dB.
_HIGHEST, _LOWEST, _NEAR = 40.0, -40.0, -24.0
_NUMBERED = 6  # curves that carry frequencies
_LARGE, _SMALL = (5.0, 7.6), (3.5, 5.2)  # height of the panel and width of the picture, inches


@value
class LoopCurve:
    """A loop transfer at one channel, all others closed."""

    label: str
    frequency: FloatArray  # (N,), rad/s
    response: ComplexArray  # (N,), NaN where nothing is drawn
    stable: bool | None  # Whether the closed loop is; None: data cannot tell
    margin: float | None  # Disk margin of this channel; None: the legend does not say
    closest: float  # Where it is reached, rad/s
    grey: bool = False  # Whether it is what others are compared with


@standalone
def nichols(
    loops: Systems, *, frequency: ArrayLike | None = None, disk_margins: Sequence[float] | float = (0.5,)
) -> control.ControlPlot:
    """Draw Nichols plots of loop transfers, with the regions that a disk margin keeps them out of.

    A loop with several channels is drawn channel by channel, each broken with all others closed (1/S_ii − 1). A diamond
    marks where a curve comes closest to the critical point in the sense of the disk margin.

    Parameters
    ----------
    loops
        Loop transfers L with negative feedback: `control.StateSpace`, `TransferFunction` or `FrequencyResponseData`,
        continuous or sampled; several in a sequence, or a mapping from labels.
    frequency : (N,) or (2,), optional
        rad/s: the frequencies themselves, or two numbers as the ends of a range; default wherever poles and zeros are.
    disk_margins
        Values of α, dimensionless, whose regions are shaded, each below 2; none: no regions.

    Returns
    -------
    control.ControlPlot
        One panel, phase in degrees across and gain in dB up; ``lines`` one for each channel of each loop.

    Raises
    ------
    ArgumentError
        Loops that are not square or cannot be closed, frequencies that are not ascending and positive, a margin out of
        its range.

    References
    ----------
    P. Seiler, A. Packard, P. Gahinet, IEEE Control Systems Magazine 40(5), 2020.
    """
    alphas = sorted(np.atleast_1d(np.asarray(disk_margins, dtype=np.float64)).tolist(), reverse=True)
    if not all(0.0 < alpha < 2.0 for alpha in alphas):
        raise ArgumentError(f"nichols: disk_margins must be numbers between 0 and 2, got {short(disk_margins)}")
    curves = [curve for one in drawn_systems("nichols", loops, frequency, loops=True) for curve in _loop_curves(one)]
    return nichols_plot(curves, alphas)


def _loop_curves(loop: DrawnSystem) -> list[LoopCurve]:
    S = None if loop.arrays is None else sensitivity(loop.arrays)
    stable = None if S is None else bool(spectral_abscissa(continuous_poles(poles(S.A), S.dt)) < 0.0)
    out = []
    for k, (h, name) in enumerate(zip(channels(loop.response), loop.inputs, strict=True)):
        words = [loop.label] if loop.label or len(loop.inputs) == 1 else []
        words += [f"at {greek(name)}"] if len(loop.inputs) > 1 else []
        if S is None or not stable:
            margin, at = closest(loop.frequency, h)
        else:
            largest, at = peak(S.part([k], [k], -0.5))
            margin = 1.0 / largest
        about: dict[str, Any] = {"stable": stable, "margin": margin, "closest": at}
        out.append(LoopCurve(label=" ".join(words) or "L", frequency=loop.frequency, response=h, **about))
    return out


def closest(frequency: FloatArray, response: ComplexArray) -> tuple[float, float]:
    """Return the disk margin of a loop that is known at some frequencies, the least of them, and where it is, rad/s."""
    with np.errstate(all="ignore"):
        size = np.nan_to_num(np.abs(1.0 / (1.0 + response) - 0.5), nan=0.5)
    k = int(np.argmax(size))
    return 1.0 / float(size[k]), float(frequency[k])


def nichols_figure(outcome: LoopOutcome, k: int | None = None) -> Figure:
    """Nichols plot of the loop that each torquer of the closed design closes while all the others stay closed.

    With `k` it is small, around the critical point, of that plant of the set, beside the nominal one in grey.
    """
    design, plant = outcome.closed, k or 0
    assert design.plants is not None
    assert design.measures is not None
    curves, torques = [], design.plants.torques
    for each, grey in ((plant, False), (0, True))[: 2 if plant else 1]:
        w, found = broken_loops(design, each)
        stable = bool(design.measures.decay[each] > 0.0)
        for name, h in zip(torques, found, strict=True):
            margin, at = closest(w, h)
            label = name if k is None else "nominal plant" if grey else f"at {name}"
            label += " (others closed)" if k is not None and not grey and len(torques) > 1 else ""
            about: dict[str, Any] = {"margin": margin if k is None else None, "closest": at, "grey": grey}
            curves.append(LoopCurve(label=label, frequency=w, response=h, stable=stable, **about))
    key, faulty = METRICS["disk margin"].key, design.plants.groups[plant] == "faults"
    keys = [f"{key}_faults" if faulty else f"{key}_worst_case", *([] if plant else [key])]
    required = max(outcome.spec.limits.get(one, 0.0) for one in keys)
    plot = nichols_plot(curves, [required] if 0.0 < required < 2.0 else [], small=k is not None)
    assert isinstance(plot.figure, Figure)
    return plot.figure


def nichols_plot(curves: Sequence[LoopCurve], alphas: Sequence[float], *, small: bool = False) -> control.ControlPlot:
    """Draw loops, and the regions that disk margins, the largest first, keep free; `small`: near the critical point."""
    names = [_legend_words(one) for one in curves]
    regions = [f"disk margin {alpha:g}" for alpha in alphas]
    shown = list(dict.fromkeys(names))
    height, width = _SMALL if small else _LARGE
    _, axes = panels(1, 1, height, [*shown, *regions], titles=False, width=width)
    panel = axes[0, 0]
    levels, phases = ([of(one.response) for one in curves] for of in (decibels, loop_phase))
    _show_loops(panel, levels, phases)
    if small:
        panel.set_xlim(-300.0, -60.0)
        panel.set_ylim(-24.0, 24.0)
        panel.xaxis.set_major_locator(MultipleLocator(60.0))
        panel.yaxis.set_major_locator(MultipleLocator(12.0))
    shaded = [
        draw_region(panel, alpha, _centres(panel), ("-", (0, (4, 1.5)), DOTTED)[k % 3])
        for k, alpha in enumerate(alphas)
    ]
    lines = []
    for k, (one, phase, level) in enumerate(zip(curves, phases, levels, strict=True)):
        grey: dict[str, Any] = {"color": REFERENCE, "linewidth": 0.9, "zorder": 1.5}
        look = grey if one.grey else curve_style(k) | {"markevery": max(1, len(level) // 12)}
        lines += panel.plot(phase, level, **look)
    places = LabelPlacer(panel, lines)
    for centre in _centres(panel):
        panel.plot([centre], [0.0], "+", color=LIMIT, markersize=10, markeredgewidth=1.6, zorder=4)
        places.reserve(centre, 0.0, 5.0)
    drawn = [of for of in zip(lines, curves, phases, levels, strict=True) if not of[1].grey]
    for line, one, phase, level in drawn:
        if one.stable is not False and len(phase):
            x, y = (float(np.interp(one.closest, one.frequency, of)) for of in (phase, level))
            panel.plot([x], [y], "D", color=line.get_color(), markersize=5.0, zorder=5)
            places.reserve(x, y, 5.0)
    for line, one, _, _ in drawn[:_NUMBERED]:
        if len(one.frequency) > 1:
            places.write_frequencies(one.frequency * HZ, line.get_xydata(), line.get_color())
    handles = [lines[names.index(name)] for name in shown]
    return control_plot(axes, lines, [*handles, *shaded], [*shown, *regions])


def _legend_words(one: LoopCurve) -> str:
    if one.margin is None:
        return one.label
    if one.stable is False:
        return f"{one.label}: closed loop not stable"
    return f"{one.label}: disk margin {plain(one.margin, 2, 'down')} at {plain(one.closest * HZ, 3)} Hz"


def _show_loops(panel: Axes, levels: Sequence[FloatArray], phases: Sequence[FloatArray]) -> None:
    """Show gains from −40 to 40 dB where there are any, and the phases that gains above −24 dB have."""
    low, high, left, right = -20.0, 20.0, -270.0, -90.0
    for level, phase in zip(levels, phases, strict=True):
        inside = np.isfinite(level) & (level > _LOWEST) & (level < _HIGHEST)
        low, high = float(level[inside].min(initial=low)), float(level[inside].max(initial=high))
        near = phase[inside & (level > _NEAR)]
        left, right = float(near.min(initial=left)), float(near.max(initial=right))
    step = 10.0 if high - low <= 80.0 else 20.0
    panel.set_ylim(step * math.floor(low / step), step * math.ceil(high / step))
    panel.yaxis.set_major_locator(MultipleLocator(step))
    # A delay turns the phase for ever: two turns are enough.
    left, right = max(left, -900.0), min(right, 360.0)
    turn = 45.0 if right - left <= 360.0 else 90.0 if right - left <= 720.0 else 180.0
    room = 0.03 * (right - left)
    panel.set_xlim(left - room, right + room)
    panel.xaxis.set_major_locator(MultipleLocator(turn))
    panel.set_xlabel("phase of L, degrees")
    panel.set_ylabel("gain of L, dB")
    panel.axhline(0.0, color=REFERENCE, linewidth=0.9, zorder=1)
    for centre in _centres(panel):
        panel.axvline(centre, color=REFERENCE, linewidth=0.9, zorder=1)


def _centres(panel: Axes) -> list[float]:
    """Return the odd multiples of 180° that are shown."""
    left, right = panel.get_xlim()
    first, last = math.ceil((left + 180.0) / 360.0), math.floor((right + 180.0) / 360.0)
    return [360.0 * k - 180.0 for k in range(first, last + 1)]


def draw_region(panel: Axes, alpha: float, centres: Sequence[float], dashes: Any) -> Any:
    """Shade what a disk margin keeps free around critical points, degrees; return one of the patches."""
    # At the rim |S − 1/2| is 1/alpha.
    delta = 0.5 * alpha * np.exp(2j * np.pi * np.linspace(0.0, 1.0, 721))
    L = np.asarray(-(1.0 - delta) / (1.0 + delta), dtype=np.complex128)
    # Around -180 degrees the angle of -L has no jump.
    phase, level = np.degrees(np.angle(-L)), decibels(L)
    look: dict[str, Any] = {"facecolor": BAND, "edgecolor": MUTED, "linewidth": 0.9, "linestyle": dashes}
    [one, *_] = [panel.fill(centre + phase, level, alpha=1.0, zorder=0.6, **look)[0] for centre in centres]
    return one
