"""Nichols plots, and the changes of gain and phase that a disk margin allows.

All factors (1 + δ (1 − skew) α/2) / (1 − δ (1 + skew) α/2) with |δ| < 1 on a loop's gain are safe; −1 over one of them
is a value that L never takes: it is in the region that the margin keeps free in the Nichols plot.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from numbers import Real
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, FuncFormatter, MultipleLocator, NullFormatter, NullLocator
from numpy.typing import ArrayLike

from platform_ctrl.analysis.arrays import ComplexArray
from platform_ctrl.analysis.disks import disk_phase, disk_to_gain_phase
from platform_ctrl.analysis.margins import DiskMargin, disk_margin
from platform_ctrl.analysis.response import LinearSystem
from platform_ctrl.common.arguments import positive, short
from platform_ctrl.common.text import at_least, at_most, greek
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.quantities import HZ, disk_gain_or_phase, plain
from platform_ctrl.report.plots.curves import Curve, Margins, channels, curve, margins
from platform_ctrl.report.plots.label_placement import LabelPlacer
from platform_ctrl.report.plots.panels import control_plot, curve_style, gains
from platform_ctrl.report.plots.systems import DrawnSystem, as_state_space, drawable, drawn_systems, gaps, grid, listed
from platform_ctrl.report.style import BAND, DOTTED, FRAME, LIMIT, MUTED, REFERENCE, panels, standalone

if TYPE_CHECKING:
    import control

# What is shown at most above and below a gain of 1, and from which gain on all phases are shown, dB.
_HIGHEST, _LOWEST, _NEAR = 40.0, -40.0, -24.0
_NUMBERED = 6  # curves that carry frequencies


@standalone
def nichols(
    loops: LinearSystem | Sequence[LinearSystem] | Mapping[str, LinearSystem],
    *,
    frequency: ArrayLike | None = None,
    labels: Sequence[str] | None = None,
    disk_margins: Sequence[float] | float = (0.5,),
    skew: float = 0.0,
    T_peaks: Sequence[float] | float = (),
    stable: bool | None = None,
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
    labels
        One for each loop; default their names.
    disk_margins
        Values of α, dimensionless, whose regions are shaded, each below 2/(1 + |skew|); none: no regions.
    skew
        Of the regions and of the loops' own disk margins, dimensionless.
    T_peaks
        Values of |T| above 1, dimensionless, whose curves are drawn (M circles).
    stable
        Whether the closed loop is stable, where that is known and frequency responses cannot show it.

    Returns
    -------
    control.ControlPlot
        One panel, phase in degrees across and gain in dB up; ``lines`` one for each channel of each loop.

    Raises
    ------
    ArgumentError
        Loops that are not square or cannot be closed, frequencies that are not ascending and positive, a margin or a
        peak out of its range.

    References
    ----------
    P. Seiler, A. Packard, P. Gahinet, IEEE Control Systems Magazine 40(5), 2020.
    """
    checked_skew("nichols", skew)
    alphas = _numbers("nichols: disk_margins", disk_margins, 0.0, 2.0 / (1.0 + abs(skew)))
    peaks = _numbers("nichols: T_peaks", T_peaks, 1.0, math.inf)
    drawn = drawn_systems("nichols", loops, labels, square=True)
    parts = [channels("nichols", one) for one in drawn]
    every = grid([one for part in parts for one in part], frequency, name="nichols", loops=True)
    curves = []
    for one, part in zip(drawn, parts, strict=True):
        # Products of systems lose their signal names: those of the first are used.
        own_names = drawn[0].inputs if len(drawn[0].inputs) == len(part) else one.inputs
        for name, own in zip(own_names, part, strict=True):
            words = [one.label] if one.label or len(part) == 1 else []
            words += [f"at {drawable(greek(name))}"] if len(part) > 1 else []
            curves.append(curve(own, every, " ".join(words) or "L"))
    found = [margins(one, skew=skew) for one in curves]
    found = [one if stable is None else dataclasses.replace(one, stable=stable) for one in found]
    names = [_legend_words(one, measured) for one, measured in zip(curves, found, strict=True)]
    regions = [f"disk margin {alpha:g}" + (f", skew {skew:g}" if skew else "") for alpha in alphas]
    _, axes = panels(1, 1, 5.0, [*names, *regions], titles=False, width=7.6)
    panel = axes[0, 0]
    _show_loops(panel, curves)
    shaded = _shaded_regions(panel, alphas, skew)
    lines = [_line(panel, one, k) for k, one in enumerate(curves)]
    places = LabelPlacer(panel, lines)
    for centre in _centres(panel):
        panel.plot([centre], [0.0], "+", color=LIMIT, markersize=10, markeredgewidth=1.6, zorder=4)
        places.reserve(centre, 0.0, 5.0)
    _closest(panel, places, curves, found)
    _peaks(panel, places, peaks)
    for line, loop in zip(lines[:_NUMBERED], curves, strict=False):
        if len(loop.frequency) > 1:
            places.write_frequencies(
                loop.frequency * HZ,
                line.get_xydata(),
                line.get_color(),
                numbers=(1.0, 2.0, 5.0),
                apart=26.0,
                words=lambda f: f"{plain(f, 3)} Hz",
                colour=MUTED,
                size=6.5,
            )
    return control_plot(axes, [lines], [*lines, *shaded], [*names, *regions])


