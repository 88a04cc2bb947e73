"""The report's section about the line of sight: what each source does to it, in tables and plots."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from platform_ctrl.job.budget import BudgetSpec
from platform_ctrl.job.quantities import plain
from platform_ctrl.plant.sensors import LOS_ANGLES
from platform_ctrl.report import style
from platform_ctrl.report.blocks import Block, Paragraph, Subsection, Table, drawn, sentence, table
from platform_ctrl.report.captions import sentences
from platform_ctrl.verification.budget_result import (
    TOGETHER,
    LineOfSightBudget,
    SimulatedBudget,
    Waterfall,
    WindowBudget,
    rms_ticks,
    waterfalls,
)
from platform_ctrl.verification.verdict import JobResult

# Shares of the mean square that count as zero.
_ROUNDING = 1e-12
_MICRO = 1e6
# Sources that have a curve of their own.
_CURVES = 5
# Height of a step of a waterfall, inches; in this height: middle of its words, of its bar, and the bar's height. A bar
# is at least this share of the width.
_ROW, _WORDS, _BAR, _TALL, _THIN = 0.3, 0.27, 0.67, 0.36, 0.006


def budget_blocks(result: JobResult) -> list[Block]:
    """Return the section's blocks; none where the job does not limit the line of sight."""
    found, budget = result.budget, result.job.budget
    if found is None or budget is None:
        return []
    rms, waterfall = sentences("budget_figure"), sentences("waterfall")
    blocks: list[Block] = [
        Paragraph(text=sentences("budget", found=found, budget=budget)),
        *drawn("Line of sight: rms up to a frequency", lambda: budget_figure(budget, found), rms),
        *drawn("Line of sight: from sources to the total", lambda: waterfall_figure(budget, found), waterfall),
        sources_table(found),
    ]
    if found.windows:
        windows = tuple(window_table(one, budget.spatial_frequencies) for one in found.windows)
        blocks.append(Subsection(title="Within an exposure", blocks=windows))
    if result.simulated_budget is not None:
        blocks.append(_simulated(result.simulated_budget))
    if found.friction.frictions:
        lines = tuple(Paragraph(text=f"{sentence(line)}") for line in found.friction.statement)
        blocks.append(Subsection(title="Dry friction", blocks=lines))
    return blocks


def sources_table(found: LineOfSightBudget, others: Mapping[str, LineOfSightBudget | None] | None = None) -> Table:
    """Return what each source does; `others` are the budgets of other designs, None where they have none."""
    rows, largest = [], max(found.total, default=0.0)
    for name, kind, rms, shares in zip(found.names, found.kinds, found.rms, found.shares, strict=True):
        # Rounding shows in axes on which a source does not act.
        acting = _micro(np.where(shares > _ROUNDING, rms, 0.0), largest)
        percent = [f"{100.0 * share:.0f} %" if share > _ROUNDING else "" for share in shares]
        rows.append((name, kind, *(text for pair in zip(acting, percent, strict=True) for text in pair)))
    totals = {TOGETHER: _micro(found.total, largest), "both axes across, angles zero": _micro([found.jitter], largest)}
    for name, one in (others or {}).items():
        totals[f"with {name}"] = ["no budget"] if one is None else _micro(one.total, largest)
    for name, numbers in totals.items():
        rows.append((name, "", *(text for one in numbers for text in (one, ""))))
    return _table("source, µrad rms|kind", [head for axis in found.axes for head in (axis, "")], rows)


def window_table(one: WindowBudget, spatial_frequencies: Sequence[float]) -> Table:
    """Return what an exposure shows of the motion of the line of sight."""
    largest = max(one.displacement, default=0.0)
    rows = [
        ("displacement: the mean", *_micro(one.displacement, largest)),
        ("smear: the line's extent, end to end", *_micro(one.smear, largest)),
        ("jitter about the line", *_micro(one.jitter, largest)),
        ("about the mean, smear included", *_micro(one.about_mean, largest)),
    ]
    for nu, contrast in zip(spatial_frequencies, one.contrast.T, strict=True):
        rows.append((f"contrast at {nu:g} cycles/rad", *(f"{x:.4f}" for x in contrast)))
    return _table(f"within {1e3 * one.exposure:g} ms, µrad rms", LOS_ANGLES, rows)


def runs_table(runs: SimulatedBudget) -> Table:
    """Return what runs show, and the linear budget for the same."""
    largest = max(runs.linear, default=0.0)
    rows = [
        ("non-linear plant", *_micro(runs.rms, largest)),
        ("its 95 % interval, from", *_micro(runs.low, largest)),
        ("to", *_micro(runs.high, largest)),
        ("linear budget of the same", *_micro(runs.linear, largest)),
    ]
    return _table("µrad rms", LOS_ANGLES, rows)


