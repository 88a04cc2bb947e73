"""The two-sided Nyquist plot of a complex loop."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from platform_ctrl.analysis.arrays import ComplexArray
from platform_ctrl.common.signatures import short
from platform_ctrl.common.text import at_least
from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.classical.complex_shaping import ComplexLoop, TwoSidedNyquist
from platform_ctrl.errors import ArgumentError
from platform_ctrl.report.plots.label_placement import LabelPlacer
from platform_ctrl.report.plots.nyquist import arrow, critical_point, margin_disk, plane_of_L
from platform_ctrl.report.quantities import HZ
from platform_ctrl.report.style import (
    DASHES,
    LIMIT,
    SERIES,
    legend_above,
    legend_rows,
    panels,
    standalone,
)

# Half width of the close view about −1, and of the wide one.
_CLOSE, _WIDE = 1.8, 6.0
# Frequencies, Hz, that are written along the curve where there is room: round numbers.
_ROUND = np.array([1, 2, 3, 5, 7])


@standalone
def two_sided_nyquist(curve: TwoSidedNyquist | ComplexLoop) -> Figure:
    """L over positive and negative frequencies: as a whole, and close to −1 with the disk that its margin keeps free.

    The disk holds the points that perturbed loops of the margin's size would need to reach −1: L touches it once.

    Parameters
    ----------
    curve
        From `design.complex_shaping.complex_loop`: the loop itself, or its ``nyquist``.

    Returns
    -------
    matplotlib.figure.Figure
        Two panels.

    Raises
    ------
    ArgumentError
        It is something else.
    """
    curve = curve.nyquist if isinstance(curve, ComplexLoop) else curve
    if not isinstance(curve, TwoSidedNyquist):
        raise ArgumentError(
            f"two_sided_nyquist: given {short(curve)}; expected a TwoSidedNyquist or ComplexLoop, from complex_loop"
        )
    names = ["ω > 0: turning from α to β", "ω < 0: from β to α", "−1"]
    if 0.0 < curve.disk_margin < 2.0:
        names.append(
            f"disk margin {at_least(curve.disk_margin, 2)}; L touches it at {_signed(curve.margin_frequency * HZ)} Hz"
        )
    figure, [[wide, close]] = panels(1, 2, 4.9, legend=legend_rows(names))
    handles: list[Any] = []
    for axes, centre, half in ((wide, 0.0, _WIDE), (close, -1.0, _CLOSE)):
        drawn = [_branch(axes, curve, sign) for sign in (1, -1)]
        disk = _disk(axes, curve)
        critical = critical_point(axes)
        plane_of_L(axes, centre, half)
        places = LabelPlacer(axes, [np.column_stack([line.get_xdata(), line.get_ydata()]) for line in drawn])
        places.reserve(-1.0, 0.0, 5.0)
        taken: list[complex] = []
        for sign in (1, -1):
            _arrows(axes, curve, sign, centre, half)
            _label(axes, places, curve, sign, centre, half, taken)
        handles = [*drawn, critical, *([disk] if disk is not None else [])]
    wide.set_ylabel("imaginary part of L")
    legend_above(figure, handles, names)
    wide.set_title(f"L = −K P, frequencies in Hz; turns round −1: {curve.encirclements}")
    close.set_title("close to −1" if curve.disk_margin else f"close to −1; {curve.closed_unstable} unstable poles")
    return figure


def _signed(number: float) -> str:
    return f"{number:+.4g}".replace("-", "−")


def _side(curve: TwoSidedNyquist, sign: int) -> tuple[FloatArray, ComplexArray]:
    chosen = curve.frequency * sign > 0.0
    return curve.frequency[chosen], curve.loop_transfer[chosen]


def _branch(axes: Axes, curve: TwoSidedNyquist, sign: int) -> Any:
    _, L = _side(curve, sign)
    # Across a pole the curve goes through infinity: no line is drawn there.
    far = np.abs(L) > 50.0
    L = np.where(far, np.nan, L)
    k = 0 if sign > 0 else 1
    [line] = axes.plot(L.real, L.imag, color=SERIES[k], linestyle=DASHES[k], linewidth=1.6)
    return line


def _disk(axes: Axes, curve: TwoSidedNyquist) -> Any:
    """Values of L that a change of the margin's size in gain and phase could bring to −1, and where L touches them."""
    drawn = margin_disk(axes, curve.disk_margin)
    if drawn is not None:
        touching = curve.loop_transfer[int(np.argmin(np.abs(curve.frequency - curve.margin_frequency)))]
        axes.plot([touching.real], [touching.imag], "D", color=LIMIT, markersize=4, zorder=3)
    return drawn


def _inside(L: ComplexArray, centre: float, half: float, share: float = 0.97) -> Any:
    return np.isfinite(L) & (np.abs(L.real - centre) < share * half) & (np.abs(L.imag) < share * half)


def _arrows(axes: Axes, curve: TwoSidedNyquist, sign: int, centre: float, half: float) -> None:
    """One arrow in the middle of each long visible stretch, towards rising frequency."""
    _, L = _side(curve, sign)
    visible = _inside(L, centre, half, 0.9)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], visible.astype(np.int8), [0]])))
    for start, end in edges.reshape(-1, 2):
        steps = np.abs(np.diff(L[start:end]))
        if steps.sum() < 0.5 * half:
            continue
        k = start + int(np.searchsorted(np.cumsum(steps), 0.5 * steps.sum()))
        k = min(k, end - 2)
        arrow(axes, L, k, 0.01 * half, SERIES[0 if sign > 0 else 1])


def _label(
    axes: Axes, places: LabelPlacer, curve: TwoSidedNyquist, sign: int, centre: float, half: float, taken: list[complex]
) -> None:
    """Write round frequencies along the branch, wherever nothing else stands near."""
    w, L = _side(curve, sign)
    f = np.abs(w) * HZ
    order = np.argsort(f)
    for decade in 10.0 ** np.arange(-1, 4):
        for number in _ROUND * decade:
            if not f.min() <= number <= f.max():
                continue
            at = complex(np.interp(number, f[order], L.real[order]), np.interp(number, f[order], L.imag[order]))
            if not _inside(np.array([at]), centre, half, 0.9)[0]:
                continue
            if any(abs(at - other) < 0.13 * half for other in taken):
                continue
            taken.append(at)
            axes.plot([at.real], [at.imag], "o", color=SERIES[0 if sign > 0 else 1], markersize=3.2)
            places.write(_signed(sign * number), at.real, at.imag)
