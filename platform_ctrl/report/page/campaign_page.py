"""The page of a campaign, and its section in a job's report."""

from __future__ import annotations

import math
import os
from pathlib import Path

from platform_ctrl.analysis.run_metrics import RUN_METRICS
from platform_ctrl.campaign.contrasts import Contrast
from platform_ctrl.campaign.identity import digest, identity
from platform_ctrl.campaign.planning import Plan
from platform_ctrl.campaign.probability import Probability, RareResult
from platform_ctrl.campaign.sensitivity import Sensitivity
from platform_ctrl.campaign.single_run import ROUNDING, rerun
from platform_ctrl.campaign.summary import Summary
from platform_ctrl.campaign.table import MANOEUVRE, PASSED
from platform_ctrl.common.files import write_whole
from platform_ctrl.common.values import value
from platform_ctrl.errors import PlatformCtrlError
from platform_ctrl.job.quantities import MINUS, listed, plain, power_of_ten
from platform_ctrl.report import style
from platform_ctrl.report.page import campaign_tables as tables
from platform_ctrl.report.page.blocks import (
    Block,
    Cards,
    Cell,
    Column,
    Document,
    Facts,
    Fold,
    Group,
    Listing,
    Mark,
    Paragraph,
    Part,
    Plate,
    Row,
    Section,
    Strip,
    Table,
    Verdict,
    cells,
    columns,
    html,
    plate,
    sentence,
    table,
)
from platform_ctrl.report.page.captions import sentences
from platform_ctrl.report.page.tables import record_part, versions
from platform_ctrl.report.plots.campaign import exceedance_figure, histogram_figure
from platform_ctrl.report.plots.time_run import time_run
from platform_ctrl.verification.verdict import JobResult

RERUN_COMMAND = "platform-ctrl simulate job.toml --run"
# Lengths of small pictures beside numbers: probabilities, shares of variance, shifts; pixels.
_SCALE, _INFLUENCE, _SHIFT = 150.0, 130.0, 180.0
# Violations that are shown.
_MOST_PROBABLE = 5


def write_campaign_page(
    summary: Summary, path: str | os.PathLike[str], *, command: str | None = None, again: str | None = None
) -> Path:
    """Write the page to `path`, the whole file or nothing: arguments as of `campaign_document`."""
    return write_whole(path, html(campaign_document(summary, command=command, again=again)))


def campaign_document(summary: Summary, *, command: str | None = None, again: str | None = None) -> Document:
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
    return Document(
        kicker=f"platform_ctrl: campaign of {tables.count_words(summary.plan.runs).replace(' ', ' simulated ')}",
        title=job.name,
        source=". ".join(filter(None, [job.platform.name, job.platform.source])),
        passed=summary.statistics.passed,
        verdict=tables.verdict(summary),
        sections=(*sections, Section(name="again", title="Inputs and versions", blocks=last)),
    )


def rare_part(plan: Plan, rare: RareResult) -> Part:
    """Return a rare event of a campaign: its probability, the levels of the search, how the inputs combine."""
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
        strip = Cell(text="", strip=Strip(length=_SHIFT, marks=marks))
        rows.append(Row(cells=(*cells(name, f"{words} σ"), strip)))
    shown = Table(columns=columns("input|moved by|", "moved by"), groups=(Group(rows=tuple(rows)),), form="narrow")
    return Part(title="How inputs combine", blocks=(Paragraph(text=sentences("campaign_moved")), shown))


def _points(plan: Plan, rare: RareResult) -> Table | None:
    """Return the most probable violations, a column each."""
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
    titles = (Column(title=""), *(Column(title="", number=True) for _ in shown))
    return Table(columns=titles, groups=(Group(rows=tuple(Row(cells=cells(*row)) for row in found)),), form="narrow")


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


