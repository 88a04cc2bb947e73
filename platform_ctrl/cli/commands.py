"""The commands. Each imports what it needs when it runs, so that ``--help`` and ``models`` answer at once.

In their help a line with a backspace, click's own mark, keeps the lines below it as they are.
"""

from __future__ import annotations

from typing import Annotated

import typer

from platform_ctrl.cli.budget_command import budget
from platform_ctrl.cli.campaign_command import campaign
from platform_ctrl.cli.design_commands import check, design
from platform_ctrl.cli.export_command import export
from platform_ctrl.cli.serve_command import serve
from platform_ctrl.cli.simulate_command import simulate
from platform_ctrl.cli.start_commands import equations, models, new, warm_up

app = typer.Typer(
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 120},
    epilog="Exit code: 0 done, every requirement met; 1 done, a requirement not met, or no controller found; 2 the "
    "input is wrong; 130 interrupted. COMMAND --help gives examples.",
)
START, DESIGN, SIMULATE, EXPORT = "Start", "Design and check", "Simulate on the non-linear plant", "Export"


def _print_version(requested: bool) -> None:
    if requested:
        from platform_ctrl import __version__

        typer.echo(f"platform-ctrl {__version__}")
        raise typer.Exit


@app.callback()
def platform_ctrl(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Design the control loops of gimballed platforms and check them on the coupled non-linear plant.

    \b
    platform-ctrl new gyro
        a plant and a job to start from
    platform-ctrl design gyro.toml
        design, check, report: out/report.html
    platform-ctrl check gyro.toml
        the verdicts again, without designing
    platform-ctrl simulate gyro.toml --manoeuvre turn
        one run with these controllers
    platform-ctrl campaign gyro.toml --runs 1000
        many runs with variations
    """  # noqa: D301


app.command(rich_help_panel=START)(new)
app.command(rich_help_panel=START)(models)
app.command(rich_help_panel=START)(equations)
app.command("warm-up", rich_help_panel=START)(warm_up)
app.command(rich_help_panel=DESIGN)(design)
app.command(rich_help_panel=DESIGN)(check)
app.command(rich_help_panel=DESIGN)(budget)
app.command(rich_help_panel=DESIGN)(serve)
app.command(rich_help_panel=SIMULATE, short_help="Simulate one manoeuvre, or one run of a campaign again.")(simulate)
app.command(rich_help_panel=SIMULATE, short_help="Simulate many runs, with variations.")(campaign)
app.command(rich_help_panel=EXPORT)(export)
