"""What design and check deliver beside the page: a section about a campaign; and when they refuse to."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from campaign_runs import processes_here
from one_gyro_job import JOB, TOO_MUCH
from platform_ctrl.cli import main
from refused_command import refused

pytest.importorskip("pyarrow", reason="a campaign's table is Parquet")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with gyro.toml, out/ as design leaves it, and campaign/ with these controllers."""
    folder = tmp_path_factory.mktemp("made")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr("platform_ctrl.campaign.engine.processes_here", processes_here)
        undrawn(patch, [])
        assert main(["new", "gyro"]) == 0
        assert main(["design", "gyro.toml", "-q"]) == 0
        assert main(["campaign", "gyro.toml", "--runs", "12", "--workers", "1", "-q"]) == 0
    return folder


@pytest.fixture
def there(made: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(made)
    return made


@pytest.fixture
def pages(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Any]]:
    """What pages would have been written about, in place of their figures, seconds of work."""
    about: list[dict[str, Any]] = []
    undrawn(monkeypatch, about)
    return about


def undrawn(patch: pytest.MonkeyPatch, about: list[dict[str, Any]]) -> None:
    """Write pages without content; the options that they were prepared with go to `about`."""
    drawn = "platform_ctrl.report.job_page.prepared"
    patch.setattr(drawn, lambda result, **options: about.append(options))
    patch.setattr("platform_ctrl.report.write_page", lambda content, path: path.touch())


def test_a_campaign_of_other_controllers_is_refused_before_the_work(
    there: Path, pages: list[dict[str, Any]], capsys: pytest.CaptureFixture[str]
) -> None:
    changed = (there / "gyro.toml").read_text(encoding="utf-8").replace("crossover_hz = 40", "crossover_hz = 41")
    (there / "other.toml").write_text(changed, encoding="utf-8")
    assert main(["design", "other.toml", "-o", "other", "-q"]) == 0
    capsys.readouterr()
    given = ["check", "gyro.toml", "--controllers", "other/result.json", "-o", "never", "--campaign", "campaign"]
    assert "--campaign campaign: was simulated with other controllers; repeat it" in refused(capsys, *given)
    assert not (there / "never").exists()
    assert main(["check", "gyro.toml", "-o", "again", "--campaign", "campaign", "-q"]) == 0
    assert pages[-1]["campaign"].statistics.runs == 12
    assert pages[-1]["again"].startswith("platform-ctrl simulate gyro.toml --controllers again")


def test_a_campaign_that_violates_a_limit_is_no_pass(
    there: Path, pages: list[dict[str, Any]], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("platform_ctrl.campaign.engine.processes_here", processes_here)
    # A limit of the run as it is on paper; some of the runs that vary exceed it.
    text = (there / "gyro.toml").read_text(encoding="utf-8")
    largest = json.loads((there / "out" / "result.json").read_text(encoding="utf-8"))["runs"][0]["largest"]
    share = 1.0001 * largest["torque_share"]["value"]
    tight = re.sub(r"torque_share = [\d.]+", f"torque_share = {share!r}", text)
    (there / "tight.toml").write_text(tight, encoding="utf-8")
    given = ["tight.toml", "--controllers", "out/result.json"]
    assert main(["check", *given, "-o", "plain", "-q"]) == 0
    assert main(["campaign", *given, "--runs", "12", "--workers", "1", "-o", "violated", "-q"]) == 1
    capsys.readouterr()
    assert main(["check", *given, "-o", "both", "--campaign", "violated", "-q"]) == 1
    told = " ".join(capsys.readouterr().out.split())
    assert re.search(r"FAILED: all \d+ requirements met.*; campaign: \d+ of 12 runs violate", told)
    record = json.loads((there / "both" / "result.json").read_text(encoding="utf-8"))
    assert not record["passed"]
    assert not record["campaign"]["passed"]
    assert 0 < record["campaign"]["violating"] < record["campaign"]["runs"] == 12


def test_a_folder_without_a_finished_campaign_of_the_job_is_refused_before_the_work(
    there: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = ["check", "gyro.toml", "-o", "never", "--campaign"]
    assert "--campaign out: there is no campaign.json; name the folder that" in refused(capsys, *given, "out")
    record = json.loads((there / "campaign" / "campaign.json").read_text(encoding="utf-8"))
    for name, changed, words in (
        ("stranger", {"job": "another"}, "belongs to the job 'another', not to 'gyro'"),
        ("begun", {"complete": False}, "is not complete; the same platform-ctrl campaign continues it"),
    ):
        (there / name).mkdir()
        (there / name / "campaign.json").write_text(json.dumps(record | changed), encoding="utf-8")
        assert f"--campaign {name}: {words}" in refused(capsys, *given, name)
    assert not (there / "never").exists()


@pytest.mark.parametrize(
    ("lost", "words", "job", "code"),
    [
        ("platform_ctrl.report.job_page.nichols_figure", "Nichols plot: not drawn", JOB, 0),
        ("platform_ctrl.report.job_page.prepared", "not written", TOO_MUCH, 1),
    ],
)
def test_a_failure_while_drawing_costs_neither_result_nor_verdict(
    lost: str,
    words: str,
    job: str,
    code: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def fails(*_: object, **__: object) -> None:
        # What is drawn last is on disk by now.
        assert (tmp_path / "out" / "result.json").is_file()
        raise np.linalg.LinAlgError("no\nluck")

    monkeypatch.setattr(lost, fails)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "job.toml").write_text(job, encoding="utf-8")
    (tmp_path / "out" / ".unfinished-a1b2").mkdir(parents=True)
    assert main(["design", "job.toml", "-q"]) == code
    out, err = capsys.readouterr()
    assert ("PASSED" if code == 0 else "FAILED") in out
    assert json.loads((tmp_path / "out" / "result.json").read_text(encoding="utf-8"))["passed"] is (code == 0)
    [line] = err.splitlines()
    assert line.startswith("out/report.html: ")
    assert f"{words}: LinAlgError: no luck" in line
    assert (tmp_path / "out" / "report.html").is_file() is (words != "not written")
    assert not list((tmp_path / "out").glob(".unfinished*"))
