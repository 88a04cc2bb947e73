"""Designs made side by side in processes are those made one after the other, and a killed process says so."""

import os
import signal
import tomllib
from pathlib import Path

import numpy as np
import pytest

import platform_ctrl as pc
from platform_ctrl.design import jobs
from platform_ctrl.design.jobs import attempted_loops
from platform_ctrl.design.loop import Design
from platform_ctrl.design.method import LoopProblem
from platform_ctrl.job.job import Job

EXAMPLES = Path(__file__).parents[2] / "examples"
pytestmark = pytest.mark.skipif(not jobs._FORKS, reason="processes are forked on Linux alone")


@pytest.fixture(scope="module")
def job() -> Job:
    """The shipped caged gyro, with a second design."""
    given = tomllib.loads((EXAMPLES / "caged_gyro.toml").read_text())
    given["plant"] = str(EXAMPLES / given["plant"])
    given["loop"][0]["design"][0].pop("tune")
    given["loop"][0]["design"].append({"name": "H-infinity", "method": "hinf"})
    return pc.read_job(given)


def test_designs_side_by_side_are_those_made_one_after_the_other(job: Job) -> None:
    lines: list[str] = []
    together, alone = attempted_loops(job, lines.append, 2), attempted_loops(job)
    assert any("2 designs side by side" in line for line in lines)
    for one, other in zip(together, alone, strict=True):
        assert [d.name for d in one.designs] == [d.name for d in other.designs]
        for d, e in zip(one.designs, other.designs, strict=True):
            assert d.plants is not None
            assert e.plants is not None
            assert d.plants.labels == e.plants.labels
            np.testing.assert_allclose(d.controller.A, e.controller.A, rtol=1e-12)
            assert [r.value for r in d.results] == pytest.approx([r.value for r in e.results], rel=1e-12)


def test_a_design_whose_process_is_killed_fails_alone(job: Job, monkeypatch: pytest.MonkeyPatch) -> None:
    made = jobs.evaluated
    first, *others = job.loops[0].designs

    def killed(problem: LoopProblem, *given: object, **more: object) -> Design:
        if problem.design.name == first.name:
            os.kill(os.getpid(), signal.SIGKILL)
        return made(problem, *given, **more)

    monkeypatch.setattr(jobs, "evaluated", killed)
    outcome = attempted_loops(job, None, 2)[0]
    assert [one.name for one in outcome.failed] == [first.name]
    assert "killed, perhaps because memory ran out; try fewer plants" in str(outcome.failed[0].error)
    assert [one.name for one in outcome.designs] == [one.name for one in others]
