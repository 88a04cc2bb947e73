"""result.json out, controllers in, two of them compared: nothing is lost or believed, every mistake is one line."""

from __future__ import annotations

import copy
import json
import math
import os
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import platform_ctrl as pc
import three_loops_job
from platform_ctrl.design import loops
from platform_ctrl.errors import InputError
from platform_ctrl.verification import check_job
from platform_ctrl.verification.comparison import compare
from platform_ctrl.verification.controllers import outcomes_from, read_controllers
from platform_ctrl.verification.result_file import read_record, result_record, write_record

JOB: dict[str, Any] = tomllib.loads(three_loops_job.JOB)
JOB["loop"][1]["limits"] |= {"damping": 0.05, "torque_noise": 0.008}
JOB["loop"][1]["design"].insert(0, {"name": "slow", "method": "classical", "crossover_hz": 30, "integral_hz": 2})


@pytest.fixture(scope="module")
def job() -> Any:
    return pc.read_job(JOB)


@pytest.fixture(scope="module")
def result(job: Any) -> Any:
    return check_job(job, loops(job))


@pytest.fixture(scope="module")
def record(result: Any) -> dict[str, Any]:
    return result_record(result)


def test_the_record_has_the_form_that_others_rely_on(record: dict[str, Any], job: Any) -> None:
    assert (record["schema"], record["platform"], record["job"]) == (1, "three-gyro platform", job.name)
    assert record["subsystems"] == [["4", "5", "7"], ["9", "10"]]
    assert [one["name"] for one in record["controllers"]] == [loop["name"] for loop in JOB["loop"]]
    caging = record["controllers"][1]
    assert (caging["inputs"], caging["outputs"]) == (["alpha9", "beta10"], ["Q9", "Q10"])
    assert (caging["dt"], caging["delay"], caging["method"]) == (0.0005, 0.0005, "classical")
    assert np.shape(caging["D"]) == (2, 2)
    assert [(one["name"], one["design"]) for one in record["alternatives"]] == [("caging 9-10", "slow")]
    assert {one["stage"] for one in record["requirements"]} == {"decoupled", "coupled", "simulated"}
    assert {"name", "value", "limit", "passed", "stage"} <= set(record["requirements"][0])
    assert record["passed"] is all(one["passed"] for one in record["requirements"])
    assert record["coupled"]["stable"] is True


def test_figures_are_recomputed_from_plant_and_matrices_alone(record: dict[str, Any], job: Any) -> None:
    import control

    entry = record["controllers"][1]
    matrices = [np.array(entry[name]) for name in "ABCD"]
    K = control.ss(*matrices, entry["dt"], inputs=entry["inputs"], outputs=entry["outputs"])
    gyro = pc.state_space(pc.linearise(job.platform), gimbals=("9", "10"))[entry["inputs"], entry["outputs"]]
    plant = pc.analysis.sampled(gyro, entry["dt"], entry["delay"], 0.0002)
    found = {one["name"]: one["value"] for one in record["requirements"] if one["subject"] == "caging 9-10"}
    decay = -np.log(np.abs(np.linalg.eigvals(pc.analysis.closed_loop(plant, K).A)).max()) / entry["dt"]
    assert found["minimum decay rate"] == pytest.approx(decay, rel=1e-9)
    bandwidth = min(pc.analysis.bandwidth(plant, K, at=at) for at in ("input", "output"))
    assert found["bandwidth"] == pytest.approx(bandwidth / (2.0 * np.pi), rel=1e-6)


def alike(one: Any, other: Any) -> bool:
    """Whether both say the same: norms are found to 1e-9, and LAPACK's last digits depend on where arrays lie."""
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(alike(one[key], other[key]) for key in one)
    if isinstance(one, list):
        if one and isinstance(one[0], list) and one[0] and isinstance(one[0][0], float):  # a matrix, by its size
            scale = float(np.abs(other).max())
            return bool(np.shape(one) == np.shape(other) and np.allclose(one, other, rtol=0.0, atol=3e-9 * scale))
        return len(one) == len(other) and all(map(alike, one, other))
    return bool(one == (pytest.approx(other, rel=3e-9, abs=1e-10) if isinstance(one, float) else other))


