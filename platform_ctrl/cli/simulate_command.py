"""``platform-ctrl simulate``: one manoeuvre of a job, or one run of its campaign again, with everything it recorded."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from platform_ctrl.analysis.system import StateSpace
from platform_ctrl.cli import job_arguments as arguments
from platform_ctrl.cli.exits import not_drawn, noted, print_json
from platform_ctrl.errors import InputError

if TYPE_CHECKING:
    from platform_ctrl.common.progress import Progress
    from platform_ctrl.job.job import Job
    from platform_ctrl.job.manoeuvre import Manoeuvre
    from platform_ctrl.verification.simulated import Run


class _Simulated(NamedTuple):
    """A run, and what is said of it beside its values."""

    job: Job
    run: Run
    passed: bool
    title: str  # Of its figure
    figure: Path | None  # Where that goes; None: nowhere
    about: Mapping[str, Any] = MappingProxyType({})  # Of a run of the campaign: its number, inputs and row
    unlikely: list[str] | None = None  # In what it differs from the campaign's table; None where it is not there


RunNumber = Annotated[
    int | None,
    typer.Option("--run", metavar="NUMBER", help="Run of the job's campaign, as its table numbers them from 0."),
]
ManoeuvreName = Annotated[
    str | None, typer.Option("--manoeuvre", metavar="NAME", help="Manoeuvre: its name, or its number from 1.")
]
Out = Annotated[
    Path | None,
    arguments.folder_option(
        f"Of a run of the campaign: the campaign's folder, default: {arguments.CAMPAIGN}; seed and sampling are those "
        "of the campaign there. A figure of the run goes there; of a manoeuvre only if a folder is named."
    ),
]


def simulate(
    job: arguments.JobFile,
    run: RunNumber = None,
    manoeuvre: ManoeuvreName = None,
    controllers: arguments.Controllers = None,
    out: Out = None,
    as_json: arguments.Json = False,
    quiet: arguments.Quiet = False,
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
        read = arguments.job_of(job)
        chosen = None if manoeuvre is None else _manoeuvre(read, manoeuvre, job)
        file, used = arguments.controller_file(controllers, None, job, read, quiet or as_json)
        from platform_ctrl.verification.controllers import read_controllers

        closed = read_controllers(file, read)
        if chosen is not None:
            found = _manoeuvre_run(read, chosen, closed, out, say)
        else:
            assert run is not None
            found = _campaign_run(read, run, closed, out or arguments.CAMPAIGN, say)
        line = "" if found.figure is None else _drawn(found, found.figure)
    noted(used)
    _show(found, line, as_json)
    return 0 if found.passed else 1


def _list(path: Path, as_json: bool) -> int:
    """Print the manoeuvres of a job, and how to choose one."""
    job = arguments.job_of(path)
    if as_json:
        listed = [{"number": k, "name": one.name, "mode": one.mode} for k, one in enumerate(job.manoeuvres, 1)]
        print_json({"schema": 1, "job": job.name, "manoeuvres": listed})
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


def _manoeuvre_run(
    job: Job, manoeuvre: Manoeuvre, controllers: list[StateSpace], out: Path | None, say: Progress
) -> _Simulated:
    from platform_ctrl.verification.simulated import simulate_manoeuvre

    if out is not None:
        arguments.prepare_folder(out)
    say(f"simulated run: {manoeuvre.name}")
    result = simulate_manoeuvre(job, manoeuvre, controllers)
    number = 1 + [one.name for one in job.manoeuvres].index(manoeuvre.name)
    figure = None if out is None else out / f"manoeuvre-{number}.svg"
    return _Simulated(job, result, all(one.passed for one in result.results), manoeuvre.name, figure)


def _campaign_run(job: Job, number: int, controllers: list[StateSpace], folder: Path, say: Progress) -> _Simulated:
    """Simulate a run of the campaign in a folder if there is one, else of the job's."""
    from platform_ctrl.campaign.single_run import recorded_plan, recorded_row, rerun, unlike
    from platform_ctrl.campaign.store import RECORD, TABLE, read_campaign_record

    record = read_campaign_record(folder)
    plan, changed = recorded_plan(job, controllers, record)
    if changed:
        words = f"{folder / RECORD}: the campaign there was simulated with {'; '.join(changed)}"
        raise InputError(f"{words}; its runs cannot be simulated again with what there is now")
    if not 0 <= number < plan.runs:
        raise InputError(f"--run {number}: the campaign has the runs 0 to {plan.runs - 1}")
    arguments.prepare_folder(folder)
    say(f"run {number} of the campaign")
    found = rerun(plan, number)
    row = None if record is None else recorded_row(folder, number)
    unlikely = (
        None if row is None else [f"{folder / TABLE}: run {number} is not the same: {x}" for x in unlike(found, row)]
    )
    about = {"run": number, "inputs": found.inputs, "row": found.metrics}
    title = f"run {number}: {found.run.manoeuvre.name}"
    figure = folder / f"run-{number}.svg"
    return _Simulated(found.job, found.run, bool(found.metrics["passed"]), title, figure, about, unlikely)


def _show(found: _Simulated, line: str, as_json: bool) -> None:
    """Print a run; `line` says why its figure is missing."""
    from platform_ctrl.verification.result_file import run_record

    job, run, figure = found.job, found.run, None if line else found.figure
    same = None if found.unlikely is None else not found.unlikely
    if as_json:
        more = {"figure": None if figure is None else str(figure), "as_in_table": same} if found.about else {}
        about = {"schema": 1, "job": job.name, "platform": job.platform.name, **found.about, **more}
        print_json(about | run_record(run))
    else:
        from platform_ctrl.campaign.store import TABLE
        from platform_ctrl.cli.terminal import show_inputs, show_run

        if found.about:
            show_inputs(f"run {found.about['run']} of the campaign", found.about["inputs"])
        show_run(run)
        if same and found.figure is not None:
            typer.echo(f"the values are those of {found.figure.parent / TABLE}")
        if figure is not None:
            typer.echo(f"figure: {figure}")
    for words in (line, *(found.unlikely or ())):
        noted(words)


def _drawn(found: _Simulated, path: Path) -> str:
    """Draw a run; return why there is no figure, or nothing."""

    def draw(path: Path) -> None:
        from platform_ctrl.report.figures.runs import write_run_figure

        write_run_figure(found.run, found.job.platform, found.title, path)

    return not_drawn(path, draw)


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
