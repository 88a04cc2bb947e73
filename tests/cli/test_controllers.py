"""Which controllers a command takes: it says so in a line, and takes none of another plant or job unasked."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest
import tomlkit

from camera_job import camera_job, camera_loop, camera_plant
from campaign_runs import processes_here
from cli.test_cli import undrawn  # noqa: F401
from platform_ctrl.cli import main
from refused_command import refused

pytestmark = pytest.mark.usefixtures("undrawn")

RUN = {"name": "turn", "mode": "caged", "axis": 3, "rate": 0.1, "rise": 0.02, "hold": 0.02, "duration": 0.1}
SOURCE = {"name": "base", "kind": "base-rate", "axis": 3, "frequencies_hz": [1.0, 100.0], "densities": [1e-8, 1e-8]}
BUDGET = {"from_hz": 1.0, "to_hz": 100.0, "source": [SOURCE]}
COMMANDS = {
    "check": ["check", "job.toml"],
    "simulate": ["simulate", "job.toml", "--manoeuvre", "turn"],
    "campaign": ["campaign", "job.toml", "--runs", "2", "--workers", "1", "--restart"],
    "export": ["export", "job.toml", "--models", "models.json", "--c", "c"],
    "budget": ["budget", "job.toml"],
}
EVERY = pytest.mark.parametrize("command", COMMANDS)


def write(folder: Path, plant: dict[str, Any] | None = None, **changes: Any) -> None:
    """Write job.toml and plant.toml."""
    data = camera_job(**{"manoeuvre": [RUN], "campaign": {"runs": 2}, "budget": BUDGET} | changes)
    data["plant"] = "plant.toml"
    (folder / "job.toml").write_text(tomlkit.dumps(data), encoding="utf-8")
    (folder / "plant.toml").write_text(tomlkit.dumps(plant or camera_plant()), encoding="utf-8")


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What design writes for the job."""
    folder = tmp_path_factory.mktemp("designed")
    write(folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("platform_ctrl.report.job_page.prepared", lambda result, **about: None)
        patch.setattr("platform_ctrl.report.write_page", lambda content, path: path.touch())
        assert main(["design", str(folder / "job.toml"), "-o", str(folder / "out"), "-q"]) == 0
    record: dict[str, Any] = json.loads((folder / "out" / "result.json").read_text(encoding="utf-8"))
    return record


@pytest.fixture
def there(result: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the job, and out/ as design leaves it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("platform_ctrl.campaign.engine.processes_here", processes_here)
    write(tmp_path)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "result.json").write_text(json.dumps(result), encoding="utf-8")
    return tmp_path


def save_beside(folder: Path, record: dict[str, Any], age: float) -> Path:
    """Write a file where the designer leaves one, so many seconds older than the result of design."""
    beside = folder / "job.controllers.json"
    beside.write_text(json.dumps(record), encoding="utf-8")
    now = (folder / "out" / "result.json").stat().st_mtime
    os.utime(beside, (now - age, now - age))
    return beside


@EVERY
def test_every_command_says_which_controllers_it_took(
    command: str, there: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    if command == "campaign":
        pytest.importorskip("pyarrow")
    assert main([*COMMANDS[command], "--json"]) == 0
    assert "controllers: out/result.json" in capsys.readouterr().err.splitlines()
    # Scripts know what they have named.
    assert main([*COMMANDS[command], "--controllers", "out/result.json", "--json"]) == 0
    assert "controllers:" not in capsys.readouterr().err


@pytest.mark.parametrize(
    ("what", "command"),
    [
        *(("plant", command) for command in COMMANDS),
        *((what, "check") for what in ("option", "limit", "use", "sampling")),
    ],
)
def test_controllers_of_another_plant_or_job_are_taken_only_by_name(
    what: str, command: str, there: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    more = {"name": "slow", "method": "pi", "crossover_hz": 10, "integral_hz": 1}
    if what == "plant":
        write(there, camera_plant(friction=[{"gimbal": "az", "coulomb": 0.02}]))
    elif what == "option":
        write(there, loop=camera_loop(design=[{"name": "pi", "method": "pi", "crossover_hz": 31, "integral_hz": 3}]))
    elif what == "limit":
        write(there, loop=camera_loop(use="pi", design=camera_job()["loop"][0]["design"], limits={"disk_margin": 0.6}))
    elif what == "use":
        write(there, loop=camera_loop(use="slow", design=[*camera_job()["loop"][0]["design"], more]))
    else:
        write(there, sampling={"rate_hz": 2000, "delay": 0.0001})
    told = refused(capsys, *COMMANDS[command], "-q")
    assert "out/result.json: was made for another " + ("plant" if what == "plant" else "job") in told
    assert "run platform-ctrl design job.toml" in told
    assert "--controllers" in told
    if what == "limit":
        assert main([*COMMANDS[command], "--controllers", "out/result.json"]) in (0, 1)
        assert "controllers: out/result.json, which was made for another" in capsys.readouterr().err


def test_what_controllers_do_not_depend_on_may_change(there: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write(there, camera_plant(source="measured"), name="another title", manoeuvre=[RUN | {"rate": 0.05}])
    with (there / "job.toml").open("a", encoding="utf-8") as file:
        file.write("\n# a comment\n")
    assert main([*COMMANDS["simulate"], "-q"]) == 0
    assert capsys.readouterr().err == "controllers: out/result.json\n"


def test_controllers_that_are_older_than_a_fresh_result_are_taken_only_by_name(
    there: Path, result: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    bare = {key: result[key] for key in ("schema", "controllers")}
    save_beside(there, bare, age=5.0)
    told = refused(capsys, *COMMANDS["check"], "-q")
    assert "job.controllers.json: is older than out/result.json, which platform-ctrl design job.toml wrote" in told
    # Newer ones are those of the designer's page.
    save_beside(there, bare, age=-5.0)
    assert main([*COMMANDS["simulate"], "-q"]) == 0
    assert capsys.readouterr().err == "controllers: job.controllers.json\n"
    # A result of another job is not fresh.
    other = result | {"sha256": dict.fromkeys(result["sha256"], 64 * "0")}
    (there / "out" / "result.json").write_text(json.dumps(other), encoding="utf-8")
    save_beside(there, bare, age=5.0)
    assert main([*COMMANDS["simulate"], "-q"]) == 0
    assert "controllers: job.controllers.json" in capsys.readouterr().err
