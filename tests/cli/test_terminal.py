"""On a terminal and elsewhere: colours, what moves while work is done, and Ctrl-C at any moment."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from platform_ctrl.cli import main
from platform_ctrl.cli.export_command import written_together
from platform_ctrl.common.files import replaced_file, write_whole
from platform_ctrl.errors import InputError

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


def test_files_appear_together_or_not_at_all(tmp_path: Path) -> None:
    (tmp_path / "one").write_text("old")

    def write(fail: type[BaseException] | None) -> None:
        with written_together(tmp_path) as [folder]:
            (folder / "one").write_text("new")
            (folder / "two").write_text("new")
            if fail is not None:
                raise fail

    for failure, told in ((KeyboardInterrupt, KeyboardInterrupt), (OSError, InputError)):
        with pytest.raises(told):
            write(failure)
        assert [path.name for path in tmp_path.iterdir()] == ["one"]
        assert (tmp_path / "one").read_text() == "old"
    write(None)
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"one": "new", "two": "new"}


def test_what_killed_runs_left_goes_and_what_a_process_writes_stays(tmp_path: Path) -> None:
    ended = subprocess.run([sys.executable, "-c", "import os; print(os.getpid())"], capture_output=True, check=True)
    left = [tmp_path / ".unfinished-a1b2c3d4", tmp_path / f".unfinished-{int(ended.stdout)}-x1"]
    for folder in left:
        folder.mkdir()
        (folder / "report.html").write_text("half")
    (tmp_path / ".unfinished-link").symlink_to(tmp_path.parent)
    (tmp_path / "else.tmp").write_text("not ours")
    with written_together(tmp_path) as [at_work], replaced_file(tmp_path / "result.json") as file:
        file.write_bytes(b"whole")
        (at_work / "two").write_text("new")
        write_whole(tmp_path / "result.json", "of another process")
        with written_together(tmp_path):
            assert at_work.is_dir()
    assert not any(path.exists() for path in left)
    assert sorted(path.name for path in tmp_path.iterdir() if not path.is_symlink()) == [
        *("else.tmp", "result.json", "two")
    ]
    assert tmp_path.parent.is_dir()
    assert (tmp_path / "result.json").read_text() == "whole"