def campaign_sections(summary: Summary, again: str) -> list[Section]:
    """Return the results of a campaign, its inputs apart; the first section has no title."""
    banner = Verdict(
        passed=summary.statistics.passed,
        words=sentence(tables.verdict(summary)),
        lines=tuple(sentence(line) for line in tables.verdict_lines(summary)),
    )
    bounds = Paragraph(text=sentences("campaign_bounds", plan=summary.plan), tone="quiet")
    sections = [Section(name="summary", title="", blocks=(banner,))]
    common = _contrasts(summary)
    if common:
        title = "What violating runs have in common" if summary.statistics.violation.events > 1 else "With and without"
        sections.append(Section(name="common", title=title, blocks=common))
    sections += _worst_trace(summary)
    shown = (probability_table(summary), bounds)
    sections.append(Section(name="probabilities", title="Probability of a violation", blocks=shown))
    if summary.rare:
        parts = tuple(rare_part(summary.plan, one) for one in summary.rare)
        sections.append(Section(name="rare", title="Rare events", blocks=parts))
    plates = tuple(campaign_plates(summary))
    if plates:
        sections.append(Section(name="figures", title="Figures", blocks=plates))
    endings = table("ended|runs|share", tables.ending_rows(summary), numbers="runs|share", form="narrow")
    return [
        *sections,
        Section(name="sensitivity", title="Influence of the inputs", blocks=_drivers(summary)),
        Section(name="worst", title="Worst runs", blocks=_worst(summary, again)),
        Section(name="ended", title="How runs ended", blocks=(endings,)),
    ]


def drawn_part(summary: Summary) -> Part:
    """Return the inputs that vary from run to run."""
    plan = summary.plan
    words = sentences("campaign_drawn", plan=plan)
    inputs = table("input|drawn from", tables.input_rows(summary), form="narrow")
    return Part(title="What varies from run to run", blocks=(Paragraph(text=words), inputs))


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


def _drivers(summary: Summary) -> tuple[Block, ...]:
    overall = [one for one in summary.sensitivities if one.manoeuvre is None]
    if not overall:
        return (Paragraph(text="Too few runs, or all alike: variance cannot be attributed to inputs."),)
    words = sentences("campaign_shares")
    cards = Cards(parts=tuple(_influences(summary, one) for one in overall))
    blocks: list[Block] = [Part(title="Shares of variance", blocks=(Paragraph(text=words), cards))]
    within = _within(summary)
    if within is not None:
        blocks.append(Part(title="Within each manoeuvre", blocks=(within,)))
    return tuple(blocks)


def _contrasts(summary: Summary) -> tuple[Block, ...]:
    """Return how often a run violates a requirement with and without each fault, manoeuvre and chosen value."""
    groups = tables.contrast_groups(summary)
    if not groups:
        return ()
    shown = [side for _, found in groups for one in found for side in (one.present, one.absent)]
    scale = scale_of(shown)
    titles = (
        *columns("with, and without|violations|probability", "violations|probability"),
        *_bounds_columns(summary, scale),
        Column(title="p-value", number=True),
    )
    rows = [Group(title=title, rows=tuple(_contrast_rows(found, scale))) for title, found in groups]
    words = sentences("campaign_contrasts")
    found = Table(columns=titles, groups=tuple(rows), form="contrasts")
    shared = [tables.contrast_words(one) for one in summary.contrasts if tables.shared_by_all(one)]
    lines = [Paragraph(text=f"{sentence(_tied(line))}.") for line in shared]
    return (*lines, found, Paragraph(text=words, tone="quiet"))


def _contrast_rows(found: list[Contrast], scale: Scale) -> list[Row]:
    rows = []
    for one in found:
        every = "in every violating run" if tables.significant(one) and one.in_every_violation else ""
        p_value = Cell(text=plain(one.p_value, 2), tone="bad" if tables.significant(one) else "")
        named = Cell(text=tables.contrast_name(one), note=every)
        sides = ((named, one.present, p_value), (Cell(text="without", tone="quiet"), one.absent, Cell(text="")))
        for name, side, last in sides:
            tone = "bad" if side.events else ""
            texts = f"{side.events:,} of {side.runs:,}", tables.chance(side.estimate)
            numbers = (Cell(text=text, tone=tone) for text in texts)
            bounds = Cell(text=tables.chances(side.low, side.high)), Cell(text="", strip=scale.strip(side))
            rows.append(Row(cells=(name, *numbers, *bounds, last)))
    return rows


