"""The report's section about the line of sight: what each source does to it."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from platform_ctrl.plant.sensors import LOS_ANGLES
from platform_ctrl.report.figures.budget import MICRO, budget_figure, simulated_figure, waterfall_figure
from platform_ctrl.report.page.blocks import Block, Paragraph, Part, Section, Table, plate, sentence, table
from platform_ctrl.report.page.captions import sentences
from platform_ctrl.report.quantities import plain, quantity
from platform_ctrl.verification.budget_result import LineOfSightBudget
from platform_ctrl.verification.simulated_budget import SimulatedBudget
from platform_ctrl.verification.verdict import JobResult

# Shares of the mean square that are none.
_ROUNDING = 1e-12


def budget_sections(result: JobResult) -> list[Section]:
    """Return the section; none where the job does not limit the line of sight."""
    found, budget = result.budget, result.job.budget
    if found is None or budget is None:
        return []
    blocks: list[Block] = [
        Paragraph(text=sentences("budget", found=found, budget=budget)),
        plate(budget_figure(budget, found), "Line of sight: rms up to a frequency", sentences("budget_figure")),
        plate(waterfall_figure(budget, found), "Line of sight: from sources to the total", sentences("waterfall")),
        _sources(found),
    ]
    if found.windows:
        blocks.append(Part(title="Within an exposure", blocks=(_windows(found, budget.spatial_frequencies),)))
    if result.simulated_budget is not None:
        blocks.append(_simulated(result.simulated_budget))
    if found.friction is not None:
        lines = tuple(Paragraph(text=f"{sentence(line)}") for line in found.friction.statement)
        blocks.append(Part(title="Dry friction", blocks=lines))
    return [Section(name="budget", title="Line-of-sight budget", blocks=tuple(blocks))]


def _sources(found: LineOfSightBudget) -> Table:
    rows = []
    for name, kind, rms, shares in zip(found.names, found.kinds, found.rms, found.shares, strict=True):
        # Rounding shows in axes on which a source does not act.
        pairs = zip(_micro(np.where(shares > _ROUNDING, rms, 0.0)), map(_percent, shares), strict=True)
        rows.append((name, kind, *(text for pair in pairs for text in pair)))
    total = [text for one in _micro(found.total) for text in (one, "")]
    numbers = "|".join(f"{axis}, µrad|share" for axis in found.axes)
    return table(f"source|kind|{numbers}", [*rows, ("all together", "", *total)], numbers=numbers)


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


def _simulated(runs: SimulatedBudget) -> Part:
    rows = []
    for name, *rms, linear in zip(LOS_ANGLES[:2], runs.rms, runs.low, runs.high, runs.linear, strict=False):
        rows.append((name, *_micro([*rms, linear]), plain(float(rms[0] / linear), 4) if linear > 0.0 else ""))
    numbers = "simulated, µrad|95 % interval, from|to|linear, µrad|simulated over linear"
    title = "Line of sight: simulated and linear rms"
    blocks: tuple[Block, ...] = (
        Paragraph(text=sentences("simulated_budget", runs=runs)),
        plate(simulated_figure(runs), title, sentences("simulated_budget_figure")),
        table(f"axis|{numbers}", rows, numbers=numbers),
        *(Paragraph(text=sentence(f"not simulated: {line}")) for line in runs.left_out),
    )
    return Part(title="Simulated runs beside the linear budget", blocks=blocks)


def _micro(rms: Iterable[float]) -> list[str]:
    return [plain(MICRO * float(x), 4) for x in rms]


def _percent(share: float) -> str:
    return f"{plain(100.0 * share, 3)} %" if share > _ROUNDING else ""