def _numbers(name: str, given: Any, above: float, below: float) -> list[float]:
    items = list(given) if isinstance(given, Sequence | np.ndarray) and not isinstance(given, str) else [given]
    if not all(isinstance(item, Real) and above < float(item) < below - 1e-9 for item in items):
        limits = f"between {above:g} and {below:g}" if math.isfinite(below) else f"above {above:g}"
        raise ArgumentError(f"{name} must be numbers {limits}, got {short(given)}")
    return sorted(map(float, items), reverse=True)


def _legend_words(one: Curve, found: Margins) -> str:
    if found.stable is False:
        return f"{one.label}: closed loop not stable"
    if found.disk is None or not math.isfinite(found.disk.alpha):
        return one.label
    return f"{one.label}: disk margin {plain(found.disk.alpha, 2, 'down')} at {plain(found.disk.frequency * HZ, 3)} Hz"


def _show_loops(panel: Axes, curves: Sequence[Curve]) -> None:
    """Show gains from −40 to 40 dB where there are any, and the phases that gains above −24 dB have."""
    low, high, left, right = -20.0, 20.0, -270.0, -90.0
    for one in curves:
        level = gains(one.response, dB=True)
        inside = np.isfinite(level) & (level > _LOWEST) & (level < _HIGHEST)
        if inside.any():
            low, high = min(low, float(level[inside].min())), max(high, float(level[inside].max()))
            phase = one.phase[inside & (level > _NEAR)]
            left, right = min(left, float(phase.min(initial=left))), max(right, float(phase.max(initial=right)))
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


def _shaded_regions(panel: Axes, alphas: Sequence[float], skew: float) -> list[Any]:
    """Shade what each margin keeps free, around every critical point, the largest below the others."""
    handles = []
    for k, alpha in enumerate(alphas):
        L = exclusion(alpha, skew)
        # Around -180 degrees the angle of -L has no jump.
        phase, level = np.degrees(np.angle(-L)), 20.0 * np.log10(np.abs(L))
        dashes = ("-", (0, (4, 1.5)), DOTTED)[k % 3]
        look: dict[str, Any] = {"facecolor": BAND, "edgecolor": MUTED, "linewidth": 0.9, "linestyle": dashes}
        drawn = [panel.fill(c + phase, level, alpha=1.0, zorder=0.6, **look)[0] for c in _centres(panel)]
        handles.append(drawn[0] if drawn else panel.fill([], [], **look)[0])
    return handles


def _line(panel: Axes, one: Curve, k: int) -> Any:
    level = gains(one.response, dB=True)
    style = curve_style(k)
    if "marker" in style:
        style["markevery"] = max(1, len(level) // 12)
    [line] = panel.plot(one.phase, level, **style)
    return line


def _closest(panel: Axes, places: LabelPlacer, curves: Sequence[Curve], found: Sequence[Margins]) -> None:
    for k, (one, measured) in enumerate(zip(curves, found, strict=True)):
        if measured.disk is None or measured.stable is False or not len(one.frequency):
            continue
        w = measured.disk.frequency
        if not one.frequency[0] <= w <= one.frequency[-1]:
            continue
        phase = float(np.interp(w, one.frequency, one.phase))
        level = float(np.interp(w, one.frequency, gains(one.response, dB=True)))
        panel.plot([phase], [level], "D", color=curve_style(k)["color"], markersize=5.0, zorder=5)
        places.reserve(phase, level, 5.0)


def _peaks(panel: Axes, places: LabelPlacer, peaks: Sequence[float]) -> None:
    """Draw where |T| has given values above 1, and write them."""
    for peak in peaks:
        turn = np.exp(2j * np.pi * np.linspace(0.0, 1.0, 721))
        L = -(peak**2 / (peak**2 - 1.0)) + peak / (peak**2 - 1.0) * turn
        phase, level = np.degrees(np.angle(-L)), 20.0 * np.log10(np.abs(L))
        for centre in _centres(panel):
            panel.plot(centre + phase, level, color=FRAME, linewidth=0.9, zorder=1.2)
            top = int(np.argmax(level))
            places.write(f"|T| {plain(peak, 3)}", centre + phase[top], level[top], colour=MUTED, size=6.5)


# Gain factors beyond which nothing is drawn.
_WIDEST = 20.0
# Regions up to which the ends of each are written; the legend has them all.
_WRITTEN = 6
# Ticks of the gain axis; the second ones where it is long.
_FINE = (0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.2, 1.3, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0)
_COARSE = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0)


