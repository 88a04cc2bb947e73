"""``platform-ctrl simulate``: one manoeuvre of a job, or one run of its campaign again, with everything it recorded."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from platform_ctrl.cli.exits import not_drawn, noted
from platform_ctrl.cli.job_arguments import (
    CAMPAIGN,
    Controllers,
    JobFile,
    Json,
    Quiet,
    controller_file,
    folder_option,
    job_of,
    option,
    prepare_folder,
)
from platform_ctrl.errors import InputError

if TYPE_CHECKING:
    import control

    from platform_ctrl.campaign.planning import Plan
    from platform_ctrl.job.job import Job
    from platform_ctrl.job.manoeuvre import Manoeuvre
    from platform_ctrl.verification.simulated import Run

TABLE = "campaign.parquet"

Shown = Callable[[bool], int]


RunNumber = Annotated[
    int | None,
    option("--run", metavar="NUMBER", help="Run of the job's campaign, as its table numbers them from 0."),
]
ManoeuvreName = Annotated[
    str | None,
    option(
        "--manoeuvre",
        metavar="NAME",
        help="Manoeuvre: its name, or its number from 1.",
    ),
]
Out = Annotated[
    Path | None,
    folder_option(
        f"Of a run of the campaign: the campaign's folder, default: {CAMPAIGN}; seed and sampling are those "
        "of the campaign there. A figure of the run goes there; of a manoeuvre only if a folder is named.",
    ),
]


def simulate(
    job: JobFile,
    run: RunNumber = None,
    manoeuvre: ManoeuvreName = None,
    controllers: Controllers = None,
    out: Out = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> int:
    """Simulate one manoeuvre on the non-linear plant, or one run of a campaign again.

    Uses existing controllers. Gimbal stops, torque limits, sampling, delay and pick-off noise are those of plant
    and job; the job's seed makes the run the same every time. A run of the campaign is simulated with all its draws:
    its values are those in the campaign's table. Without a choice the manoeuvres are listed. Exit code 1 if a limit is
    not met.

    \b
    platform-ctrl simulate job.toml
        what can be simulated
    platform-ctrl simulate job.toml --manoeuvre turn -o runs
        by name, with a figure
    platform-ctrl simulate job.toml --manoeuvre 1 --json
        by number, the values as JSON
    platform-ctrl simulate job.toml --run 4711
        the campaign's run 4711: campaign/run-4711.svg
    platform-ctrl simulate job.toml --run 4711 -o night
        of the campaign that was simulated with -o night
    """  # noqa: D301
    from platform_ctrl.cli.terminal import progress

    if run is not None and manoeuvre is not None:
        raise InputError(
            "--run and --manoeuvre exclude each other; give --run NUMBER for a run of the campaign, or --manoeuvre NAME"
        )
    if run is None and manoeuvre is None:
        return _list(job, as_json)
    with progress(quiet or as_json, f"reading {job}") as say:
        read = job_of(job)
        chosen = None if manoeuvre is None else _manoeuvre(read, manoeuvre, job)
        file, used = controller_file(controllers, None, job, read, quiet or as_json)
        from platform_ctrl.verification.controllers import read_controllers

        closed = read_controllers(file, read)
        if chosen is None:
            assert run is not None
            planned = _planned(read, run, closed, out)
            prepare_folder(planned[1])
            say(f"run {run} of the campaign")
            show = _campaign_run(run, *planned)
        else:
            if out is not None:
                prepare_folder(out)
            say(f"simulated run: {chosen.name}")
            show = _manoeuvre_run(read, chosen, closed, out)
    noted(used)
    return show(as_json)


def _list(path: Path, as_json: bool) -> int:
    """Print the manoeuvres of a job, and how to choose one."""
    job = job_of(path)
    if as_json:
        from platform_ctrl.common.files import json_text

        listed = [{"number": k, "name": one.name, "mode": one.mode} for k, one in enumerate(job.manoeuvres, 1)]
        typer.echo(json_text({"schema": 1, "job": job.name, "manoeuvres": listed}))
        return 0
    from platform_ctrl.cli.terminal import screen, show_pairs, show_words

    console = screen()
    if not job.manoeuvres:
        show_words(console, f"{path}: has no manoeuvres; a [[manoeuvre]] adds one")
        return 0
    console.print(f"manoeuvres of {job.name}", style="bold", markup=False)
    numbered = [(f"{k}: {one.name}", f"{one.mode}, {one.duration:g} s") for k, one in enumerate(job.manoeuvres, 1)]
    show_pairs(console, numbered, indent="  ")
    words = "simulate one: --manoeuvre NUMBER or NAME"
    if job.campaign is not None:
        words += f"; one of the {job.campaign.runs:,} runs of the campaign: --run NUMBER"
    show_words(console, words)
    return 0


def _manoeuvre_run(job: Job, manoeuvre: Manoeuvre, controllers: list[control.StateSpace], out: Path | None) -> Shown:
    from platform_ctrl.verification.simulated import simulate_manoeuvre

    result = simulate_manoeuvre(job, manoeuvre, controllers)
    name = f"manoeuvre-{1 + [one.name for one in job.manoeuvres].index(manoeuvre.name)}.svg"
    figure, line = (None, "") if out is None else _drawn(result, job, manoeuvre.name, out / name)

    def show(as_json: bool) -> int:
        _show(job, result, {} if as_json else None)
        _show_figure(None if as_json else figure, line)
        return 0 if all(one.passed for one in result.results) else 1

    return show


def _campaign_run(number: int, plan: Plan, folder: Path, recorded: bool) -> Shown:
    from platform_ctrl.campaign.single_run import recorded_row, rerun, unlike

    found = rerun(plan, number)
    row = recorded_row(folder, number) if recorded else None
    unlikely = [] if row is None else unlike(found, row)
    title = f"run {number}: {found.run.manoeuvre.name}"
    figure, line = _drawn(found.run, found.job, title, folder / f"run-{number}.svg")

    def show(as_json: bool) -> int:
        if as_json:
            more = {"run": number, "inputs": found.inputs, "row": found.metrics}
            more["figure"] = None if figure is None else str(figure)
            _show(found.job, found.run, more | {"as_in_table": None if row is None else not unlikely})
        else:
            from platform_ctrl.cli.terminal import show_inputs

            show_inputs(f"run {number} of the campaign", found.inputs)
            _show(found.job, found.run)
            if row is not None and not unlikely:
                typer.echo(f"the values are those of {folder / TABLE}")
        _show_figure(None if as_json else figure, line)
        for one in unlikely:
            noted(f"{folder / TABLE}: run {number} is not the same: {one}")
        return 0 if found.metrics["passed"] else 1

    return show


def _show(job: Job, run: Run, more: dict[str, Any] | None = None) -> None:
    """Print a run; with `more` as JSON beside it."""
    from platform_ctrl.common.files import json_text
    from platform_ctrl.verification.result_file import run_record
    from platform_ctrl.verification.simulated import largest

    if more is not None:
        about = {"schema": 1, "job": job.name, "platform": job.platform.name, **more}
        typer.echo(json_text(about | run_record(job, run)))
        return
    from platform_ctrl.cli.terminal import show_run

    show_run(run, largest(job, run.manoeuvre, run.trajectory))


def _planned(job: Job, number: int, controllers: list[control.StateSpace], out: Path | None) -> tuple[Plan, Path, bool]:
    """Return the plan of the campaign in a folder if there is one, else the job's; the folder; and whether."""
    from platform_ctrl.campaign.single_run import recorded_plan
    from platform_ctrl.campaign.store import RECORD, read_campaign_record

    folder = out or CAMPAIGN
    record = read_campaign_record(folder)
    made, changed = recorded_plan(job, controllers, record)
    if changed:
        raise InputError(
            f"{folder / RECORD}: the campaign there was simulated with {'; '.join(changed)}; its runs cannot be "
            "simulated again with what there is now"
        )
    if not 0 <= number < made.runs:
        raise InputError(f"--run {number}: the campaign has the runs 0 to {made.runs - 1}")
    return made, folder, record is not None


def _drawn(run: Run, job: Job, title: str, path: Path) -> tuple[Path | None, str]:
    """Return the file of a figure, or None and why it is missing."""

    def draw(path: Path) -> None:
        from platform_ctrl.report.figures.runs import write_run_figure

        write_run_figure(run, job.platform, title, path)

    line = not_drawn(path, draw)
    return (None, line) if line else (path, "")


def _show_figure(figure: Path | None, line: str) -> None:
    if figure is not None:
        typer.echo(f"figure: {figure}")
    if line:
        noted(line)


def _manoeuvre(job: Job, selected: str, path: Path) -> Manoeuvre:
    from platform_ctrl.plant.mistakes import given

    names = [manoeuvre.name for manoeuvre in job.manoeuvres]
    if selected in names:
        return job.manoeuvres[names.index(selected)]
    if selected.isdecimal() and 1 <= int(selected) <= len(names):
        return job.manoeuvres[int(selected) - 1]
    known = ", ".join(f"{number} {given(name)}" for number, name in enumerate(names, 1))
    raise InputError(
        f"--manoeuvre {given(selected)}: {path} has no such manoeuvre; its manoeuvres are: {known or 'none'}"
    )
