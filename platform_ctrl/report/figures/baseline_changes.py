"""One figure of what has moved since a baseline: every figure against its tolerance, and the loops before and now."""

from __future__ import annotations

import os
from contextlib import suppress
from io import BytesIO
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from platform_ctrl.analysis.arrays import ComplexArray, StateArrays, named_system
from platform_ctrl.analysis.feedback import closed_loop, gang
from platform_ctrl.analysis.frequency_grids import following_grid
from platform_ctrl.analysis.poles import continuous_poles, poles
from platform_ctrl.common.files import write_whole
from platform_ctrl.common.text import text_width
from platform_ctrl.common.values import FloatArray
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.quantities import HZ, in_one_unit
from platform_ctrl.report.style import (
    BAND,
    FULL_WIDTH,
    INK,
    LIMIT,
    MUTED,
    REFERENCE,
    SERIES,
    frequency_axes,
    gain_limits,
    linear_axis,
    settings,
    standalone,
)
from platform_ctrl.verification.baselines.comparison import Change, Comparison
from platform_ctrl.verification.baselines.record import LoopMatrices

_DPI = 150
# No more bars than a page holds, and none longer than this many tolerances.
_BARS, _LONGEST = 24, 8.0
_BAR, _LOOP, _TOP, _BOTTOM, _GAP = 0.24, 2.5, 0.6, 0.5, 0.75
_PER_ROW = 3


