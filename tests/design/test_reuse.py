"""Designs that are kept in a folder: the same as without it, and made again where anything has changed."""

import json
from pathlib import Path

import pytest

from platform_ctrl.design import jobs
from platform_ctrl.design.jobs import attempted_loops
from platform_ctrl.design.methods import read_job
from platform_ctrl.job.reading import data_hash, job_data
from platform_ctrl.verification import check_job
from platform_ctrl.verification.result_file import result_record

EXAMPLE = Path(__file__).parents[2] / "examples" / "caged_gyro.toml"


@pytest.fixture
def data():
    whole = job_data(read_job(EXAMPLE))
    return {key: one for key, one in whole.items() if key not in ("manoeuvre", "campaign", "fault")}


def designed(data, folder=None):
    """The record of the result, and the lines on designs that were taken over."""
    said = []
    job = read_job(data)
    outcomes = attempted_loops(job, said.append, folder=folder)
    return result_record(check_job(job, outcomes)), [line for line in said if line.endswith("unchanged")]


def test_a_design_that_is_taken_over_is_the_same_to_the_last_bit(data, tmp_path):
    without, _ = designed(data)
    first, none = designed(data, tmp_path)
    again, taken = designed(data, tmp_path)
    assert not none
    assert taken == ["caging: classical, unchanged"]
    assert json.dumps(first) == json.dumps(without)
    assert json.dumps(again) == json.dumps(without)


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
    assert designed(data, tmp_path)[1]


def test_a_damaged_file_counts_as_none(data, tmp_path):
    designed(data, tmp_path)
    file = tmp_path / jobs.FILE
    whole = file.read_text()
    digit = whole.index('"B": [') + 8
    partial = {key: {} for key in json.loads(whole)["designs"]}
    for damaged in (
        "",
        whole[:100],
        "[]",
        "{}",
        json.dumps({"designs": partial, "hash": data_hash({"designs": partial})}),
        whole[:digit] + str((int(whole[digit]) + 1) % 10) + whole[digit + 1 :],
    ):
        file.write_text(damaged)
        assert not designed(data, tmp_path)[1]
