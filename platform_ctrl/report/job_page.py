"""The report of a job: its content in order, and the page."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from platform_ctrl.common.arguments import instance
from platform_ctrl.common.files import write_whole
from platform_ctrl.design.loop import LoopOutcome
from platform_ctrl.job.judging import CheckResult
from platform_ctrl.mechanics.linearisation import LinearModel
from platform_ctrl.mechanics.state_space import coupled_while_changing
from platform_ctrl.report import captions, comparison, curves, style, tables
from platform_ctrl.report.blocks import (
    Block,
    Facts,
    Fold,
    Listing,
    Missing,
    PageContent,
    PageSection,
    Paragraph,
    Plate,
    Subsection,
    attempted,
    drawn,
    html,
    plate,
    sentence,
)
from platform_ctrl.report.budget_page import budget_blocks
from platform_ctrl.report.campaign_page import as_section, digests
from platform_ctrl.report.campaign_tables import campaign_words
from platform_ctrl.report.captions import compared_with_alternatives, opening, sentences
from platform_ctrl.report.figures.axes_picture import axes_picture
from platform_ctrl.report.figures.job import (
    coupled_pole_figure,
    margin_bars_figure,
    nutation_figure,
    platform_disturbance,
    pole_figure,
    root_locus_plot,
    servo,
    simultaneous_margin,
)
from platform_ctrl.report.figures.nichols import nichols_figure
from platform_ctrl.report.figures.panels import paint
from platform_ctrl.report.figures.time_run import time_run
from platform_ctrl.report.first_screen import (
    change_part,
    first_screen,
    own_results,
    section_verdict,
)
from platform_ctrl.report.modes import nutates
from platform_ctrl.verification.changes import changes
from platform_ctrl.verification.coupled import ALL_LOOPS
from platform_ctrl.verification.simulated import Run
from platform_ctrl.verification.verdict import JobResult

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from platform_ctrl.campaign.summary import Summary

# Branches of a root locus up to which it is drawn: of a long delay they lie side by side, and take minutes to follow.
_MOST_BRANCHES = 80


def write_page(result: JobResult | PageContent, path: str | os.PathLike[str], **options: Any) -> Path:
    """Write the page to `path`: the whole file, or nothing if that fails.

    Parameters
    ----------
    result
        From `platform_ctrl.verification.check_job`.
    path
        The file; an existing one is replaced.
    **options
        ``command``: the command line that repeats the job; ``campaign``: summary of a campaign of the job, from
        `platform_ctrl.campaign.summarise`, which becomes a section; ``again``: the command line that repeats one run of
        the campaign, without the run's number at its end.

    Returns
    -------
    pathlib.Path
        The file.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    return write_whole(path, html(prepared(result, **options)))


def prepared(
    result: JobResult | PageContent,
    *,
    command: str | None = None,
    campaign: Summary | None = None,
    again: str | None = None,
) -> PageContent:
    """Return the content of the report, for `write_page`, with every figure drawn.

    Parameters
    ----------
    result
        From `platform_ctrl.verification.check_job`. A document is returned as it is.
    command
        The command line that repeats the job; default: one that reads the job printed at the end of the report.
    campaign
        Summary of a campaign of the job, from `platform_ctrl.campaign.summary.summarise`; it becomes a section.
    again
        The command line that repeats one run of the campaign, without the run's number at its end.

    Returns
    -------
    PageContent
        Sections with text, tables and figures.

    Raises
    ------
    ArgumentError
        An argument of another kind than annotated.
    """
    if isinstance(result, PageContent):
        return result
    return _document(instance("result", result, JobResult), command, campaign, again)