def test_reading_what_was_written_gives_the_same_verdicts_and_figures(
    record: dict[str, Any], job: Any, tmp_path: Path
) -> None:
    file = tmp_path / "result.json"
    write_record(record, file)
    written = read_record(file)
    del written["sha256"]["result"]
    assert written == record
    again = outcomes_from(job, read_controllers(file, job), read_controllers(file, job, "alternatives"))
    anew = result_record(check_job(job, again))
    for key in ("passed", "requirements", "coupled", "runs", "subsystems"):
        assert alike(anew[key], record[key])
    for key in ("controllers", "alternatives"):
        for one, other in zip(anew[key], record[key], strict=True):
            assert one["method"] == "given"
            made = {"method", "options", "sections"}
            assert {k: one[k] for k in "ABCD"} == {k: other[k] for k in "ABCD"}
            assert alike(*({k: v for k, v in part.items() if k not in made} for part in (one, other)))


def test_claims_of_a_file_are_not_believed(record: dict[str, Any], job: Any) -> None:
    forged = copy.deepcopy(record)
    forged["controllers"][1]["claims"] = {"disk_margin": 1.9, "gamma": 0.1}
    [caging] = [o for o in outcomes_from(job, read_controllers(forged, job)) if o.spec.name == "caging 9-10"]
    assert caging.closed.measures is not None
    assert caging.closed.measures.disk_margin[0] == pytest.approx(record["controllers"][1]["claims"]["disk_margin"])
    assert "gamma" not in caging.closed.claims


def test_a_worse_controller_fails_the_check(record: dict[str, Any], job: Any) -> None:
    worse = copy.deepcopy(record)
    for letter in "CD":
        worse["controllers"][1][letter] = (4.0 * np.array(worse["controllers"][1][letter])).tolist()
    outcome = check_job(job, outcomes_from(job, read_controllers(worse, job)))
    assert not outcome.passed
    failed = result_record(outcome)
    assert failed["coupled"]["stable"] is False
    assert {(r["subject"], r["name"]) for r in failed["requirements"] if not r["passed"]} >= {
        ("caging 9-10", "disk margin"),
        ("all loops closed", "minimum decay rate"),
    }
    json.dumps(failed, allow_nan=False)  # infinite noise and lost margins are null


def test_a_controller_without_states_is_read(record: dict[str, Any], job: Any) -> None:
    bare = copy.deepcopy(record)
    bare["controllers"][1] |= {"A": [[]], "B": [[]], "C": [[], []]}
    K = read_controllers(bare, job)[1]
    assert (K.nstates, K.ninputs, K.noutputs) == (0, 2, 2)


def second(record: dict[str, Any]) -> Any:
    return record["controllers"][1]


Change = Callable[[dict[str, Any]], object]

