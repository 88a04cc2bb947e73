"""The commands. Each imports what it needs when it runs, so that ``--help`` and ``models`` answer at once.

In their help a line with a backspace, click's own mark, keeps the lines below it as they are.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from platform_ctrl.cli.campaign_command import campaign
from platform_ctrl.cli.check_command import check
from platform_ctrl.cli.equations_command import equations
from platform_ctrl.cli.export_command import export
from platform_ctrl.cli.held_baseline import writable
from platform_ctrl.cli.help_layout import Teaching, TeachingGroup
from platform_ctrl.cli.inputs import (
    DESIGNED,
    REPORT,
    RESULT,
    CampaignFolder,
    JobFile,
    Json,
    Junit,
    Pdf,
    Quiet,
    job_of,
    plant_file,
    prepared,
)
from platform_ctrl.cli.job_outcome import Extras, delivered
from platform_ctrl.cli.new_command import new
from platform_ctrl.cli.serve_command import serve
from platform_ctrl.cli.simulate_command import simulate

app = typer.Typer(
    cls=TeachingGroup,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 120},
    epilog="Exit code: 0 done, every requirement met; 1 done, a requirement not met, or no controller found; 2 the "
    "input is wrong; 130 interrupted. platform-ctrl COMMAND --help tells more, with examples.",
)
BEGIN, DESIGN, FLY, OUT = "To begin with", "Design and check", "Fly on the non-linear plant", "The way out"


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
    platform-ctrl new gyro                             a plant and a job to start from
    platform-ctrl design gyro.toml                     design, check, report: out/report.html
    platform-ctrl check gyro.toml                      the same verdicts after a change
    platform-ctrl simulate gyro.toml --manoeuvre turn  one run with these controllers
    platform-ctrl campaign gyro.toml --runs 1000       many runs with what may vary
    """  # noqa: D301


app.command(cls=Teaching, rich_help_panel=BEGIN)(new)


@app.command(cls=Teaching, rich_help_panel=BEGIN)
def models(as_json: Json = False) -> None:
    """List the plants that come with the package.

    \b
    platform-ctrl models                            to read
    platform-ctrl models --json | jq -r '.[].name'  the names alone
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


app.command(cls=Teaching, rich_help_panel=BEGIN)(equations)


@app.command(cls=Teaching, rich_help_panel=DESIGN)
def design(
    job: JobFile,
    out: Annotated[
        Path, typer.Option("--out", "-o", metavar="DIR", help=f"Folder for {RESULT} and {REPORT}; made if needed.")
    ] = DESIGNED,
    pdf: Pdf = False,
    campaign: CampaignFolder = None,
    junit: Junit = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> int:
    """Design every loop of a job and check the whole.

    Each loop is designed by every method that the job names; those that the job says are closed together on the coupled
    model and flown on the non-linear plant. Writes result.json and report.html, whole or not at all.

    \b
    platform-ctrl design job.toml                            report: out/report.html
    platform-ctrl design job.toml -o run7 --pdf              run7/report.html and run7/report.pdf
    platform-ctrl design job.toml --campaign campaign --pdf  with a section about the campaign that was flown
    platform-ctrl design job.toml --json | jq .requirements  the verdicts, to compute with

    Exit code 1 if a requirement is not met, or if a method finds no controller (one line on standard error says which).
    """  # noqa: D301
    from platform_ctrl.cli.terminal import progress

    with progress(quiet or as_json, f"reading {job}") as say:
        read = job_of(job)
        extras = Extras.given(read, pdf, campaign)
        prepared(out, extras.files)
        if junit is not None:
            writable("--junit", junit, [job, *plant_file(job, read), *(out / name for name in extras.files)])
        from platform_ctrl.check import checked
        from platform_ctrl.design import loops
        from platform_ctrl.simulation.warming import warm_up

        if read.manoeuvres:
            warm_up()
        result = checked(read, loops(read, say), say)
        show = delivered(result, out, as_json, say, ["design", str(job), "-o", str(out)], extras=extras)
        if junit is not None:
            from platform_ctrl.report.junit import write_junit

            write_junit(result, junit)
    return show()


app.command(cls=Teaching, rich_help_panel=DESIGN)(check)
app.command(cls=Teaching, rich_help_panel=DESIGN)(serve)
app.command(cls=Teaching, rich_help_panel=FLY)(simulate)
app.command(cls=Teaching, rich_help_panel=FLY)(campaign)
app.command(cls=Teaching, rich_help_panel=OUT)(export)
