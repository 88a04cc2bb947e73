"""A campaign's rare events as blocks of its page."""

from __future__ import annotations

import math

from platform_ctrl.campaign.plan import Plan
from platform_ctrl.campaign.rare_result import RareResult
from platform_ctrl.report import campaign_tables as tables
from platform_ctrl.report.content import (
    Block,
    Cell,
    Column,
    Facts,
    Group,
    Mark,
    Paragraph,
    Part,
    Row,
    Strip,
    Table,
    sentence,
    table,
)
from platform_ctrl.report.quantities import MINUS, plain

# Length of the picture beside a shift, in pixels.
_SHIFT = 180.0
# Violations that are shown.
_MOST_PROBABLE = 5


def rare_part(plan: Plan, rare: RareResult) -> Part:
    """Return a rare event of a campaign: its probability, the levels that led there, what has to come together."""
    repetitions = [
        (
            str(k),
            tables.chance(one.probability),
            f"{one.variation:.2f}",
            ", ".join(plain(float(level), 3) for level in one.levels),
        )
        for k, one in enumerate(rare.repetitions, 1)
    ]
    numbers = "probability|own variation"
    blocks: list[Block] = [
        Facts(rows=tuple(tables.rare_rows(rare))),
        table(f"repetition|{numbers}|levels, figure over limit", repetitions, numbers=numbers, form="narrow"),
    ]
    shifts = tables.moved(plan, rare)
    if shifts:
        blocks.append(_moved(shifts))
    points = _points(plan, rare)
    if points is not None:
        blocks.append(Part(title="Most probable violations", blocks=(points,)))
    return Part(title=sentence(tables.rare_words(rare)), blocks=tuple(blocks))


def _moved(shifts: list[tuple[str, float]]) -> Part:
    largest = max(abs(shift) for _, shift in shifts) or 1.0
    rows = []
    for name, shift in shifts:
        end = 0.5 + 0.5 * shift / largest
        marks = (
            Mark(form="bar", start=min(0.5, end), end=max(0.5, end), colour="series-2"),
            Mark(form="tick", start=0.5, colour="frame"),
        )
        words = f"{shift:+.1f}".replace("-", MINUS)
        rows.append(
            Row(
                cells=(
                    Cell(text=name),
                    Cell(text=f"{words} σ"),
                    Cell(text="", strip=Strip(length=_SHIFT, marks=marks)),
                )
            )
        )
    columns = (Column(title="input"), Column(title="moved by", number=True), Column(title=""))
    words = "Mean of the inputs of violating runs, in standard deviations from their middles; a fault's towards "
    made = Table(columns=columns, groups=(Group(rows=tuple(rows)),), form="narrow")
    return Part(title="What has to come together", blocks=(Paragraph(text=f"{words}happening."), made))


def _points(plan: Plan, rare: RareResult) -> Table | None:
    """Return the violations that are most probable, a column each."""
    shown = rare.violations[:_MOST_PROBABLE]
    if not shown:
        return None
    inputs = [plan.inputs_at(one.u[None, :]) for one in shown]
    found = [
        ("distance", *(f"{one.distance:.2f} σ" for one in shown)),
        ("over limit", *("diverged" if math.isinf(one.ratio) else plain(one.ratio, 4) for one in shown)),
        *((name, *(tables.input_words(one[name][0].item()) for one in inputs)) for name in plan.input_names),
        ("noise of run", *(str(one.run) for one in shown)),
    ]
    columns = (Column(title=""), *(Column(title="", number=True) for _ in shown))
    rows = tuple(Row(cells=tuple(Cell(text=text) for text in row)) for row in found)
    return Table(columns=columns, groups=(Group(rows=rows),), form="narrow")
