"""Help: every command and option is described, examples are real."""

from __future__ import annotations

import re
import shlex

import pytest

from platform_ctrl.cli import main

ARGUMENTS = {"JOB", "NAME", "PLANT"}


def help_of(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert main([*arguments, "--help"]) == 0
    return capsys.readouterr().out


def entries(text: str, head: str) -> dict[str, str]:
    """What is listed under a head, by what stands before two blanks, in a line each."""
    block = text.partition(f"\n{head}:\n")[2].partition("\n\n")[0]
    items = [" ".join(one.split("\n")) for one in re.split(r"\n  (?=\S)", f"\n{block}")[1:]]
    return {
        name: " ".join(words.split()) for name, _, words in (re.sub(r"\s{2,}", "  ", x).partition("  ") for x in items)
    }


def commands(capsys: pytest.CaptureFixture[str]) -> list[str]:
    return list(entries(help_of(capsys), "Commands"))


def test_every_argument_and_option_is_described(capsys: pytest.CaptureFixture[str]) -> None:
    listed = commands(capsys)
    assert len(listed) == 12
    for name in listed:
        text = help_of(capsys, name)
        described = entries(text, "Arguments") | entries(text, "Options")
        assert any(one.endswith("--help") for one in described), name
        for spelling, words in described.items():
            assert re.search(r"[.)]( \[[^\]]*\])*$", words), (name, spelling, words)


def test_every_example_is_a_command_line_that_is_understood(capsys: pytest.CaptureFixture[str]) -> None:
    listed = commands(capsys)
    texts = [help_of(capsys), *(help_of(capsys, name) for name in listed)]
    lines = [line.strip() for text in texts for line in text.splitlines() if line.startswith("  platform-ctrl ")]
    assert len(lines) > 30
    for line in lines:
        _, command, *words = shlex.split(re.split(r"  +| [|>] | && ", line)[0])
        text = help_of(capsys, command)
        given = [word.partition("=")[0] for word in words if word.startswith("-")]
        assert set(given) <= set(re.findall(r"(?<!\S)--?[a-z][a-z-]*", text.partition("\nOptions:")[2])), line
        positional = ARGUMENTS & {one.split()[0] for one in entries(text, "Arguments")}
        assert bool(positional) == bool(words) or not positional, line
