"""What a campaign came to as sections of blocks: a page of its own, or a part of a job's report."""

from __future__ import annotations

import math

from platform_ctrl.campaign.contrasts import Contrast
from platform_ctrl.campaign.identity import digest, identity
from platform_ctrl.campaign.planning import Plan
from platform_ctrl.campaign.probability import Probability
from platform_ctrl.campaign.rare_result import RareResult
from platform_ctrl.campaign.sensitivity import Sensitivity
from platform_ctrl.campaign.summary import Summary
from platform_ctrl.campaign.table import MANOEUVRE, METRICS, PASSED
from platform_ctrl.common.values import value
from platform_ctrl.report.page import campaign_tables as tables
from platform_ctrl.report.page.blocks import (
    Block,
    Cards,
    Cell,
    Column,
    Facts,
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
    sentence,
    table,
)
from platform_ctrl.report.quantities import MINUS, listed, plain, power_of_ten
from platform_ctrl.verification.verdict import JobResult

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


RERUN_COMMAND = "platform-ctrl simulate job.toml --run"

# Lengths of small pictures beside numbers, in pixels.
_SCALE, _INFLUENCE = 150.0, 130.0
_SAMPLING = {"sobol": "Sobol points", "latin-hypercube": "a Latin hypercube", "random": "independent numbers"}


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


def verdict(summary: Summary) -> Verdict:
    """Return the banner."""
    return Verdict(
        passed=summary.statistics.passed,
        words=sentence(tables.verdict(summary)),
        lines=tuple(sentence(line) for line in tables.verdict_lines(summary)),
    )


def campaign_sections(summary: Summary, again: str) -> list[Section]:
    """Return everything that a campaign came to but its inputs; the first section has no title.

    Parameters
    ----------
    summary
        From `platform_ctrl.campaign.summary.summarise`.
    again
        The command line that flies one run again, without the run's number at its end.
    """
    first = (verdict(summary), probability_table(summary), Paragraph(text=_bounds_words(summary), tone="quiet"))
    sections = [Section(name="probabilities", title="", blocks=first)]
    if summary.rare:
        parts = tuple(rare_part(summary.plan, one) for one in summary.rare)
        sections.append(Section(name="rare", title="Rare events", blocks=parts))
    plates = tuple(campaign_plates(summary))
    if plates:
        sections.append(Section(name="figures", title="Figures", blocks=plates))
    sections += [
        Section(name="sensitivity", title="What drives them", blocks=_drivers(summary)),
        Section(name="worst", title="Worst runs", blocks=_worst(summary, again)),
        Section(name="ended", title="How runs ended", blocks=(_endings(summary),)),
    ]
    return sections


def drawn_part(summary: Summary) -> Part:
    """Return what differs from run to run."""
    plan = summary.plan
    words = (
        f"{tables.count_words(plan.runs)} from seed {plan.seed}, {_SAMPLING[plan.sampling]}; integration step at most "
        f"{plan.step:g} s. A run depends on the seed and its number alone."
    )
    inputs = table("input|drawn from", tables.input_rows(summary), form="narrow")
    return Part(title="What differs from run to run", blocks=(Paragraph(text=words), inputs))


def digests(summary: Summary) -> tuple[tuple[str, str], ...]:
    """Return what the runs follow from."""
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
        cells = (
            Cell(text=row.requirement),
            Cell(text=row.limit),
            Cell(text=row.violations, tone=tone),
            Cell(text=row.probability, tone=tone),
            Cell(text=row.bounds),
            Cell(text="", strip=scale.strip(row.numbers)),
            *(Cell(text=text) for text in (row.median, row.high_quantile, row.largest)),
            Cell(text="" if row.worst is None else str(row.worst)),
        )
        groups.setdefault(heading, []).append(Row(cells=cells))
    columns = (
        Column(title="requirement"),
        *(Column(title=title, number=True) for title in ("limit", "violations", "probability")),
        Column(title=f"{plain(100.0 * summary.statistics.confidence, 3)} % bounds", number=True),
        Column(title="", strip=scale.head),
        *(Column(title=title, number=True) for title in ("median", "99 %", "largest", "worst run")),
    )
    found = tuple(Group(title=title, rows=tuple(rows)) for title, rows in groups.items())
    return Table(columns=columns, groups=found, form="probabilities")