def _influences(summary: Summary, one: Sensitivity) -> Part:
    found, others = tables.influence_rows(summary, one)
    blocks: list[Block] = []
    if found:
        rows = []
        for single, share, interval, sign in found:
            marks = (
                Mark(form="ground", start=0.0, end=1.0),
                Mark(form="bar", start=0.0, end=single.index, colour="series-1"),
                Mark(form="range", start=single.low, end=single.high, colour="ink"),
            )
            strip = Strip(length=_INFLUENCE, marks=marks, words=interval)
            rows.append(Row(cells=(Cell(text=single.parameter), Cell(text="", strip=strip), *cells(share, sign))))
        titles = columns("input||share|rank corr.", "share|rank corr.")
        blocks.append(Table(columns=titles, groups=(Group(rows=tuple(rows)),)))
    else:
        words = f"No input has a share that is significant in {one.runs:,} runs."
        blocks.append(Paragraph(text=words, tone="quiet"))
    violating = _tied(tables.violation_drivers(one))
    if violating:
        blocks.append(Paragraph(text=f"Inputs of the violations: {violating}."))
    for cause in tables.causes(summary, one.requirement):
        if cause.parameter != MANOEUVRE:
            blocks.append(Paragraph(text=f"{sentence(_tied(tables.contrast_words(cause)))}."))
    if others and found:
        ranked = " Computed from ranks, since a few runs have extreme values." if one.ranked else ""
        words = f"No significant share in {one.runs:,} runs: {', '.join(others)}.{ranked}"
        blocks.append(Paragraph(text=words, tone="quiet"))
    return Part(title=sentence(tables.requirement_name(one.requirement)), blocks=tuple(blocks))


def _within(summary: Summary) -> Table | None:
    """Return the most influential inputs within each manoeuvre."""
    inside = [one for one in summary.sensitivities if one.manoeuvre is not None]
    figures = [name for name in (*RUN_METRICS, PASSED) if any(one.requirement == name for one in inside)]
    rows = []
    for manoeuvre in dict.fromkeys(one.manoeuvre for one in inside):
        own = {one.requirement: _all_drivers(one) for one in inside if one.manoeuvre == manoeuvre}
        rows.append((str(manoeuvre), *(own.get(figure, "") for figure in figures)))
    return table("|".join(["manoeuvre", *map(tables.requirement_name, figures)]), rows) if rows else None


def _all_drivers(one: Sensitivity) -> str:
    violating = tables.violation_drivers(one)
    return _tied(tables.short_drivers(one) + (f"; its violations: {violating}" if violating else ""))


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


def _worst_trace(summary: Summary) -> list[Section]:
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
        return [Section(name="trace", title="The worst run", blocks=(Paragraph(text=words, tone="bad"),))]
    [(_, (requirement, number, limit, _, inputs))] = tables.worst_rows(summary, [worst], tables.all_drivers(summary))
    shown = {"requirement": requirement, "number": number, "limit": limit, "inputs": inputs}
    caption = sentences("campaign_trace", worst=worst, runs=summary.statistics.simulated, **shown)
    drawn = plate(time_run(found.run, found.job.platform), name, caption)
    return [Section(name="trace", title="The worst run", blocks=(drawn,))]


def as_section(summary: Summary, result: JobResult, again: str | None) -> Section:
    """Return a campaign as a section of a job's report, with a warning if its plant, sampling or controllers differ."""
    first, *others = campaign_sections(summary, again or RERUN_COMMAND)
    parts = (Part(title=section.title, blocks=section.blocks) for section in others)
    runs = f"{tables.count_words(summary.plan.runs)} of the job with everything that may vary."
    different = differences(summary, result)
    blocks: list[Block] = [Paragraph(text=sentence(runs))]
    if different:
        words = f"It was simulated with other {listed(different)}: its values are not those of the design above."
        blocks.append(Paragraph(text=words, tone="bad"))
    return Section(name="campaign", title="Campaign", blocks=(*blocks, *first.blocks, *parts, drawn_part(summary)))


def differences(summary: Summary, result: JobResult) -> list[str]:
    """Return which of plant, controllers and sampling a campaign does not share with a job's result."""
    plan, job = summary.plan, result.job
    closed = tuple(outcome.closed.controller for outcome in result.loops)
    pairs = {
        "plant": (plan.job.platform, job.platform),
        "sampling": (plan.job.sampling, job.sampling),
        "controllers": (plan.controllers, closed),
    }
    return [name for name, (its, own) in pairs.items() if digest(its) != digest(own)]