def _document(
    result: JobResult,
    command: str | None,
    campaign: Summary | None,
    again: str | None,
) -> PageContent:
    job, palette = result.job, curves.palette_of(result.loops)

    def plates(draw: Callable[..., Any], *arguments: Any) -> tuple[Any, ...]:
        return _blocks(attempted("Figures", lambda: draw(*arguments)))

    with style.settings():
        loops = [plates(_loop_plates, result.model, outcome, palette) for outcome in result.loops]
        runs = [block for run in result.runs for block in plates(_run_block, run, result)]
        of_whole = (_plant_plates, _servo_plates, budget_blocks, _coupled)
        first = plates(_first, result, campaign)
        plant, servo, budget, coupled = (plates(draw, result) for draw in of_whole)
    together = [one for one in result.requirements if one.subject == ALL_LOOPS]
    of_runs = [one for run in result.runs for one in run.results]

    def section(
        name: str, title: str, make: Callable[[], Sequence[Block]], *plates: Block, **judged: Any
    ) -> PageSection:
        blocks = (*_blocks(attempted("Text and tables", make)), *plates)
        return PageSection(name=name, title=title, blocks=blocks, **judged)

    with style.settings():
        sections = [
            PageSection(
                name="summary",
                title="",
                blocks=(
                    *first,
                    *_blocks(attempted("Summary", lambda: _summary(result, campaign))),
                ),
            ),
            section(
                "requirements",
                "Requirements",
                lambda: (tables.requirement_table(result),),
                **_judged(result.requirements),
            ),
            PageSection(name="plant", title="Plant and modes", blocks=tuple(_plant(result, plant))),
            *(
                section(
                    f"loop-{k}",
                    sentence(outcome.spec.name),
                    partial(_loop, result, outcome),
                    *loops[k - 1],
                    *(servo if outcome.spec.kind == "stabilisation" else ()),
                    **_judged(own_results(result, outcome)),
                )
                for k, outcome in enumerate(result.loops, 1)
            ),
            PageSection(name="coupled", title="Coupled system", blocks=coupled, **_judged(together)),
            *([PageSection(name="budget", title="Line-of-sight budget", blocks=budget)] if budget else []),
            *([section("runs", "Simulated runs", lambda: _runs(result), *runs, **_judged(of_runs))] if runs else []),
            *_campaign(result, campaign, again),
            section("again", "Inputs and versions", lambda: _again(result, command, campaign)),
        ]
    return PageContent(
        kicker="platform_ctrl: design and check of control loops",
        title=job.name,
        source=". ".join(filter(None, [job.platform.name, job.platform.source])),
        passed=result.passed and (campaign is None or campaign.passed),
        verdict="; ".join(filter(None, (tables.verdict(result), campaign_words(campaign)))),
        sections=tuple(sections),
    )


def _blocks(found: Any) -> tuple[Any, ...]:
    """Return what a drawing has returned as a sequence: words alone where it failed."""
    return (found,) if isinstance(found, Missing) else tuple(found)


def _first(result: JobResult, campaign: Summary | None) -> tuple[Block, ...]:
    what_to_change = attempted("What to change", lambda: change_part(result, changes(result)))
    return (*_blocks(attempted("First screen", lambda: first_screen(result, campaign))), *_blocks(what_to_change))


def _summary(result: JobResult, campaign: Summary | None) -> tuple[Block, ...]:
    first, verdict, *details = opening(result, campaign)
    lead = Paragraph(text=f"{first} {verdict}", tone="lead")
    rest = (Paragraph(text=" ".join(details)),) if details else ()
    return (lead, *rest)


def _plant(result: JobResult, plates: Sequence[Block]) -> list[Block]:
    axes, *others = plates
    words = attempted("Subsystems", lambda: _subsystems(result))
    parts = attempted("Gimbals and modes", lambda: _plant_tables(result))
    return [*_blocks(words), axes, *_blocks(parts), *others]


def _subsystems(result: JobResult) -> list[Block]:
    gimbals, changing = len(result.job.platform.gimbals), coupled_while_changing(result.model)
    words = sentences("groups", subsystems=result.subsystems, gimbals=gimbals, changing=changing)
    return [Paragraph(text=words)]


def _plant_tables(result: JobResult) -> list[Block]:
    blocks: list[Block] = [Subsection(title="Gimbals", blocks=(tables.gimbal_table(result),))]
    if result.job.platform.rotors:
        blocks.append(Subsection(title="Rotors", blocks=(tables.rotor_table(result),)))
    elements = tables.element_table(result)
    if elements is not None:
        blocks.append(Subsection(title="Springs, friction and other elements", blocks=(elements,)))
    title = "Modes of the uncontrolled gimbals"
    blocks.append(Subsection(title=title, blocks=(attempted(title, lambda: tables.mode_table(result)),)))
    return blocks