def _bounds_words(summary: Summary) -> str:
    words = "Bounds: Clopper and Pearson, two-sided, exact for independent runs"
    even = {"sobol": "Sobol points fill", "latin-hypercube": "a Latin hypercube fills"}.get(summary.plan.sampling)
    if even is None:
        return f"{words}."
    return f"{words}; {even} the space more evenly, so that the estimate as a rule scatters less than they say."


def campaign_plates(summary: Summary) -> list[Plate]:
    """Return the figures: how far out the runs reach, and a histogram of every figure that is asked for."""
    from platform_ctrl.report import style
    from platform_ctrl.report.figures import campaign as figures

    found = summary.statistics
    names = [name for name in METRICS if any(one.requirement == name and one.manoeuvre for one in found.requirements)]
    if not names:
        return []
    drawn = [
        (
            figures.exceedance_figure(found),
            "How far out the runs reach",
            "Share of the runs above a level, the level relative to the limit. Where a line crosses 1 is the "
            "probability of violating it; how steeply it falls there says what a little more margin is worth.",
        )
    ]
    drawn += [
        (
            figures.histogram_figure(found, name),
            METRICS[name][0].capitalize(),
            "Runs by their figure, red beyond the limit. Runs that diverged have none: they are counted, not drawn.",
        )
        for name in names
    ]
    return [
        Plate(svg=style.svg(one, f"{title}. {caption}"), title=title, caption=caption) for one, title, caption in drawn
    ]


def _drivers(summary: Summary) -> tuple[Block, ...]:
    overall = [one for one in summary.sensitivities if one.manoeuvre is None]
    counted = _contrasts(summary)
    if not overall:
        return (*counted, Paragraph(text="Too few runs, or all alike: nothing can be said of variance."))
    words = (
        "Share of a figure's variance that each input explains on its own (first-order Sobol index, the thin line its "
        "95 % interval), and its rank correlation: with + the figure rises with the input. Inputs that chance alone "
        "could explain are not called drivers. What no input explains on its own is interaction or noise."
    )
    cards = Cards(parts=tuple(_influences(summary, one) for one in overall))
    blocks: list[Block] = [*counted, Part(title="Shares of variance", blocks=(Paragraph(text=words), cards))]
    within = _within(summary)
    if within is not None:
        blocks.append(Part(title="Within each manoeuvre", blocks=(within,)))
    return tuple(blocks)


def _contrasts(summary: Summary) -> tuple[Block, ...]:
    """Return how often a run violates something with and without each fault, manoeuvre and chosen value."""
    groups = tables.contrast_groups(summary)
    if not groups:
        return ()
    shown = [side for _, found in groups for one in found for side in (one.present, one.absent)]
    scale = scale_of(shown)
    columns = (
        Column(title="with, and without"),
        *(Column(title=title, number=True) for title in ("violations", "probability")),
        Column(title=f"{plain(100.0 * summary.statistics.confidence, 3)} % bounds", number=True),
        Column(title="", strip=scale.head),
        Column(title="p-value", number=True),
    )
    rows = [Group(title=title, rows=tuple(_contrast_rows(found, scale))) for title, found in groups]
    words = (
        "How often a run violates a requirement with a fault, in a manoeuvre or at a chosen value, and how often "
        "without. A rare cause has hardly a share of any variance: it is seen here. The p-value is the probability of "
        "such a difference if the value has no influence (Fisher's exact test, Holm's correction over the values)."
    )
    found = Table(columns=columns, groups=tuple(rows), form="contrasts")
    return (Part(title="Violations with and without", blocks=(Paragraph(text=words), found)),)


def _contrast_rows(found: list[Contrast], scale: Scale) -> list[Row]:
    rows = []
    for one in found:
        every = "in every violating run" if one.in_every_violation else ""
        p_value = Cell(text=plain(one.p_value, 2), tone="bad" if one.driver else "")
        named = Cell(text=tables.contrast_name(one), note=every)
        sides = ((named, one.present, p_value), (Cell(text="without", tone="quiet"), one.absent, Cell(text="")))
        for name, side, last in sides:
            cells = (
                name,
                Cell(text=f"{side.events:,} of {side.runs:,}", tone="bad" if side.events else ""),
                Cell(text=tables.chance(side.estimate), tone="bad" if side.events else ""),
                Cell(text=tables.chances(side.low, side.high)),
                Cell(text="", strip=scale.strip(side)),
                last,
            )
            rows.append(Row(cells=cells))
    return rows


