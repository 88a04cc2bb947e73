"""The report of a job: its content in order, and the page."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from platform_ctrl.campaign.store import identity
from platform_ctrl.common.arguments import instance
from platform_ctrl.common.files import write_whole
from platform_ctrl.design.loop import LoopOutcome
from platform_ctrl.job.judging import CheckResult
from platform_ctrl.mechanics.linearisation import LinearModel
from platform_ctrl.mechanics.modes import nutates
from platform_ctrl.mechanics.state_space import coupled_while_changing
from platform_ctrl.report import captions, comparison, curves, style, tables
from platform_ctrl.report.blocks import (
    Block,
    Listing,
    PageContent,
    PageSection,
    Paragraph,
    Subsection,
    drawn,
    html,
    made,
    sentence,
)
from platform_ctrl.report.budget_page import budget_blocks
from platform_ctrl.report.campaign_page import campaign_blocks
from platform_ctrl.report.campaign_tables import campaign_words
from platform_ctrl.report.captions import opening, sentences
from platform_ctrl.report.figures.job import (
    coupled_pole_figure,
    nutation_figure,
    platform_disturbance,
    pole_figure,
    root_locus_plot,
    servo,
    simultaneous_margin,
)
from platform_ctrl.report.figures.nichols import nichols_figure
from platform_ctrl.report.figures.panels import paint
from platform_ctrl.report.figures.plant import axes_picture
from platform_ctrl.report.figures.runs import time_run
from platform_ctrl.report.first_screen import change_part, first_screen, own_results, section_verdict
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


def _document(result: JobResult, command: str | None, campaign: Summary | None, again: str | None) -> PageContent:
    job, palette = result.job, curves.palette_of(result.loops)
    together = [one for one in result.requirements if one.subject == ALL_LOOPS]
    of_runs = [one for run in result.runs for one in run.results]
    with style.settings():
        budget = made("Line-of-sight budget", lambda: budget_blocks(result))
        sections = [
            PageSection(
                name="summary",
                title="",
                blocks=(
                    *made("First screen", lambda: first_screen(result, campaign)),
                    *made("Summary", lambda: _summary(result, campaign)),
                    *made("What to change", lambda: change_part(result, changes(result))),
                ),
            ),
            PageSection(
                name="requirements",
                title="Requirements",
                blocks=made("Requirements", lambda: tables.requirement_table(result)),
                **_judged(result.requirements),
            ),
            PageSection(name="plant", title="Plant and modes", blocks=_plant(result)),
            *(
                PageSection(
                    name=f"loop-{k}",
                    title=sentence(outcome.spec.name),
                    blocks=_loop(result, outcome, palette),
                    **_judged(own_results(result, outcome)),
                )
                for k, outcome in enumerate(result.loops, 1)
            ),
            PageSection(name="coupled", title="Coupled system", blocks=_coupled(result), **_judged(together)),
            *([PageSection(name="budget", title="Line-of-sight budget", blocks=budget)] if budget else []),
            *_runs(result, of_runs),
            *_campaign(result, campaign, again),
            PageSection(name="again", title="Inputs and versions", blocks=_again(result, command, campaign)),
        ]
    return PageContent(
        kicker="platform_ctrl: design and check of control loops",
        title=job.name,
        source=". ".join(filter(None, [job.platform.name, job.platform.source])),
        passed=result.passed and (campaign is None or campaign.passed),
        verdict="; ".join(filter(None, (tables.verdict(result), campaign_words(campaign)))),
        sections=tuple(sections),
    )


def _judged(results: Sequence[CheckResult]) -> dict[str, Any]:
    words, passed = section_verdict(results)
    return {"verdict": words, "passed": passed}


def _summary(result: JobResult, campaign: Summary | None) -> tuple[Block, ...]:
    first, *details = opening(result, campaign)
    rest = (Paragraph(text=" ".join(details)),) if details else ()
    return (Paragraph(text=first, tone="lead"), *rest)


def _plant(result: JobResult) -> tuple[Block, ...]:
    placed = any(gimbal.origin.any() for gimbal in result.job.platform.gimbals)
    where = "joints are where the plant file says" if placed else "all axes go through one point"
    words = f"Which body turns about which axis. Bodies are drawn apart; in the model {where}."
    caption = sentences("nutation", uncertainty=result.job.uncertainty.spin)
    return (
        *made("Subsystems", lambda: _subsystems(result)),
        *drawn("Axes and bodies", lambda: axes_picture(result.job.platform), words),
        *made("Gimbals and modes", lambda: _plant_tables(result)),
        *drawn("Campbell diagram", lambda: nutation_figure(result), caption),
    )


def _subsystems(result: JobResult) -> Paragraph:
    gimbals, changing = len(result.job.platform.gimbals), coupled_while_changing(result.model)
    words = sentences("groups", subsystems=result.subsystems, gimbals=gimbals, changing=changing)
    return Paragraph(text=words)


def _plant_tables(result: JobResult) -> list[Block]:
    blocks: list[Block] = [Subsection(title="Gimbals", blocks=(tables.gimbal_table(result),))]
    if result.job.platform.rotors:
        blocks.append(Subsection(title="Rotors", blocks=(tables.rotor_table(result),)))
    elements = tables.element_table(result)
    if elements is not None:
        blocks.append(Subsection(title="Sensors, springs, friction and other elements", blocks=(elements,)))
    title = "Modes of the uncontrolled gimbals"
    blocks.append(Subsection(title=title, blocks=made(title, lambda: tables.mode_table(result))))
    return blocks


def _loop(result: JobResult, outcome: LoopOutcome, palette: Mapping[str, bool]) -> tuple[Block, ...]:
    servo_caption = sentences("servo")
    return (
        *made("Text and tables", lambda: _loop_tables(result, outcome)),
        *made("Figures", lambda: _loop_plates(result.model, outcome, palette)),
        *(
            drawn("The servo's loops in the coupled system", lambda: _servo(result), servo_caption)
            if outcome.spec.kind == "stabilisation" and result.coupled is not None
            else ()
        ),
    )


def _servo(result: JobResult) -> Figure | None:
    found = servo(result)
    return None if found is None else paint(found, 2.0)


def _loop_tables(result: JobResult, outcome: LoopOutcome) -> list[Block]:
    unstable = captions.unstable(outcome.closed)
    words = sentences("loop_summary", outcome=outcome, unstable=unstable)
    blocks: list[Block] = [Paragraph(text=words)]
    designs = comparison.design_table(result, outcome)
    if designs.groups:
        blocks.append(designs)
    options = comparison.option_table(outcome)
    blocks.append(Subsection(title="Options and controllers", blocks=(options,), folded=True))
    lines = [f"Not proved: {line}" for line in _unproved(result, outcome)]
    lines += [f"“{one.name}” has failed: {one.sentence}." for one in outcome.failed]
    blocks += [Paragraph(text=line, tone="bad") for line in lines]
    groups = comparison.group_rows(outcome.closed)
    if groups:
        title = f"Plants that “{outcome.use}” must work with"
        blocks.append(Subsection(title=title, blocks=(tables.group_table(groups),)))
    return blocks


def _unproved(result: JobResult, outcome: LoopOutcome) -> list[str]:
    """Return a line for every claim of the designs that is not proved."""
    proofs = {name: one for (loop, name), one in result.proofs.items() if loop == outcome.spec.name}
    return [f"{name}: {claim}" for name, one in proofs.items() for claim in one.claims if not claim.proved]


def _loop_plates(model: LinearModel, outcome: LoopOutcome, palette: Mapping[str, bool]) -> tuple[Block, ...]:
    loop = curves.shown_loop(outcome, palette)
    if loop is None:
        return ()
    design, kinds = outcome.closed, curves.further_gains(loop)
    unstable, nutating = captions.unstable(design), nutates(model, outcome.spec.gimbals)
    of_channels = sentences("loop_transfer", outcome=outcome, nutates=nutating)
    of_nichols = sentences("nichols", outcome=outcome, unstable=unstable)
    states = 0 if design.plants is None else design.plants.A.shape[-1] + design.own_controller.nstates
    left_out = ""
    if states > _MOST_BRANCHES:
        left_out = f" There is no root locus: its {states} branches, most of them of delays, could not be told apart."
    plates = (
        *drawn(
            "Sensitivities", lambda: paint(curves.sensitivity(loop), 2.1), lambda: captions.sensitivity(outcome, loop)
        ),
        *drawn("Loop transfer", lambda: paint(curves.loop_transfer(loop), 1.35), of_channels),
        *drawn("Nichols plot", lambda: nichols_figure(outcome), of_nichols, small=True),
        *drawn(
            "Disturbances", lambda: paint(curves.disturbance(loop), 2.0), lambda: captions.disturbance(outcome, loop)
        ),
        *drawn(
            "Other gains with limits",
            lambda: paint(curves.further(loop, kinds), 2.0) if kinds else None,
            lambda: captions.further_gains(outcome, kinds),
        ),
        *drawn("Closed-loop poles", lambda: pole_figure(loop), lambda: captions.poles(outcome, loop.plants) + left_out),
    )
    if not 0 < states <= _MOST_BRANCHES:
        return plates

    def locus() -> tuple[Block, ...]:
        plot = root_locus_plot(design, outcome.spec)
        return drawn(title, lambda: plot.figure, sentences("root_locus", name=design.name, locus=plot.locus))

    title = "Root locus over the loop gain"
    return (*plates, *made(title, locus))


def _coupled(result: JobResult) -> tuple[Block, ...]:
    check, limits = result.coupled, result.job.coupled
    if check is None:
        return (Paragraph(text="Not checked: a loop has no controller.", tone="bad"),)
    poles, margins = sentences("coupled_poles", check=check), "Disk margins channel by channel"
    blocks = (
        *made("Coupled system", lambda: Paragraph(text=captions.coupled(result))),
        *drawn("Poles of the coupled system", lambda: coupled_pole_figure(result), poles),
    )
    if check.channels:
        words = sentences("channel_margins", allowed=limits.coupling_cost, free=check.free)
        shown = (Paragraph(text=words, tone="quiet"), *made(margins, lambda: tables.margin_table(check)))
        blocks += (Subsection(title=margins, blocks=shown),)
    if check.stable and check.simultaneous.frequencies.size:
        title = "Disk margin in all channels at once"
        words = sentences("simultaneous", check=check)
        blocks += drawn(title, lambda: paint(simultaneous_margin(check, limits.disk_margin), 1.95), words)
    # A carried platform does not yield to torques.
    if check.stable and check.free and check.controller is not None:
        words = sentences("platform_disturbance")
        blocks += drawn("Torque on the platform", lambda: paint(platform_disturbance(result), 2.0), words)
    return blocks


def _runs(result: JobResult, judged: Sequence[CheckResult]) -> list[PageSection]:
    if not result.runs:
        return []
    blocks = (
        Paragraph(text=sentences("runs", seed=result.job.seed)),
        *(block for run in result.runs for block in _run_blocks(run, result)),
    )
    return [PageSection(name="runs", title="Simulated runs", blocks=blocks, **_judged(judged))]


def _run_blocks(run: Run, result: JobResult) -> tuple[Block, ...]:
    name, platform = run.manoeuvre.name, result.job.platform
    if run.trajectory.t.size:
        return drawn(name, lambda: time_run(run, platform), lambda: captions.run(run, platform))
    nothing = Paragraph(text=f"The run {run.trajectory.ended}: nothing was recorded.")
    return (Subsection(title=name, blocks=(nothing,)),)


def _campaign(result: JobResult, campaign: Summary | None, again: str | None) -> list[PageSection]:
    if campaign is not None:
        blocks = made("Campaign", lambda: campaign_blocks(campaign, result, again))
    elif result.job.campaign is not None:
        blocks = (Paragraph(text=sentences("no_campaign")),)
    else:
        return []
    return [PageSection(name="campaign", title="Campaign", blocks=blocks)]


def _again(result: JobResult, command: str | None, campaign: Summary | None) -> tuple[Block, ...]:
    given = any(design.method == "given" for outcome in result.loops for design in outcome.designs)
    again = "platform-ctrl check job.toml --controllers result.json" if given else "platform-ctrl design job.toml"
    words = "Save the text below as job.toml and run" if command is None else "This report was made by"
    repeated = (
        "The numbers do not depend on the machine beyond rounding; simulated runs repeat to the bit with the "
        f"same versions and seed {result.job.seed}."
    )
    digests = () if campaign is None else (tables.folded_facts("Digests of the campaign", identity(campaign.plan)),)
    return (
        Paragraph(text=words),
        Listing(text=command or again),
        Paragraph(text=repeated),
        tables.folded_facts("Versions", tables.report_versions()),
        *digests,
        *made("Job and plant as read", lambda: tables.record_part(result.job)),
    )
