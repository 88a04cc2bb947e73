"""The command line: what it writes, how it ends, and that nobody sees a traceback."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import one_gyro_job
import platform_ctrl as pc
from platform_ctrl import platform_source
from platform_ctrl.cli import main
from refused_command import refused
from three_loops_job import JOB
from verification.test_records import alike


@pytest.fixture(scope="module")
def designed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with job.toml, and out/ as `design` leaves it."""
    folder = tmp_path_factory.mktemp("designed")
    (folder / "job.toml").write_text(JOB, encoding="utf-8")
    assert main(["design", str(folder / "job.toml"), "-o", str(folder / "out"), "--quiet"]) == 0
    return folder


@pytest.fixture
def there(designed: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(designed)
    return designed


def leave_out_figures(patch: pytest.MonkeyPatch) -> None:
    patch.setattr("platform_ctrl.report.job_page.prepared", lambda result, **about: result)
    patch.setattr("platform_ctrl.report.write_page", lambda result, path: Path(path).touch())


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out the figures, seconds of work: that they are drawn is seen in `designed` and in the first check."""
    leave_out_figures(monkeypatch)


def process_environment() -> dict[str, str]:
    path = str(Path(pc.__file__).parents[1])
    return os.environ | {"PYTHONPATH": path, "PYTHONIOENCODING": "utf-8"}


def test_design_writes_the_result_the_report_and_its_designs_and_nothing_else(designed: Path) -> None:
    assert sorted(path.name for path in (designed / "out").iterdir()) == ["designs.json", "report.html", "result.json"]
    record = json.loads((designed / "out" / "result.json").read_text(encoding="utf-8"))
    assert record["passed"] is True
    assert [one["name"] for one in record["controllers"]] == ["caging 4-5-7", "caging 9-10", "stabilisation"]
    assert "three gyros, fixed numbers" in (designed / "out" / "report.html").read_text(encoding="utf-8")


@pytest.mark.usefixtures("undrawn")
def test_check_comes_to_the_verdicts_of_design(there: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "job.toml"]) == 0
    out, err = capsys.readouterr()
    assert "PASSED" in out
    assert "simulated run: turn" in err.splitlines()
    assert (there / "check" / "report.html").is_file()
    before, after = (json.loads((there / folder / "result.json").read_text()) for folder in ("out", "check"))
    # Differences of numbers near one keep some ten digits.
    assert alike(after["requirements"], before["requirements"])
    assert alike(after["coupled"], before["coupled"])


@pytest.mark.usefixtures("undrawn")
def test_a_requirement_that_is_not_met_ends_with_one(there: Path, capsys: pytest.CaptureFixture[str]) -> None:
    strict = JOB.replace("bandwidth_hz = 20", "bandwidth_hz = 200")
    (there / "strict.toml").write_text(strict, encoding="utf-8")
    given = ["check", "strict.toml", "--controllers", "out/result.json", "-o", "strict", "--json"]
    assert main(given) == 1
    out, err = capsys.readouterr()
    assert err == ""
    printed = json.loads(out)
    assert printed == json.loads((there / "strict" / "result.json").read_text())
    failed = [(one["subject"], one["name"]) for one in printed["requirements"] if not one["passed"]]
    assert failed == [("caging 9-10", "bandwidth")]


def test_simulate_flies_one_manoeuvre_by_name_or_number(there: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulate", "job.toml", "--manoeuvre", "2", "-q"]) == 0
    out, err = capsys.readouterr()
    assert err == "controllers: out/result.json\n"
    assert out.startswith("step")
    assert main(["simulate", "job.toml", "--manoeuvre", "turn", "--json"]) == 0
    run: dict[str, Any] = json.loads(capsys.readouterr().out)
    assert (run["name"], run["mode"], run["ended"]) == ("turn", "caged", "completed")
    # The same run as in the check: the seed makes it so.
    whole = json.loads((there / "out" / "result.json").read_text())
    assert run["largest"] == whole["runs"][0]["largest"]


def test_an_unstable_loop_has_its_report_and_ends_with_one_and_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "job.toml").write_text(JOB.replace("crossover_hz = 40", "crossover_hz = 400"), encoding="utf-8")
    assert main(["design", str(tmp_path / "job.toml"), "-o", str(tmp_path / "out"), "--json"]) == 1
    out, err = capsys.readouterr()
    assert err.startswith("platform-ctrl: error: caging 9-10, classical: the closed loop grows at")
    assert len(err.splitlines()) == 1
    record = json.loads(out)
    assert record["passed"] is False
    assert [one["design"] for one in record["failed"]] == ["classical"]
    assert "caging 9-10" in [one["name"] for one in record["controllers"]]
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    own = page[page.index('id="loop-2"') : page.index('id="loop-3"')]
    assert "Loop transfer" in own
    assert "Nichols plot" in own
    assert "closed loop not stable" in own
    assert "the closed loop grows at" in own


BAD = {
    "no controller": ("inertial_lead_hz = 40", "option 'inertial_lead_hz' has no meaning for this loop"),
    "unstable": ("crossover_hz = 400", "the closed loop grows at"),
    "an error of a library": ("", "LinAlgError: no luck"),
}


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize(
    ("how", "used"), [("no controller", True), ("unstable", False), ("an error of a library", False)]
)
def test_a_design_that_fails_does_not_end_the_others(
    how: str, used: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    option, words = BAD[how]

    def fails(*_: object) -> Any:
        raise np.linalg.LinAlgError("no luck")

    monkeypatch.setattr("platform_ctrl.design.methods.hinf.MixedSensitivity.design", fails)
    method = f'"classical", integral_hz = 2, {option}' if option else '"hinf"'
    bad = f'{{ name = "bad", method = {method} }}'
    text = one_gyro_job.JOB.replace("design = [{", f"design = [{bad}, {{")
    text = text.replace('use = "classical"', 'use = "bad"') if used else text
    (tmp_path / "job.toml").write_text(text, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    assert main(["design", "job.toml", "-q"]) == (1 if used else 0)
    out, err = capsys.readouterr()
    assert f"failed: caging 9-10, bad: {words}" in " ".join(out.split()).replace("classical: option", "option")
    assert err.startswith("platform-ctrl: error: caging 9-10, bad: ") if used else not err
    record = json.loads((tmp_path / "out" / "result.json").read_text(encoding="utf-8"))
    assert record["passed"] is not used
    [failed] = record["failed"]
    assert (failed["name"], failed["design"]) == ("caging 9-10", "bad")
    assert words in failed["reason"]
    there = [one["design"] for one in record["controllers"] + record["alternatives"]]
    assert "classical" in there
    assert ("bad" in there) is (how == "unstable")
    assert (tmp_path / "out" / "report.html").is_file()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["desing"], "No such command 'desing'"),
        (["design", "job.toml", "--colour"], "No such option: --colour"),
        (["design", "joob.toml"], 'joob.toml: there is no such file; did you mean "job.toml"?'),
        (
            ["design", "plant.toml"],
            "plant.toml: is a plant, not a job; platform-ctrl new NAME writes a job",
        ),
        (["equations", "job.toml"], "job.toml: this is a job file"),
        (["design", "wrong.toml"], 'unknown key "bandwith_hz"; did you mean "bandwidth_hz"?'),
        (["design", "job.toml", "-o", "job.toml"], "-o job.toml: is no folder"),
        (["check", "job.toml", "-o", "taken"], "-o taken: report.html is a folder there"),
        (["check", "job.toml", "--controllers", "none.json"], "none.json: there is no such file"),
        (["check", "job.toml", "--controllers", "job.toml"], "job.toml: is not JSON"),
        (["check", "job.toml", "--controllers", "faster.json"], 'controllers 1 "caging 4-5-7": dt: 0.0001 s is not'),
        (
            ["simulate", "job.toml", "--manoeuvre", "3"],
            '--manoeuvre "3": job.toml has no such manoeuvre; its manoeuvres are: 1 "turn", 2 "step"',
        ),
    ],
)
def test_wrong_input_is_one_line_and_ends_with_two(
    arguments: list[str], words: str, there: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (there / "wrong.toml").write_text(JOB.replace("bandwidth_hz = 20", "bandwith_hz = 20"), encoding="utf-8")
    (there / "plant.toml").write_text(platform_source("rate_gyro"), encoding="utf-8")
    (there / "taken" / "report.html").mkdir(parents=True, exist_ok=True)
    faster = (there / "out" / "result.json").read_text().replace('"dt": 0.0005', '"dt": 0.0001')
    (there / "faster.json").write_text(faster)
    assert words in refused(capsys, *arguments)


@pytest.mark.skipif(os.name != "posix", reason="SIGINT as a terminal sends it")
def test_ctrl_c_ends_with_one_line_and_leaves_nothing_half_written(tmp_path: Path) -> None:
    (tmp_path / "job.toml").write_text(JOB.replace("duration = 0.02", "duration = 200.0"), encoding="utf-8")
    process = subprocess.Popen(
        [sys.executable, "-m", "platform_ctrl", "design", "job.toml"],
        cwd=tmp_path,
        env=process_environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stderr is not None
    process.stderr.readline()  # the first step has begun
    time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert err.splitlines()[-1] == "platform-ctrl: interrupted"
    assert "Traceback" not in err
    assert out == ""
    # Designs that are done are kept for the next time.
    assert {path.name for path in (tmp_path / "out").iterdir()} <= {"designs.json"}


def test_a_reader_that_goes_away_is_no_error(tmp_path: Path) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "w") as gone:
        done = subprocess.run(
            [sys.executable, "-m", "platform_ctrl", "models"],
            env=process_environment(),
            stdout=gone,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert done.stderr == ""


def test_what_runs_need_is_compiled(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["warm-up", "-q"]) == 0
    assert capsys.readouterr().out.startswith("compiled in ")
    assert main(["warm-up", "--json"]) == 0
    assert set(json.loads(capsys.readouterr().out)) == {"schema", "seconds"}
