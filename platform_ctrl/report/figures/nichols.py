"""Nichols plots, and the changes of gain and phase that a disk margin allows.

All factors (1 + δ α/2) / (1 − δ α/2) with |δ| < 1 on a loop's gain are safe; −1 over one of them is a value that L
never takes: it is in the region that the margin keeps free in the Nichols plot.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from numbers import Real
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, MultipleLocator, NullFormatter, NullLocator
from numpy.typing import ArrayLike

from platform_ctrl.analysis.curves import decibels, loop_phase, refined_loop
from platform_ctrl.analysis.margins import DiskMargin, disk_margin, disk_phase, disk_to_gain_phase
from platform_ctrl.analysis.metrics import METRICS
from platform_ctrl.analysis.norms import peak
from platform_ctrl.analysis.poles import continuous_poles, poles, spectral_abscissa
from platform_ctrl.analysis.response import LinearSystem, frequency_response
from platform_ctrl.analysis.system import ComplexArray
from platform_ctrl.common.arguments import positive, short
from platform_ctrl.common.text import at_least, at_most, greek
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.loop import LoopOutcome
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.quantities import HZ, disk_gain_or_phase, plain
from platform_ctrl.report.curves import broken_loops
from platform_ctrl.report.figures.panels import LabelPlacer, control_plot, curve_style
from platform_ctrl.report.figures.systems import (
    DrawnSystem,
    Systems,
    channels,
    drawn_systems,
    grid,
    labelled,
    sensitivity,
)
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
    drawn = drawn_systems("nichols", loops, loops=True)
    every = grid(drawn, frequency, "nichols")
    # Products of systems lose their signal names: those of the first are used.
    first = list(drawn[0].source.input_labels)
    curves = []
    for one in drawn:
        names = list(one.source.input_labels)
        curves += _loop_curves(one, every, first if len(first) == len(names) else names)
    return nichols_plot(curves, alphas)


def _loop_curves(loop: DrawnSystem, every: FloatArray, names: Sequence[str]) -> list[LoopCurve]:
    w, response = loop.along(every)
    responses = channels(response)
    if loop.arrays is not None:
        arrays = loop.arrays
        w, responses = refined_loop(w, lambda w: channels(frequency_response(arrays, w)))
    S = None if loop.arrays is None else sensitivity(loop.arrays)
    stable = None if S is None else bool(spectral_abscissa(continuous_poles(poles(S.A), S.dt)) < 0.0)
    out = []
    for k, (h, name) in enumerate(zip(responses, names, strict=True)):
        words = [loop.label] if loop.label or len(responses) == 1 else []
        words += [f"at {greek(name)}"] if len(responses) > 1 else []
        if S is None or not stable:
            margin, at = closest(w, h)
        else:
            own = S.part([k], [k])
            largest, at = peak(own._replace(D=own.D - 0.5))
            margin = 1.0 / largest
        label = " ".join(words) or "L"
        out.append(LoopCurve(label=label, frequency=w, response=h, stable=stable, margin=margin, closest=at))
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


def exclusion(alpha: float) -> ComplexArray:
    """Return the rim of the values of L that a disk margin below 2 keeps free: there |S − 1/2| is 1/alpha."""
    delta = 0.5 * alpha * np.exp(2j * np.pi * np.linspace(0.0, 1.0, 721))
    return np.asarray(-(1.0 - delta) / (1.0 + delta), dtype=np.complex128)


def draw_region(panel: Axes, alpha: float, centres: Sequence[float], dashes: Any = "-") -> Any:
    """Shade what a disk margin keeps free around critical points, degrees; return one of the patches."""
    L = exclusion(alpha)
    # Around -180 degrees the angle of -L has no jump.
    phase, level = np.degrees(np.angle(-L)), decibels(L)
    look: dict[str, Any] = {"facecolor": BAND, "edgecolor": MUTED, "linewidth": 0.9, "linestyle": dashes}
    [one, *_] = [panel.fill(centre + phase, level, alpha=1.0, zorder=0.6, **look)[0] for centre in centres]
    return one


# Gain factors beyond which nothing is drawn.
_WIDEST = 20.0
# Ticks of the gain axis; the second ones where it is long.
_FINE = (0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.2, 1.3, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0)
_COARSE = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0)


@value
class _Region:
    """A disk margin, and the loop that it belongs to, if any."""

    label: str
    alpha: float
    loop: DrawnSystem | None = None
    margin: DiskMargin | None = None

    @property
    def touching(self) -> tuple[float, float] | None:
        """The smallest change that makes a loop with one channel unstable: gain factor and degrees."""
        if self.margin is None or len(self.margin.perturbation) != 1 or not np.isfinite(self.margin.perturbation[0]):
            return None
        factor = self.margin.perturbation[0]
        return abs(factor), math.degrees(abs(np.angle(factor)))


@standalone
def disk_margin_region(
    margins: float | LinearSystem | Sequence[float | LinearSystem] | Mapping[str, float | LinearSystem],
) -> control.ControlPlot:
    """Draw the changes of gain and phase that are safe in every channel at once.

    Inside a region no change makes the loop unstable, at whatever frequencies it happens. The gain and phase
    margins that a region contains are written where it ends on the axes. For a loop with one channel the dotted curve
    shows the changes that make it unstable (−1/L): the region touches it.

    Parameters
    ----------
    margins
        Disk margins α, dimensionless, or loop transfers L with negative feedback (`control.StateSpace`,
        `TransferFunction`, `FrequencyResponseData`) whose disk margins are then found; several in a sequence, or a
        mapping from labels.

    Returns
    -------
    control.ControlPlot
        One panel, gain factor across and phase in degrees up; ``lines`` the rims of the regions.

    Raises
    ------
    ArgumentError
        A margin that is not a number >= 0, or loops that are not square.

    References
    ----------
    P. Seiler, A. Packard, P. Gahinet, IEEE Control Systems Magazine 40(5), 2020.
    """
    regions = [_region(label, one) for label, one in labelled("disk_margin_region", margins)]
    words = [_words(region) for region in regions]
    _, axes = panels(1, 1, 4.0, words, titles=False, width=7.2)
    panel = axes[0, 0]
    lines, curves = [], []
    for k, region in enumerate(regions):
        rim_gain, rim_phase = _rim(region.alpha)
        [line] = panel.plot(rim_gain, rim_phase, **curve_style(k) | {"marker": "", "linewidth": 1.7, "zorder": 3})
        panel.fill_between(rim_gain, rim_phase, 0.0, color=line.get_color(), alpha=0.10, linewidth=0)
        lines.append(line)
        curves += _critical(panel, region, line.get_color())
    low = max(1.0 / _WIDEST, min(0.7, *(line.get_xdata()[0] / 1.5 for line in lines)))
    _axes(panel, low, 1.0 / low, min(180.0, max(20.0, *(1.2 * line.get_ydata().max() for line in lines))))
    places = LabelPlacer(panel, [*lines, *curves])
    for line, region in zip(lines, regions, strict=True):
        _mark(panel, places, region, line.get_color())
    return control_plot(axes, lines, lines, words)


def _region(label: str, one: Any) -> _Region:
    name = "disk_margin_region"
    if isinstance(one, Real) and not isinstance(one, bool):
        return _Region(label=label if label.strip("0123456789") else "", alpha=positive(name, float(one), zero=True))
    [loop] = drawn_systems(name, one, loops=True)
    found = disk_margin(loop.source)
    return _Region(label=label or "L", alpha=found.alpha, loop=loop, margin=found)


def _words(region: _Region) -> str:
    head = f"{region.label}: " if region.label else ""
    if region.alpha == 0.0:
        stable = region.margin is None or not region.margin.reason
        return head + ("disk margin 0" if stable else "closed loop not stable, no margin")
    margin = f"disk margin {plain(region.alpha, 2, 'down')}" if math.isfinite(region.alpha) else "any disk margin"
    return f"{head}{margin}: {' or '.join(disk_gain_or_phase(region.alpha))}"


def _rim(alpha: float) -> tuple[FloatArray, FloatArray]:
    """Return the rim of a region, gain factors and degrees, down to phase 0 where it ends within what is drawn."""
    if alpha == 0.0:
        return np.array([1.0]), np.array([0.0])
    low, high, _ = disk_to_gain_phase(min(alpha, 1e9))
    # Denser towards the ends, where the rim is steep.
    share = 0.5 * (1.0 - np.cos(np.linspace(0.0, np.pi, 401)))
    ends = max(low, 1.0 / _WIDEST), min(high, _WIDEST)
    gain = ends[0] * (ends[1] / ends[0]) ** share
    gain[[0, -1]] = ends
    phase = np.degrees(disk_phase(gain, alpha))
    phase[[0, -1]] = np.where(np.isclose(ends, (low, high)), 0.0, phase[[0, -1]])
    return gain, phase


def _axes(panel: Axes, left: float, right: float, top: float) -> None:
    panel.set_xscale("log")
    panel.set_xlim(left, right)
    panel.set_ylim(0.0, top)
    least = np.log(right / left) / 14.0
    ticks: list[float] = [1.0]
    factors = _FINE if right < 40.0 * left else _COARSE
    for factor in sorted((f for f in factors if left <= f <= right), key=lambda f: abs(math.log(f))):
        if min(abs(math.log(factor / tick)) for tick in ticks) >= least:
            ticks.append(factor)
    panel.xaxis.set_major_locator(FixedLocator(sorted(ticks)))
    panel.xaxis.set_major_formatter(FuncFormatter(lambda factor, _: f"× {factor:g}"))
    panel.xaxis.set_minor_locator(NullLocator())
    panel.xaxis.set_minor_formatter(NullFormatter())
    step = next(step for step in (5.0, 10.0, 15.0, 30.0, 45.0) if top <= 6.5 * step or step == 45.0)
    panel.set_yticks(np.arange(0.0, top + 1e-9, step))
    panel.axvline(1.0, color=REFERENCE, linewidth=0.9, zorder=1)
    panel.set_xlabel("change of gain")
    panel.set_ylabel("change of phase, either way, degrees")


def _critical(panel: Axes, region: _Region, colour: str) -> list[FloatArray]:
    """Draw the changes that make a loop with one channel unstable, and where the region touches them."""
    if region.loop is None or region.touching is None:
        return []
    _, response = region.loop.along(grid([region.loop], None, "disk_margin_region"))
    with np.errstate(all="ignore"):
        factor = -1.0 / response[0, 0]
    gain, phase = np.abs(factor), np.degrees(np.abs(np.angle(factor)))
    panel.plot(gain, phase, color=colour, linewidth=1.0, linestyle=(0, (1.2, 1.4)), zorder=2)
    panel.plot(*([x] for x in region.touching), "D", color=colour, markersize=4.5, zorder=4)
    return [np.column_stack([gain, phase])]


def _mark(panel: Axes, places: LabelPlacer, region: _Region, colour: str) -> None:
    """Write the margins where a region ends on the axes, and the frequency where its loop is touched."""
    if region.alpha <= 0.0:
        return
    low, high, phase = disk_to_gain_phase(min(region.alpha, 1e9))
    points = [(low, 0.0, f"× {at_most(low, 3)}")]
    points += [(high, 0.0, f"× {at_least(high, 3)}")] if math.isfinite(high) else []
    points += [(1.0, math.degrees(phase), f"{at_least(math.degrees(phase), 3)}°")] if phase < math.pi else []
    for x, y, text in points:
        if x > 0.0 and places.shows(x, y):
            panel.plot([x], [y], color=colour, marker="o", markersize=4.0, clip_on=False, zorder=5)
            places.write(text, x, y, colour=colour, bold=True, required=True)
    if region.margin is not None and region.touching is not None:
        places.write(f"{plain(region.margin.frequency * HZ, 3)} Hz", *region.touching, colour=colour)
