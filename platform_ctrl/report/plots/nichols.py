"""Nichols plots of loops, with the regions that disk margins keep free."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MultipleLocator
from numpy.typing import ArrayLike

from platform_ctrl.analysis.transfer_function import LinearSystem
from platform_ctrl.common.arguments import positive
from platform_ctrl.common.signatures import check_arguments, short
from platform_ctrl.common.text import greek
from platform_ctrl.errors import ArgumentError
from platform_ctrl.report.plots.curves import Curve, Margins, channels, curve, margins
from platform_ctrl.report.plots.disk_region import checked_skew, exclusion
from platform_ctrl.report.plots.label_placement import LabelPlacer
from platform_ctrl.report.plots.panels import blocks, control_plot, curve_style, gains
from platform_ctrl.report.plots.systems import drawable, drawn_systems, grid
from platform_ctrl.report.quantities import HZ, plain
from platform_ctrl.report.style import BAND, FRAME, LIMIT, MUTED, REFERENCE, standalone

if TYPE_CHECKING:
    import control

# What is shown at most above and below a gain of 1, dB.
_HIGHEST, _LOWEST = 60.0, -60.0
# Curves that carry frequencies.
_WRITTEN = 6


@check_arguments
@standalone
def nichols(
    loops: LinearSystem | Sequence[LinearSystem] | Mapping[str, LinearSystem],
    *,
    frequency: ArrayLike | None = None,
    labels: Sequence[str] | None = None,
    disk_margins: Sequence[float] | float = (0.5,),
    skew: float = 0.0,
    T_peaks: Sequence[float] | float = (),
) -> control.ControlPlot:
    """Draw loop transfers as gain over phase, with the regions that a disk margin keeps them out of.

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
    alphas = _numbers("nichols: disk_margins", disk_margins)
    most = 2.0 / (1.0 + abs(skew))
    for alpha in alphas:
        if alpha >= most - 1e-9:
            raise ArgumentError(f"nichols: disk_margins must be below 2/(1 + |skew|) = {most:g}, got {alpha:g}")
    peaks = _numbers("nichols: T_peaks", T_peaks)
    for peak in peaks:
        if peak <= 1.0:
            raise ArgumentError(f"nichols: T_peaks must be above 1, got {peak:g}")
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
    names = [_legend_words(one, measured) for one, measured in zip(curves, found, strict=True)]
    regions = [f"disk margin {alpha:g}" + (f", skew {skew:g}" if skew else "") for alpha in alphas]
    _, axes = blocks(1, 1, (5.0,), [*names, *regions], titles=False, width=7.6)
    panel = axes[0, 0]
    _window(panel, curves)
    shaded = _regions(panel, alphas, skew)
    lines = [_line(panel, one, k) for k, one in enumerate(curves)]
    places = LabelPlacer(panel, lines)
    for centre in _centres(panel):
        panel.plot([centre], [0.0], "+", color=LIMIT, markersize=10, markeredgewidth=1.6, zorder=4)
        places.reserve(centre, 0.0, 5.0)
    _closest(panel, places, curves, found)
    _peaks(panel, places, peaks)
    for line, loop in zip(lines[:_WRITTEN], curves, strict=False):
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


def _numbers(name: str, given: Any) -> list[float]:
    items = list(given) if isinstance(given, Sequence | np.ndarray) and not isinstance(given, str) else [given]
    try:
        return sorted((positive(name, item) for item in items), reverse=True)
    except ArgumentError:
        raise ArgumentError(f"{name} must be numbers > 0, got {short(given)}") from None


def _legend_words(one: Curve, found: Margins) -> str:
    if found.stable is False:
        return f"{one.label}: closed loop not stable"
    if found.disk is None or not math.isfinite(found.disk.alpha):
        return one.label
    return f"{one.label}: disk margin {plain(found.disk.alpha, 2, 'down')} at {plain(found.disk.frequency * HZ, 3)} Hz"


def _window(panel: Axes, curves: Sequence[Curve]) -> None:
    """Show gains from −60 to 60 dB where there are any, and the phases that belong to them."""
    low, high, left, right = -20.0, 20.0, -270.0, -90.0
    for one in curves:
        level = gains(one.response, dB=True)
        inside = np.isfinite(level) & (level > _LOWEST) & (level < _HIGHEST)
        if inside.any():
            low, high = min(low, float(level[inside].min())), max(high, float(level[inside].max()))
            left, right = min(left, float(one.phase[inside].min())), max(right, float(one.phase[inside].max()))
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


def _regions(panel: Axes, alphas: Sequence[float], skew: float) -> list[Any]:
    """Shade what each margin keeps free, around every critical point, the largest below the others."""
    handles = []
    for k, alpha in enumerate(alphas):
        L = exclusion(alpha, skew)
        # Around -180 degrees the angle of -L has no jump.
        phase, level = np.degrees(np.angle(-L)), 20.0 * np.log10(np.abs(L))
        style: dict[str, Any] = {
            "edgecolor": MUTED,
            "linewidth": 0.9,
            "linestyle": ("-", (0, (4, 1.5)), (0, (1.2, 1.4)))[k % 3],
        }
        drawn = [
            panel.fill(c + phase, level, facecolor=BAND, alpha=1.0, zorder=0.6, **style)[0] for c in _centres(panel)
        ]
        handles.append(drawn[0] if drawn else panel.fill([], [], facecolor=BAND, **style)[0])
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
