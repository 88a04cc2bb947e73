"""Designs kept in a folder, or made side by side in processes, are the same as those made one after the other."""

import json
import os
import signal
import tomllib
from pathlib import Path

import numpy as np
import pytest

from design.test_sight import two_loops
from platform_ctrl import read_job
from platform_ctrl.design import jobs
from platform_ctrl.design.jobs import attempted_loops
from platform_ctrl.job.reading import data_hash, job_data

EXAMPLE = Path(__file__).parents[2] / "examples" / "caged_gyro.toml"


@pytest.fixture
def data():
    whole = job_data(read_job(EXAMPLE))
    return {key: one for key, one in whole.items() if key not in ("manoeuvre", "campaign", "fault")}


def designed(data, folder=None):
    """What a record of the design would have, and the lines on designs that were taken over."""
    said = []
    [one] = attempted_loops(read_job(data), said.append, folder=folder)[0].designs
    matrices = [getattr(one.own_controller, name).tolist() for name in "ABCD"]
    numbers = [one.options, one.claims, [r.value for r in one.results], matrices]
    return json.dumps(numbers), [line for line in said if line.endswith("unchanged")]


def test_a_design_that_is_taken_over_is_the_same_to_the_last_bit(data, tmp_path):
    without, _ = designed(data)
    first, none = designed(data, tmp_path)
    again, taken = designed(data, tmp_path)
    assert not none
    assert taken == ["caging: classical, unchanged"]
    assert first == again == without


@pytest.mark.parametrize("change", ["limit", "option", "uncertainty", "code"])
def test_what_a_design_depends_on_makes_it_again(data, tmp_path, monkeypatch, change):
    designed(data, tmp_path)
    loop = data["loop"][0]
    if change == "limit":
        loop["limits"]["disk_margin"] *= 0.9
    elif change == "option":
        loop["design"][0]["crossover_hz"] = 1.01 * loop["design"][0]["crossover_hz"]
    elif change == "uncertainty":
        data["uncertainty"] = {"inertia": 0.01}
    else:
        monkeypatch.setattr(jobs, "code_hash", lambda: "another")
    assert not designed(data, tmp_path)[1]


def test_a_damaged_file_counts_as_none(data, tmp_path):
    designed(data, tmp_path)
    file = tmp_path / jobs.FILE
    whole = file.read_text()
    digit = whole.index('"dt": ') + 6
    partial = {key: {} for key in json.loads(whole)["designs"]}
    for damaged in (
        whole[:100],
        "[]",
        json.dumps({"designs": partial, "hash": data_hash({"designs": partial})}),
        whole[:digit] + str((int(whole[digit]) + 1) % 10) + whole[digit + 1 :],
    ):
        file.write_text(damaged)
        assert not designed(data, tmp_path)[1]


@pytest.fixture(scope="module")
def job():
    """The shipped caged gyro, with a second design."""
    given = tomllib.loads((EXAMPLE).read_text())
    given["plant"] = str(EXAMPLE.parent / given["plant"])
    given["loop"][0]["design"][0].pop("tune")
    given["loop"][0]["design"].append({"name": "H-infinity", "method": "hinf"})
    return read_job(given)


FORKED = pytest.mark.skipif(not jobs._FORKS, reason="processes are forked on Linux alone")


@FORKED
def test_designs_side_by_side_are_those_made_one_after_the_other(job):
    lines = []
    together, alone = attempted_loops(job, lines.append, 2), attempted_loops(job)
    assert any("2 designs side by side" in line for line in lines)
    for one, other in zip(together, alone, strict=True):
        assert [d.name for d in one.designs] == [d.name for d in other.designs]
        for d, e in zip(one.designs, other.designs, strict=True):
            assert d.plants.labels == e.plants.labels
            np.testing.assert_allclose(d.controller.A, e.controller.A, rtol=1e-12)
            assert [r.value for r in d.results] == pytest.approx([r.value for r in e.results], rel=1e-12)


@FORKED
def test_a_design_whose_process_is_killed_fails_alone(job, monkeypatch):
    made = jobs.evaluated
    first, *others = job.loops[0].designs

    def killed(problem, *given, **more):
        if problem.design.name == first.name:
            os.kill(os.getpid(), signal.SIGKILL)
        return made(problem, *given, **more)

    monkeypatch.setattr(jobs, "evaluated", killed)
    outcome = attempted_loops(job, None, 2)[0]
    assert [one.name for one in outcome.failed] == [first.name]
    assert "killed, perhaps because memory ran out; try fewer plants" in str(outcome.failed[0].error)
    assert [one.name for one in outcome.designs] == [one.name for one in others]


def test_a_loop_beside_one_that_has_failed_is_refused():
    yaw, pitch = attempted_loops(two_loops(yaw_hz=900, jitter=1.0))
    assert yaw.failure is not None
    assert "loop 'yaw', which moves the line of sight too, has failed" in str(pitch.failure.error)
