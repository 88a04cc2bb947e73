"""Help: every command and option is described, examples are real; the page says it all."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import pytest
import typer

from platform_ctrl.cli import main
from platform_ctrl.cli.commands import app

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "command-line.md"
GROUP: Any = typer.main.get_command(app)
COMMANDS: dict[str, Any] = GROUP.commands
# They do not depend on where they are looked up, and stand in tables of their own.
COMMON = {"--json", "--quiet", "-q"}


def help_of(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert main([*arguments, "--help"]) == 0
    return capsys.readouterr().out


def names(command: Any) -> list[list[str]]:
    """Every argument by its metavar, every option by its spellings."""
    return [p.opts if p.param_type_name == "option" else [p.metavar] for p in command.params]


def section(command: str) -> str:
    found = re.search(rf"^## `{command}`\n(.*?)^## ", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    assert found is not None, f"docs/reference/command-line.md has no section on {command}"
    return found[1]


@pytest.mark.parametrize("name", COMMANDS)
def test_every_argument_and_option_is_described(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    shown = help_of(capsys, name)
    for param in COMMANDS[name].params:
        assert param.help, param.name
        assert param.help.endswith(".") or param.help.endswith(")"), param.help
    for spellings in names(COMMANDS[name]):
        assert max(spellings, key=len) in shown


def examples() -> list[str]:
    texts = [GROUP.callback.__doc__, *(command.callback.__doc__ for command in COMMANDS.values())]
    lines = [line for text in texts for line in text.splitlines() if line.startswith("    platform-ctrl ")]
    return [re.split(r"  +", line.strip())[0] for line in lines]


@pytest.mark.parametrize("line", examples())
def test_every_example_is_a_command_line_that_is_understood(line: str) -> None:
    words = shlex.split(re.split(r" [|>] | && ", line)[0])
    assert words[0] == "platform-ctrl"
    if words[1].startswith("--"):
        assert words[1:] in (["--install-completion"], ["--version"])
        return
    with COMMANDS[words[1]].make_context(words[1], words[2:]) as context:
        given = {name: item for name, item in context.params.items() if item not in (None, False)}
    assert given or words[1] in ("models", "warm-up")


@pytest.mark.parametrize("name", COMMANDS)
def test_the_page_has_every_command_and_option(name: str) -> None:
    text = section(name)
    cells = {cell for row in re.findall(r"^\|([^|]*)\|", text, re.MULTILINE) for cell in re.findall(r"`([^`]+)`", row)}
    options = {spelling for spellings in names(COMMANDS[name]) for spelling in spellings} - COMMON
    assert options == cells
    assert f"platform-ctrl {name}" in text
    assert f"| [`{name}`](#{name}) |" in PAGE.read_text(encoding="utf-8")


def test_the_page_has_the_options_of_all_commands() -> None:
    text = PAGE.read_text(encoding="utf-8")
    for spellings in [*names(GROUP), ["--json"], ["--quiet", "-q"], ["--help", "-h"]]:
        assert all(f"`{spelling}`" in text for spelling in spellings), spellings
    for command in COMMANDS.values():
        assert "--json" in {spelling for spellings in names(command) for spelling in spellings}
