"""``platform-ctrl check`` with a baseline and with JUnit output."""

from __future__ import annotations

import errno
import json
import os
from pathlib import Path

import pytest
from junitparser import JUnitXml

from cli.test_cli import undrawn  # noqa: F401
from one_gyro_job import JOB, SLOWER, TOO_MUCH
from platform_ctrl.cli import main
from refused_command import refused

pytestmark = pytest.mark.usefixtures("undrawn")


@pytest.fixture
def there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Path:
    """A folder with job.toml, its controllers, gyro.json, and slower.json: the controllers of a slower loop."""
    monkeypatch.chdir(tmp_path)
    for name, text, out in (("slower.toml", SLOWER, "slower"), ("job.toml", JOB, "out")):
        (tmp_path / name).write_text(text, encoding="utf-8")
        assert main(["design", name, "-o", out, "--quiet"]) == 0
    assert main(["check", "job.toml", "--baseline", "gyro.json", "--update-baseline", "--quiet"]) == 0
    assert "baseline: gyro.json: written, 12 figures" in capsys.readouterr().out
    return tmp_path


def test_what_is_as_it_was_accepted_passes(there: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "job.toml", "--baseline", "gyro.json", "-q"]) == 0
    assert "baseline gyro.json: none of 12 figures is worse by more than its tolerance" in capsys.readouterr().out
    assert main(["check", "job.toml", "--baseline", "gyro.json", "--update-baseline", "-q"]) == 0
    assert "baseline: gyro.json: unchanged" in capsys.readouterr().out


