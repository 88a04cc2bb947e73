"""The report of a job: its content in order, and the page."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from platform_ctrl.common.files import write_whole
from platform_ctrl.common.processes import SecondProcess
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.store import Store
from platform_ctrl.design.jobs import LoopOutcome
from platform_ctrl.job.job import Job
from platform_ctrl.job.judging import CheckResult
from platform_ctrl.mechanics.linearisation import LinearModel, linearise
from platform_ctrl.mechanics.state_space import coupled_while_changing
from platform_ctrl.plant.platform import Platform
from platform_ctrl.report import style
from platform_ctrl.report.axes.picture import axes_picture
from platform_ctrl.report.figures.coupled import (
    coupled_pole_figure,
    margin_bars_figure,
    nutation_figure,
    platform_disturbance_figure,
    servo_figure,
    simultaneous_margin_figure,
)
from platform_ctrl.report.figures.loop import (
    disturbance_figure,
    further_gains,
    further_gains_figure,
    loop_transfer_figure,
    nichols_figure,
    pole_figure,
    root_locus_plot,
    sensitivity_figure,
)
from platform_ctrl.report.loop_responses import LoopResponses, loop_responses, palette_of
from platform_ctrl.report.modes import nutates
from platform_ctrl.report.page import captions, comparison, tables
from platform_ctrl.report.page.blocks import (
    Block,
    Document,
    Facts,
    Fold,
    Listing,
    Paragraph,
    Part,
    Plate,
    Section,
    html,
    pdf,
    plate,
    sentence,
)
from platform_ctrl.report.page.budget_page import budget_sections
from platform_ctrl.report.page.campaign_page import as_section, digests
from platform_ctrl.report.page.captions import compared_with_alternatives, opening, sentences
from platform_ctrl.report.page.first_screen import change_part, first_screen, own_results, section_verdict
from platform_ctrl.report.page.kept_blocks import Ahead, Drawing, drawn_ahead, kept_or_drawn
from platform_ctrl.report.plots.time_run import time_run
from platform_ctrl.verification.changes import changes
from platform_ctrl.verification.coupled import ALL_LOOPS
from platform_ctrl.verification.simulated import Run
from platform_ctrl.verification.verdict import JobResult

if TYPE_CHECKING:
    from platform_ctrl.campaign.summary import Summary

# Branches of a root locus up to which it is drawn: of a long delay they lie side by side, and take minutes to follow.
_MOST_BRANCHES = 80


@check_arguments
def write_page(result: JobResult | Document, path: str | os.PathLike[str]) -> Path:
    """Write the page to `path`: the whole file, or nothing if that fails.

    Parameters
    ----------
    result
        From `prepared`, or from `platform_ctrl.verification.check_job` if no option of `prepared` is needed.
    path
        The file; an existing one is replaced.

    Returns
    -------
    pathlib.Path
        The file.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    return write_whole(path, page_html(result))


@check_arguments
def page_html(result: JobResult | Document) -> str:
    """Return the page as HTML: self-contained, for light and dark screens and for paper."""
    return html(prepared(result))


@check_arguments
def write_pdf(result: JobResult | Document, path: str | os.PathLike[str]) -> Path:
    """Write the report as PDF to `path`: the whole file, or nothing if that fails.

    Parameters
    ----------
    result
        From `platform_ctrl.report.prepared`, or from `platform_ctrl.verification.check_job` if none of its options is
        needed.
    path
        The file; an existing one is replaced.

    Returns
    -------
    pathlib.Path
        The file.

    Raises
    ------
    InputError
        The file cannot be written, or typst is not installed.
    PlatformCtrlError
        Typst could not set the document.
    """
    return write_whole(path, pdf_bytes(result))


@check_arguments
def pdf_bytes(result: JobResult | Document) -> bytes:
    """Return the report as PDF: the content of the page in the same order; the same bytes for the same result."""
    return pdf(prepared(result))


