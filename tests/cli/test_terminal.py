"""On a terminal and elsewhere: colours, what moves while work is done, and Ctrl-C at any moment."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest

from platform_ctrl.cli import main

pytestmark = pytest.mark.skipif(os.name != "posix", reason="terminals as POSIX has them")


@pytest.fixture(scope="module")
def there(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("terminal")
    assert main(["new", "gyro", "-o", str(folder)]) == 0
    with pytest.MonkeyPatch.context() as patch:  # the figures are seconds of work
        patch.setattr("platform_ctrl.report.job_page.prepared", lambda result, **about: result)
        patch.setattr("platform_ctrl.report.write_page", lambda result, path: path.touch())
        assert main(["design", str(folder / "gyro.toml"), "-o", str(folder / "out"), "-q"]) == 0
    return folder


SIMULATE = ("simulate", "gyro.toml", "--manoeuvre", "turn")
GREEN = "\x1b[32m"


def test_a_pipe_gets_lines_without_colours_unless_they_are_forced(
    there: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(there)
    monkeypatch.setenv("COLUMNS", "120")
    for name in ("NO_COLOR", "FORCE_COLOR"):
        monkeypatch.delenv(name, raising=False)

    def piped() -> str:
        assert main(SIMULATE) == 0
        out, err = capsys.readouterr()
        assert err == "simulated run: turn\ncontrollers: out/result.json\n"
        return out

    plain = piped()
    assert "\x1b" not in plain
    monkeypatch.setenv("FORCE_COLOR", "1")
    forced = piped()
    assert GREEN in forced
    assert _without_colours(forced) == plain
    monkeypatch.setenv("NO_COLOR", "1")
    assert GREEN not in piped()


def _without_colours(text: str) -> str:
    return re.sub(r"\x1b\[[\d;]*m", "", text)
