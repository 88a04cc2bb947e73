"""The budget of the line of sight as a limit and a goal of designs, against the budget itself and differences."""

import functools

import pytest

import platform_ctrl as pc
from camera_job import camera_job, camera_loop
from given_controllers import outcomes, verdict
from platform_ctrl import design
from platform_ctrl.errors import InputError

PITCH = {
    "name": "pitch",
    "kind": "base-rate",
    "axis": 2,
    "frequencies_hz": [0.5, 5.0, 200.0],
    "densities": [1e-3, 1e-3, 1e-6],
}
YAW = PITCH | {"name": "yaw", "axis": 3}
FAN = {"name": "fan", "kind": "torque", "gimbal": "el", "sines": [[40.0, 2e-3, 0.0], [1100.0, 1e-2, 1.0]]}
BUDGET = {
    "from_hz": 0.5,
    "to_hz": 1200.0,
    "exposure": [0.005, 0.02],
    "spatial_frequencies": [50.0, 2000.0],
    "limits": {"jitter": 1.0, "windowed_jitter": 1.0, "jitter_per_axis": 1.0, "smear": 1.0, "contrast": 0.01},
    "source": [PITCH, YAW, FAN],
}
KEYS = ("jitter", "jitter_per_axis", "windowed_jitter", "smear")


def job(angles=(), **loop):
    """Return the job of the small camera gimbal, with its budget, elevations and a loop with these keys."""
    own, at = {"limits": {"disk_margin": 0.5}} | loop, {"angles": {"q_el": list(angles)}} if angles else {}
    operation = {"Omega": [0.2, 0.2, 0.2]} | at
    return pc.read_job(camera_job(budget=BUDGET, operation=operation, loop=camera_loop(**own)))


@functools.cache
def given_values():
    """Return the values of the budget with the PI as given."""
    one = job()
    return budget_of(one, design.loops(one)[0].closed)


def budget_of(one, found):
    """Return the values of the budget's limits with a design closed, by their names."""
    return {result.name: result.value for result in verdict(one, [found.controller]).budget.results}


@pytest.fixture(scope="module")
def measured():
    """A PI whose loop is limited by every rms of the budget."""
    one = job([0.6], limits=dict.fromkeys(KEYS, 1.0) | {"contrast": 0.01})
    return one, design.loops(one)[0].closed


def test_a_design_is_measured_by_the_budget_of_its_job(measured):
    one, found = measured
    expected, values = budget_of(one, found), {result.name: result.value for result in found.results}
    assert len(expected) == 5
    for name, value in expected.items():
        assert values[name] == pytest.approx(value, rel=1e-6)


def test_a_jitter_below_that_of_the_given_design_is_tuned():
    given = given_values()["line-of-sight jitter"]
    start = {"name": "pi", "method": "pi", "crossover_hz": 30, "integral_hz": 3, "tune": True}
    tuned = job(limits={"disk_margin": 0.5, "jitter": 0.7 * given}, design=[start])
    found = design.loops(tuned)[0].closed
    assert found.passed
    assert budget_of(tuned, found)["line-of-sight jitter"] <= 0.7 * given


def test_a_structured_design_makes_jitter_small_within_its_limits():
    structured = {"name": "pi", "method": "structured", "structure": "pid", "evaluations": 20}
    goal = job(soft={"jitter": 1e-7}, design=[structured])
    found = design.loops(goal)[0].closed
    reached = budget_of(goal, found)["line-of-sight jitter"]
    assert found.passed
    assert reached < 0.6 * given_values()["line-of-sight jitter"]
    assert found.goals[0].value == pytest.approx(reached, rel=1e-6)


@pytest.mark.slow
def test_a_structured_design_leaves_the_contrast_that_is_asked():
    reached = given_values()["contrast of the image"]
    structured = {"name": "pi", "method": "structured", "structure": "pid", "evaluations": 20}
    asked = 1.0 - 0.6 * (1.0 - reached)
    one = job(limits={"disk_margin": 0.5, "contrast": asked}, design=[structured])
    found = design.loops(one)[0].closed
    assert found.passed
    assert reached < asked <= budget_of(one, found)["contrast of the image"]


def two_loops(rate_hz=2000, start=None, yaw_hz=30, **limits):
    """Return the job with a loop of each axis, both with these limits."""
    axes = {"yaw": ("az", "yaw_gyro", yaw_hz), "pitch": ("el", "pitch_gyro", 30)}
    loops = []
    for name, (gimbal, gyro, hz) in axes.items():
        own = start or {"name": "pi", "method": "pi", "crossover_hz": hz, "integral_hz": 3}
        loop = camera_loop(limits={"disk_margin": 0.5} | limits, name=name, gimbals=[gimbal], sensors=[gyro])
        loops += [one | {"design": [own]} for one in loop]
    loops[1]["rate_hz"] = rate_hz
    return pc.read_job(camera_job(budget=BUDGET, loop=loops))


@pytest.mark.slow
def test_several_loops_keep_the_jitter_that_they_have_together():
    given = verdict(two_loops(), [one.closed.controller for one in design.loops(two_loops())]).budget.jitter
    start = {"name": "pi", "method": "pi", "crossover_hz": 15, "integral_hz": 2, "tune": True}
    tuned = two_loops(start=start, jitter=0.9 * given)
    made = design.loops(tuned)
    controllers = [one.closed.controller for one in made]
    reached = verdict(tuned, controllers).budget.jitter
    assert reached <= 0.9 * given
    for one in (*made, *outcomes(tuned, controllers)):
        assert one.closed.passed
        [own] = [result.value for result in one.closed.results if result.name == "line-of-sight jitter"]
        assert own == pytest.approx(reached, rel=1e-6)


def test_a_limit_that_the_job_has_no_budget_for_is_refused():
    data = camera_job(loop=camera_loop(limits={"jitter": 1e-5}))
    with pytest.raises(InputError, match="jitter needs a budget of the line of sight"):
        pc.read_job(data)
    with pytest.raises(InputError, match=r"use \[budget.limits\]"):
        two_loops(rate_hz=1000, jitter=1e-5)


@pytest.mark.parametrize(("place", "most"), [("limits", 1.0), ("limits", 30.0), ("soft", 1.2)])
def test_a_contrast_that_no_image_has_is_refused(place, most):
    with pytest.raises(InputError, match=r"contrast must be a share between 0 and 1, got"):
        job(**{place: {"contrast": most}})