@check_arguments
def prepared(
    result: JobResult | Document,
    *,
    command: str | None = None,
    campaign: Summary | None = None,
    again: str | None = None,
) -> Document:
    """Return the content of the report, for `write_page` and `write_pdf`, with every figure drawn.

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
    Document
        Sections with text, tables and figures.

    Raises
    ------
    ArgumentError
        An argument of another kind than annotated.
    """
    if isinstance(result, Document):
        return result
    return _document(result, command, campaign, again)


def drawn_beside(
    result: JobResult, beside: SecondProcess, store: Store | None = None, ahead: Ahead | None = None, **options: Any
) -> Document:
    """Return what `prepared` returns with its `options`; another process draws a part of what is not in the store.

    `ahead` is from `loops_ahead`.
    """
    given: dict[str, Any] = {"command": None, "campaign": None, "again": None} | options
    return _document(result, **given, beside=beside, store=store, ahead=ahead)


def loops_ahead(job: Job, loops: Sequence[LoopOutcome], beside: SecondProcess, store: Store) -> Ahead:
    """Let another process begin with the figures of loops, which the check of the whole adds nothing to."""
    return drawn_ahead(_loop_drawings(linearise(job.platform), _bare(loops)), store, beside)


def _document(
    result: JobResult,
    command: str | None,
    campaign: Summary | None,
    again: str | None,
    beside: SecondProcess | None = None,
    store: Store | None = None,
    ahead: Ahead | None = None,
) -> Document:
    job = result.job
    drawn = iter(kept_or_drawn(_drawings(result), store, beside, ahead))
    loops = [next(drawn) for _ in result.loops]
    runs = [next(drawn) for _ in result.runs]
    plant, servo, budget, first, coupled = drawn
    together = [one for one in result.requirements if one.subject == ALL_LOOPS]
    with style.settings():
        sections = [
            Section(name="summary", title="", blocks=(*first, *_summary(result, campaign))),
            Section(
                name="requirements",
                title="Requirements",
                blocks=(tables.requirement_table(result),),
                **_judged(result.requirements),
            ),
            _plant(result, *plant),
            *(_loop(result, outcome, k, loops[k - 1], servo) for k, outcome in enumerate(result.loops, 1)),
            Section(name="coupled", title="Coupled system", blocks=coupled, **_judged(together)),
            *budget,
            *_runs(result, runs),
            *_campaign(result, campaign, again),
            _again(result, command, campaign),
        ]
    return Document(
        kicker="platform_ctrl: design and check of control loops",
        title=job.name,
        source=". ".join(filter(None, [job.platform.name, job.platform.source])),
        passed=result.passed,
        verdict=tables.verdict(result),
        sections=tuple(sections),
    )


def _drawings(result: JobResult) -> list[Drawing]:
    """Return what draws the plates of each loop, the blocks of each run, and then those of the whole."""
    bare, spinning = _bare(result.loops), captions.spins(result.job.platform)
    drawings = _loop_drawings(result.model, bare)
    for run in result.runs:
        caption = captions.run(run, spinning, result.loops) if run.trajectory.t.size else ""
        drawings.append(Drawing(_run_block, (run, result.job.platform, caption)))
    proofs = {key: dataclasses.replace(one, certificates=()) for key, one in result.proofs.items()}
    whole = dataclasses.replace(result, loops=bare, runs=(), proofs=proofs)
    # Last: this process begins with the end, and the whole result goes nowhere.
    of_whole = (_plant_plates, _servo_plates, budget_sections, _first, _coupled)
    return drawings + [Drawing(draw, (whole,)) for draw in of_whole]


def _bare(loops: Sequence[LoopOutcome]) -> tuple[LoopOutcome, ...]:
    # Without certificates, of which figures show nothing: there are hundreds, and all of it may go to another process.
    return tuple(
        dataclasses.replace(one, designs=tuple(dataclasses.replace(design, certificates=()) for design in one.designs))
        for one in loops
    )


def _loop_drawings(model: LinearModel, bare: Sequence[LoopOutcome]) -> list[Drawing]:
    palette = palette_of(bare)
    return [Drawing(_caging_plates, (model, outcome, palette)) for outcome in bare]


def _first(result: JobResult) -> tuple[Block, ...]:
    return (*first_screen(result), *change_part(result, changes(result)))