def _table(words: str, axes: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    """Return a table with columns of words and of numbers; of axes that are not named nothing is shown."""
    width = len(words.split("|")) + len(axes)
    filled = [[*row, *[""] * (width - len(row))] for row in rows]
    return table("|".join([words, *axes]), filled, numbers="|".join(axes))


def _simulated(runs: SimulatedBudget) -> Subsection:
    blocks: tuple[Block, ...] = (
        Paragraph(text=sentences("simulated_budget", runs=runs)),
        runs_table(runs),
        *(Paragraph(text=sentence(f"not simulated: {line}")) for line in runs.left_out),
    )
    return Subsection(title="Simulated runs beside the linear budget", blocks=blocks)


def _micro(rms: Iterable[float], largest: float) -> list[str]:
    """Return angles, rad, in µrad, all with as many decimals as show the largest to four digits."""
    decimals = max(3 - math.floor(math.log10(_MICRO * largest)), 0) if 0.0 < largest < math.inf else 0
    least = 10.0**-decimals
    return [
        f"< {least:.{decimals}f}" if 0.0 < _MICRO * x < 0.5 * least else f"{_MICRO * x:.{decimals}f}" if x else "0"
        for x in rms
    ]


def budget_figure(budget: BudgetSpec, found: LineOfSightBudget) -> Figure:
    """Draw the rms of both axes across the line of sight up to a frequency: all sources, and the largest ones."""
    largest = found.ranking[:_CURVES]
    names = ["all sources", *(found.names[k] for k in largest)]
    figure, [[first, second]] = style.panels(1, 2, 2.0, names)
    handles: list[Line2D] = []
    inside = (found.frequencies_hz >= budget.from_hz) & (found.frequencies_hz <= budget.to_hz)
    f = found.frequencies_hz[inside]
    for axis, axes in enumerate((first, second)):
        curves = [found.total_cumulative[axis], *(found.cumulative[k, axis] for k in largest)]
        drawn = []
        for k, curve in enumerate(curves):
            rms = _MICRO * np.sqrt(curve[inside])
            drawn += axes.plot(f, rms, **style.line_style(k))
        handles = handles or drawn
        style.frequency_axes(axes, budget.from_hz, budget.to_hz, log_gain=False)
        axes.set_ylim(0.0, 1.08 * _MICRO * max(float(found.total[axis]), 1e-12))
        style.linear_axis(axes.yaxis)
        axes.set_title(found.axes[axis])
    first.set_ylabel("rms up to this frequency, µrad")
    style.legend(figure, handles, names)
    return figure


def waterfall_figure(budget: BudgetSpec, found: LineOfSightBudget) -> Figure:
    """Draw how the mean squares of the sources add up to the total, the largest first: by axis, and both together."""
    falls = waterfalls(budget, found)
    rows = 1 + max(len(fall.names) for fall in falls)
    figure, [every] = style.panels(1, len(falls), _ROW * rows)
    for axes, fall in zip(every, falls, strict=True):
        axes.set_title(fall.axis)
        axes.set_xlim(0.0, fall.end)
        axes.set_ylim(rows, 0.0)
        axes.set_yticks([])
        axes.spines["left"].set_visible(False)
        ticks = rms_ticks(fall.end)
        axes.set_xticks(ticks**2, [plain(_MICRO * float(one), 3) for one in ticks])
        axes.set_xlabel("rms, µrad; lengths are mean squares")
        _steps(axes, fall, found.ranking)
        if fall.limit is not None:
            where = "" if fall.limit_inside else " →"
            words = f"limit {plain(_MICRO * fall.limit, 3)} µrad{where}"
            axes.set_title(words, loc="right", color=style.LIMIT, fontweight="normal", fontsize=7.5)
            if fall.limit_inside:
                axes.axvline(fall.limit**2, color=style.LIMIT, linestyle=style.DASHED, linewidth=1.2)
    return figure


def _steps(axes: Axes, fall: Waterfall, ranking: Sequence[int]) -> None:
    """Draw a bar with its words above for each step, and one for all together."""
    last = len(fall.names)
    ranks = [_CURVES if place is None else ranking.index(place) for place in fall.places]
    bars = [*zip(fall.low, fall.high, ranks, strict=True), (0.0, fall.total**2, -1)]
    words = [*zip(fall.names, fall.rms, fall.shares, strict=True), (TOGETHER, fall.total, 1.0)]
    for k, ((low, high, rank), (name, rms, share)) in enumerate(zip(bars, words, strict=True)):
        # As the curve of the plot up to a frequency, of which the first is that of all sources.
        colour = style.line_style(1 + rank)["color"] if rank < _CURVES else style.REFERENCE
        left = min(low, high)
        axes.barh(k + _BAR, max(abs(high - low), _THIN * fall.end), _TALL, left, color=colour, linewidth=0.0)
        value = f"{plain(_MICRO * rms, 3)} µrad" + ("" if k == last else f", {plain(100.0 * share, 2)} %")
        axes.text(0.0, k + _WORDS, f"{name}: {value}", fontsize=7.5, va="center", color=style.INK)
