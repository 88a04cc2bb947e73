"""Help: every command and option is described, examples are real."""

from __future__ import annotations

import re
import shlex
from typing import Any

import pytest
import typer

from platform_ctrl.cli import main
from platform_ctrl.cli.commands import app

GROUP: Any = typer.main.get_command(app)
COMMANDS: dict[str, Any] = GROUP.commands


def help_of(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert main([*arguments, "--help"]) == 0
    return capsys.readouterr().out


def names(command: Any) -> list[list[str]]:
    """Every argument by its metavar, every option by its spellings."""
    return [p.opts if p.param_type_name == "option" else [p.metavar] for p in command.params]


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
