"""The report of a job: its content in order, and the page."""

from __future__ import annotations

import os
import shlex
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from platform_ctrl.campaign.store import identity
from platform_ctrl.common.arguments import instance
from platform_ctrl.common.files import write_whole
from platform_ctrl.design.loop import LoopOutcome
from platform_ctrl.mechanics.linearisation import LinearModel
from platform_ctrl.mechanics.modes import nutates
from platform_ctrl.mechanics.state_space import coupled_while_changing
from platform_ctrl.report import blocks as page
from platform_ctrl.report import captions, comparison, curves, style, tables
from platform_ctrl.report.budget_page import budget_blocks
from platform_ctrl.report.campaign_page import campaign_blocks
from platform_ctrl.report.captions import opening, sentences
from platform_ctrl.report.figures import job as figures
from platform_ctrl.report.figures.nichols import nichols_figure
from platform_ctrl.report.figures.panels import paint
from platform_ctrl.report.figures.plant import axes_picture
from platform_ctrl.report.figures.runs import time_run
from platform_ctrl.report.first_screen import change_part, first_screen, own_results, section_verdict
from platform_ctrl.verification.bounds import loop_bounds
from platform_ctrl.verification.changes import changes
from platform_ctrl.verification.coupled import ALL_LOOPS
from platform_ctrl.verification.simulated import Run
from platform_ctrl.verification.verdict import JobResult

if TYPE_CHECKING:
    from platform_ctrl.campaign.summary import Summary

# Branches of a root locus up to which it is drawn: of a long delay they lie side by side, and take minutes to follow.
_MOST_BRANCHES = 80


