"""Every change that is proposed does what a check of the job with that change finds."""

from __future__ import annotations

import copy
from typing import Any

import pytest

from camera_job import camera_job
from platform_ctrl.verification.changes import changes, keyed
from report_jobs import caging, checked, classical, job, turn

# Reached are 27.7 Hz and 0.337.
LIMITS = {"bandwidth_hz": 34, "disk_margin_worst_case": 0.4}
GYRO = job(loop=[caging(classical("slow", 25), classical(), limits=LIMITS)], manoeuvre=[turn()])
BASE = {
    "name": "wind",
    "kind": "torque",
    "gimbal": "el",
    "frequencies_hz": [1.0, 10.0, 100.0],
    "densities": [1e-7, 1e-7, 1e-8],
}
TRACK = {
    "name": "track",
    "kind": "tracking",
    "around": "rate",
    "sensors": ["yaw_error", "pitch_error"],
    "use": "pi",
    "limits": {"disk_margin": 1.6},
    "design": [{"name": "pi", "method": "pi", "crossover_hz": 2.0, "integral_hz": 0.3}],
}


def camera(limits: dict[str, Any], *loops: dict[str, Any], budget: dict[str, float] | None = None) -> dict[str, Any]:
    data = camera_job()
    data["loop"][0]["limits"] = limits
    data["loop"] += loops
    data["operation"]["Omega"] = [0.0, 0.0, 0.0]
    if budget is not None:
        data["plant"]["friction"] = []
        data["budget"] = {"from_hz": 0.5, "to_hz": 200.0, "limits": budget, "source": [BASE]}
    return data


def changed(data: dict[str, Any], row: Any) -> Any:
    """The job with a change, designed and checked."""
    new = copy.deepcopy(data)
    loop = next(one for one in new["loop"] if one["name"] == row.loop)
    if row.kind == "design":
        loop["use"] = row.name
    else:
        design = next(one for one in loop["design"] if one["name"] == row.design)
        design |= {row.name: row.after}
    return checked(new)


def promised(rows: tuple[Any, ...], data: dict[str, Any], rel: float = 1e-9) -> None:
    """Assert that each row is what a check finds."""
    for row in rows:
        found = keyed(changed(data, row).requirements)
        for pair in (row.target, *row.violated, *([row.loss] if row.loss else [])):
            after = found[pair.after.subject, pair.after.stage, pair.after.name]
            assert pair.after.value == pytest.approx(after.value, rel=rel), row.name
            assert pair.after.passed == after.passed


def test_a_missed_bandwidth_is_met_by_a_larger_crossover_and_the_row_says_what_that_costs() -> None:
    result = checked(GYRO)
    rows = changes(result)
    assert {row.target.before.name for row in rows} == {one.name for one in result.requirements if not one.passed}
    faster, *others = rows
    assert (faster.kind, faster.name, faster.target.before.name) == ("option", "crossover_hz", "bandwidth")
    assert faster.after > faster.before == 40.0
    assert faster.target.after.passed
    # The gain about one axis alone makes the loop faster or more robust, each at the cost of the other.
    traded = {row.target.before.name: row for row in others if row.name == "damping2_hz"}
    for wanted, lost, way in (
        ("bandwidth", "disk margin, worst case", 1),
        ("disk margin, worst case", "bandwidth", -1),
    ):
        row = traded[wanted]
        assert way * (row.after - row.before) > 0.0
        [conflict] = row.violated
        assert conflict.after.name == lost
        assert conflict.after.value < conflict.before.value
    promised(rows, GYRO)


def test_the_loop_around_the_one_that_is_changed_is_measured_too() -> None:
    data = camera({"disk_margin": 1.55, "bandwidth_hz": 10}, TRACK)
    rows = changes(checked(data))
    assert {row.loop for row in rows} == {"rate", "track"}
    promised(rows, data)


def test_an_option_is_moved_for_a_limit_of_the_budget() -> None:
    data = camera({"disk_margin": 0.4}, budget={"jitter": 1e-6})
    result = checked(data)
    assert result.budget is not None
    data["budget"]["limits"]["jitter"] = 0.8 * result.budget.jitter
    rows = changes(checked(data))
    assert any(row.kind == "option" and row.target.before.subject == "line of sight" for row in rows)
    promised(rows, data, rel=2e-4)


def test_a_job_whose_runs_alone_fail_has_no_rows() -> None:
    data = job(loop=[caging(classical(), limits={"disk_margin": 0.1})], manoeuvre=[turn(limits={"angle": 1e-7})])
    result = checked(data)
    assert [one.stage for one in result.requirements if not one.passed] == ["simulated"]
    assert changes(result) == ()


def test_a_limit_out_of_reach_has_no_rows() -> None:
    data = copy.deepcopy(GYRO)
    # Close to 2, the largest disk margin of any loop.
    data["loop"] = [caging(classical(), limits={"disk_margin": 1.99})]
    rows = changes(checked(data))
    assert not any(row.target.after.passed for row in rows)