def _plant_plates(result: JobResult) -> list[Block]:
    words = "Which body turns about which axis. Bodies are drawn apart; in the model all axes go through one point."
    axes = drawn("Axes and bodies", lambda: (axes_picture(result.job.platform), words))
    caption = sentences("nutation", uncertainty=result.job.uncertainty.spin)
    nutation = attempted("Campbell diagram", lambda: _plate(nutation_figure(result), "Campbell diagram", caption))
    return [axes, *([] if nutation is None else [nutation])]


def _plate(figure: Figure | None, title: str, caption: str) -> Plate | None:
    return None if figure is None else plate(figure, title, caption)


def _loop(result: JobResult, outcome: LoopOutcome) -> list[Block]:
    unstable = captions.unstable(outcome.closed)
    compared = [] if unstable else compared_with_alternatives(outcome)
    words = sentences("loop_summary", outcome=outcome, unstable=unstable, comparisons=compared)
    blocks: list[Block] = [Paragraph(text=words)]
    designs = comparison.design_table(result, outcome)
    if designs.groups:
        blocks.append(designs)
    blocks.append(Fold(title="Options and controllers", blocks=(comparison.option_table(outcome),)))
    lines = [f"Not proved: {line}" for line in _unproved(result, outcome)]
    lines += [f"“{one.name}” has failed: {one.sentence}." for one in outcome.failed]
    blocks += [Paragraph(text=line, tone="bad") for line in lines]
    groups = comparison.group_rows(outcome.closed)
    if groups:
        title = f"Plants that “{outcome.use}” must work with"
        blocks.append(Subsection(title=title, blocks=(tables.group_table(groups),)))
    return blocks


def _judged(results: Sequence[CheckResult]) -> dict[str, Any]:
    words, passed = section_verdict(results)
    return {"verdict": words, "passed": passed}


def _unproved(result: JobResult, outcome: LoopOutcome) -> list[str]:
    """Return a line for every claim of the designs that is not proved."""
    proofs = {name: one for (loop, name), one in result.proofs.items() if loop == outcome.spec.name}
    return [f"{name}: {claim}" for name, one in proofs.items() for claim in one.claims if not claim.proved]


def _loop_plates(model: LinearModel, outcome: LoopOutcome, palette: Mapping[str, bool]) -> list[Block]:
    found = curves.shown_loop(outcome, palette)
    if found is None:
        return []
    loop, kinds = found, curves.further_gains(found)
    unstable, nutating = captions.unstable(outcome.closed), nutates(model, outcome.spec.gimbals)
    pictures: list[tuple[str, Callable[[], tuple[Figure, str]]]] = [
        ("Sensitivities", lambda: (paint(curves.sensitivity(loop), 2.1), captions.sensitivity(outcome, loop))),
        (
            "Loop transfer",
            lambda: (
                paint(curves.loop_transfer(loop), 1.35),
                sentences("loop_transfer", outcome=outcome, nutates=nutating),
            ),
        ),
        (
            "Nichols plot",
            lambda: (nichols_figure(outcome), sentences("nichols", outcome=outcome, unstable=unstable)),
        ),
        ("Disturbances", lambda: (paint(curves.disturbance(loop), 2.0), captions.disturbance(outcome, loop))),
    ]
    if kinds:
        words = captions.further_gains(outcome, loop, kinds)
        pictures.append(("Other gains with limits", lambda: (paint(curves.further(loop, kinds), 2.0), words)))
    plates: list[Block] = [drawn(title, draw, small=title == "Nichols plot") for title, draw in pictures]
    closed = outcome.closed.plants
    states = 0 if closed is None else closed.A.shape[-1] + outcome.closed.own_controller.nstates
    left_out = ""
    if states > _MOST_BRANCHES:
        left_out = f" There is no root locus: its {states} branches, most of them of delays, could not be told apart."
    plates.append(
        drawn(
            "Closed-loop poles",
            lambda: (pole_figure(loop), captions.poles(outcome, loop.plants) + left_out),
        )
    )

    def root_locus() -> tuple[Figure, str]:
        plot = root_locus_plot(outcome.closed, outcome.spec)
        return plot.figure, sentences("root_locus", name=outcome.closed.name, locus=plot.locus)

    if 0 < states <= _MOST_BRANCHES:
        plates.append(drawn("Root locus over the loop gain", root_locus))
    return plates


