"""The report's tables as blocks of the page: rows of text from `tables` and `comparison`, with their marks."""

from __future__ import annotations

from collections.abc import Sequence

from platform_ctrl.design.jobs import LoopOutcome
from platform_ctrl.job.job import Job
from platform_ctrl.report.page import comparison, tables
from platform_ctrl.report.page.blocks import (
    Cell,
    Column,
    Document,
    Group,
    Listing,
    Mark,
    Paragraph,
    Part,
    Row,
    Strip,
    Table,
    table,
)
from platform_ctrl.report.page.tables import RequirementRow
from platform_ctrl.report.record import job_data, toml
from platform_ctrl.verification.verdict import JobResult

_BAR = 64.0


def requirement_table(result: JobResult) -> Table:
    """Return every requirement of a job, loop by loop, and each loop's goals after it."""
    goals, groups = tables.goal_rows(result), []
    for subject, rows in tables.by_subject(result).items():
        title = f"{subject}, {rows[0].design}" if rows[0].design else subject
        groups.append(Group(title=title, rows=tuple(_requirement(row) for row in rows)))
        wished = tuple(_requirement(row) for row in goals if row.subject == subject)
        if wished:
            groups.append(Group(title=f"goals of {subject}, no part of the verdict", rows=wished, quiet=True))
    columns = (
        Column(title="requirement"),
        Column(title="value", number=True),
        Column(title="limit", number=True),
        Column(title="margin", number=True),
        Column(title="stage"),
        Column(title="method"),
        Column(title="met"),
    )
    return Table(columns=columns, groups=tuple(groups), form="requirements")


def _requirement(row: RequirementRow) -> Row:
    reached = ("reached" if row.passed else "not reached") if row.goal else ("met" if row.passed else "not met")
    tone = "quiet" if row.goal else "good" if row.passed else "bad"
    name = row.requirement.removeprefix(comparison.GOAL) if row.goal else row.requirement
    colour = "reference" if row.goal else "bad" if row.share < 0.0 else "good"
    marks = (Mark(form="ground", start=0.0, end=1.0), Mark(form="bar", start=0.0, end=abs(row.share), colour=colour))
    return Row(
        cells=(
            Cell(text=name, note=row.evidence),
            Cell(text=row.value, tone="bad" if tone == "bad" else ""),
            Cell(text=row.limit),
            Cell(
                text=row.margin,
                tone="bad" if tone == "bad" else "",
                strip=Strip(length=_BAR, marks=marks if row.margin else ()),
            ),
            Cell(text=row.stage),
            Cell(text=row.method),
            Cell(text=f"{row.symbol} {reached}", tone=tone),
        ),
        missed=not row.passed and not row.goal,
    )


def design_table(result: JobResult, outcome: LoopOutcome) -> Table:
    """Return the designs of a loop side by side; the column of the one that is closed counts."""
    columns = [Column(title="design"), Column(title="limit", number=True)]
    for design in outcome.designs:
        closed = design.name == outcome.use
        tag = f"{design.method}, closed" if closed else design.method
        columns.append(Column(title=design.name, tag=tag, number=True, strong=closed))
    groups = [
        Group(
            title=part.title,
            quiet=True,
            rows=tuple(
                Row(cells=(Cell(text=row.name), Cell(text=row.limit), *(_judged(cell) for cell in row.cells)))
                for row in part.rows
            ),
        )
        for part in comparison.sections(result, outcome)
    ]
    return Table(columns=tuple(columns), groups=tuple(groups), form="designs")


def _judged(cell: comparison.Cell) -> Cell:
    return Cell(text=cell.text, tone="" if cell.met is None else "good" if cell.met else "bad")


def group_table(rows: Sequence[tuple[str, ...]]) -> Table:
    """Return the groups of plants that a loop has to stand."""
    numbers = "plants|minimum decay rate|least damping|least disk margin"
    return table(f"group|{numbers}|with", list(rows), numbers=numbers, form="narrow")


def gimbal_table(result: JobResult) -> Table:
    """Return the gimbals, moved in as they carry each other."""
    return table(
        "gimbal|carried by|axis|angle|J about the axis|stops|torquer|pick-off noise",
        tables.gimbal_rows(result),
        numbers="J about the axis|stops",
    )


def rotor_table(result: JobResult) -> Table:
    """Return the rotors."""
    return table("rotor|carried by|spin axis|L|C|spin|speed", tables.rotor_rows(result), numbers="L|C|spin")


def element_table(result: JobResult) -> Table | None:
    """Return what acts besides the torquers; None where nothing does."""
    rows = tables.element_rows(result)
    return table("element|acts on|numbers", rows) if rows else None


def mode_table(result: JobResult) -> Table:
    """Return the modes of the uncontrolled gimbals; a group is named once."""
    rows, last = [], None
    for group, motion, poles, frequency, rate in tables.mode_rows(result):
        rows.append(("" if group == last else group, rate, motion, poles, frequency))
        last = group
    return table("group|platform rate|motion|poles|frequency", rows, numbers="poles|frequency")


def record_part(job: Job) -> Part:
    """Return the job with its plant, to be copied."""
    words = f"Every number in full, in SI units, the plant included (the job names it “{job.plant}”)."
    return Part(
        title="Job and plant as read",
        blocks=(Paragraph(text=words), Listing(text=toml(job_data(job)), file="job.toml")),
    )


def html(document: Document) -> str:
    """Return a document as a page that needs nothing else."""
    from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape

    environment = Environment(
        loader=PackageLoader("platform_ctrl.report"),
        autoescape=select_autoescape(default=True, default_for_string=True),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template("page.html").render(document=document)
