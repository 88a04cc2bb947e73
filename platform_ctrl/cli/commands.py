"""The commands. Each imports what it needs when it runs, so that ``--help`` and ``models`` answer at once.

In their help a line with a backspace, click's own mark, keeps the lines below it as they are.
"""

from __future__ import annotations

import json
import shlex
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from platform_ctrl.cli.equations_command import equations
from platform_ctrl.errors import InputError

if TYPE_CHECKING:
    from platform_ctrl.check import JobResult
    from platform_ctrl.job import Job, Manoeuvre

DESIGNED = Path("out")
CHECKED = Path("check")
RESULT, REPORT = "result.json", "report.html"

Shown = Callable[[], int]

app = typer.Typer(
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="Exit code: 0 done, every requirement met; 1 done, a requirement not met; 2 the input is wrong.",
)

JobFile = Annotated[Path, typer.Argument(metavar="JOB", help="Job file (TOML).", show_default=False)]
Json = Annotated[bool, typer.Option("--json", help="Print JSON alone on standard output, and no progress.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Show no progress.")]
Controllers = Annotated[
    Path | None,
    typer.Option(
        "--controllers",
        metavar="FILE",
        help=f"A {RESULT}, or a JSON file with its keys schema and controllers alone. Default: {DESIGNED / RESULT}.",
        show_default=False,
    ),
]


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
    platform-ctrl models                          which plants come with it
    platform-ctrl equations three_gyro_platform   its equations in symbols, by the paper's numbers
    platform-ctrl design job.toml -o out          design, check, report: out/report.html
    platform-ctrl check job.toml                  the same verdicts for out/result.json, after the job has changed
    platform-ctrl simulate job.toml --run 1       one manoeuvre of the job, with the same controllers
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
        read = _read_job(job)
        _prepared(out)
        from platform_ctrl.check import checked
        from platform_ctrl.design import loops

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
        read = _read_job(job)
        file = _controller_file(controllers, out)
        from platform_ctrl.check import checked
        from platform_ctrl.check.given import outcomes_from, read_controllers
        from platform_ctrl.check.recorded import unconfirmed

        closed = read_controllers(file, read)
        others = read_controllers(file, read, "alternatives")
        _prepared(folder)
        result = checked(read, outcomes_from(read, closed, others), say)
        notes = unconfirmed(file, result)
        command = ["check", str(job), "--controllers", str(file), "-o", str(folder)]
        show = _delivered(result, folder, as_json, say, command)
    for note in notes:
        typer.echo(f"{file}: not confirmed: {note}", err=True)
    return show()


@app.command()
def simulate(
    job: JobFile,
    run: Annotated[
        str, typer.Option("--run", metavar="NAME", help="Manoeuvre of the job: its name, or its number from 1.")
    ],
    controllers: Controllers = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> int:
    """Fly one manoeuvre on the non-linear plant.

    The controllers exist already. Gimbal stops, torque limits, sampling, delay and pick-off noise are those of plant
    and job; the job's seed makes the run the same every time. Exit code 1 if a limit of the manoeuvre is not met.

    \b
    platform-ctrl simulate job.toml --run 1
    platform-ctrl simulate job.toml --run "1 rad/s about axis 2" --controllers mine.json
    """  # noqa: D301
    from platform_ctrl.cli.terminal import progress, show_run

    with progress(quiet or as_json, f"reading {job}") as say:
        read = _read_job(job)
        manoeuvre = _manoeuvre(read, run, job)
        file = _controller_file(controllers, None)
        from platform_ctrl.check import fly, largest
        from platform_ctrl.check.given import read_controllers
        from platform_ctrl.check.records import laid_out, run_record

        given = read_controllers(file, read)
        say(f"simulated run: {manoeuvre.name}")
        flown = fly(read, manoeuvre, given)
    if as_json:
        typer.echo(laid_out({"schema": 1, "job": read.name, "platform": read.platform.name, **run_record(read, flown)}))
    else:
        show_run(flown, largest(read, flown.trajectory))
    return 0 if all(one.passed for one in flown.results) else 1


def _read_job(path: Path) -> Job:
    from platform_ctrl.reading import read_job

    return read_job(path)


def _controller_file(given: Path | None, folder: Path | None) -> Path:
    if given is not None:
        return given
    file = folder / RESULT if folder is not None and (folder / RESULT).exists() else DESIGNED / RESULT
    if not file.exists():
        raise InputError(
            f"{file}: there is no such file; expected the controllers that platform-ctrl design writes: run it first, "
            "or name a file with --controllers"
        )
    return file


def _manoeuvre(job: Job, wanted: str, path: Path) -> Manoeuvre:
    from platform_ctrl.reading.mistakes import given

    names = [manoeuvre.name for manoeuvre in job.manoeuvres]
    if wanted in names:
        return job.manoeuvres[names.index(wanted)]
    if wanted.isdecimal() and 1 <= int(wanted) <= len(names):
        return job.manoeuvres[int(wanted) - 1]
    known = ", ".join(f"{number} {given(name)}" for number, name in enumerate(names, 1))
    raise InputError(f"--run {given(wanted)}: no such manoeuvre in {path}; it has {known or 'none'}")


def _prepared(folder: Path) -> None:
    """Make the folder and try to write there: before the work, not after it.

    Raises
    ------
    InputError
        It is a file, or cannot be written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except (FileExistsError, NotADirectoryError):
        raise InputError(f"-o {folder}: is not a folder, or lies in a file; expected a folder") from None
    except OSError as error:
        raise InputError(f"-o {folder}: cannot be written to: {error.strerror or error}") from None
    for name in (RESULT, REPORT):
        if (folder / name).is_dir():
            raise InputError(f"-o {folder}: {name} is a folder there; expected a file or nothing")


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
