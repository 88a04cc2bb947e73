"""The page of a campaign, and its section in a job's report."""

from __future__ import annotations

import math
from functools import partial

from platform_ctrl.analysis.metrics import RUN_METRICS
from platform_ctrl.campaign.single_run import ROUNDING, rerun
from platform_ctrl.campaign.store import differences, identity, source_hashes
from platform_ctrl.campaign.summary import Influence, Summary
from platform_ctrl.errors import PlatformCtrlError
from platform_ctrl.job.quantities import count, listed, plain
from platform_ctrl.report import blocks as page
from platform_ctrl.report import campaign_tables as tables
from platform_ctrl.report import style
from platform_ctrl.report.captions import sentences
from platform_ctrl.report.figures.runs import histograms, time_run, with_limit
from platform_ctrl.report.tables import folded_facts, record_part, report_versions
from platform_ctrl.verification.verdict import JobResult


def campaign_document(
    summary: Summary,
    *,
    command: str = "platform-ctrl campaign job.toml",
    again: str = "platform-ctrl simulate job.toml --run",
) -> page.PageContent:
    """Return the content of the page; `command` made the campaign, `again` and a run's number repeat that run."""
    job = summary.plan.job

    def last() -> tuple[page.Block, ...]:
        return (
            page.Paragraph(text="This page was made by"),
            page.Listing(text=command),
            drawn_part(summary),
            folded_facts("Versions and digests", {**report_versions(), **identity(summary.plan)}),
            record_part(job),
        )

    with style.settings():
        sections = (*campaign_sections(summary, again), *page.section("again", "Inputs and versions", last))
    return page.PageContent(
        kicker=f"platform_ctrl: campaign of {count(summary.plan.runs, 'simulated run')}",
        title=job.name,
        source=". ".join(filter(None, [job.platform.name, job.platform.source])),
        passed=summary.statistics.passed,
        verdict=tables.verdict(summary)[0],
        sections=sections,
    )


def campaign_sections(summary: Summary, again: str) -> list[page.PageSection]:
    """Return the results of a campaign, its inputs apart; the first section has no title."""
    several = summary.statistics.violation.events > 1
    common = "What violating runs have in common" if several else "What drives the runs"
    return [
        *page.section("summary", "", lambda: _banner(summary)),
        *page.section("common", common, lambda: _influences(summary)),
        *page.section("trace", "The worst run", lambda: _worst_trace(summary)),
        *page.section("probabilities", "Probability of a violation", lambda: _probabilities(summary)),
        *page.section("figures", "Figures", lambda: _histograms(summary)),
        *page.section("worst", "Worst runs", lambda: _worst(summary, again)),
        *page.section("ended", "How runs ended", lambda: _endings(summary)),
    ]


def _banner(summary: Summary) -> page.Verdict:
    words, assumed = tables.verdict(summary)
    lines = tuple(page.sentence(line) for line in tables.verdict_lines(summary))
    aside = page.sentence(f"{assumed}.") if assumed else ""
    return page.Verdict(passed=summary.statistics.passed, words=page.sentence(words), lines=lines, aside=aside)


def _probabilities(summary: Summary) -> tuple[page.Block, ...]:
    bounds = page.Paragraph(text=sentences("campaign_bounds", plan=summary.plan), tone="quiet")
    return probability_table(summary), bounds


def _histograms(summary: Summary) -> tuple[page.Block, ...]:
    caption = sentences("campaign_histogram")
    each = [(one.name.capitalize(), with_limit(summary.statistics, name)) for name, one in RUN_METRICS.items()]
    return tuple(block for title, of in each if of for block in page.drawn(title, partial(histograms, of), caption))


def _endings(summary: Summary) -> page.Table:
    found = summary.statistics
    ended = [(words, f"{runs:,}", tables.chance(runs / found.runs)) for words, runs in found.endings.items()]
    return page.table("ended|runs|share", ended, numbers="runs|share", form="narrow")


def drawn_part(summary: Summary) -> page.Subsection:
    """Return the inputs that vary from run to run."""
    plan = summary.plan
    words = sentences("campaign_drawn", plan=plan)
    inputs = page.table("input|drawn from", tables.input_rows(summary), form="narrow")
    return page.Subsection(title="What varies from run to run", blocks=(page.Paragraph(text=words), inputs))


def probability_table(summary: Summary) -> page.Table:
    """Return how probable it is that each requirement is violated."""
    rows = tables.probability_rows(summary)
    groups: dict[str, list[page.Row]] = {}
    for row in rows:
        # A manoeuvre's name stays as people have to type it.
        heading = page.sentence(row.group) if row.group == tables.ALL_MANOEUVRES else row.group
        tone = "bad" if row.numbers.events else ""
        # How often it is violated stands in the third and the fourth column.
        shown = tuple(page.Cell(text=text, tone=tone if k in (2, 3) else "") for k, text in enumerate(row.words))
        groups.setdefault(heading, []).append(page.Row(cells=shown))
    numbers = f"limit|violations|probability|{_bounds(summary)}|median|99 %|largest|worst run"
    found = tuple(page.Group(title=title, rows=tuple(rows)) for title, rows in groups.items())
    return page.Table(columns=page.columns(f"requirement|{numbers}", numbers), groups=found, form="probabilities")


def _bounds(summary: Summary) -> str:
    return f"{plain(100.0 * summary.statistics.confidence, 3)} % bounds"


