"""`design --watch`: every save of a file that the job names leads to another design, and no mistake ends it."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from cli.test_cli import process_environment
from one_gyro_job import JOB
from platform_ctrl.cli.design_commands import whenever_saved

NAMES = 'plant = "plant.toml"\nloop = [{ name = "out", responses = "measured.csv" }]\n'


def runs(job: Path, *saves: Callable[[], object], error: Exception | None = None) -> int:
    """Return how many runs there were; during each run one save is made, and Ctrl-C is pressed in the last."""
    made: list[None] = []

    def run() -> int:
        made.append(None)
        if len(made) > len(saves):
            raise KeyboardInterrupt
        saves[len(made) - 1]()
        if error is not None:
            raise error
        return 1

    with pytest.raises(KeyboardInterrupt):
        whenever_saved(job, run, quiet=True)
    return len(made)


@pytest.fixture
def job(tmp_path: Path) -> Path:
    (tmp_path / "out").mkdir()
    (tmp_path / "job.toml").write_text(NAMES)
    (tmp_path / "measured.csv").write_text("1")
    return tmp_path / "job.toml"


def test_the_job_its_plant_and_its_data_are_watched(job: Path) -> None:
    saves = (
        lambda: job.write_text(f"{NAMES}# one\n"),
        lambda: job.with_name("plant.toml").write_text("made"),
        lambda: job.with_name("measured.csv").write_text("1, 2"),
        lambda: job.with_name("plant.toml").unlink(),
    )
    assert runs(job, *saves) == 5


@pytest.mark.skipif(os.name != "posix", reason="SIGINT as a terminal sends it")
def test_the_command_designs_again_after_each_save_until_ctrl_c(tmp_path: Path) -> None:
    job = tmp_path / "gyro.toml"
    job.write_text(JOB, encoding="utf-8")
    process = subprocess.Popen(
        [sys.executable, "-m", "platform_ctrl", "design", "gyro.toml", "--watch"],
        cwd=tmp_path,
        env=process_environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    assert process.stdout is not None

    def until_it_waits() -> str:
        assert process.stdout is not None
        lines: list[str] = []
        while not (lines and lines[-1].startswith("waiting until gyro.toml")):
            lines.append(process.stdout.readline())
            assert lines[-1], "".join(lines)
        return "".join(lines)

    try:
        assert "PASSED" in until_it_waits()
        assert json.loads((tmp_path / "out" / "result.json").read_text(encoding="utf-8"))["passed"] is True
        job.write_text(JOB + "[[loop", encoding="utf-8")
        assert "platform-ctrl: error: gyro.toml: is not TOML" in until_it_waits()
        process.send_signal(signal.SIGINT)
        assert process.stdout.read() == "platform-ctrl: interrupted\n"
        assert process.wait() == 130
    finally:
        process.kill()
        process.stdout.close()
