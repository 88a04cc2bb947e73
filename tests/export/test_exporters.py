"""The registry of exporters: what holds for every one of them, and the recipe in the documentation for another."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import platform_ctrl as pc
from one_gyro_job import JOB
from platform_ctrl.cli import main
from platform_ctrl.errors import ArgumentError
from platform_ctrl.export.exporters import Exporter, exporters, register, unregister

DOCS = Path(__file__).parents[2] / "docs"
RECIPE = (DOCS / "architecture.md").read_text(encoding="utf-8").partition("### Add an exporter")[2]


@pytest.fixture
def with_poles() -> Iterator[None]:
    """The exporter of the documentation is registered."""
    exec(re.findall(r"```python\n(.*?)```", RECIPE, flags=re.DOTALL)[0], {})
    yield
    unregister("poles")


@pytest.fixture
def job(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "job.toml"
    path.write_text(JOB)
    return path


def test_the_recipes_exporter_is_an_option_of_the_command(
    with_poles: None, job: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", "--help"]) == 0
    assert "Poles of the plant as text." in " ".join(capsys.readouterr().out.split())
    assert main(["export", "job.toml", "--poles", "poles.txt", "--digits", "9", "--mjcf", "p.xml", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert [one["format"] for one in answer["written"]] == ["mjcf", "poles"]
    assert answer["written"][1]["sha256"] == hashlib.sha256(Path("poles.txt").read_bytes()).hexdigest()
    written = np.loadtxt("poles.txt") @ [1.0, 1j]
    plant = pc.state_space(pc.linearise(pc.read_job(job).platform))
    np.testing.assert_allclose(written, np.sort_complex(plant.poles()), atol=1e-8 * np.abs(written).max())
    assert f"{len(written)} poles" in answer["notes"][-1]


def test_what_was_removed_is_no_option_any_more(job: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", "job.toml", "--poles", "poles.txt"]) == 2
    assert "--poles" in capsys.readouterr().err


@pytest.mark.parametrize("exporter", exporters(), ids=lambda one: one.name)
def test_every_exporter_is_in_the_help_and_in_the_documentation(
    exporter: Exporter, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", "--help"]) == 0
    shown = capsys.readouterr().out
    page = (DOCS / "export.md").read_text(encoding="utf-8")
    assert f"| `{exporter.flag}` |" in page
    assert all(f"{flag} " in shown for flag in exporter.flags)


@pytest.mark.parametrize("exporter", exporters(), ids=lambda one: one.name)
def test_two_exporters_cannot_share_an_option(exporter: Exporter) -> None:
    with pytest.raises(ArgumentError, match=f"{exporter.flag} exists already"):
        register(exporter)
