"""What a result advises: changes that do what a check with them finds, and what bounds a loop, by asymptotes."""

from __future__ import annotations

import copy
from typing import Any

import pytest

import platform_ctrl as pc
from camera_job import camera_job, tracking_loop
from design import test_sight as sight
from one_axis import job_of, loop_of, one_axis
from platform_ctrl import design
from platform_ctrl.report import write_page
from platform_ctrl.verification.bounds import loop_bounds
from platform_ctrl.verification.changes import changes, keyed
from platform_ctrl.verification.result_file import result_record
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
TRACK = tracking_loop({"disk_margin": 1.6}, crossover_hz=2.0, integral_hz=0.3)


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


J, RATE = 0.07, 2000.0


def bounded_job(delay=0.0, noise=0.0, modes=(), crossover=1.0, uncertainty=None, **limits):
    """A rate loop, almost pure gain over an inertia."""
    plant = one_axis(
        [0.05, 0.05, J],
        torquer=[{"gimbal": "g", "name": "Q", "limit": 1.0}],
        rate_sensor=[{"name": "gyro", "body": "g", "axis": [0, 0, 1], "noise_rms": noise}],
        mode=list(modes),
    )
    options = {"crossover_hz": crossover, "integral_hz": 1e-3, "rolloff_hz": 0.44 * RATE}
    loop = loop_of("g", ["gyro"], "pi", kind="rate", limits=limits, design=options)
    more = {"operation": {"Omega": [0.0, 0.0, 0.0]}, "uncertainty": uncertainty or {}}
    return pc.read_job(job_of(plant, loop, rate_hz=RATE, delay=delay, **more))


def bounds_of(one):
    [outcome] = design.loops(one)
    return loop_bounds(one, outcome)


def test_a_delay_alone_bounds_the_bandwidth_by_its_inverse():
    # 40 samples of delay; the hold adds half a sample and the low-pass a third of one.
    found = bounds_of(bounded_job(delay=0.02, disk_margin=0.8))
    [one] = found.bounds
    assert (one.parameter, found.requirement) == ("delay", "disk margin")
    assert one.sensitivity == pytest.approx(-1.0, abs=0.04)
    # Of the loop g/s e^(-sT) the margin 0.8 allows g T of a bit less than 0.6.
    again = bounds_of(bounded_job(delay=0.02, disk_margin=0.8, crossover=found.gain))
    assert again.gain == pytest.approx(1.0, abs=2e-3)


def test_the_peak_of_a_mode_bounds_the_bandwidth_by_its_frequency():
    mode = {"name": "arm", "frequency": 200.0, "damping": 0.01, "participation": {"Q": 2.0, "gyro": -2.0}}
    found = bounds_of(bounded_job(modes=[mode], disk_margin=0.5))
    [one] = found.bounds
    assert one.parameter == "frequency of arm"
    assert one.sensitivity == pytest.approx(1.0, abs=0.1)


def test_noise_bounds_the_bandwidth_by_its_limit(tmp_path):
    one = bounded_job(noise=1e-4, disk_margin=0.1, torque_noise=1e-4, delay=1e-4)
    found = bounds_of(one)
    by_name = {bound.parameter: bound.sensitivity for bound in found.bounds}
    assert found.bounds[0].parameter == "noise"
    assert by_name["noise"] == pytest.approx(-1.0, abs=0.05)
    assert abs(by_name["delay"]) < 0.1
    result = pc.verification.check_job(one, design.loops(one))
    record = result_record(result)["controllers"][0]["bounds"]
    assert record["of"][0]["parameter"] == "noise"
    assert record["requirement"].startswith("torque noise")
    shown = write_page(result, tmp_path / "report.html").read_text(encoding="utf-8")
    assert "What bounds the bandwidth" in shown
    assert "The noise changes it most" in shown


def test_a_bound_holds_for_plants_that_are_worst_at_another_gain():
    # A slow loop is worst with a small inertia, a fast one with one of the modes at an end of its range.
    def at(crossover):
        sizes = {"a": (179.0, 0.016, 1.2, -1.0), "b": (776.0, 0.01, 1.0, 1.0)}
        modes = [
            {"name": name, "frequency": w, "damping": zeta, "participation": {"Q": phi, "gyro": phi * sign}}
            for name, (w, zeta, phi, sign) in sizes.items()
        ]
        uncertain = {"mode_frequency": 0.2, "inertia": 0.2}
        return bounded_job(1.9e-4, 0.0, modes, crossover, uncertain, disk_margin=0.3, disk_margin_worst_case=0.3)

    gain = 1.95 * bounds_of(at(1.95)).gain
    met = [all(r.passed for r in design.loops(at(share * gain))[0].closed.results) for share in (0.98, 1.02)]
    assert met == [True, False]


def test_a_loop_that_misses_its_limits_is_bounded_below_its_gain():
    found = bounds_of(bounded_job(delay=0.02, disk_margin=0.8, crossover=12.0))
    assert 0.2 < found.gain < 0.8


def test_what_bounds_a_loop_is_said_beside_limits_of_the_line_of_sight():
    """With a delay, which makes the plants anew; limits far off change nothing."""
    found = []
    for far in ({}, {"jitter": 1.0, "contrast": 0.01}):
        one = sight.job(limits={"disk_margin": 0.3} | far)
        found.append(bounds_of(one))
    without, within = ((of.gain, of.requirement, of.bounds[0].sensitivity) for of in found)
    assert within == pytest.approx(without)


def tracked(crossover: float) -> pc.Job:
    """A loop on a reading that is 50 ms old, almost pure gain, around a rate loop fifty times as fast."""
    plant = one_axis(
        [0.05, 0.05, J],
        torquer=[{"gimbal": "g", "name": "Q", "limit": 1.0}],
        rate_sensor=[{"name": "gyro", "body": "g", "axis": [0, 0, 1]}],
        pickoff=[{"gimbal": "g", "delay": 0.05}],
    )
    rates = {"crossover_hz": 100.0, "integral_hz": 1e-3, "rolloff_hz": 0.44 * RATE}
    inner = loop_of("g", ["gyro"], "pi", kind="rate", name="rate", limits={"disk_margin": 0.1}, design=rates)
    slow = {"name": "d", "method": "pi", "crossover_hz": crossover, "integral_hz": 1e-3}
    outer = {"name": "T", "kind": "tracking", "around": "rate", "sensors": ["q"], "use": "d", "design": [slow]}
    still = {"operation": {"Omega": [0.0, 0.0, 0.0]}}
    return pc.read_job(job_of(plant, inner, outer | {"limits": {"disk_margin": 0.8}}, rate_hz=RATE, **still))


def test_the_age_of_its_reading_bounds_a_tracking_loop_by_its_inverse():
    outer, inner = design.loops(one := tracked(1.0))
    found = loop_bounds(one, outer, inner)
    by_name = {bound.parameter: bound.sensitivity for bound in found.bounds}
    # The rate loop inside adds its own lag of about 1/(2 pi 100 Hz), which a larger gain shortens.
    assert found.bounds[0].parameter == "delay of its sensors"
    assert by_name["delay of its sensors"] == pytest.approx(-50.0 / (50.0 + 1.6), abs=0.03)
    assert by_name["gain of rate"] == pytest.approx(1.6 / (50.0 + 1.6), abs=0.02)
    outer, inner = design.loops(again := tracked(found.gain))
    assert loop_bounds(again, outer, inner).gain == pytest.approx(1.0, abs=2e-3)
