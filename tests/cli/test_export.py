"""``platform-ctrl export``: every form, all or none; folders of others, wrong input, Ctrl-C."""

from __future__ import annotations

import hashlib
import json
import tomllib
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from one_gyro_job import JOB
from platform_ctrl import design, export, read_job
from platform_ctrl.cli import main
from platform_ctrl.export import write_controllers
from refused_command import refused

EVERYTHING = ("--c", "c", "--mat", "k.mat", "--models", "m.json", "--csv", "r", "--mjcf", "p.xml")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("export")
    job = read_job(tomllib.loads(JOB))
    controllers = [outcome.closed.controller for outcome in design.loops(job)]
    write_controllers(controllers, folder / "k.json", delay=job.sampling.delay)
    return folder / "k.json"


@pytest.fixture
def there(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the job and, where design leaves them, its controllers."""
    (tmp_path / "job.toml").write_text(JOB)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "result.json").write_bytes(made.read_bytes())
    monkeypatch.chdir(tmp_path)
    return tmp_path


def files(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_every_form_is_written_and_told_with_its_hash(there: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = files(there)
    assert main(["export", "job.toml", *EVERYTHING, "--json"]) == 0
    out, err = capsys.readouterr()
    told = json.loads(out)
    assert err == "controllers: out/result.json\n"
    assert told["job"] == "gyro 9-10"
    of = Path("out/result.json")
    assert told["controllers"] == {"file": str(of), "sha256": hashlib.sha256(of.read_bytes()).hexdigest()}
    now = files(there)
    assert {one["path"]: one["sha256"] for one in told["written"]} == {
        name: hashlib.sha256(content).hexdigest() for name, content in now.items() if name not in before
    }
    assert {one["format"] for one in told["written"]} == {"c", "mat", "models", "csv", "mjcf"}
    assert told["notes"][0].startswith("p.xml: stops of 4, 5, 7, 9, 10")
    # Each is what it says.
    assert told["controllers"]["sha256"] in now["c/caging_9_10_classical.h"].decode()
    assert len(export.read_mat("k.mat")) == len(export.read_systems("m.json")) == 4
    assert design.read_measurement("r/plant_caging_9-10.csv", period=0.0005).input_labels == ["Q9", "Q10"]
    assert ET.parse("p.xml").getroot().get("model") == "three-gyro platform"
    # The same again is the same.
    assert main(["export", "job.toml", *EVERYTHING, "--quiet"]) == 0
    assert files(there) == now
    assert capsys.readouterr().out.splitlines()[0] == "MATLAB data: k.mat"


def test_options_reach_what_they_are_of(there: Path) -> None:
    arguments = ["--number", "float", "--form", "polar", "--root", "prescribed"]
    assert main(["export", "job.toml", "-q", "--c", "c", "--csv", "r", "--mjcf", "p.xml", *arguments]) == 0
    source = (there / "c" / "caging_9_10_classical.c").read_text() + (
        there / "c" / "caging_9_10_classical.h"
    ).read_text()
    assert "0F;" in source
    assert "--number float" in source
    assert "alpha9/Q9 phase_deg" in (there / "r" / "plant_caging_9-10.csv").read_text()
    assert 'name="Omega1_dot"' in (there / "p.xml").read_text()


def test_what_needs_no_controllers_asks_for_none(there: Path) -> None:
    (there / "out" / "result.json").unlink()
    assert main(["export", "job.toml", "-q", "--mjcf", "p.xml", "--models", "m.json"]) == 0
    assert [one.name for one in export.read_systems("m.json")] == [
        "plant",
        "plant with free root",
        "plant caging 9-10",
    ]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "nothing to write; name at least one of --c, --mat"),
        (["--mat", "k.mat", "--number=float"], "is an option of --c"),
        (["--c", "c", "--number", "q7"], "--number: must be double or float, got 'q7'"),
        (["--mat", "job.toml"], "--mat job.toml: the command reads or writes it for something else"),
        (["--c", "x", "--csv", "x"], "--c x: the command reads or writes it for something else too"),
        (["--c", "out"], "--c out: holds files of no earlier export; name a new or empty folder"),
        (["--c", "out/result.json/a/c"], "--c out/result.json/a/c: out/result.json is a file, but must be a folder"),
    ],
)
def test_wrong_input_is_one_line_and_writes_nothing(
    arguments: list[str], words: str, there: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = files(there)
    assert words in refused(capsys, "export", "job.toml", *arguments, "-q")
    assert files(there) == before


@pytest.mark.parametrize("option", ["--mat", "--c"])
def test_the_plant_that_the_job_reads_is_never_written_over(
    option: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["new", "gyro", "--out", str(tmp_path)]) == 0
    before = files(tmp_path)
    (tmp_path / "k.json").write_text("{}")
    words = ["export", str(tmp_path / "gyro.toml"), "--controllers", str(tmp_path / "k.json")]
    capsys.readouterr()
    assert main([*words, option, str(tmp_path / "gyro_plant.toml")]) == 2
    assert "something else" in capsys.readouterr().err
    assert files(tmp_path) == before | {"k.json": b"{}"}


def test_a_folder_of_its_own_is_renewed_but_never_what_somebody_changed(
    there: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", "job.toml", "-q", "--c", "c"]) == 0
    double = files(there / "c")
    assert {"gyro_9_10.c", "gyro_9_10.h", "export.json"} < set(double)
    (there / "c" / "board.c").write_text("int main(void) { return 0; }\n")
    assert main(["export", "job.toml", "-q", "--c", "c", "--number", "float"]) == 0
    single = files(there / "c")
    assert set(single) == {*double, "board.c"}
    assert single["gyro_9_10.h"] != double["gyro_9_10.h"]
    with (there / "c" / "gyro_9_10.c").open("a") as file:
        file.write("/* mine */\n")
    changed = files(there / "c")
    capsys.readouterr()
    assert "--c c: gyro_9_10.c was changed since it was exported" in refused(
        capsys, "export", "job.toml", "--c", "c", "-q"
    )
    assert files(there / "c") == changed
    # A file of another's where a new one would stand.
    (there / "r").mkdir()
    assert main(["export", "job.toml", "-q", "--csv", "r"]) == 0
    for name in ("export.json", "plant_caging_9-10.csv"):
        (there / "r" / name).write_text('{"files": {}}' if name == "export.json" else "measured")
    capsys.readouterr()
    assert "is not part of an earlier export" in refused(capsys, "export", "job.toml", "--csv", "r", "-q")
    (there / "r" / "export.json").write_text('{"files": {"../job.toml": ""}}')
    assert "is not the record of an export" in refused(capsys, "export", "job.toml", "--csv", "r", "-q")


@pytest.mark.parametrize("failure", [KeyboardInterrupt, OSError])
def test_nothing_is_left_half_written(
    failure: type[BaseException], there: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The last of three forms fails after the others are written."""
    (there / "k.mat").write_text("old")
    before = files(there)

    def fail(*_: object, **__: object) -> None:
        raise failure("no room")

    monkeypatch.setattr("platform_ctrl.export.job_systems.write_responses", fail)
    arguments = ["export", "job.toml", "-q", "--mat", "k.mat", "--c", "c", "--csv", "r"]
    assert main(arguments) == (130 if failure is KeyboardInterrupt else 2)
    assert files(there) == before
    assert not (there / "c").exists()
