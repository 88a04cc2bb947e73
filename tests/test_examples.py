"""The examples run as they stand: what they print is what theory says, and what they draw is there."""

from __future__ import annotations

import re
import runpy
import struct
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Run an example in an empty folder, as a script with these arguments; return what it prints."""

    def script(name: str, *arguments: str) -> str:
        monkeypatch.setattr(sys, "argv", [name, *arguments])
        runpy.run_path(str(EXAMPLES / name), run_name="__main__")
        return capsys.readouterr().out

    monkeypatch.chdir(tmp_path)
    return script


def drawn(file: Path) -> tuple[int, int]:
    """Width and height of a PNG."""
    head = file.read_bytes()[:24]
    assert head[:8] == b"\x89PNG\r\n\x1a\n"
    return struct.unpack(">II", head[16:24])


def test_bode_draws_and_prints_the_margins(tmp_path: Path, run: Callable[..., str]) -> None:
    said = run("bode.py", "-o", "bode.png")
    assert min(drawn(tmp_path / "bode.png")) > 500
    alone = [float(x) for x in re.findall(r"^Q\w+: disk margin ([\d.]+)", said, re.MULTILINE)]
    [both] = [float(x) for x in re.findall(r"^both at once: disk margin ([\d.]+)", said, re.MULTILINE)]
    assert len(alone) == 2
    # All channels may move at once: the margin cannot exceed that of any one of them.
    assert 0.0 < both <= min(alone)


def test_root_locus_draws_and_finds_where_stability_ends(tmp_path: Path, run: Callable[..., str]) -> None:
    said = run("root_locus.py", "--gain", "0.5", "3", "--spin", "0.9", "1.1", "-o", "loci.png")
    assert min(drawn(tmp_path / "loci.png")) > 500
    [limit] = re.findall(r"^loop gain / nominal from 0.5 to 3: stable at first, changes at ([\d.]+)", said, re.M)
    # Both torques scaled together are one of the perturbations that the disk margin 0.451 of bode.py covers.
    assert float(limit) > (1.0 + 0.451 / 2.0) / (1.0 - 0.451 / 2.0)
    assert "rotor speed / nominal from 0.9 to 1.1: stable everywhere" in said


def test_state_feedback_by_cvxpy_is_closed_judged_and_drawn(tmp_path: Path, run: Callable[..., str]) -> None:
    said = run("cvxpy_state_feedback.py", "S.png")
    assert min(drawn(tmp_path / "S.png")) > 400
    assert "cvxpy: optimal" in said
    verdicts = dict(re.findall(r"^(.+): .*: (met|not met)$", said, re.MULTILINE))
    assert (
        verdicts["damping, worst case"] == verdicts["disk margin, worst case"] == verdicts["torque noise, rms"] == "met"
    )
    # An LQ design bounds no peak and no gain at a frequency.
    assert verdicts["bandwidth"] == "not met"


def test_two_sided_nyquist_draws_and_prints_margins_of_both_signs(tmp_path: Path, run: Callable[..., str]) -> None:
    said = run("two_sided_nyquist.py", "-o", "nyquist.png")
    assert min(drawn(tmp_path / "nyquist.png")) > 500
    crossings = [float(x) for x in re.findall(r"^  \|L\| = 1 at +([+-][\d.]+) Hz", said, re.MULTILINE)]
    assert min(crossings) < 0.0 < max(crossings)
    [margin] = re.findall(r"^disk margin ([\d.]+), reached at \+", said, re.MULTILINE)
    assert 0.5 < float(margin) < 0.7