def _summary(result: JobResult, campaign: Summary | None) -> tuple[Block, ...]:
    first, verdict, *details = opening(result, campaign)
    lead = Paragraph(text=f"{first} {verdict}", tone="lead")
    rest = (Paragraph(text=" ".join(details)),) if details else ()
    return (lead, *rest)


def _plant(result: JobResult, axes: Plate, *plates: Plate) -> Section:
    gimbals = len(result.job.platform.gimbals)
    changing = coupled_while_changing(result.model)
    blocks: list[Block] = [
        Paragraph(text=sentences("groups", subsystems=result.subsystems, gimbals=gimbals, changing=changing)),
        axes,
        Part(title="Gimbals", blocks=(tables.gimbal_table(result),)),
    ]
    if result.job.platform.rotors:
        blocks.append(Part(title="Rotors", blocks=(tables.rotor_table(result),)))
    elements = tables.element_table(result)
    if elements is not None:
        blocks.append(Part(title="Springs, friction and other elements", blocks=(elements,)))
    blocks.append(Part(title="Modes of the uncontrolled gimbals", blocks=(tables.mode_table(result),)))
    return Section(name="plant", title="Plant and modes", blocks=(*blocks, *plates))


def _plant_plates(result: JobResult) -> list[Plate]:
    words = "Drawn from the plant file: which body turns about which axis, and how they carry each other."
    picture = axes_picture(result.job.platform, alone=False)
    axes, nutation = Plate(svg=picture, title="Axes and bodies", caption=words), nutation_figure(result)
    if nutation is None:
        return [axes]
    caption = sentences("nutation", uncertainty=result.job.uncertainty.spin)
    return [axes, plate(nutation, "Campbell diagram", caption)]


def _loop(
    result: JobResult, outcome: LoopOutcome, number: int, plates: Sequence[Plate], servo: Sequence[Plate]
) -> Section:
    unstable = captions.unstable(outcome.closed)
    compared = [] if unstable else compared_with_alternatives(outcome)
    words = sentences("loop_summary", outcome=outcome, unstable=unstable, comparisons=compared)
    blocks: list[Block] = [Paragraph(text=words)]
    designs = comparison.design_table(result, outcome)
    if designs.groups:
        blocks.append(designs)
    blocks.append(Fold(title="Options and controllers", blocks=(comparison.option_table(outcome),)))
    blocks += [Paragraph(text=f"Not proved: {line}", tone="bad") for line in _unproved(result, outcome)]
    groups = comparison.group_rows(outcome.closed)
    if groups:
        title = f"Plants that “{outcome.use}” must work with"
        blocks.append(Part(title=title, blocks=(tables.group_table(groups),)))
    blocks += plates
    if outcome.spec.kind == "stabilisation":
        blocks += servo
    title, own = sentence(outcome.spec.name), own_results(result, outcome)
    return Section(name=f"loop-{number}", title=title, blocks=tuple(blocks), **_judged(own))


def _judged(results: Sequence[CheckResult]) -> dict[str, Any]:
    words, passed = section_verdict(results)
    return {"verdict": words, "passed": passed}


def _unproved(result: JobResult, outcome: LoopOutcome) -> list[str]:
    """Return a line for every claim of the designs that has no proof, or whose proof failed."""
    lines = []
    for design in outcome.designs:
        proofs = result.proofs[design.loop, design.name]
        failed = [f"{one.statement}: {one.reason}" for one in proofs.verifications if not one.proved]
        lines += [f"{design.name}, {line}" for line in (*failed, *proofs.unproved)]
    return lines


