"""``platform-ctrl equations``: what it prints, and how it ends."""

from __future__ import annotations

import json

import pytest
import sympy

from platform_ctrl import equations, read_platform
from platform_ctrl.cli import main

PLANT = "three_gyro_platform"


def test_json_is_alone_on_standard_output(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["equations", PLANT, "--json"]) == 0
    captured = capsys.readouterr()
    record = json.loads(captured.out)
    assert captured.err == ""
    assert record == equations(read_platform(PLANT), "json")
    assert sympy.sympify(record["matrices"]["A"][3][3]) == sympy.Symbol("J4")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["no_such_plant"], 'there is no shipped model "no_such_plant"'),
        ([PLANT, "--format", "pdf"], "--format: must be text, latex or json, got 'pdf'"),
        ([PLANT, "--format", "latex", "--json"], "--format latex and --json exclude each other"),
        ([PLANT, "--order", "4"], "--order: must be 0, 1, 2, 3 or exact, got '4'"),
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
