"""After `platform-ctrl warm-up` no command compiles anything."""

from __future__ import annotations

import pytest

from platform_ctrl.cli import main
from platform_ctrl.cli.warm_up_command import _counts


def test_what_is_compiled_once_is_not_compiled_again(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["warm-up", "-q"]) == 0
    first = capsys.readouterr().out.splitlines()
    assert [line.partition(":")[0] for line in first[:-1]] == ["simulation", "design, check and serve"]
    assert first[-1].startswith("done in ")
    compiled, _ = _counts()
    assert main(["warm-up", "-q"]) == 0
    again = capsys.readouterr().out.splitlines()[:-1]
    assert all(": 0 compiled, " in line for line in again)
    assert _counts()[0] == compiled