def _caging_plates(model: LinearModel, outcome: LoopOutcome, palette: Mapping[str, bool]) -> list[Plate]:
    responses = loop_responses(model, outcome, palette)
    plants = responses.designs[0].design.plants if responses is not None else None
    if responses is None or plants is None:
        return []
    spec = outcome.spec
    plates = [
        plate(sensitivity_figure(responses, spec), "Sensitivities", captions.sensitivity(outcome, responses)),
        plate(
            loop_transfer_figure(responses, spec, plants.torques, plants.nutation),
            "Loop transfer",
            sentences("loop_transfer", outcome=outcome, nutates=nutates(model, [spec.gimbals])),
        ),
    ]
    if not captions.unstable(outcome.closed):
        figure = nichols_figure(responses, spec, plants.torques)
        plates.append(plate(figure, "Nichols plot", sentences("nichols", outcome=outcome), small=True))
    plates += [
        plate(disturbance_figure(responses, spec), "Disturbances", captions.disturbance(outcome, responses)),
        *_further_plates(responses, outcome),
    ]
    figure, caption = pole_figure(responses, spec, plants.nutation, plants.period), captions.poles(outcome, plants)
    closed = outcome.closed.plants
    states = 0 if closed is None else closed.A.shape[-1] + outcome.closed.own_controller.nstates
    if states > _MOST_BRANCHES:
        caption += f" There is no root locus: its {states} branches, most of them of delays, could not be told apart."
    plates.append(plate(figure, "Closed-loop poles", caption))
    if 0 < states <= _MOST_BRANCHES:
        plot = root_locus_plot(outcome.closed, spec)
        caption = sentences("root_locus", name=outcome.closed.name, locus=plot.locus)
        plates.append(plate(plot.figure, "Root locus over the loop gain", caption))
    return plates


def _further_plates(responses: LoopResponses, outcome: LoopOutcome) -> list[Plate]:
    kinds = further_gains(responses, outcome.spec)
    if not kinds:
        return []
    figure = further_gains_figure(responses, outcome.spec, kinds)
    return [plate(figure, "Other gains with limits", captions.further_gains(outcome, responses, kinds))]


def _servo_plates(result: JobResult) -> list[Plate]:
    figure = servo_figure(result)
    return [] if figure is None else [plate(figure, "The servo's loops in the coupled system", sentences("servo"))]


def _coupled(result: JobResult) -> tuple[Block, ...]:
    check = result.coupled
    blocks: list[Block] = [
        Paragraph(text=captions.coupled(result)),
        plate(coupled_pole_figure(result), "Poles of the coupled system", sentences("coupled_poles", check=check)),
    ]
    if check.channels:
        caption = sentences("margin_bars", allowed=result.job.coupled.coupling_cost, free=check.free)
        blocks.append(plate(margin_bars_figure(check), "Disk margins channel by channel", caption))
    if check.stable and check.simultaneous.frequencies.size:
        figure = simultaneous_margin_figure(check, result.job.coupled.disk_margin)
        blocks.append(plate(figure, "Disk margin in all channels at once", sentences("simultaneous", check=check)))
    # A carried platform does not yield to torques.
    if check.stable and check.free and check.controller is not None:
        figure = platform_disturbance_figure(result)
        blocks.append(plate(figure, "Torque on the platform", sentences("platform_disturbance")))
    return tuple(blocks)


def _runs(result: JobResult, blocks: Sequence[Block]) -> list[Section]:
    if not result.runs:
        return []
    first = Paragraph(text=sentences("runs", seed=result.job.seed))
    own = [one for run in result.runs for one in run.results]
    return [Section(name="runs", title="Simulated runs", blocks=(first, *blocks), **_judged(own))]


def _run_block(run: Run, platform: Platform, caption: str) -> Block:
    name = run.manoeuvre.name
    if run.trajectory.t.size:
        return plate(time_run(run, platform), name, caption)
    nothing = Paragraph(text=f"The run {run.trajectory.ended}: nothing was recorded.")
    return Part(title=name, blocks=(nothing,))


def _campaign(result: JobResult, campaign: Summary | None, again: str | None) -> list[Section]:
    if campaign is None:
        if result.job.campaign is None:
            return []
        return [Section(name="campaign", title="Campaign", blocks=(Paragraph(text=sentences("no_campaign")),))]
    return [as_section(campaign, result, again)]


def _again(result: JobResult, command: str | None, campaign: Summary | None) -> Section:
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
    return Section(name="again", title="Inputs and versions", blocks=tuple(blocks))