def write_page(result: JobResult | page.PageContent, path: str | os.PathLike[str], **options: Any) -> Path:
    """Write the page to `path`: the whole file, or nothing if that fails.

    Parameters
    ----------
    result
        From `platform_ctrl.verification.check_job`.
    path
        The file; an existing one is replaced.
    **options
        ``command``: the command line that repeats the job; ``file``: the job's file in it; ``campaign``: summary of a
        campaign of the job, from `platform_ctrl.campaign.summarise`, which becomes a section; ``again``: the command
        line that repeats one run of the campaign, without the run's number at its end.

    Returns
    -------
    pathlib.Path
        The file.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    return write_whole(path, page.html(prepared(result, **options)))


def prepared(
    result: JobResult | page.PageContent,
    *,
    command: str | None = None,
    file: str = "job.toml",
    campaign: Summary | None = None,
    again: str | None = None,
) -> page.PageContent:
    """Return the content of the report, for `write_page`, with every figure drawn.

    Parameters
    ----------
    result
        From `platform_ctrl.verification.check_job`. A document is returned as it is.
    command
        The command line that repeats the job; default: one that reads the job printed at the end of the report.
    file
        The job's file, as commands that the report proposes name it.
    campaign
        Summary of a campaign of the job, from `platform_ctrl.campaign.summary.summarise`; it becomes a section.
    again
        The command line that repeats one run of the campaign, without the run's number at its end; default: of `file`.

    Returns
    -------
    PageContent
        Sections with text, tables and figures.

    Raises
    ------
    ArgumentError
        An argument of another kind than annotated.
    """
    if isinstance(result, page.PageContent):
        return result
    job, palette = instance("result", result, JobResult).job, curves.palette_of(result.loops)
    required, of = result.requirements, section_verdict
    together = [one for one in required if one.subject == ALL_LOOPS]
    of_runs = [one for run in result.runs for one in run.results]
    again = again or f"platform-ctrl simulate {shlex.quote(file)} --run"
    with style.settings():
        sections = (
            *page.section("summary", "", lambda: _first(result, campaign)),
            *page.section("requirements", "Requirements", lambda: tables.requirement_table(result), of(required)),
            *page.section("plant", "Plant and modes", lambda: _plant(result)),
            *(
                section
                for k, one in enumerate(result.loops, 1)
                for section in page.section(
                    f"loop-{k}",
                    page.sentence(one.spec.name),
                    partial(_loop, result, one, palette),
                    of(own_results(result, one)),
                )
            ),
            *page.section("coupled", "Coupled system", lambda: _coupled(result), of(together)),
            *page.section("budget", "Line-of-sight budget", lambda: budget_blocks(result)),
            *page.section("runs", "Simulated runs", lambda: _runs(result), of(of_runs)),
            *page.section("campaign", "Campaign", lambda: _campaign(result, campaign, file, again)),
            *page.section("again", "Inputs and versions", lambda: _again(result, command, campaign)),
        )
    passed, verdict = tables.verdict(result, campaign)
    return page.PageContent(
        kicker="platform_ctrl: design and check of control loops",
        title=job.name,
        source=". ".join(filter(None, [job.platform.name, job.platform.source])),
        passed=passed,
        verdict=verdict,
        sections=sections,
    )


def _first(result: JobResult, campaign: Summary | None) -> tuple[page.Block, ...]:
    return (
        *page.made("First screen", lambda: first_screen(result, campaign)),
        *page.made("Summary", lambda: _summary(result, campaign)),
        *page.made("What to change", lambda: change_part(result, changes(result))),
    )


def _summary(result: JobResult, campaign: Summary | None) -> tuple[page.Block, ...]:
    first, *details = opening(result, campaign)
    rest = (page.Paragraph(text=" ".join(details)),) if details else ()
    return (page.Paragraph(text=first, tone="lead"), *rest)


def _plant(result: JobResult) -> tuple[page.Block, ...]:
    placed = any(gimbal.origin.any() for gimbal in result.job.platform.gimbals)
    gimbals, changing = len(result.job.platform.gimbals), coupled_while_changing(result.model)
    groups = sentences("groups", subsystems=result.subsystems, gimbals=gimbals, changing=changing)
    where = "joints are where the plant file says" if placed else "all axes go through one point"
    words = f"Which body turns about which axis. Bodies are drawn apart; in the model {where}."
    caption = sentences("nutation", uncertainty=result.job.uncertainty.spin)
    return (
        page.Paragraph(text=groups),
        *page.drawn("Axes and bodies", lambda: axes_picture(result.job.platform), words),
        *page.made("Gimbals and modes", lambda: _plant_tables(result)),
        *page.drawn("Campbell diagram", lambda: figures.nutation_figure(result), caption),
    )


def _plant_tables(result: JobResult) -> list[page.Block]:
    blocks: list[page.Block] = [page.Subsection(title="Gimbals", blocks=(tables.gimbal_table(result),))]
    if result.job.platform.rotors:
        blocks.append(page.Subsection(title="Rotors", blocks=(tables.rotor_table(result),)))
    elements = tables.element_table(result)
    if elements is not None:
        blocks.append(page.Subsection(title="Sensors, springs, friction and other elements", blocks=(elements,)))
    title = "Modes of the uncontrolled gimbals"
    blocks.append(page.Subsection(title=title, blocks=page.made(title, lambda: tables.mode_table(result))))
    return blocks


def _loop(result: JobResult, outcome: LoopOutcome, palette: Mapping[str, bool]) -> tuple[page.Block, ...]:
    return (
        *page.made("Text and tables", lambda: _loop_tables(result, outcome)),
        *page.made("Figures", lambda: _loop_plates(result.model, outcome, palette)),
        *(
            page.drawn(
                "The servo's loops in the coupled system",
                lambda: paint(found, 2.0) if (found := figures.servo(result)) else None,
                sentences("servo"),
            )
            if outcome.spec.kind == "stabilisation" and result.coupled is not None
            else ()
        ),
    )


def _loop_tables(result: JobResult, outcome: LoopOutcome) -> list[page.Block]:
    unstable = captions.unstable(outcome.closed)
    words = sentences("loop_summary", outcome=outcome, unstable=unstable)
    blocks: list[page.Block] = [page.Paragraph(text=words)]
    designs = comparison.design_table(result, outcome)
    if designs.groups:
        blocks.append(designs)
    options = comparison.option_table(outcome)
    blocks.append(page.Subsection(title="Options and controllers", blocks=(options,), folded=True))
    proofs = {name: one for (loop, name), one in result.proofs.items() if loop == outcome.spec.name}
    lines = [f"Not proved: {name}: {claim}" for name, one in proofs.items() for claim in one.claims if not claim.proved]
    lines += [f"“{one.name}” has failed: {one.sentence}." for one in outcome.failed]
    blocks += [page.Paragraph(text=line, tone="bad") for line in lines]
    groups = comparison.group_table(outcome.closed)
    if groups is not None:
        blocks.append(page.Subsection(title=f"Plants that “{outcome.use}” must work with", blocks=(groups,)))
    if (found := loop_bounds(result.job, outcome, result.inner(outcome))) is not None:
        says = page.Paragraph(text=sentences("bounds", found=found, hertz=found.bandwidth / (2.0 * np.pi)))
        blocks.append(page.Subsection(title="What bounds the bandwidth", blocks=(says, tables.bound_table(found))))
    return blocks


def _loop_plates(model: LinearModel, outcome: LoopOutcome, palette: Mapping[str, bool]) -> tuple[page.Block, ...]:
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
        *page.drawn(
            "Sensitivities", lambda: paint(curves.sensitivity(loop), 2.1), lambda: captions.sensitivity(outcome, loop)
        ),
        *page.drawn("Loop transfer", lambda: paint(curves.loop_transfer(loop), 1.35), of_channels),
        *page.drawn("Nichols plot", lambda: nichols_figure(outcome), of_nichols, small=True),
        *page.drawn(
            "Disturbances", lambda: paint(curves.disturbance(loop), 2.0), lambda: captions.disturbance(outcome, loop)
        ),
        *page.drawn(
            "Other gains with limits",
            lambda: paint(curves.further(loop, kinds), 2.0) if kinds else None,
            lambda: captions.further_gains(outcome, kinds),
        ),
        *page.drawn(
            "Closed-loop poles",
            lambda: figures.pole_figure(loop),
            lambda: captions.poles(outcome, loop.plants) + left_out,
        ),
    )
    if not 0 < states <= _MOST_BRANCHES:
        return plates

    def locus() -> tuple[page.Block, ...]:
        plot = figures.root_locus_plot(design, outcome.spec)
        return page.drawn(title, lambda: plot.figure, sentences("root_locus", name=design.name, locus=plot.locus))

    title = "Root locus over the loop gain"
    return (*plates, *page.made(title, locus))


def _coupled(result: JobResult) -> tuple[page.Block, ...]:
    check, limits = result.coupled, result.job.coupled
    if check is None:
        return (page.Paragraph(text="Not checked: a loop has no controller.", tone="bad"),)
    poles, margins = sentences("coupled_poles", check=check), "Disk margins channel by channel"
    blocks = (
        *page.made("Coupled system", lambda: page.Paragraph(text=captions.coupled(result))),
        *page.drawn("Poles of the coupled system", lambda: figures.coupled_pole_figure(result), poles),
    )
    if check.channels:
        words = sentences("channel_margins", allowed=limits.coupling_cost, free=check.free)
        shown = (page.Paragraph(text=words, tone="quiet"), *page.made(margins, lambda: tables.margin_table(check)))
        blocks += (page.Subsection(title=margins, blocks=shown),)
    if check.stable and check.simultaneous.frequencies.size:
        title = "Disk margin in all channels at once"
        words = sentences("simultaneous", check=check)
        blocks += page.drawn(title, lambda: paint(figures.simultaneous_margin(check, limits.disk_margin), 1.95), words)
    # A carried platform does not yield to torques.
    if check.stable and check.free and check.controller is not None:
        words = sentences("platform_disturbance")
        blocks += page.drawn("Torque on the platform", lambda: paint(figures.platform_disturbance(result), 2.0), words)
    return blocks


def _runs(result: JobResult) -> tuple[page.Block, ...]:
    if not result.runs:
        return ()
    words = page.Paragraph(text=sentences("runs", seed=result.job.seed))
    return (words, *(block for run in result.runs for block in _run_blocks(run, result)))


def _run_blocks(run: Run, result: JobResult) -> tuple[page.Block, ...]:
    name, platform = run.manoeuvre.name, result.job.platform
    if run.trajectory.t.size:
        return page.drawn(name, lambda: time_run(run, platform), lambda: captions.run(run, platform))
    nothing = page.Paragraph(text=f"The run {run.trajectory.ended}: nothing was recorded.")
    return (page.Subsection(title=name, blocks=(nothing,)),)


def _campaign(result: JobResult, campaign: Summary | None, file: str, again: str) -> tuple[page.Block, ...]:
    if campaign is not None:
        return campaign_blocks(campaign, result, again)
    without = result.job.campaign is not None
    return (page.Paragraph(text=sentences("no_campaign", file=shlex.quote(file))),) if without else ()


def _again(result: JobResult, command: str | None, campaign: Summary | None) -> tuple[page.Block, ...]:
    given = any(design.method == "given" for outcome in result.loops for design in outcome.designs)
    again = "platform-ctrl check job.toml --controllers result.json" if given else "platform-ctrl design job.toml"
    words = "Save the text below as job.toml and run" if command is None else "This report was made by"
    repeated = (
        "The numbers do not depend on the machine beyond rounding; simulated runs repeat to the bit with the "
        f"same versions and seed {result.job.seed}."
    )
    digests = () if campaign is None else (tables.folded_facts("Digests of the campaign", identity(campaign.plan)),)
    return (
        page.Paragraph(text=words),
        page.Listing(text=command or again),
        page.Paragraph(text=repeated),
        tables.folded_facts("Versions", tables.report_versions()),
        *digests,
        *page.made("Job and plant as read", lambda: tables.record_part(result.job)),
    )
