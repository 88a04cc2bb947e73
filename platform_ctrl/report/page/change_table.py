"""What to change, on the first screen: one change a row, what it gains and what it costs."""

from __future__ import annotations

from platform_ctrl.job.judging import CheckResult
from platform_ctrl.job.methods import METHODS
from platform_ctrl.report.page.blocks import Block, Cell, Column, Group, Paragraph, Part, Row, Table
from platform_ctrl.report.page.captions import sentences
from platform_ctrl.report.quantities import compared, percent, plain
from platform_ctrl.verification.changes import FAR, GAIN, Change
from platform_ctrl.verification.verdict import JobResult


def change_part(result: JobResult, rows: tuple[Change, ...]) -> tuple[Block, ...]:
    """Return the rows under their heading; nothing for a job without requirements."""
    if not result.requirements:
        return ()
    missed = [one for one in result.requirements if not one.passed]
    tuned = {(spec.name, one.name) for spec in result.job.loops for one in spec.designs if one.tune}
    words = sentences("what_to_change", rows=rows, missed=len(missed), gain=GAIN, far=FAR)
    more = sentences(
        "changes_measured",
        rows=rows,
        runs=sum(one.stage == "simulated" for one in missed),
        scaled=any(one.kind == "gain" for one in rows),
        tuned=any((one.loop, one.design) in tuned for one in rows if one.kind == "option"),
    )
    first, notes = (Paragraph(text=text, tone="quiet") for text in (words, more))
    blocks: list[Block] = [first, _table(rows)] if rows else [first]
    if notes.text:
        blocks.append(notes)
    return (Part(title="What to change", blocks=tuple(blocks)),)


def _table(rows: tuple[Change, ...]) -> Table:
    columns = tuple(Column(title=title) for title in ("requirement", "change", "gain", "cost"))
    body = tuple(
        Row(
            cells=(
                Cell(text=one.target.before.name, note=one.target.before.subject),
                _change(one),
                Cell(
                    text=_moved(one.target.before, one.target.after),
                    note=_margins(one.target.before, one.target.after),
                    tone="good" if one.target.after.passed and not one.target.before.passed else "",
                ),
                _cost(one),
            ),
            missed=not one.target.before.passed,
        )
        for one in rows
    )
    return Table(columns=columns, groups=(Group(rows=body),), form="changes")


def _change(one: Change) -> Cell:
    if one.kind == "design":
        return Cell(text=f"close “{one.name}”", note=f"{one.loop}: a design of this job")
    if one.kind == "source":
        return Cell(text=f"{one.name} at {plain(100.0 * one.after, 3)} %", note="amplitude of a source of the budget")
    where = f"{one.loop}, {one.design}"
    if one.kind == "gain":
        return Cell(text=f"gain × {plain(one.after, 3)}", note=where)
    method = next((kind for kind in METHODS.values() if kind.instant and one.name in kind.options), None)
    unit = "" if method is None else f" {method.options[one.name].unit}"
    return Cell(text=f"{one.name} {plain(one.before)} → {plain(one.after)}{unit}".rstrip(), note=where)


def _cost(one: Change) -> Cell:
    if one.violated:
        worst = one.violated[0]
        number, limit = compared(worst.after)
        way = "below" if worst.after.sense == "at least" else "above"
        others = len(one.violated) - 1
        more = f"; {others} more violated" if others else ""
        return Cell(
            text=f"{worst.after.name} {compared(worst.before)[0]} → {number}: {way} {limit}",
            note=f"{_where(one, worst.after)}{_margins(worst.before, worst.after)}{more}",
            tone="bad",
        )
    if one.loss is None:
        return Cell(text="none", tone="quiet")
    before, after = one.loss.before, one.loss.after
    note = f"{_where(one, after)}{_margins(before, after)}: within its limit"
    return Cell(text=f"{after.name} {_moved(before, after)}", note=note)


def _where(one: Change, result: CheckResult) -> str:
    return "" if result.subject == one.target.before.subject else f"{result.subject}: "


def _moved(before: CheckResult, after: CheckResult) -> str:
    return f"{compared(before)[0]} → {compared(after)[0]}"


def _margins(before: CheckResult, after: CheckResult) -> str:
    return f"margin {percent(before.margin)} → {percent(after.margin)}"
