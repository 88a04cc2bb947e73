"""The page of a campaign, and its section in a job's report."""

from __future__ import annotations

import math
import os
from pathlib import Path

from platform_ctrl.analysis.run_metrics import RUN_METRICS
from platform_ctrl.campaign.single_run import ROUNDING, rerun
from platform_ctrl.campaign.statistics import Probability
from platform_ctrl.campaign.store import identity, source_hashes
from platform_ctrl.campaign.summary import Influence, Summary
from platform_ctrl.common.files import write_whole
from platform_ctrl.common.values import value
from platform_ctrl.errors import PlatformCtrlError
from platform_ctrl.job.quantities import listed, plain, power_of_ten
from platform_ctrl.report import campaign_tables as tables
from platform_ctrl.report import style
from platform_ctrl.report.blocks import (
    Block,
    Cell,
    Column,
    Facts,
    Fold,
    Group,
    Listing,
    Mark,
    PageContent,
    PageSection,
    Paragraph,
    Plate,
    Row,
    Strip,
    Subsection,
    Table,
    Verdict,
    cells,
    columns,
    html,
    plate,
    sentence,
    table,
)
from platform_ctrl.report.captions import sentences
from platform_ctrl.report.figures.campaign import exceedance_figure, histogram_figure
from platform_ctrl.report.figures.time_run import time_run
from platform_ctrl.report.tables import record_part, versions
from platform_ctrl.verification.verdict import JobResult

RERUN_COMMAND = "platform-ctrl simulate job.toml --run"
# Length of the small pictures beside probabilities, pixels.
_SCALE = 150.0


def write_campaign_page(
    summary: Summary, path: str | os.PathLike[str], *, command: str | None = None, again: str | None = None
) -> Path:
    """Write the page to `path`, the whole file or nothing: arguments as of `campaign_document`."""
    return write_whole(path, html(campaign_document(summary, command=command, again=again)))


def campaign_document(summary: Summary, *, command: str | None = None, again: str | None = None) -> PageContent:
    """Return the content of the page; `command` made the campaign, `again` and a run's number repeat that run."""
    job = summary.plan.job
    with style.settings():
        sections = campaign_sections(summary, again or RERUN_COMMAND)
    last = (
        Paragraph(text="This page was made by"),
        Listing(text=command or "platform-ctrl campaign job.toml"),
        drawn_part(summary),
        Fold(title="Versions and digests", blocks=(Facts(rows=(*versions(), *digests(summary))),)),
        record_part(job),
    )
    return PageContent(
        kicker=f"platform_ctrl: campaign of {tables.count_words(summary.plan.runs).replace(' ', ' simulated ')}",
        title=job.name,
        source=". ".join(filter(None, [job.platform.name, job.platform.source])),
        passed=summary.statistics.passed,
        verdict=tables.verdict(summary),
        sections=(*sections, PageSection(name="again", title="Inputs and versions", blocks=last)),
    )


@value
class Scale:
    """A logarithmic scale of probability from 10^−`decades` to 1."""

    decades: int

    def at(self, probability: float) -> float:
        """Return where a probability lies, as a share of the scale's length."""
        place = 1.0 + math.log10(max(probability, 1e-300)) / self.decades
        return round(min(max(place, 0.0), 1.0), 4)

    @property
    def head(self) -> Strip:
        """Words over every decade, or over every other one."""
        step = 1 if self.decades <= 4 else 2
        powers = range(-self.decades, 1, step) if self.decades % step == 0 else range(1 - self.decades, 1, step)
        marks = (Mark(form="word", start=self.at(10.0**k), text=power_of_ten(10.0**k)) for k in powers)
        return Strip(length=_SCALE, marks=tuple(marks))

    def strip(self, one: Probability) -> Strip:
        """Return an estimate and its bounds."""
        marks = [Mark(form="tick", start=self.at(10.0**k)) for k in range(-self.decades, 1)]
        colour = "limit" if one.events else "series-1"
        if one.runs:
            marks.append(Mark(form="range", start=self.at(one.low), end=self.at(one.high), colour=colour))
        if one.events:
            marks.append(Mark(form="point", start=self.at(one.estimate), colour=colour))
        return Strip(length=_SCALE, marks=tuple(marks))


def scale_of(shown: list[Probability]) -> Scale:
    """Return the scale on which all these probabilities can be seen."""
    least = min((one.low or 0.3 * one.high for one in shown if one.runs), default=1e-2)
    return Scale(decades=max(2, min(12, math.ceil(-math.log10(max(least, 1e-12))))))


