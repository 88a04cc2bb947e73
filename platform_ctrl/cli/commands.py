"""The commands. Each imports what it needs when it runs, so that ``--help`` and ``models`` answer at once.

In their help a line with a backspace, click's own mark, keeps the lines below it as they are.
"""

from __future__ import annotations

import re
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from platform_ctrl.cli.budget_command import budget
from platform_ctrl.cli.campaign_command import campaign
from platform_ctrl.cli.design_commands import check, design
from platform_ctrl.cli.export_command import export
from platform_ctrl.cli.serve_command import serve
from platform_ctrl.cli.simulate_command import simulate
from platform_ctrl.cli.start_commands import equations, models, new
from platform_ctrl.cli.warm_up_command import warm_up

# Groups are those of typer's `rich_help_panel`; options without one come last.
_OPTIONS, _ARGUMENTS, _EXAMPLES = "Options", "Arguments", "Examples"
_EXAMPLE = re.compile(r"(\S.*?)(?:\s{2,}(\S.*))?")
# A hyphen inside a word, at which click would break it, and what stands for it meanwhile.
_HYPHEN, _WHOLE = re.compile(r"(?<=\w)-(?=\w)"), "\N{NON-BREAKING HYPHEN}"
# Columns between an example and its meaning, and by which the meaning is indented where it does not fit beside it.
_GAP, _INDENT = 2, 4

Example = tuple[str, str]


class Teaching(TyperCommand):
    """A command with examples at the end of its help."""

    def __init__(self, name: str | None, *, help: str | None = None, **more: Any) -> None:
        prose, self.examples = split(help or "")
        super().__init__(name, help=prose, **more)

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """Return what follows the command's name, as people write it."""
        return [piece.strip("{}") for piece in super().collect_usage_pieces(ctx)]

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write arguments and options."""
        _write_options(self, ctx, formatter)

    def format_epilog(self, ctx: Any, formatter: Any) -> None:
        """Write the examples."""
        _write_examples(self.examples, formatter)
        super().format_epilog(ctx, formatter)


class TeachingGroup(TyperGroup):
    """All commands in groups, with examples at the end."""

    def __init__(self, *, help: str | None = None, **more: Any) -> None:
        prose, self.examples = split(help or "")
        super().__init__(help=prose, **more)

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the commands, then the options."""
        groups: dict[str, list[Example]] = {}
        for name in self.list_commands(ctx):
            command = self.get_command(ctx, name)
            if command is not None and not command.hidden:
                panel = str(getattr(command, "rich_help_panel", None) or "Commands")
                groups.setdefault(panel, []).append((name, _first_sentence(command.help or "")))
        widest = max(len(name) for rows in groups.values() for name, _ in rows)
        for title, rows in groups.items():
            with formatter.section(title):
                formatter.write_dl([(f"{name:<{widest}}", words) for name, words in rows])
        _write_options(self, ctx, formatter)

    def format_epilog(self, ctx: Any, formatter: Any) -> None:
        """Write the examples, and what the exit codes mean."""
        _write_examples(self.examples, formatter)
        super().format_epilog(ctx, formatter)


def split(help: str) -> tuple[str, list[Example]]:
    """Return the prose of a help text, and its examples with their meanings."""
    prose, examples = [], []
    for paragraph in help.split("\n\n"):
        mark, _, rest = paragraph.strip().partition("\n")
        if mark != "\b":
            prose.append(paragraph)
            continue
        for line in rest.splitlines():
            found = _EXAMPLE.fullmatch(line.strip())
            if found is not None:
                examples.append((found[1], found[2] or ""))
    return "\n\n".join(prose), examples


def _write_options(command: Any, ctx: Any, formatter: Any) -> None:
    groups: dict[str, list[Example]] = {_ARGUMENTS: []}
    for param in command.get_params(ctx):
        record = param.get_help_record(ctx)
        if record is not None:
            if param.param_type_name == "argument":
                groups[_ARGUMENTS].append((param.metavar, param.help))
            else:
                groups.setdefault(getattr(param, "rich_help_panel", None) or _OPTIONS, []).append(record)
    groups[_OPTIONS] = groups.pop(_OPTIONS, [])
    for title, rows in groups.items():
        if rows:
            with formatter.section(title):
                formatter.write_dl([(name, _HYPHEN.sub(_WHOLE, words or "")) for name, words in rows])
    formatter.buffer = [piece.replace(_WHOLE, "-") for piece in formatter.buffer]


def _write_examples(examples: list[Example], formatter: Any) -> None:
    """Write examples with their meanings beside them, or all of them below where one would not fit."""
    if not examples:
        return
    column = max(len(command) for command, words in examples) + _GAP
    with formatter.section(_EXAMPLES):
        room = formatter.width - formatter.current_indent
        beside = all(column + len(words) <= room for _, words in examples if words)
        for command, words in examples:
            if beside or not words:
                formatter.write(f"{'':>{formatter.current_indent}}{f'{command:<{column}}{words}'.rstrip()}\n")
            else:
                formatter.write(f"{'':>{formatter.current_indent}}{command}\n")
                formatter.write(f"{'':>{formatter.current_indent + _INDENT}}{words}\n")


def _first_sentence(text: str) -> str:
    """Return what a command does, in one line."""
    paragraph = " ".join(text.strip().partition("\n\n")[0].split())
    return paragraph.partition(". ")[0].rstrip(".")


app = typer.Typer(
    cls=TeachingGroup,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 120},
    epilog="Exit code: 0 done, every requirement met; 1 done, a requirement not met, or no controller found; 2 the "
    "input is wrong; 130 interrupted. See platform-ctrl COMMAND --help, with examples.",
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
    platform-ctrl new gyro                             a plant and a job to start from
    platform-ctrl design gyro.toml                     design, check, report: out/report.html
    platform-ctrl check gyro.toml                      the verdicts again, without designing
    platform-ctrl simulate gyro.toml --manoeuvre turn  one run with these controllers
    platform-ctrl campaign gyro.toml --runs 1000       many runs with variations
    """  # noqa: D301


app.command(cls=Teaching, rich_help_panel=START)(new)


app.command(cls=Teaching, rich_help_panel=START)(models)
app.command(cls=Teaching, rich_help_panel=START)(equations)
app.command("warm-up", cls=Teaching, rich_help_panel=START)(warm_up)


app.command(cls=Teaching, rich_help_panel=DESIGN)(design)
app.command(cls=Teaching, rich_help_panel=DESIGN)(check)
app.command(cls=Teaching, rich_help_panel=DESIGN)(budget)
app.command(cls=Teaching, rich_help_panel=DESIGN)(serve)
app.command(cls=Teaching, rich_help_panel=SIMULATE)(simulate)
app.command(cls=Teaching, rich_help_panel=SIMULATE)(campaign)
app.command(cls=Teaching, rich_help_panel=EXPORT)(export)
