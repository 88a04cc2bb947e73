"""The command campaign, and simulate --run: a campaign's run again, as it stands in the table."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

import platform_ctrl as pc
from campaign_runs import TEXT, processes_here
from platform_ctrl.cli import main
from refused_command import refused

pytest.importorskip("pyarrow", reason="a campaign's table is Parquet")

RUNS = 40
CONTROLLERS = {
    "schema": 1,
    "controllers": [
        {"name": f"gain {angle}", "dt": 5e-4, "delay": 5e-4, "inputs": [angle], "outputs": [torque]}
        | {"A": [[]], "B": [[]], "C": [[]], "D": [[gain]]}
        for angle, torque, gain in (("alpha9", "Q9", -0.5), ("beta10", "Q10", -0.5), ("alpha4", "Q4", -0.4))
    ],
}


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with job.toml, out/result.json, and campaign/ as the command leaves it."""
    folder = tmp_path_factory.mktemp("simulated")
    (folder / "job.toml").write_text(TEXT, encoding="utf-8")
    (folder / "out").mkdir()
    (folder / "out" / "result.json").write_text(json.dumps(CONTROLLERS), encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr("platform_ctrl.campaign.engine.processes_here", processes_here)
        assert main(["campaign", "job.toml", "--runs", str(RUNS), "--workers", "1", "-q"]) in (0, 1)
    return folder


@pytest.fixture
def there(flown: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(flown)
    monkeypatch.setattr("platform_ctrl.campaign.engine.processes_here", processes_here)
    return flown


def rows(folder: Path) -> list[dict[str, Any]]:
    import pyarrow.parquet

    listed: list[dict[str, Any]] = pyarrow.parquet.read_table(folder / "campaign.parquet").to_pylist()
    return listed


def test_the_same_command_again_flies_nothing_and_ends_alike(there: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = (there / "campaign" / "campaign.parquet").stat()
    code = main(["campaign", "job.toml", "--runs", str(RUNS), "--json"])
    out, err = capsys.readouterr()
    assert err == "controllers: out/result.json\n"
    record = json.loads(out)
    assert record == json.loads((there / "campaign" / "campaign.json").read_text())
    assert code == (0 if record["counts"]["passed"] == RUNS else 1)
    after = (there / "campaign" / "campaign.parquet").stat()
    assert (after.st_mtime_ns, after.st_ino) == (before.st_mtime_ns, before.st_ino)


def test_every_limit_met_ends_with_zero_and_one_that_is_not_with_one(there: Path) -> None:
    loose = TEXT.replace("angle = 0.003", "angle = 3.0").replace("angle = 0.0005", "angle = 3.0")
    (there / "loose.toml").write_text(loose.replace("torque_share = 1.0", "torque_share = 1e6"))
    (there / "tight.toml").write_text(TEXT.replace("angle = 0.0005", "angle = 1e-12"))
    common = ["--runs", "8", "--workers", "1", "-q"]
    assert main(["campaign", "loose.toml", "-o", "loose", *common]) == 0
    assert main(["campaign", "tight.toml", "-o", "tight", *common]) == 1


def test_a_run_again_shows_its_draws_and_the_figures_of_its_row(
    there: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    row = rows(there / "campaign")[17]
    code = main(["simulate", "job.toml", "--run", "17", "-q"])
    out, err = capsys.readouterr()
    assert err == "controllers: out/result.json\n"
    assert code == (0 if row["passed"] else 1)
    lines = {line.split("  ")[0]: line.split("  ")[-1].split()[0] for line in out.splitlines() if "  " in line}
    assert out.startswith("run 17 of the campaign\n")
    assert lines["manoeuvre"] == row["manoeuvre"]
    assert float(lines["rotor.11.spin"]) == pytest.approx(row["rotor.11.spin"], rel=1e-5)
    shown = re.search(r"^largest gimbal angle +([\d.]+) mrad \(", out, re.MULTILINE)
    assert shown is not None
    assert float(shown[1]) == pytest.approx(1e3 * row["angle"], rel=1e-3)
    assert f"the values are those of {Path('campaign') / 'campaign.parquet'}" in out
    assert (there / "campaign" / "run-17.svg").read_text().lstrip().startswith("<?xml")

    assert main(["simulate", "job.toml", "--run", "17", "--json"]) == code
    again = json.loads(capsys.readouterr().out)
    assert again["as_in_table"] is True
    assert again["inputs"] == {name: row[name] for name in ("manoeuvre", "rotor.11.spin", "sampling.delay")}
    assert again["row"] == {name: item for name, item in row.items() if name not in (*again["inputs"], "run")}
    assert again["largest"]["angle"]["value"] == pytest.approx(row["angle"], rel=1e-12)


def test_a_campaign_with_other_seed_and_length_is_known_by_its_folder(
    there: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = ["--runs", "120", "--seed", "3", "--sampling", "latin-hypercube", "--workers", "1", "-q"]
    main(["campaign", "job.toml", *given, "-o", "other"])
    row = rows(there / "other")[110]
    capsys.readouterr()
    main(["simulate", "job.toml", "--run", "110", "-o", "other", "--json"])
    again = json.loads(capsys.readouterr().out)
    assert again["as_in_table"] is True
    assert again["row"]["angle"] == row["angle"]
    assert (there / "other" / "run-110.svg").is_file()


def test_a_campaign_of_another_job_is_not_taken_for_this_one(there: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (there / "changed.toml").write_text(TEXT.replace("deviation = 0.01", "deviation = 0.02"))
    words = "campaign.json: the campaign there was simulated with another job"
    assert words in refused(capsys, "simulate", "changed.toml", "--run", "5", "-o", "campaign")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            ["campaign", "job.toml", "--runs", "1073741824", "--sampling", "latin-hypercube", "-o", "new"],
            "runs must be at most 89478485 with 3 numbers a run",
        ),
        (["simulate", "job.toml", "--run", "4711"], "--run 4711: the campaign has the runs 0 to 39"),
        (["simulate", "job.toml", "--run", "1", "--manoeuvre", "1"], "--run and --manoeuvre exclude each other"),
    ],
)
def test_wrong_input_is_one_line_and_ends_with_two(
    arguments: list[str], words: str, there: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert words in refused(capsys, *arguments)


@pytest.mark.skipif(os.name != "posix", reason="SIGINT as a terminal sends it")
def test_ctrl_c_stops_soon_says_how_to_go_on_and_loses_nothing(there: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (there / "long.toml").write_text(TEXT.replace("duration = 0.02", "duration = 0.1"))
    arguments = ["campaign", "long.toml", "--runs", "100000", "-o", "long", "--workers", "1"]
    process = subprocess.Popen(
        [sys.executable, "-m", "platform_ctrl", *arguments],
        cwd=there,
        env=os.environ | {"PYTHONPATH": str(Path(pc.__file__).parents[1])},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    deadline = time.monotonic() + 120.0
    while len(list((there / "long").glob("campaign.parquet/0*-*.parquet"))) < 2 and time.monotonic() < deadline:
        time.sleep(0.02)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to all processes
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert out == ""
    *_, last, end = err.splitlines()
    assert end == "platform-ctrl: interrupted"
    assert last == "stopped: what was simulated is kept in long; the same command continues"
    assert "Traceback" not in err
    kept = [path.name for path in (there / "long" / "campaign.parquet").iterdir()]
    assert sum(int(name[13:25]) - int(name[:12]) for name in kept) > 0


def test_a_scheduler_that_is_not_there_leaves_no_folder_behind(
    there: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr("platform_ctrl.campaign.engine._TIMEOUT", 0.5)
    given = ["campaign", "job.toml", "-o", "nowhere", "--scheduler", "tcp://127.0.0.1:9", "-q"]
    assert "--scheduler tcp://127.0.0.1:9: " in refused(capsys, *given)
    assert not (there / "nowhere").exists()