@value
class _Region:
    """One region: a disk margin, and the loop that it belongs to, if any."""

    label: str
    alpha: float
    loop: DrawnSystem | None
    margin: DiskMargin | None


@standalone
def disk_margin_region(
    margins: float | LinearSystem | Sequence[float | LinearSystem] | Mapping[str, float | LinearSystem],
    *,
    skew: float = 0.0,
    labels: Sequence[str] | None = None,
    frequency: ArrayLike | None = None,
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
    skew
        Of the disk, dimensionless: 0 for gains that may rise as far as they may fall, > 0 mostly rise, < 0 mostly fall.
    labels
        One for each.
    frequency : (N,) or (2,), optional
        Where −1/L is drawn, rad/s, or two numbers as the ends of a range. The margin does not depend on it.

    Returns
    -------
    control.ControlPlot
        One panel, gain factor across and phase in degrees up; ``lines`` the rims of the regions.

    Raises
    ------
    ArgumentError
        A margin that is not a number >= 0, loops that are not square, a skew that is not finite, or labels that do not
        fit.

    References
    ----------
    P. Seiler, A. Packard, P. Gahinet, IEEE Control Systems Magazine 40(5), 2020.
    """
    checked_skew("disk_margin_region", skew)
    regions = _regions(margins, labels, skew)
    words = [_words(region, skew) for region in regions]
    _, axes = panels(1, 1, 4.0, words, titles=False, width=7.2)
    panel = axes[0, 0]
    left, right, top = _window(regions, skew)
    gain = np.geomspace(left, right, 401)
    lines = []
    for k, region in enumerate(regions):
        rim_gain, rim_phase = _rim(region.alpha, skew, gain)
        [line] = panel.plot(rim_gain, rim_phase, **curve_style(k) | {"marker": "", "linewidth": 1.7, "zorder": 3})
        panel.fill_between(rim_gain, rim_phase, 0.0, color=line.get_color(), alpha=0.10, linewidth=0)
        lines.append(line)
    _axes(panel, left, right, top)
    curves = [_critical(panel, region, k, frequency) for k, region in enumerate(regions)]
    _mark(panel, regions, skew, [*lines, *curves])
    return control_plot(axes, [lines], lines, words)


def checked_skew(name: str, skew: object) -> None:
    """Raise ArgumentError if a skew is no finite number."""
    if not isinstance(skew, Real) or isinstance(skew, bool) or not math.isfinite(skew):
        raise ArgumentError(f"{name}: skew must be a finite number, got {skew!r}")


def exclusion(alpha: float, skew: float) -> ComplexArray:
    """Return the rim of the values of L that a disk margin keeps free: there |S + (skew − 1)/2| is 1/alpha.

    `alpha` is below 2/(1 + |skew|), so that the region holds neither 0 nor infinity.
    """
    delta = np.exp(2j * np.pi * np.linspace(0.0, 1.0, 721))
    return np.asarray(
        -(1.0 - 0.5 * alpha * (1.0 + skew) * delta) / (1.0 + 0.5 * alpha * (1.0 - skew) * delta), dtype=np.complex128
    )


def _regions(margins: Any, labels: Sequence[str] | None, skew: float) -> list[_Region]:
    name = "disk_margin_region"
    given, texts = listed(name, margins, labels)
    out = []
    for k, (one, label) in enumerate(zip(given, texts, strict=True)):
        if isinstance(one, Real) and not isinstance(one, bool):
            out.append(_Region(label=label or "", alpha=positive(name, float(one), zero=True), loop=None, margin=None))
            continue
        [loop] = drawn_systems(name if len(given) == 1 else f"{name}: loop {k + 1}", one, square=True)
        found = disk_margin(loop.source if loop.is_data else as_state_space(name, loop), skew=skew)
        text = label if label is not None else loop.label or ("L" if len(given) == 1 else f"L {k + 1}")
        out.append(_Region(label=text, alpha=found.alpha, loop=loop, margin=found))
    return out


def _words(region: _Region, skew: float) -> str:
    head = f"{region.label}: " if region.label else ""
    if region.alpha == 0.0:
        stable = region.margin is None or not region.margin.reason
        return head + ("disk margin 0" if stable else "closed loop not stable, no margin")
    margin = f"disk margin {plain(region.alpha, 2, 'down')}" if math.isfinite(region.alpha) else "any disk margin"
    skewed = f", skew {plain(skew, 3)}" if skew else ""
    return f"{head}{margin}{skewed}: {' or '.join(disk_gain_or_phase(region.alpha, skew))}"


def _window(regions: Sequence[_Region], skew: float) -> tuple[float, float, float]:
    """Return the lowest and highest gain and the highest phase that are shown."""
    low, high, top = 0.7, 1.0 / 0.7, 20.0
    for region in regions:
        if region.alpha > 0.0:
            one = disk_to_gain_phase(min(region.alpha, 1e9), skew)
            low = min(low, one[0] / 1.5 if one[0] > 0.0 else 0.0)
            high = max(high, 1.5 * one[1])
            gain = np.append(np.geomspace(max(low, 1.0 / _WIDEST), min(high, _WIDEST), 400), 1.0)
            inside = np.degrees(disk_phase(gain, region.alpha, skew))
            top = max(top, 1.2 * float(inside[np.isfinite(inside)].max(initial=0.0)))
    return max(low, 1.0 / _WIDEST), min(high, _WIDEST), min(top, 180.0)


def _rim(alpha: float, skew: float, gain: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the rim of a region over gains, down to phase 0 where it ends within them."""
    if alpha == 0.0:
        return np.array([1.0]), np.array([0.0])
    alpha = min(alpha, 1e9)
    low, high, _ = disk_to_gain_phase(alpha, skew)
    # Denser towards the ends, where the rim is steep.
    ends = [
        end * (1.0 + sign * np.geomspace(1e-6, 0.1, 80))
        for end, sign in ((low, 1.0), (high, -1.0))
        if 0 < end < math.inf
    ]
    every = np.unique(np.concatenate([gain, [1.0], *ends]))
    every = every[(every >= gain[0]) & (every <= gain[-1])]
    phase = np.degrees(disk_phase(every, alpha, skew))
    inside = np.isfinite(phase)
    every, phase = every[inside], phase[inside]
    if gain[0] < low:
        every, phase = np.append(low, every), np.append(0.0, phase)
    if high < gain[-1]:
        every, phase = np.append(every, high), np.append(phase, 0.0)
    return every, phase


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


def _critical(panel: Axes, region: _Region, k: int, frequency: ArrayLike | None) -> FloatArray:
    """Draw the changes that make a loop with one channel unstable, and where the region touches them."""
    loop = region.loop
    if loop is None or loop.shape != (1, 1) or region.margin is None or region.margin.reason:
        return np.zeros((0, 2))
    _, response = loop.along(grid([loop], frequency, name="disk_margin_region", loops=True))
    with np.errstate(all="ignore"):
        factor = gaps(-1.0 / response[0, 0])
    gain, phase = np.abs(factor), np.degrees(np.abs(np.angle(factor)))
    colour = curve_style(k)["color"]
    panel.plot(gain, phase, color=colour, linewidth=1.0, linestyle=(0, (1.2, 1.4)), zorder=2)
    touching = region.margin.perturbation[0]
    if np.isfinite(touching):
        at = abs(touching), math.degrees(abs(np.angle(touching)))
        panel.plot(*([x] for x in at), "D", color=colour, markersize=4.5, zorder=4)
    return np.column_stack([gain, phase])


def _mark(panel: Axes, regions: Sequence[_Region], skew: float, curves: Sequence[FloatArray | Line2D]) -> None:
    """Write the margins where the regions end on the axes, and the frequency where a loop is touched."""
    places = LabelPlacer(panel, curves)
    for k, region in enumerate(regions):
        if region.alpha <= 0.0:
            continue
        low, high, phase = disk_to_gain_phase(min(region.alpha, 1e9), skew)
        style: dict[str, Any] = {"color": curve_style(k)["color"], "marker": "o", "markersize": 4.0, "clip_on": False}
        points = [(low, 0.0, f"× {at_most(low, 3)}")]
        points.append((high, 0.0, f"× {at_least(high, 3)}") if math.isfinite(high) else (0.0, 0.0, ""))
        if phase < math.pi:
            points.append((1.0, math.degrees(phase), f"{at_least(math.degrees(phase), 3)}°"))
        for x, y, text in points if len(regions) <= _WRITTEN else points[2:]:
            if x > 0.0 and places.shows(x, y):
                panel.plot([x], [y], **style, zorder=5)
                places.write(text, x, y, colour=style["color"], bold=True, required=len(regions) < 4)
        margin = region.margin
        if margin is not None and len(margin.perturbation) == 1 and np.isfinite(margin.perturbation[0]):
            touching = margin.perturbation[0]
            at = abs(touching), math.degrees(abs(np.angle(touching)))
            places.write(f"{plain(margin.frequency * HZ, 3)} Hz", *at, colour=style["color"])
