"""`platform-ctrl warm-up` compiles what runs need."""

from __future__ import annotations

import json

import pytest

from platform_ctrl.cli import main
from platform_ctrl.simulation.batch import is_compiled


def test_what_runs_need_is_compiled(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["warm-up", "-q"]) == 0
    assert capsys.readouterr().out.startswith("compiled in ")
    assert is_compiled()
    assert main(["warm-up", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["seconds"] < 10.0