def _influences(summary: Summary) -> tuple[page.Block, ...]:
    """Return what violating runs have in common, and what drives each requirement."""
    groups = tables.influence_groups(summary)
    if not any(groups.values()):
        return (page.Paragraph(text="Neither ranks nor counts show an influence of an input."),) if groups else ()
    numbers = f"rank corr.|violations|probability|{_bounds(summary)}|p-value"
    # Names of manoeuvres, at the end of a title, stay as people have to type them.
    rows = [
        page.Group(title=page.sentence(title), rows=_influence_rows(found)) for title, found in groups.items() if found
    ]
    shared = [tables.cause_words(one) for one in tables.causes(summary) if one.in_every_violation]
    lines = [page.Paragraph(text=f"{page.sentence(line)}.") for line in shared]
    words = page.Paragraph(text=sentences("campaign_influences"), tone="quiet")
    titles = page.columns(f"with, and without|{numbers}", numbers)
    contrasts = page.Table(columns=titles, groups=tuple(rows), form="contrasts")
    return (*lines, contrasts, words)


def _influence_rows(found: list[Influence]) -> tuple[page.Row, ...]:
    rows = []
    for one in found:
        every = "in every violating run" if one.cause and one.in_every_violation else ""
        p_value = page.Cell(text=plain(one.p_value, 2), tone="bad" if one.cause else "")
        correlation = page.Cell(text=tables.signed(one.correlation), tone="" if one.driver else "quiet")
        named = page.Cell(text=tables.value_name(one), note=every)
        sides = (
            (named, correlation, one.present, p_value),
            (page.Cell(text="without", tone="quiet"), page.Cell(text=""), one.absent, page.Cell(text="")),
        )
        for name, second, side, last in sides:
            tone = "bad" if side.events else ""
            texts = f"{side.events:,} of {side.runs:,}", tables.chance(side.estimate)
            numbers = (page.Cell(text=text, tone=tone) for text in texts)
            bounds = page.Cell(text=tables.chances(side.low, side.high))
            rows.append(page.Row(cells=(name, second, *numbers, bounds, last)))
    return tuple(rows)


def _worst(summary: Summary, again: str) -> tuple[page.Block, ...]:
    found = tables.worst_rows(summary, summary.statistics.worst, tables.all_drivers(summary))
    if not found:
        return (page.Paragraph(text="No manoeuvre has a limit."),)
    rows = []
    for one, (requirement, number, limit, ratio, inputs) in found:
        shown = (
            *page.cells(str(one.run), one.manoeuvre, requirement, number, limit),
            page.Cell(text=ratio, tone="bad" if one.ratio > 1.0 else ""),
            page.Cell(text=inputs, tone="quiet"),
            page.Cell(text=one.ended),
        )
        rows.append(page.Row(cells=shown))
    words = "The values that are largest relative to their limits. Any of these runs can be repeated, with plots:"
    numbers = "run|value|limit|over limit"
    titles = page.columns("run|manoeuvre|requirement|value|limit|over limit|inputs that matter|ended", numbers)
    worst = page.Table(columns=titles, groups=(page.Group(rows=tuple(rows)),), form="worst")
    return (page.Paragraph(text=words), page.Listing(text=f"{again} {found[0][0].run}"), worst)


def _worst_trace(summary: Summary) -> tuple[page.Block, ...]:
    """Return the run that comes nearest to its limits or furthest beyond them, simulated again and drawn over time."""
    if not summary.statistics.worst:
        return ()
    worst = summary.statistics.worst[0]
    try:
        found = rerun(summary.plan, worst.run)
    except PlatformCtrlError:  # the list of the worst runs says why it was not simulated
        return ()
    if not found.run.trajectory.t.size:
        return ()
    name = f"run {worst.run}, {worst.manoeuvre}"
    if not math.isclose(found.metrics[worst.requirement], worst.value, rel_tol=ROUNDING):
        words = f"{page.sentence(name)} is not drawn: simulated again, it gives another value than the table holds."
        return (page.Paragraph(text=words, tone="bad"),)
    [(_, (requirement, number, limit, _, inputs))] = tables.worst_rows(summary, [worst], tables.all_drivers(summary))
    shown = {"requirement": requirement, "number": number, "limit": limit, "inputs": inputs}
    caption = sentences("campaign_trace", worst=worst, runs=summary.statistics.simulated, **shown)
    return page.drawn(name, lambda: time_run(found.run, found.job.platform), caption)


def campaign_blocks(summary: Summary, result: JobResult, again: str) -> tuple[page.Block, ...]:
    """Return a campaign as part of a job's report, with a warning if its plant, its runs or its controllers differ."""
    first, *others = campaign_sections(summary, again)
    parts = (page.Subsection(title=section.title, blocks=section.blocks) for section in others)
    runs = f"{count(summary.plan.runs, 'run')} of the job with everything that may vary."
    closed = [outcome.closed.controller for outcome in result.loops]
    its = source_hashes(summary.plan.job, summary.plan.controllers)
    different = differences(its, source_hashes(result.job, closed))
    blocks: list[page.Block] = [page.Paragraph(text=runs)]
    if different:
        words = f"It was simulated with {listed(different)}: its values are not those of the design above."
        blocks.append(page.Paragraph(text=words, tone="bad"))
    return (*blocks, *first.blocks, *parts, drawn_part(summary))
