"""The commands. Each imports what it needs when it runs, so that ``--help`` and ``models`` answer at once.

In their help a line with a backspace, click's own mark, keeps the lines below it as they are.
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from platform_ctrl.cli.campaign_command import campaign
from platform_ctrl.cli.equations_command import equations
from platform_ctrl.cli.inputs import (
    DESIGNED,
    RESULT,
    Controllers,
    JobFile,
    Json,
    Quiet,
    controller_file,
    job_of,
    prepared,
)
from platform_ctrl.cli.simulate_command import simulate

if TYPE_CHECKING:
    from platform_ctrl.check import JobResult

CHECKED = Path("check")
REPORT = "report.html"

Shown = Callable[[], int]

app = typer.Typer(
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="Exit code: 0 done, every requirement met; 1 done, a requirement not met; 2 the input is wrong.",
)


def _print_version(wanted: bool) -> None:
    if wanted:
        from platform_ctrl import __version__

        typer.echo(f"platform-ctrl {__version__}")
        raise typer.Exit


@app.callback()
def platform_ctrl(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Design the control loops of gimballed platforms with fast rotors, and check them on the coupled non-linear plant.

    \b
    platform-ctrl models                              which plants come with it
    platform-ctrl equations three_gyro_platform       its equations in symbols, by the paper's numbers
    platform-ctrl design job.toml -o out              design, check, report: out/report.html
    platform-ctrl check job.toml                      the same verdicts for out/result.json, after the job has changed
    platform-ctrl simulate job.toml --manoeuvre turn  one manoeuvre of the job, with the same controllers
    platform-ctrl campaign job.toml --runs 10000      many runs with everything that may vary
    """  # noqa: D301


@app.command()
def models(as_json: Json = False) -> None:
    """List the plants that come with the package.

    \b
    platform-ctrl models
    platform-ctrl models --json
    """  # noqa: D301
    import tomllib

    from platform_ctrl.reading import platform_source, shipped_models
    from platform_ctrl.report.quantities import count

    listed = []
    for name in shipped_models():
        plant = tomllib.loads(platform_source(name))
        parts = {key: len(plant.get(key, [])) for key in ("gimbal", "rotor", "torquer", "pickoff")}
        listed.append({"name": name, "title": plant["name"], "source": plant.get("source", ""), **parts})
    if as_json:
        typer.echo(json.dumps(listed, indent=2))
        return
    width = max(len(model["name"]) for model in listed)
    for model in listed:
        bodies = f"{count(model['gimbal'], 'gimbal')}, {count(model['rotor'], 'rotor')}"
        typer.echo(f"{model['name']:<{width}}  {model['title']}: {bodies}")


app.command()(equations)


@app.command()
def design(
    job: JobFile,
    out: Annotated[
        Path, typer.Option("--out", "-o", metavar="DIR", help=f"Folder for {RESULT} and {REPORT}; made if needed.")
    ] = DESIGNED,
    as_json: Json = False,
    quiet: Quiet = False,
) -> int:
    """Design every loop of a job and check the whole.

    Each loop is designed by every method that the job names; those that the job says are closed together on the coupled
    model and flown on the non-linear plant. Writes result.json and report.html, whole or not at all.

    \b
    platform-ctrl design examples/three_gyro_platform.toml
    platform-ctrl design job.toml -o run7
    platform-ctrl design job.toml --json | jq '.requirements[] | select(.passed | not)'

    Exit code 1 if a requirement is not met, or if a method finds no controller (one line on standard error says which).
    """  # noqa: D301
    from platform_ctrl.cli.terminal import progress

    with progress(quiet or as_json, f"reading {job}") as say:
        read = job_of(job)
        prepared(out, (RESULT, REPORT))
        from platform_ctrl.check import checked
        from platform_ctrl.design import loops
        from platform_ctrl.simulation.warming import warm_up

        if read.manoeuvres:
            warm_up()
        result = checked(read, loops(read, say), say)
        show = _delivered(result, out, as_json, say, ["design", str(job), "-o", str(out)])
    return show()


@app.command()
def check(
    job: JobFile,
    controllers: Controllers = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            metavar="DIR",
            help=f"Folder for {RESULT} and {REPORT}, default: {CHECKED}. If it is named here and holds a {RESULT}, the "
            "controllers come from there by default.",
            show_default=False,
        ),
    ] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> int:
    """Check controllers that exist already.

    The same verdicts as those of design, without designing. Every figure is measured anew from the matrices; nothing
    that the file claims is believed, and what is not confirmed of it is told on stderr. Use it after the plant, the
    spread or a limit has changed, or for controllers that were made elsewhere.

    \b
    platform-ctrl check job.toml                              those of out/result.json
    platform-ctrl check job.toml --controllers mine.json -o mine
    platform-ctrl check job.toml --quiet && deploy
    """  # noqa: D301
    from platform_ctrl.cli.terminal import progress

    folder = out or CHECKED
    with progress(quiet or as_json, f"reading {job}") as say:
        read = job_of(job)
        file = controller_file(controllers, out)
        from platform_ctrl.check import checked
        from platform_ctrl.check.given import outcomes_from, read_controllers
        from platform_ctrl.check.recorded import unconfirmed

        closed = read_controllers(file, read)
        others = read_controllers(file, read, "alternatives")
        prepared(folder, (RESULT, REPORT))
        result = checked(read, outcomes_from(read, closed, others), say)
        notes = unconfirmed(file, result)
        command = ["check", str(job), "--controllers", str(file), "-o", str(folder)]
        show = _delivered(result, folder, as_json, say, command)
    for note in notes:
        typer.echo(f"{file}: not confirmed: {note}", err=True)
    return show()


app.command()(simulate)
app.command()(campaign)


def _delivered(result: JobResult, folder: Path, as_json: bool, say: Callable[[str], None], command: list[str]) -> Shown:
    """Write both files; return what shows the result and gives the exit code, for when the spinner has gone."""
    from platform_ctrl.check.records import laid_out, result_record, write_record
    from platform_ctrl.cli.terminal import show_result
    from platform_ctrl.report import write_page

    say(f"drawing the report: {folder / REPORT}")
    write_page(result, folder / REPORT, command=shlex.join(["platform-ctrl", *command]))
    record = result_record(result)
    write_record(record, folder / RESULT)

    def show() -> int:
        if as_json:
            typer.echo(laid_out(record))
        else:
            show_result(result)
            typer.echo(f"report: {folder / REPORT}, figures: {folder / RESULT}")
        return 0 if result.passed else 1

    return show