def campaign_sections(summary: Summary, again: str) -> list[PageSection]:
    """Return the results of a campaign, its inputs apart; the first section has no title."""
    banner = Verdict(
        passed=summary.statistics.passed,
        words=sentence(tables.verdict(summary)),
        lines=tuple(sentence(line) for line in tables.verdict_lines(summary)),
    )
    bounds = Paragraph(text=sentences("campaign_bounds", plan=summary.plan), tone="quiet")
    sections = [PageSection(name="summary", title="", blocks=(banner,))]
    common = _influences(summary)
    if common:
        title = (
            "What violating runs have in common" if summary.statistics.violation.events > 1 else "What drives the runs"
        )
        sections.append(PageSection(name="common", title=title, blocks=common))
    sections += _worst_trace(summary)
    shown = (probability_table(summary), bounds)
    sections.append(PageSection(name="probabilities", title="Probability of a violation", blocks=shown))
    plates = tuple(campaign_plates(summary))
    if plates:
        sections.append(PageSection(name="figures", title="Figures", blocks=plates))
    endings = table("ended|runs|share", tables.ending_rows(summary), numbers="runs|share", form="narrow")
    return [
        *sections,
        PageSection(name="worst", title="Worst runs", blocks=_worst(summary, again)),
        PageSection(name="ended", title="How runs ended", blocks=(endings,)),
    ]


def drawn_part(summary: Summary) -> Subsection:
    """Return the inputs that vary from run to run."""
    plan = summary.plan
    words = sentences("campaign_drawn", plan=plan)
    inputs = table("input|drawn from", tables.input_rows(summary), form="narrow")
    return Subsection(title="What varies from run to run", blocks=(Paragraph(text=words), inputs))


def digests(summary: Summary) -> tuple[tuple[str, str], ...]:
    """Return the digests of everything that determines the runs."""
    return tuple((name, str(item)) for name, item in identity(summary.plan).items())


def probability_table(summary: Summary) -> Table:
    """Return how probable it is that each requirement is violated."""
    rows = tables.probability_rows(summary)
    scale = scale_of([row.numbers for row in rows])
    groups: dict[str, list[Row]] = {}
    for row in rows:
        # A manoeuvre's name stays as people have to type it.
        heading = sentence(row.group) if row.group == tables.ALL_MANOEUVRES else row.group
        tone = "bad" if row.numbers.events else ""
        shown = (
            *cells(row.requirement, row.limit),
            *(Cell(text=text, tone=tone) for text in (row.violations, row.probability)),
            Cell(text=row.bounds),
            Cell(text="", strip=scale.strip(row.numbers)),
            *cells(row.median, row.high_quantile, row.largest, "" if row.worst is None else str(row.worst)),
        )
        groups.setdefault(heading, []).append(Row(cells=shown))
    titles = (
        *columns("requirement|limit|violations|probability", "limit|violations|probability"),
        *_bounds_columns(summary, scale),
        *(Column(title=title, number=True) for title in ("median", "99 %", "largest", "worst run")),
    )
    found = tuple(Group(title=title, rows=tuple(rows)) for title, rows in groups.items())
    return Table(columns=titles, groups=found, form="probabilities")


def _bounds_columns(summary: Summary, scale: Scale) -> tuple[Column, Column]:
    bounds = f"{plain(100.0 * summary.statistics.confidence, 3)} % bounds"
    return Column(title=bounds, number=True), Column(title="", strip=scale.head)


def campaign_plates(summary: Summary) -> list[Plate]:
    """Return the plots: how far the runs reach, and a histogram of every metric that has a limit."""
    found = summary.statistics
    names = [
        name for name in RUN_METRICS if any(one.requirement == name and one.manoeuvre for one in found.requirements)
    ]
    if not names:
        return []
    drawn = [(exceedance_figure(found), "How far the runs reach", sentences("campaign_reach"))]
    drawn += [
        (histogram_figure(found, name), RUN_METRICS[name].name.capitalize(), sentences("campaign_histogram"))
        for name in names
    ]
    return [plate(*one) for one in drawn]


def _influences(summary: Summary) -> tuple[Block, ...]:
    """Return what violating runs have in common, and what drives each requirement."""
    groups = tables.influence_groups(summary)
    shown = [side for _, found, _ in groups for one in found for side in (one.present, one.absent)]
    if not shown:
        return (Paragraph(text="Neither ranks nor counts show an influence of an input."),) if groups else ()
    scale = scale_of(shown)
    titles = (
        *columns("with, and without|rank corr.|violations|probability", "rank corr.|violations|probability"),
        *_bounds_columns(summary, scale),
        Column(title="p-value", number=True),
    )
    # Names of manoeuvres, at the end of a title, stay as people have to type them.
    rows = [
        Group(title=sentence(title), rows=tuple(_influence_rows(found, scale))) for title, found, _ in groups if found
    ]
    shared = [tables.cause_words(one) for one in tables.causes(summary) if one.in_every_violation]
    lines = [Paragraph(text=f"{sentence(_tied(line))}.") for line in shared]
    quiet = [f"{sentence(title)}: {', '.join(names)}." for title, found, names in groups if found and names]
    others = [Paragraph(text=f"Of no influence that these runs show. {' '.join(quiet)}", tone="quiet")] if quiet else []
    words = Paragraph(text=sentences("campaign_influences"), tone="quiet")
    return (*lines, Table(columns=titles, groups=tuple(rows), form="contrasts"), *others, words)