@standalone
def moved_figure(comparison: Comparison, title: str) -> Figure:
    """Return a figure of the changes since a baseline, for those who find a failed test.

    Above, a bar for every figure, the worst first: its change over its tolerance, worse to the right. Below, for every
    loop whose plant or controller is another one, the largest singular value of its sensitivity before and now.
    """
    bars = [change for change in comparison.changes if change.before is not None and change.now is not None]
    bars = sorted(bars, key=lambda change: -change.of_tolerance)
    shown = bars if len(bars) <= _BARS else sorted(bars, key=_size)[-_BARS:]
    shown = sorted(shown, key=lambda change: -change.of_tolerance)
    loops = [pair for pair in comparison.pairs if pair[0].plant is not None and not pair[0].agrees(pair[1])]
    loops = [(before, now) for before, now in loops if now.plant is not None]
    rows = -(-len(loops) // _PER_ROW)
    bars_height = _BAR * max(len(shown), 2)
    height = _TOP + bars_height + _BOTTOM + rows * (_LOOP + _GAP)
    figure = Figure(figsize=(FULL_WIDTH, height))
    figure.text(0.1 / FULL_WIDTH, 1.0 - 0.2 / height, title, weight="bold", fontsize=9.5, color=INK, va="center")
    names = [f"{change.subject}: {change.name}" for change in shown]
    left = 0.25 + max((text_width(name, 8.0) for name in names), default=0.0) / 72.0
    left = min(left, 0.5 * FULL_WIDTH)
    width = FULL_WIDTH - left - 1.9
    axes = figure.add_axes(
        (left / FULL_WIDTH, 1.0 - (_TOP + bars_height) / height, width / FULL_WIDTH, bars_height / height)
    )
    _draw_bars(axes, shown, names, hidden=len(bars) - len(shown))
    cell = (FULL_WIDTH - 0.7) / max(min(len(loops), _PER_ROW), 1)
    for k, (before, now) in enumerate(loops):
        row, column = divmod(k, _PER_ROW)
        bottom = height - _TOP - bars_height - _BOTTOM - (row + 1) * (_LOOP + _GAP) + 0.5
        place = (0.7 + column * cell) / FULL_WIDTH, bottom / height, (cell - 0.6) / FULL_WIDTH, _LOOP / height
        _draw_loop(figure.add_axes(place), before, now)
    return figure


def write_moved_figure(comparison: Comparison, title: str, path: str | os.PathLike[str]) -> Path:
    """Write `moved_figure` as a PNG, whole or not at all, and return its path; folders are made."""
    target, drawn = Path(path), BytesIO()
    figure = moved_figure(comparison, title)
    with settings():
        figure.savefig(drawn, format="png", dpi=_DPI, facecolor="white")
    with suppress(OSError):  # said by what writes
        target.parent.mkdir(parents=True, exist_ok=True)
    return write_whole(target, drawn.getvalue())


def _size(change: Change) -> float:
    """What is worse beyond its tolerance comes before all others, however much better they are."""
    return _LONGEST * 1e6 + change.of_tolerance if change.state == "worse" else abs(change.of_tolerance)


def _draw_bars(axes: Axes, shown: list[Change], names: list[str], hidden: int) -> None:
    sizes = np.array([change.of_tolerance for change in shown])
    reach = float(np.clip(np.abs(sizes).max(initial=0.0), 1.6, _LONGEST))
    colours = [LIMIT if change.state == "worse" else SERIES[0] for change in shown]
    places = -np.arange(len(shown), dtype=np.float64)
    axes.axvspan(-1.0, 1.0, color=BAND, linewidth=0, zorder=0)
    axes.axvline(0.0, color=REFERENCE, linewidth=0.8)
    axes.barh(places, np.clip(sizes, -reach, reach), height=0.62, color=colours, zorder=2)
    axes.set_yticks(places, names)
    axes.set_ylim(-max(len(shown), 2) + 0.5, 0.5)
    axes.set_xlim(-reach, reach)
    linear_axis(axes.xaxis, 9)
    axes.grid(axis="y", visible=False)
    axes.tick_params(axis="y", length=0)
    words = "change over tolerance: within the band accepted, to the right of it worse"
    words += "; bars that touch the frame are longer" if np.abs(sizes).max(initial=0.0) > reach else ""
    axes.set_xlabel(words + (f"; {hidden} figures more" if hidden else ""))
    for change, place in zip(shown, places, strict=True):
        before, now = in_one_unit((change.before, change.now), change.unit)
        unit = before.partition(" ")[2]
        words = f"{before.removesuffix(unit).rstrip()} → {now}"
        colour = LIMIT if change.state == "worse" else MUTED
        axes.annotate(
            words,
            (1.0, place),
            (6, 0),
            xycoords=("axes fraction", "data"),
            textcoords="offset points",
            va="center",
            color=colour,
            fontsize=7.5,
        )


def _draw_loop(axes: Axes, before: LoopMatrices, now: LoopMatrices) -> None:
    """Draw the largest singular value of S before and now, on a grid that follows the poles of both."""
    axes.set_title(f"S of {now.loop}")
    found = _responses(before, now)
    if found is None:
        axes.text(0.5, 0.5, "the baseline's matrices\nclose no loop", ha="center", transform=axes.transAxes)
        return
    frequency, *curves = found
    axes.plot(frequency * HZ, curves[0], color=SERIES[1], linestyle=(0, (5, 2)), linewidth=1.3, label="before")
    axes.plot(frequency * HZ, curves[1], color=SERIES[0], linewidth=1.8, label="now")
    frequency_axes(axes, frequency[0] * HZ, frequency[-1] * HZ)
    gain_limits(axes, curves, low=1e-3, high=1e2)
    axes.axhline(np.sqrt(0.5), color=REFERENCE, linewidth=0.8)
    axes.set_ylabel("largest singular value, 1")
    axes.legend(loc="lower right")


def _responses(before: LoopMatrices, now: LoopMatrices) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Return frequencies and both sensitivities; None where the file's matrices, edited by hand, have none."""
    nyquist = np.pi / now.controller.dt
    try:
        with np.errstate(all="ignore"):
            poles = np.concatenate([_poles(before), _poles(now)])
            # A pole of a delay, z = 0, lies infinitely far to the left; one to the right has overflowed.
            if np.isnan(poles).any() or np.isposinf(poles.real).any():
                return None
            slowest = np.abs(poles.imag[np.abs(poles.imag) > 1e-4 * nyquist]).min(initial=0.05 * nyquist)
            frequency = following_grid(poles, max(0.02 * float(slowest), 1e-4 * nyquist), 0.999 * nyquist)
            curves = [_sensitivity(loop, frequency) for loop in (before, now)]
    except (ArgumentError, np.linalg.LinAlgError):
        return None
    return (frequency, curves[0], curves[1]) if np.isfinite(curves).all() else None


def _matrices(loop: LoopMatrices) -> tuple[StateArrays, StateArrays]:
    assert loop.plant is not None
    return loop.plant, loop.controller


def _poles(loop: LoopMatrices) -> ComplexArray:
    P, K = _matrices(loop)
    A = closed_loop(P, K).A
    z = np.concatenate([poles(A), poles(P.A)])
    return continuous_poles(z, K.dt)


def _sensitivity(loop: LoopMatrices, frequency: FloatArray) -> FloatArray:
    P, K = _matrices(loop)
    found = gang(named_system(P, loop.outputs, loop.inputs), named_system(K, loop.inputs, loop.outputs), frequency)
    sizes = [np.linalg.svd(np.moveaxis(S, -1, 0), compute_uv=False)[:, 0] for S in (found.S_input, found.S_output)]
    return np.asarray(np.maximum(*sizes), dtype=np.float64)