MISTAKES: dict[str, tuple[Change, str]] = {
    "another schema": (lambda r: r.update(schema=2), "schema must be 1, the format that this version reads, got 2"),
    "an empty list": (lambda r: r.update(controllers=[]), "controllers must be a list of controllers, got []"),
    "no table": (lambda r: r["controllers"].insert(0, 3), "controllers 1 must be a table, got 3"),
    "unknown input": (
        lambda r: second(r).update(inputs=["alpha9", "betta10"]),
        'inputs: "betta10" is no pick-off of the plant and no output of a controller before it; did you mean "beta10"?',
    ),
    "unknown output": (
        lambda r: second(r).update(outputs=["Q9", "Q11"]),
        'outputs: "Q11" is no torquer of the plant; did you mean',
    ),
    "input from a later controller": (
        lambda r: r["controllers"].insert(0, r["controllers"].pop()),
        "no output of a controller before it",
    ),
    "continuous": (lambda r: second(r).update(dt=0), "dt: 0 s is not the job's sample period, 0.0005 s"),
    "A not square": (lambda r: second(r)["A"].pop(), "A must be 3 x 3 (square), row 1 has 4 elements"),
    "C ragged": (
        lambda r: second(r)["C"][1].append(0.0),
        "C must be 2 x 4 (by inputs, outputs and A), row 2 has 5 elements",
    ),
    "D not finite": (
        lambda r: second(r)["D"][0].__setitem__(1, math.inf),
        "D must be 2 x 2 (by inputs, outputs and A), row 1 element 2, inf, is not finite",
    ),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_every_mistake_is_one_line_that_names_its_place(record: dict[str, Any], job: Any, mistake: str) -> None:
    change, words = MISTAKES[mistake]
    wrong = copy.deepcopy(record)
    change(wrong)
    with pytest.raises(InputError) as caught:
        read_controllers(wrong, job)
    assert words in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_loops_and_controllers_that_do_not_match_are_named(record: dict[str, Any], job: Any) -> None:
    controllers = read_controllers(record, job)
    with pytest.raises(InputError, match='none closes the loop "stabilisation" of the job; add one with'):
        outcomes_from(job, controllers[:2])
    with pytest.raises(InputError, match='both close the loop "caging 9-10"'):
        outcomes_from(job, [*controllers, controllers[1]])
    half = copy.deepcopy(record)
    second(half).update(outputs=["Q9"], C=second(half)["C"][:1], D=second(half)["D"][:1])
    del half["controllers"][2]
    with pytest.raises(
        InputError, match=r"its outputs Q9 are those of no loop of the job; they must be those of one loop .caging 4-5"
    ):
        outcomes_from(job, read_controllers(half, job))
    more = copy.deepcopy(record)
    more["controllers"][1]["inputs"] = ["alpha9", "beta7"]
    with pytest.raises(InputError, match=r"inputs alpha9, beta7; the loop .* is measured with alpha9, beta10"):
        outcomes_from(job, read_controllers(more, job))


def test_a_file_is_replaced_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "result.json"
    write_record({"first": 1}, file)

    def full(source: Path, target: Path) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(InputError, match=r"cannot be written: No space left on device"):
        write_record({"second": 2}, file)
    assert json.loads(file.read_bytes())["first"] == 1
    assert [path.name for path in tmp_path.iterdir()] == ["result.json"]


def values(**named: float | None) -> dict[str, Any]:
    """A result with requirements on values of a loop: bandwidths at least, all others at most 1."""
    return {
        "sha256": {"plant": "p", "job": "j"},
        "controllers": [{"name": "loop", "claims": {}, **{key: [[1.0]] for key in "ABCD"}}],
        "coupled": {"stable": True},
        "runs": [],
        "requirements": [
            {"subject": "loop", "stage": "decoupled", "name": name, "unit": "", "limit": 1.0, "value": number}
            | {"sense": "at least" if name.startswith("bandwidth") else "at most"}
            for name, number in named.items()
        ],
    }


@pytest.mark.parametrize(
    ("before", "now", "state"),
    [
        ({"bandwidth": 100.0}, {"bandwidth": 99.0}, "within"),
        ({"bandwidth": 100.0}, {"bandwidth": 98.9}, "worse"),
        ({"bandwidth": 100.0}, {"bandwidth": 101.1}, "better"),
        ({"noise": 100.0}, {"noise": 101.1}, "worse"),
        ({"noise": -100.0}, {"noise": -98.9}, "worse"),
        ({"noise": 0.0}, {"noise": 1e-13}, "within"),
        ({"noise": 0.0}, {"noise": 1e-9}, "worse"),
        ({"noise": 1.0}, {"noise": None}, "worse"),
        ({"bandwidth": 1.0}, {"bandwidth": None}, "worse"),
        ({"noise": None}, {"noise": None}, "within"),
        ({"noise": None}, {"noise": 1.0}, "better"),
        ({"noise": 1.0}, {}, "missing"),
        ({}, {"noise": 1.0}, "new"),
        ({"disk margin lost by coupling": 1e-4}, {"disk margin lost by coupling": 9e-3}, "within"),
        ({"disk margin lost by coupling": 1e-4}, {"disk margin lost by coupling": 2e-2}, "worse"),
    ],
)
def test_a_value_is_judged_by_its_sense_and_the_tolerance(before: Any, now: Any, state: str) -> None:
    found = compare(values(**now), values(**before), 0.01)
    assert [one.state for one in found.changes] == [state]
    assert found.passed == (state not in ("worse", "missing"))


def test_what_two_results_do_not_have_in_common_is_said() -> None:
    one = values(noise=1.0)
    other = copy.deepcopy(one)
    assert compare(one, other, 0.01).differing == ()
    other["sha256"]["job"] = "k"
    other["controllers"][0]["B"] = [[1.0 + 1e-5]]
    assert compare(one, other, 0.01).differing == ("another job", "another controller of loop")
    other["sha256"]["plant"] = "q"
    assert compare(one, other, 0.01).differing == ("another plant", "another controller of loop")


def test_a_loop_and_the_line_of_sight_of_one_name_are_told_apart() -> None:
    accepted, now = values(bandwidth=2.0), values(bandwidth=2.0)
    for one, coupled in ((accepted, 2.0), (now, 1.8)):
        one["requirements"].append(one["requirements"][0] | {"stage": "coupled", "value": coupled})
    [worse] = compare(now, accepted, 0.01).of("worse")
    assert (worse.before, worse.now) == (2.0, 1.8)