def _influence_rows(found: list[Influence], scale: Scale) -> tuple[Row, ...]:
    rows = []
    for one in found:
        every = "in every violating run" if one.cause and one.in_every_violation else ""
        p_value = Cell(text=plain(one.p_value, 2), tone="bad" if one.cause else "")
        correlation = Cell(text=tables.signed(one.correlation), tone="" if one.driver else "quiet")
        named = Cell(text=tables.value_name(one), note=every)
        sides = (
            (named, correlation, one.present, p_value),
            (Cell(text="without", tone="quiet"), Cell(text=""), one.absent, Cell(text="")),
        )
        for name, second, side, last in sides:
            tone = "bad" if side.events else ""
            texts = f"{side.events:,} of {side.runs:,}", tables.chance(side.estimate)
            numbers = (Cell(text=text, tone=tone) for text in texts)
            bounds = Cell(text=tables.chances(side.low, side.high)), Cell(text="", strip=scale.strip(side))
            rows.append(Row(cells=(name, second, *numbers, *bounds, last)))
    return tuple(rows)


def _tied(words: str) -> str:
    """Return words in which no line ends between a number and its per cent sign."""
    return words.replace(" %", "\u00a0%")


def _worst(summary: Summary, again: str) -> tuple[Block, ...]:
    found = tables.worst_rows(summary, summary.statistics.worst, tables.all_drivers(summary))
    if not found:
        return (Paragraph(text="No manoeuvre has a limit."),)
    rows = []
    for one, (requirement, number, limit, ratio, inputs) in found:
        shown = (
            *cells(str(one.run), one.manoeuvre, requirement, number, limit),
            Cell(text=ratio, tone="bad" if one.ratio > 1.0 else ""),
            Cell(text=inputs, tone="quiet"),
            Cell(text=one.ended),
        )
        rows.append(Row(cells=shown))
    words = "The values that are largest relative to their limits. Any of these runs can be repeated, with plots:"
    numbers = "run|value|limit|over limit"
    titles = columns("run|manoeuvre|requirement|value|limit|over limit|inputs that matter|ended", numbers)
    worst = Table(columns=titles, groups=(Group(rows=tuple(rows)),), form="worst")
    return (Paragraph(text=words), Listing(text=f"{again} {found[0][0].run}"), worst)


def _worst_trace(summary: Summary) -> list[PageSection]:
    """Return the run that comes nearest to its limits or furthest beyond them, simulated again and drawn over time."""
    if not summary.statistics.worst:
        return []
    worst = summary.statistics.worst[0]
    try:
        found = rerun(summary.plan, worst.run)
    except PlatformCtrlError:  # the list of the worst runs says why it was not simulated
        return []
    if not found.run.trajectory.t.size:
        return []
    name = f"run {worst.run}, {worst.manoeuvre}"
    if not math.isclose(found.metrics[worst.requirement], worst.value, rel_tol=ROUNDING):
        words = f"{sentence(name)} is not drawn: simulated again, it gives another value than the table holds."
        return [PageSection(name="trace", title="The worst run", blocks=(Paragraph(text=words, tone="bad"),))]
    [(_, (requirement, number, limit, _, inputs))] = tables.worst_rows(summary, [worst], tables.all_drivers(summary))
    shown = {"requirement": requirement, "number": number, "limit": limit, "inputs": inputs}
    caption = sentences("campaign_trace", worst=worst, runs=summary.statistics.simulated, **shown)
    drawn = plate(time_run(found.run, found.job.platform), name, caption)
    return [PageSection(name="trace", title="The worst run", blocks=(drawn,))]


def as_section(summary: Summary, result: JobResult, again: str | None) -> PageSection:
    """Return a campaign as a section of a job's report, with a warning if its plant, sampling or controllers differ."""
    first, *others = campaign_sections(summary, again or RERUN_COMMAND)
    parts = (Subsection(title=section.title, blocks=section.blocks) for section in others)
    runs = f"{tables.count_words(summary.plan.runs)} of the job with everything that may vary."
    different = differences(summary, result)
    blocks: list[Block] = [Paragraph(text=sentence(runs))]
    if different:
        words = f"It was simulated with other {listed(different)}: its values are not those of the design above."
        blocks.append(Paragraph(text=words, tone="bad"))
    return PageSection(name="campaign", title="Campaign", blocks=(*blocks, *first.blocks, *parts, drawn_part(summary)))


def differences(summary: Summary, result: JobResult) -> list[str]:
    """Return which of plant, controllers and sampling a campaign does not share with a job's result."""
    closed = [outcome.closed.controller for outcome in result.loops]
    its, own = source_hashes(summary.plan.job, summary.plan.controllers), source_hashes(result.job, closed)
    return [name for name in its if its[name] != own[name]]
