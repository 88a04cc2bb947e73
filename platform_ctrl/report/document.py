"""The page: everything that a job came to, in one file that needs nothing else."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from platform_ctrl.check.verdict import JobResult
from platform_ctrl.design.jobs import LoopOutcome
from platform_ctrl.frozen import value
from platform_ctrl.report import captions, comparison, tables
from platform_ctrl.report.record import job_data, toml, versions
from platform_ctrl.report.rendering import rendered
from platform_ctrl.report.survival import survival
from platform_ctrl.writing import write_whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@value
class Plate:
    """A figure on the page: its SVG, its title, and a sentence on what to see."""

    svg: str
    title: str
    caption: str


def write_page(result: JobResult, path: str | os.PathLike[str], *, command: str | None = None) -> Path:
    """Write the page to `path`, whole or not at all.

    Parameters
    ----------
    result
        From `platform_ctrl.check.checked`.
    path
        The file; one that exists is replaced.
    command
        The command line that does it again; default one that reads the job printed at the end of the page.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    return write_whole(path, page(result, command=command))


def page(result: JobResult, *, command: str | None = None) -> str:
    """Return the page as HTML: self-contained, for light and dark screens and for paper.

    Parameters
    ----------
    result
        From `platform_ctrl.check.checked`.
    command
        As in `write_page`.
    """
    from platform_ctrl.report import style

    given = any(design.method == "given" for outcome in result.loops for design in outcome.designs)
    again = "platform-ctrl check job.toml --controllers result.json" if given else "platform-ctrl design job.toml"
    rows = tables.requirement_rows(result)
    with style.settings():
        content = {
            "result": result,
            "job": result.job,
            "platform": result.job.platform,
            "verdict": tables.verdict(result),
            "rows": rows,
            "groups": tables.by_subject(result),
            "goals": tables.goal_rows(result),
            "gimbals": tables.gimbal_rows(result),
            "rotors": tables.rotor_rows(result),
            "elements": tables.element_rows(result),
            "modes": tables.mode_rows(result),
            "axes": _axes_plate(result),
            "plant_plates": _plant_plates(result),
            "loops": [_loop_section(result, outcome) for outcome in result.loops],
            "coupled": captions.coupled_summary(result),
            "coupled_plates": _coupled_plates(result),
            "runs": [_run_section(result, k) for k in range(len(result.runs))],
            "record": toml(job_data(result.job)),
            "versions": versions().items(),
            "command": command or again,
            "own_record": command is None,
        }
    return rendered("report.html", content)


def _plate(figure: Figure, title: str, caption: str) -> Plate:
    from platform_ctrl.report import style

    return Plate(svg=style.svg(figure, f"{title}. {caption}"), title=title, caption=caption)


def _axes_plate(result: JobResult) -> Plate:
    from platform_ctrl.report.axes_picture import axes_picture

    caption = "Drawn from the plant file: which body turns about which axis, and how they carry each other."
    return Plate(svg=axes_picture(result.job.platform, alone=False), title="Axes and bodies", caption=caption)


def _plant_plates(result: JobResult) -> list[Plate]:
    from platform_ctrl.report import figures

    nutation = figures.nutation_figure(result)
    if nutation is None:
        return []
    return [_plate(nutation, "Nutation over rotor speed", captions.nutation(result))]


def _loop_section(result: JobResult, outcome: LoopOutcome) -> dict[str, Any]:
    section: dict[str, Any] = {
        "outcome": outcome,
        "summary": captions.loop_summary(outcome),
        "comparison": comparison.sections(result, outcome),
        "unproved": _unproved(result, outcome),
        "groups": comparison.group_rows(outcome.closed),
        "plates": _caging_plates(result, outcome),
    }
    if outcome.spec.kind == "stabilisation":
        section["plates"] += _servo_plates(result)
    return section


def _unproved(result: JobResult, outcome: LoopOutcome) -> list[str]:
    """Return a line for every claim of the designs that has no proof, or whose proof failed."""
    lines = []
    for design in outcome.designs:
        proofs = result.proofs[design.loop, design.name]
        failed = [f"{one.statement}: {one.reason}" for one in proofs.verifications if not one.proved]
        lines += [f"{design.name}, {line}" for line in (*failed, *proofs.unproved)]
    return lines


def _caging_plates(result: JobResult, outcome: LoopOutcome) -> list[Plate]:
    from platform_ctrl.report import figures
    from platform_ctrl.report.loop_responses import loop_responses, root_locus

    responses = loop_responses(result.model, outcome)
    plants = responses.designs[0].design.plants if responses is not None else None
    if responses is None or plants is None:
        return []
    spec = outcome.spec
    plates = [
        _plate(figures.sensitivity_figure(responses, spec), "Sensitivities", captions.sensitivity(outcome, responses)),
        _plate(
            figures.loop_transfer_figure(responses, spec, plants.torques, plants.nutation),
            "Loop transfer",
            captions.loop_transfer(outcome),
        ),
        _plate(figures.disturbance_figure(responses, spec), "Disturbances", captions.disturbance(outcome, responses)),
        _plate(
            figures.pole_figure(responses, spec, plants.nutation, plants.period),
            "Closed-loop poles",
            captions.poles(outcome, plants),
        ),
    ]
    if outcome.closed.plants is not None:
        locus = root_locus(outcome.closed)
        figure = figures.root_locus_figure(locus, spec, plants.nutation, plants.period)
        plates.append(_plate(figure, "Root locus over the loop gain", captions.root_locus(outcome, locus)))
    return plates


def _servo_plates(result: JobResult) -> list[Plate]:
    from platform_ctrl.report import figures

    figure = figures.servo_figure(result)
    return [] if figure is None else [_plate(figure, "The servo's loops in the coupled system", captions.servo())]


def _coupled_plates(result: JobResult) -> list[Plate]:
    from platform_ctrl.report import figures

    check = result.coupled
    plates = [
        _plate(figures.coupled_pole_figure(result), "Poles of the coupled system", captions.coupled_poles(result))
    ]
    if check.channels:
        plates.append(
            _plate(figures.margin_bars_figure(check), "Disk margins channel by channel", captions.margin_bars(result))
        )
    if check.stable and check.simultaneous.frequencies.size:
        figure = figures.simultaneous_margin_figure(check, result.job.coupled.disk_margin)
        plates.append(_plate(figure, "Disk margin in all channels at once", captions.simultaneous(result)))
    # Who carries the platform takes every torque on it.
    if check.stable and check.free:
        figure = figures.platform_disturbance_figure(result)
        plates.append(_plate(figure, "Torque on the platform", captions.platform_disturbance()))
    return plates


def _run_section(result: JobResult, k: int) -> dict[str, Any]:
    from platform_ctrl.report import figures

    run = result.runs[k]
    caption = " ".join(filter(None, [captions.run(run), survival(run, result.loops)]))
    return {
        "run": run,
        "plate": _plate(figures.run_figure(run, result.job.platform), run.manoeuvre.name, caption)
        if run.trajectory.t.size
        else None,
    }
