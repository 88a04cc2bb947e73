"""`design --watch`: every save of a file that the job names leads to another design, and no mistake ends it."""

from __future__ import annotations

from pathlib import Path

import pytest

from platform_ctrl.cli import main
from platform_ctrl.errors import InputError

NAMES = 'plant = "plant.toml"\nloop = [{ name = "out", responses = "measured.csv" }]\n'


def test_the_job_its_plant_and_its_data_are_watched_until_ctrl_c(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each design saves a file while it runs, the third finds a mistake, and Ctrl-C is pressed in the last."""
    monkeypatch.chdir(tmp_path)
    job, plant, measured = (Path(name) for name in ("job.toml", "plant.toml", "measured.csv"))
    job.write_text(NAMES)
    measured.write_text("1")
    saves = [
        lambda: job.write_text(f"{NAMES}# one\n"),
        lambda: plant.write_text("made"),
        lambda: measured.write_text("1, 2"),
        lambda: plant.unlink(),
    ]
    made: list[Path] = []

    def designed(given: Path, folder: Path, **options: bool) -> int:
        made.append(given)
        if len(made) > len(saves):
            raise KeyboardInterrupt
        saves[len(made) - 1]()
        if len(made) == 3:
            raise InputError("job.toml: is not TOML")
        return 1

    monkeypatch.setattr("platform_ctrl.cli.design_commands._designed", designed)
    assert main(["design", "job.toml", "--watch"]) == 130
    assert made == [job] * 5
    lines = capsys.readouterr().err.splitlines()
    assert sum(line.startswith("waiting until job.toml or a file that it names is saved") for line in lines) == 4
    assert "platform-ctrl: error: job.toml: is not TOML" in lines
    assert lines[-1] == "platform-ctrl: interrupted"
