"""`platform-ctrl new`: what it copies is designed as it is; nothing is overwritten."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

import platform_ctrl as pc
from platform_ctrl.cli import main
from refused_command import refused

KINDS = {
    "caged-gyro": "caged_gyro",
    "camera-gimbal": "camera_gimbal",
    "multirotor-gimbal": "multirotor_gimbal",
    "drone-gimbal": "drone_gimbal",
    "telescope-mount": "telescope_mount",
    "seeker-head": "seeker_head",
    "steering-mirror": "fast_steering_mirror",
    "floated-gyro": "floated_gyro_platform",
    "stabilised-platform": "three_gyro_platform",
    "control-moment-gyro": "control_moment_gyro",
}


@pytest.fixture
def there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_what_is_copied_is_designed_simulated_and_varied_as_it_is(
    there: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["new", "gyro"]) == 0
    assert names(there) == ["gyro.toml", "gyro_plant.toml"]
    assert "next:  platform-ctrl design gyro.toml" in capsys.readouterr().out.splitlines()
    assert main(["design", "gyro.toml", "-q"]) == 0
    assert main(["simulate", "gyro.toml", "--manoeuvre", "turn", "-q"]) == 0
    assert "PASSED" in capsys.readouterr().out
    job = pc.read_job(there / "gyro.toml")
    assert job.campaign is not None
    assert len(job.campaign.vary) == 2


def test_every_kind_is_offered(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["new", "--help"]) == 0
    assert f"Whatyouhave:{','.join(KINDS)}." in re.sub(r"\s", "", capsys.readouterr().out)


@pytest.mark.parametrize(("kind", "example"), KINDS.items())
def test_each_kind_is_an_example_under_another_name_with_its_comments(
    kind: str, example: str, there: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["new", "mine", "--kind", kind, "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert (record["plant"], record["job"], record["kind"]) == ("mine_plant.toml", "mine.toml", kind)
    job = pc.read_job(there / "mine.toml")
    assert (job.name, job.plant) == ("mine", "mine_plant.toml")
    text = (there / "mine.toml").read_text(encoding="utf-8")
    assert text.count("#") > 5
    assert f"{example}.toml" not in text
    copied = pc.read_job(Path(__file__).parents[2] / "examples" / f"{example}.toml")
    assert [loop.name for loop in job.loops] == [loop.name for loop in copied.loops]
    assert any(loop.limits for loop in job.loops)


def test_files_that_are_there_stay_unless_told_otherwise(there: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (there / "gyro.toml").write_text("mine", encoding="utf-8")
    assert "gyro.toml: exists already" in refused(capsys, "new", "gyro")
    assert names(there) == ["gyro.toml"]
    assert (there / "gyro.toml").read_text(encoding="utf-8") == "mine"
    assert main(["new", "gyro", "--force"]) == 0
    assert pc.read_job(there / "gyro.toml").plant == "gyro_plant.toml"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["new", "a/b"], "NAME: 'a/b' may contain only letters, digits"),
        (["new", ".."], "NAME: '..'"),
        (["new", "x", "--kind", "gyro"], "--kind: must be caged-gyro, camera-gimbal"),
        (["new", "x", "-o", "there.toml"], "-o there.toml: is no folder"),
    ],
)
def test_wrong_input_is_one_line_and_nothing_is_written(
    arguments: list[str], words: str, there: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (there / "there.toml").touch()
    assert words in refused(capsys, *arguments)
    assert names(there) == ["there.toml"]