def _servo_plates(result: JobResult) -> list[Block]:
    title = "The servo's loops in the coupled system"
    if result.coupled is None:
        return []

    def make() -> Plate | None:
        found = servo(result)
        return None if found is None else plate(paint(found, 2.0), title, sentences("servo"))

    made = attempted(title, make)
    return [] if made is None else [made]


def _coupled(result: JobResult) -> list[Block]:
    check, limits = result.coupled, result.job.coupled
    if check is None:
        return [Paragraph(text="Not checked: a loop has no controller.", tone="bad")]
    blocks: list[Block] = [
        Paragraph(text=captions.coupled(result)),
        drawn(
            "Poles of the coupled system",
            lambda: (coupled_pole_figure(result), sentences("coupled_poles", check=check)),
        ),
    ]
    if check.channels:
        caption = sentences("margin_bars", allowed=limits.coupling_cost, free=check.free)
        blocks.append(drawn("Disk margins channel by channel", lambda: (margin_bars_figure(check), caption)))
    if check.stable and check.simultaneous.frequencies.size:
        blocks.append(
            drawn(
                "Disk margin in all channels at once",
                lambda: (
                    paint(simultaneous_margin(check, limits.disk_margin), 1.95),
                    sentences("simultaneous", check=check),
                ),
            )
        )
    # A carried platform does not yield to torques.
    if check.stable and check.free and check.controller is not None:
        blocks.append(
            drawn(
                "Torque on the platform",
                lambda: (paint(platform_disturbance(result), 2.0), sentences("platform_disturbance")),
            )
        )
    return blocks


def _runs(result: JobResult) -> list[Block]:
    return [Paragraph(text=sentences("runs", seed=result.job.seed))]


def _run_block(run: Run, result: JobResult) -> list[Block]:
    name, platform = run.manoeuvre.name, result.job.platform
    if run.trajectory.t.size:
        caption = captions.run(run, captions.spins(platform), result.loops)
        return [drawn(name, lambda: (time_run(run, platform), caption))]
    nothing = Paragraph(text=f"The run {run.trajectory.ended}: nothing was recorded.")
    return [Subsection(title=name, blocks=(nothing,))]


def _campaign(result: JobResult, campaign: Summary | None, again: str | None) -> list[PageSection]:
    if campaign is None:
        if result.job.campaign is None:
            return []
        return [PageSection(name="campaign", title="Campaign", blocks=(Paragraph(text=sentences("no_campaign")),))]
    found = attempted("Campaign", lambda: as_section(campaign, result, again))
    return [
        found if isinstance(found, PageSection) else PageSection(name="campaign", title="Campaign", blocks=(found,))
    ]


def _again(result: JobResult, command: str | None, campaign: Summary | None) -> list[Block]:
    given = any(design.method == "given" for outcome in result.loops for design in outcome.designs)
    again = "platform-ctrl check job.toml --controllers result.json" if given else "platform-ctrl design job.toml"
    words = "Save the text below as job.toml and run" if command is None else "This report was made by"
    seed = result.job.seed
    blocks: list[Block] = [
        Paragraph(text=words),
        Listing(text=command or again),
        Paragraph(
            text="The numbers do not depend on the machine beyond rounding; simulated runs repeat to the bit with the "
            f"same versions and seed {seed}."
        ),
        Fold(title="Versions", blocks=(Facts(rows=tables.versions()),)),
    ]
    if campaign is not None:
        blocks.append(Fold(title="Digests of the campaign", blocks=(Facts(rows=digests(campaign)),)))
    blocks.append(tables.record_part(result.job))
    return blocks
