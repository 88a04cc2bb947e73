"""The pytest fixture, in a pytest run of its own, and the tables of what is missed and what became worse."""

from __future__ import annotations

import os
import shutil
from importlib.metadata import entry_points
from pathlib import Path

import pytest

import platform_ctrl as pc
from one_gyro_job import JOB, SLOWER, TOO_MUCH
from platform_ctrl.cli import main

pytest_plugins = ["pytester"]

TESTS = """
import pytest
from platform_ctrl.cli.testing import assert_requirements
from platform_ctrl.errors import InputError

def test_the_job_meets_its_requirements_and_is_computed_once(closed_loop):
    result = closed_loop("gyro.toml", baseline="accepted.json")
    assert_requirements(result)
    assert closed_loop("gyro.toml") is result

def test_controllers_that_exist_are_taken(closed_loop):
    assert closed_loop("gyro.toml", "accepted.json", baseline="accepted.json").passed

def test_slower(closed_loop):
    closed_loop("slower.toml", baseline="accepted.json")

def test_too_much(closed_loop):
    assert_requirements(closed_loop("too_much.toml"))

def test_no_baseline(closed_loop):
    with pytest.raises(InputError, match="none.json: there is no such file"):
        closed_loop("gyro.toml", baseline="none.json")
"""


EXAMPLES = Path(__file__).parents[2] / "examples"
PLUGIN = "platform_ctrl.cli.testing.plugin"


def plugged_in(pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> None:
    """Make pytest find the plugin by its entry point; the package may not be installed, but on the path alone."""
    paths = [Path(pc.__file__).parents[1]]
    if not any(one.value == PLUGIN for one in entry_points(group="pytest11")):
        info = pytester.mkdir("site") / "stand_in-0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text("Metadata-Version: 2.1\nName: stand-in\nVersion: 0\n", encoding="utf-8")
        (info / "entry_points.txt").write_text(f"[pytest11]\nplatform_ctrl = {PLUGIN}\n", encoding="utf-8")
        paths.append(info.parent)
    for path in paths:
        monkeypatch.syspath_prepend(path)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(map(str, paths)))
    monkeypatch.setenv("PYTEST_ADDOPTS", "-p no:cacheprovider")


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The result of the job, made before pytester forgets the modules that a test was the first to load."""
    folder = tmp_path_factory.mktemp("accepted")
    (folder / "gyro.toml").write_text(JOB, encoding="utf-8")
    assert main(["design", str(folder / "gyro.toml"), "-o", str(folder / "out"), "-q"]) == 0
    return (folder / "out" / "result.json").read_text(encoding="utf-8")


def test_a_job_in_a_test_is_compared_with_its_requirements_and_with_an_accepted_result(
    record: str, pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    plugged_in(pytester, monkeypatch)
    for name, text in (("gyro", JOB), ("slower", SLOWER), ("too_much", TOO_MUCH)):
        (pytester.path / f"{name}.toml").write_text(text, encoding="utf-8")
    (pytester.path / "accepted.json").write_text(record, encoding="utf-8")
    pytester.makepyfile(TESTS)
    # The regression test among the examples, which is there to be copied.
    for name in ("test_closed_loop.py", "gyro_9_10.json"):
        shutil.copy(EXAMPLES / name, pytester.path)
    done = pytester.runpytest_subprocess("-W", "error")
    done.assert_outcomes(passed=5, failed=2)
    done.stdout.fnmatch_lines_random(
        [
            "E*accepted.json: of * values 4 worse by more than their tolerance",
            "E*caging 9-10: bandwidth * 27.68 Hz * 24.03 Hz *−13 % * 0.2768 Hz * at least 20 Hz",
            "E*made with another job and another controller of caging 9-10",
            "E*gyro 9-10: 1 of * requirements not met",
            "E*caging 9-10, classical: bandwidth *27.6* Hz *at least 35 Hz*−21 %*",
        ]
    )