def _influences(summary: Summary, one: Sensitivity) -> Part:
    found, others = tables.influence_rows(summary, one)
    blocks: list[Block] = []
    if found:
        columns = (
            Column(title="input"),
            Column(title=""),
            Column(title="share", number=True),
            Column(title="rank corr.", number=True),
        )
        rows = []
        for single, share, interval, sign in found:
            marks = (
                Mark(form="ground", start=0.0, end=1.0),
                Mark(form="bar", start=0.0, end=single.index, colour="series-1"),
                Mark(form="range", start=single.low, end=single.high, colour="ink"),
            )
            strip = Strip(length=_INFLUENCE, marks=marks, words=interval)
            cells = (Cell(text=single.parameter), Cell(text="", strip=strip), Cell(text=share), Cell(text=sign))
            rows.append(Row(cells=cells))
        blocks.append(Table(columns=columns, groups=(Group(rows=tuple(rows)),)))
    else:
        words = f"No input has a share that {one.runs:,} runs tell from chance."
        blocks.append(Paragraph(text=words, tone="quiet"))
    violating = _tied(tables.violation_drivers(one))
    if violating:
        blocks.append(Paragraph(text=f"What sends runs beyond the limit: {violating}."))
    for cause in tables.causes(summary, one.requirement):
        if cause.parameter != MANOEUVRE:
            blocks.append(Paragraph(text=f"{sentence(_tied(tables.contrast_words(cause)))}."))
    if others and found:
        ranked = " By ranks, since a few runs lie far out." if one.ranked else ""
        words = f"No share told from chance in {one.runs:,} runs: {', '.join(others)}.{ranked}"
        blocks.append(Paragraph(text=words, tone="quiet"))
    return Part(title=sentence(tables.requirement_name(one.requirement)), blocks=tuple(blocks))


def _within(summary: Summary) -> Table | None:
    """Return what drives what inside each manoeuvre."""
    inside = [one for one in summary.sensitivities if one.manoeuvre is not None]
    figures = [name for name in (*METRICS, PASSED) if any(one.requirement == name for one in inside)]
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
        return (Paragraph(text="No manoeuvre asks anything."),)
    columns = (
        Column(title="run", number=True),
        Column(title="manoeuvre"),
        Column(title="requirement"),
        *(Column(title=title, number=True) for title in ("value", "limit", "over limit")),
        Column(title="inputs that matter"),
        Column(title="ended"),
    )
    rows = []
    for one, (requirement, number, limit, ratio, inputs) in found:
        cells = (
            *(Cell(text=text) for text in (str(one.run), one.manoeuvre, requirement, number, limit)),
            Cell(text=ratio, tone="bad" if one.ratio > 1.0 else ""),
            Cell(text=inputs, tone="quiet"),
            Cell(text=one.ended),
        )
        rows.append(Row(cells=cells))
    words = "The largest figures over their limits. Any of them can be flown again, with plots:"
    command = Listing(text=f"{again} {found[0][0].run}")
    return (Paragraph(text=words), command, Table(columns=columns, groups=(Group(rows=tuple(rows)),), form="worst"))


def _endings(summary: Summary) -> Table:
    return table("ended|runs|share", tables.ending_rows(summary), numbers="runs|share", form="narrow")


def as_section(summary: Summary, result: JobResult, again: str | None) -> Section:
    """Return a campaign as a section of a job's report.

    Parameters
    ----------
    summary
        From `platform_ctrl.campaign.summary.summarise`.
    result
        The job whose report it is: what else the campaign flew is said.
    again
        As in `campaign_sections`; default one for a job file of no particular name.
    """
    first, *others = campaign_sections(summary, again or RERUN_COMMAND)
    parts = (Part(title=section.title, blocks=section.blocks) for section in others)
    flown = f"{tables.count_words(summary.plan.runs)} of the job with everything that may vary."
    different = differences(summary, result)
    blocks: list[Block] = [Paragraph(text=sentence(flown))]
    if different:
        words = f"It was flown with other {listed(different)}: its figures are not those of the design above."
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
