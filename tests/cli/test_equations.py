"""``platform-ctrl equations``: what it prints, and how it ends."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
import sympy

from platform_ctrl.cli import main
from platform_ctrl.mechanics.symbolic.equations import equations
from platform_ctrl.plant.reading import read_platform
from platform_ctrl.plant.source import platform_source

PLANT = "three_gyro_platform"


def test_text_is_the_default(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["equations", PLANT]) == 0
    assert capsys.readouterr().out == equations(read_platform(PLANT))


def test_options_reach_the_equations(capsys: pytest.CaptureFixture[str]) -> None:
    for given, order in (("0", 0), ("2", 2), ("exact", None)):
        assert main(["equations", PLANT, "--order", given, "--terms", "exact", "--format", "latex"]) == 0
        assert capsys.readouterr().out == equations(read_platform(PLANT), "latex", order=order, terms="exact")


@pytest.mark.parametrize("option", [["--json"], ["--format", "json"], ["--json", "--format", "json"]])
def test_json_is_alone_on_standard_output(option: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["equations", PLANT, *option]) == 0
    captured = capsys.readouterr()
    record = json.loads(captured.out)
    assert captured.err == ""
    assert record == equations(read_platform(PLANT), "json")
    assert sympy.sympify(record["matrices"]["A"][3][3]) == sympy.Symbol("J4")


def test_a_plant_file_serves_as_well(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(platform_source(PLANT).replace('name = "three-gyro platform"', 'name = "mine"'), encoding="utf-8")
    assert main(["equations", str(file)]) == 0
    assert capsys.readouterr().out.startswith("mine: ")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["no_such_plant"], 'there is no shipped model "no_such_plant"'),
        (["nowhere/plant.toml"], "there is no such file"),
        ([PLANT, "--format", "pdf"], "--format: must be text, latex or json, got 'pdf'"),
        ([PLANT, "--format", "latex", "--json"], "--format latex and --json exclude each other"),
        ([PLANT, "--terms", "all"], "--terms: must be paper or exact, got 'all'"),
        ([PLANT, "--order", "4"], "--order: must be 0, 1, 2, 3 or exact, got '4'"),
        ([PLANT, "--order", "one"], "--order: must be 0, 1, 2, 3 or exact, got 'one'"),
        ([], "Missing argument"),
    ],
)
def test_wrong_input_is_one_line_and_exit_code_2(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["equations", *arguments]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert message in captured.err
    assert captured.err.count("\n") == 1


def test_help_of_the_program_names_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--help"]) == 0
    assert "  equations  " in capsys.readouterr().out
    assert main(["equations", "--help"]) == 0
    assert "--order" in capsys.readouterr().out


def test_a_terminal_without_greek_letters_is_no_reason_to_stop() -> None:
    command = [sys.executable, "-m", "platform_ctrl", "equations", PLANT]
    done = subprocess.run(command, capture_output=True, env={"PYTHONIOENCODING": "ascii", "PATH": ""}, check=False,
                          cwd=Path(__file__).resolve().parents[2])  # fmt: skip
    assert done.returncode == 0
    assert b"(27)" in done.stdout
