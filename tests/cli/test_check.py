"""``platform-ctrl check --baseline``: no value is worse than in an accepted result."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from cli.test_cli import leave_out_figures, undrawn  # noqa: F401
from one_gyro_job import JOB, SLOWER, TOO_MUCH
from platform_ctrl.cli import main
from refused_command import refused

pytestmark = pytest.mark.usefixtures("undrawn")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with job.toml, out/result.json, and slower/result.json: the controllers of a slower loop."""
    folder = tmp_path_factory.mktemp("made")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        leave_out_figures(patch)
        for name, text, out in (("slower.toml", SLOWER, "slower"), ("job.toml", JOB, "out")):
            (folder / name).write_text(text, encoding="utf-8")
            assert main(["design", name, "-o", out, "--quiet"]) == 0
    return folder


@pytest.fixture
def there(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


CHECK = ["check", "job.toml", "-q", "--baseline", "out/result.json"]
SLOW = [*CHECK, "--controllers", "slower/result.json"]


def test_an_unchanged_loop_is_no_worse_and_keeps_its_sections(there: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(CHECK) == 0
    assert "baseline out/result.json: none of " in capsys.readouterr().out
    [before, now] = (json.loads((there / name / "result.json").read_bytes()) for name in ("out", "check"))
    assert now["controllers"][0]["sections"] == before["controllers"][0]["sections"] != []


@pytest.mark.usefixtures("there")
def test_a_slower_loop_is_worse_by_a_table_that_says_why(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(SLOW) == 1
    out = capsys.readouterr().out
    assert "values 4 worse by more than their tolerance" in out
    row = "caging 9-10: bandwidth 27.68 Hz 24.03 Hz −13 % 0.2768 Hz at least 20 Hz"
    assert row in " ".join(out.split())
    assert "made with another controller of caging 9-10" in out


def test_the_tolerance_is_that_of_the_job(there: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (there / "job.toml").write_text("tolerance = 0.2\n" + JOB, encoding="utf-8")
    assert main(SLOW) == 0
    assert "made with another job" in capsys.readouterr().out


def test_json_has_every_change_and_the_result_file_none(there: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*SLOW, "--json"]) == 1
    out, err = capsys.readouterr()
    found = json.loads(out)["baseline"]
    assert (found["file"], found["passed"]) == ("out/result.json", False)
    worse = {one["name"]: one for one in found["changes"] if one["state"] == "worse"}
    assert worse["bandwidth"]["before"] > worse["bandwidth"]["now"] > worse["bandwidth"]["limit"] == 20
    assert "4 worse" in err
    assert "baseline" not in json.loads((there / "check" / "result.json").read_text(encoding="utf-8"))


def test_a_requirement_that_is_missed_is_not_made_up_for(there: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (there / "job.toml").write_text(TOO_MUCH, encoding="utf-8")
    assert main([*CHECK, "--controllers", "out/result.json"]) == 1
    assert "none of" in capsys.readouterr().out


def _emptied(data: dict[str, Any]) -> None:
    data["requirements"].clear()


def _altered(data: dict[str, Any]) -> None:
    data["requirements"][0]["value"] = 0.0


def _of_an_earlier_version(data: dict[str, Any]) -> None:
    del data["sha256"]["result"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (_emptied, "is no result of a job with its requirements; accept a file that design or check wrote"),
        (_altered, "was altered after it was written; accept a file that design or check wrote"),
        (
            _of_an_earlier_version,
            "is no result of a job with its requirements; accept a file that design or check wrote",
        ),
    ],
)
def test_an_emptied_or_altered_result_is_refused(
    there: Path, capsys: pytest.CaptureFixture[str], change: Any, words: str
) -> None:
    data = json.loads((there / "out" / "result.json").read_text(encoding="utf-8"))
    change(data)
    (there / "mine.json").write_text(json.dumps(data), encoding="utf-8")
    assert f"mine.json: {words}" in refused(capsys, "check", "job.toml", "--baseline", "mine.json")
    assert "none.json" in refused(capsys, "check", "job.toml", "--baseline", "none.json")
