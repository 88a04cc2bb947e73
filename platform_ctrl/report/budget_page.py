"""The report's section about the line of sight: what each source does to it, in tables and plots."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from platform_ctrl.job.budget import BudgetSpec
from platform_ctrl.job.quantities import plain, quantity
from platform_ctrl.plant.sensors import LOS_ANGLES
from platform_ctrl.report.blocks import Block, Paragraph, Subsection, Table, drawn, sentence, table
from platform_ctrl.report.captions import sentences
from platform_ctrl.report.style import (
    DASHED,
    INK,
    LIMIT,
    REFERENCE,
    frequency_axes,
    legend,
    line_style,
    linear_axis,
    panels,
)
from platform_ctrl.verification.budget_result import (
    TOGETHER,
    LineOfSightBudget,
    SimulatedBudget,
    Waterfall,
    rms_ticks,
    waterfalls,
)
from platform_ctrl.verification.verdict import JobResult

# Shares of the mean square that are none.
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
        _sources(found),
    ]
    if found.windows:
        blocks.append(Subsection(title="Within an exposure", blocks=(_windows(found, budget.spatial_frequencies),)))
    if result.simulated_budget is not None:
        blocks.append(_simulated(result.simulated_budget))
    if found.friction is not None:
        lines = tuple(Paragraph(text=f"{sentence(line)}") for line in found.friction.statement)
        blocks.append(Subsection(title="Dry friction", blocks=lines))
    return blocks


def _sources(found: LineOfSightBudget) -> Table:
    rows = []
    for name, kind, rms, shares in zip(found.names, found.kinds, found.rms, found.shares, strict=True):
        # Rounding shows in axes on which a source does not act.
        pairs = zip(_micro(np.where(shares > _ROUNDING, rms, 0.0)), map(_percent, shares), strict=True)
        rows.append((name, kind, *(text for pair in pairs for text in pair)))
    total = [text for one in _micro(found.total) for text in (one, "")]
    numbers = "|".join(f"{axis}, µrad|share" for axis in found.axes)
    return table(f"source|kind|{numbers}", [*rows, (TOGETHER, "", *total)], numbers=numbers)


def _windows(found: LineOfSightBudget, spatial_frequencies: Iterable[float]) -> Table:
    rows = []
    for one in found.windows:
        for k, axis in enumerate(found.axes[:2]):
            rms = _micro([one.displacement[k], one.smear[k], one.jitter[k], one.about_mean[k]])
            contrast = [plain(float(x), 4) for x in one.contrast[k]]
            rows.append((quantity(one.exposure, "s"), axis, *rms, *contrast))
    waves = [f"contrast at {nu:g}/rad" for nu in spatial_frequencies]
    numbers = "|".join(["displacement, µrad", "smear, end to end", "jitter", "about the mean", *waves])
    return table(f"exposure|axis|{numbers}", rows, numbers=numbers)


def _simulated(runs: SimulatedBudget) -> Subsection:
    rows = []
    for name, *rms, linear in zip(LOS_ANGLES[:2], runs.rms, runs.low, runs.high, runs.linear, strict=False):
        rows.append((name, *_micro([*rms, linear]), plain(float(rms[0] / linear), 4) if linear > 0.0 else ""))
    numbers = "simulated, µrad|95 % interval, from|to|linear, µrad|simulated over linear"
    blocks: tuple[Block, ...] = (
        Paragraph(text=sentences("simulated_budget", runs=runs)),
        table(f"axis|{numbers}", rows, numbers=numbers),
        *(Paragraph(text=sentence(f"not simulated: {line}")) for line in runs.left_out),
    )
    return Subsection(title="Simulated runs beside the linear budget", blocks=blocks)


def _micro(rms: Iterable[float]) -> list[str]:
    return [plain(_MICRO * float(x), 4) for x in rms]


def _percent(share: float) -> str:
    return f"{plain(100.0 * share, 3)} %" if share > _ROUNDING else ""


def budget_figure(budget: BudgetSpec, found: LineOfSightBudget) -> Figure:
    """Draw the rms of both axes across the line of sight up to a frequency: all sources, and the largest ones."""
    largest = found.ranking[:_CURVES]
    names = ["all sources", *(found.names[k] for k in largest)]
    figure, [[first, second]] = panels(1, 2, 2.0, names)
    handles: list[Line2D] = []
    inside = (found.frequencies_hz >= budget.from_hz) & (found.frequencies_hz <= budget.to_hz)
    f = found.frequencies_hz[inside]
    for axis, axes in enumerate((first, second)):
        curves = [found.total_cumulative[axis], *(found.cumulative[k, axis] for k in largest)]
        drawn = []
        for k, curve in enumerate(curves):
            rms = _MICRO * np.sqrt(curve[inside])
            drawn += axes.plot(f, rms, **line_style(k))
        handles = handles or drawn
        frequency_axes(axes, budget.from_hz, budget.to_hz, log_gain=False)
        axes.set_ylim(0.0, 1.08 * _MICRO * max(float(found.total[axis]), 1e-12))
        linear_axis(axes.yaxis)
        axes.set_title(found.axes[axis])
    first.set_ylabel("rms up to this frequency, µrad")
    legend(figure, handles, names)
    return figure


def waterfall_figure(budget: BudgetSpec, found: LineOfSightBudget) -> Figure:
    """Draw how the mean squares of the sources add up to the total, the largest first: by axis, and both together."""
    falls = waterfalls(budget, found)
    rows = 1 + max(len(fall.names) for fall in falls)
    figure, [every] = panels(1, len(falls), _ROW * rows)
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
            axes.set_title(words, loc="right", color=LIMIT, fontweight="normal", fontsize=7.5)
            if fall.limit_inside:
                axes.axvline(fall.limit**2, color=LIMIT, linestyle=DASHED, linewidth=1.2)
    return figure


def _steps(axes: Axes, fall: Waterfall, ranking: Sequence[int]) -> None:
    """Draw a bar with its words above for each step, and one for all together."""
    last = len(fall.names)
    bars = [
        *zip(fall.low, fall.high, [_curve_of(ranking, place) for place in fall.places], strict=True),
        (0.0, fall.total**2, 0),
    ]
    words = [*zip(fall.names, fall.rms, fall.shares, strict=True), (TOGETHER, fall.total, 1.0)]
    for k, ((low, high, curve), (name, rms, share)) in enumerate(zip(bars, words, strict=True)):
        colour = REFERENCE if curve is None else line_style(curve)["color"]
        left = min(low, high)
        axes.barh(k + _BAR, max(abs(high - low), _THIN * fall.end), _TALL, left, color=colour, linewidth=0.0)
        value = f"{plain(_MICRO * rms, 3)} µrad" + ("" if k == last else f", {plain(100.0 * share, 2)} %")
        axes.text(0.0, k + _WORDS, f"{name}: {value}", fontsize=7.5, va="center", color=INK)


def _curve_of(ranking: Sequence[int], place: int | None) -> int | None:
    """Return which curve of the plot up to a frequency a source is, 0 being all; None where it has none of its own."""
    rank = ranking.index(place) if place is not None else _CURVES
    return 1 + rank if rank < _CURVES else None
