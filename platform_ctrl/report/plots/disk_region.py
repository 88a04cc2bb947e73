"""What a disk margin allows, in the plane of gain and phase: the region of safe changes, and what it keeps free of L.

All factors (1 + δ (1 − skew) α/2) / (1 − δ (1 + skew) α/2) with |δ| < 1 on a loop's gain are safe; −1 over one of them
is a value that L never takes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from numbers import Real
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter, NullLocator
from numpy.typing import ArrayLike

from platform_ctrl.analysis.arrays import ComplexArray
from platform_ctrl.analysis.disks import disk_phase, disk_to_gain_phase
from platform_ctrl.analysis.margins import DiskMargin, disk_margin
from platform_ctrl.analysis.transfer_function import LinearSystem
from platform_ctrl.common.arguments import positive
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.text import at_least, at_most
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError
from platform_ctrl.report.plots.label_placement import LabelPlacer
from platform_ctrl.report.plots.panels import blocks, control_plot, curve_style
from platform_ctrl.report.plots.systems import DrawnSystem, as_state_space, drawn_systems, gaps, grid, listed
from platform_ctrl.report.quantities import HZ, disk_gain_or_phase, plain
from platform_ctrl.report.style import REFERENCE, standalone

if TYPE_CHECKING:
    import control

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


@check_arguments
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
    _, axes = blocks(1, 1, (4.0,), words, titles=False, width=7.2)
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


def exclusion(alpha: float, skew: float, points: int = 721) -> ComplexArray:
    """Return the rim of the values of L that a disk margin keeps free: there |S + (skew − 1)/2| is 1/alpha.

    `alpha` is below 2/(1 + |skew|), so that the region holds neither 0 nor infinity.
    """
    delta = np.exp(2j * np.pi * np.linspace(0.0, 1.0, points))
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