def test_what_is_worse_ends_with_one_and_says_what_moved_though_every_requirement_is_met(
    there: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["check", "job.toml", "--controllers", "slower/result.json", "--baseline", "gyro.json", "-q"]
    assert main(arguments) == 1
    out = capsys.readouterr().out
    assert "PASSED: all 5 requirements met" in out
    assert "baseline gyro.json: of 12 figures 3 worse by more than their tolerance" in out
    assert "caging 9-10: bandwidth    27.68 Hz  24.03 Hz  -13 %" in out
    assert "plot: gyro.moved.png" in out
    assert (there / "gyro.moved.png").read_bytes().startswith(b"\x89PNG")
    assert main([*arguments, "--update-baseline"]) == 0
    assert "baseline: gyro.json: written, 3 worse" in capsys.readouterr().out
    assert not (there / "gyro.moved.png").exists()
    assert main(arguments) == 0


def test_what_is_better_passes(there: Path, capsys: pytest.CaptureFixture[str]) -> None:
    slower = ["check", "job.toml", "--controllers", "slower/result.json", "--baseline", "new/slower.json", "-q"]
    assert main([*slower, "--update-baseline"]) == 0
    assert main(["check", "job.toml", "--baseline", "new/slower.json", "-q"]) == 0
    assert "better by more than its tolerance: caging 9-10: bandwidth, 24.03 Hz -> 27.68 Hz" in capsys.readouterr().out


def test_a_requirement_that_is_missed_is_not_made_up_for_by_its_baseline(
    there: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (there / "job.toml").write_text(TOO_MUCH, encoding="utf-8")
    given = ["--controllers", "out/result.json", "--baseline", "gyro.json", "--junit", "made/check.xml"]
    assert main(["check", "job.toml", *given, "-q"]) == 1
    assert "FAILED: 1 of 5 requirements not met" in capsys.readouterr().out
    suites = {suite.name: suite for suite in JUnitXml.fromfile(str(there / "made" / "check.xml"))}
    assert list(suites) == ["caging 9-10", "all loops closed", "gyro.json"]
    [failed] = [case for suite in suites.values() for case in suite if case.is_failure]
    assert failed.name == "bandwidth"
    assert failed.result[0].message == (
        "caging 9-10, classical: bandwidth 27.68 Hz, at least 35 Hz: not met, margin -21 %"
    )
    assert suites["gyro.json"].tests == 12


def test_json_has_the_comparison_and_is_alone_on_standard_output(
    there: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["check", "job.toml", "--controllers", "slower/result.json", "--baseline", "gyro.json", "--json"]
    assert main(arguments) == 1
    out, err = capsys.readouterr()
    found = json.loads(out)["baseline"]
    assert (found["file"], found["passed"], found["updated"], found["plot"]) == (
        "gyro.json",
        False,
        False,
        "gyro.moved.png",
    )
    states = {one["name"]: one["state"] for one in found["figures"] if one["subject"] == "caging 9-10"}
    assert (states["bandwidth"], states["minimum decay rate"]) == ("worse", "within")
    assert "3 worse" in err
    assert "baseline" not in json.loads((there / "check" / "result.json").read_text(encoding="utf-8"))


def test_nothing_is_accepted_where_the_result_cannot_be_written(
    there: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device", "result.json")

    monkeypatch.setattr("platform_ctrl.common.files.replaced_file", full)
    before = Path("gyro.json").read_bytes()
    arguments = ["check", "job.toml", "--controllers", "slower/result.json", "--baseline", "gyro.json", "-q"]
    assert "No space left" in refused(capsys, *arguments, "--update-baseline")
    assert Path("gyro.json").read_bytes() == before


def test_without_a_baseline_there_is_no_word_of_one(there: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "job.toml", "--junit", "check.xml", "-q"]) == 0
    assert "baseline" not in capsys.readouterr().out
    assert [suite.name for suite in JUnitXml.fromfile("check.xml")] == ["caging 9-10", "all loops closed"]


def test_wrong_input_is_one_line_before_any_work(there: Path, capsys: pytest.CaptureFixture[str]) -> None:
    check = ["check", "job.toml", "--quiet"]
    assert "none.json: there is no such file; --update-baseline writes it" in refused(
        capsys, *check, "--baseline", "none.json"
    )
    assert "--update-baseline: needs --baseline FILE" in refused(capsys, *check, "--update-baseline")
    assert "out/result.json: " in refused(capsys, *check, "--baseline", "out/result.json")
    assert "--baseline out: is a folder" in refused(capsys, *check, "--baseline", "out", "--update-baseline")
    assert "--junit job.toml/x.xml: job.toml is a file, but must be a folder" in refused(
        capsys, *check, "--junit", "job.toml/x.xml"
    )
    # What is no file would be gone, were a file to take its place.
    os.mkfifo("pipe")
    assert "--junit pipe: is a device or a pipe, but must be a file" in refused(capsys, *check, "--junit", "pipe")
    assert "--junit out: is a folder" in refused(capsys, *check, "--junit", "out")
    before = Path("job.toml").read_text()
    for taken in ("job.toml", "./out/result.json", "gyro.json", "check/report.html", "check/result.json"):
        held = ["--baseline", "gyro.json", "--junit", taken]
        assert "for something else; name another" in refused(capsys, *check, *held)
    assert Path("job.toml").read_text() == before


@pytest.mark.parametrize("command", ["check", "design"])
def test_junit_never_lands_on_the_plant_of_the_job(
    command: str, there: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plant = (Path(__file__).parents[2] / "models" / "three_gyro_platform.toml").read_bytes()
    Path("plant.toml").write_bytes(plant)
    Path("job.toml").write_text(JOB.replace('"three_gyro_platform"', '"plant.toml"'), encoding="utf-8")
    assert "for something else" in refused(capsys, command, "job.toml", "--quiet", "--junit", "plant.toml")
    assert Path("plant.toml").read_bytes() == plant


def test_a_baseline_is_a_file_of_controllers_too(there: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "job.toml", "--controllers", "gyro.json", "--baseline", "gyro.json", "-q"]) == 0
    out, err = capsys.readouterr()
    assert "none of 12 figures" in out
    assert err == ""
