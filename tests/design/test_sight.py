"""The budget of the line of sight as a limit and a goal of designs, against the budget itself and differences."""

import numpy as np
import pytest

import platform_ctrl as pc
from camera_job import camera_job, camera_loop
from platform_ctrl import design
from platform_ctrl.analysis.sight import blur_of, contrast_of
from platform_ctrl.analysis.system import System
from platform_ctrl.design.fixed_structure.loops import LoopGradients
from platform_ctrl.errors import InputError
from platform_ctrl.verification.budget import line_of_sight_budget

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


def budget_of(one, found):
    """Return the values of the budget's limits with a design closed, by their names."""
    return {result.name: result.value for result in line_of_sight_budget(one, [found.controller]).results}


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


def test_forms_in_the_controller_are_the_budget_and_their_slopes_those_of_differences(measured):
    _, found = measured
    K = System.of(found.controller, "pi")
    forms, other = found.plants.sight_budget.forms(K), K._replace(C=1.2 * K.C, D=1.2 * K.D)
    exact, elsewhere = found.plants.sight_budget.exact(K), found.plants.sight_budget.exact(other)
    for key in KEYS:
        assert max(form.at(K) for form in forms[key]) == pytest.approx(exact[key], rel=1e-6)
        # Dry friction is that with K.
        assert max(form.at(other) for form in forms[key]) == pytest.approx(elsewhere[key], rel=2e-2)
    # Of a Gaussian motion, with all of the windows' motion in one variance.
    blurred = max(form.at(K) for form in forms["contrast"])
    assert contrast_of(blurred) == pytest.approx(exact["contrast"], abs=2e-3)
    assert contrast_of(blurred) <= exact["contrast"]
    assert blur_of(contrast_of(blurred)) == pytest.approx(blurred)
    n, M = len(K.A), np.block([[K.A, K.B], [K.C, K.D]])
    step = np.random.default_rng(3).standard_normal(M.shape) * np.abs(M) * 1e-6

    def at(M):
        return LoopGradients(found.plants, System(M[:n, :n], M[:n, n:], M[n:, :n], M[n:, n:], K.dt))

    for key in (*KEYS, "contrast"):
        here, high, low = (at(M + sign * step).sight(forms[key], 1e-5) for sign in (0.0, 1.0, -1.0))
        slopes = np.sum(here.gradient * step, axis=(1, 2))
        np.testing.assert_allclose(slopes, 0.5 * (high.ratio - low.ratio), rtol=1e-4, atol=1e-12)


def test_a_jitter_below_that_of_the_given_design_is_tuned():
    one = job()
    given = budget_of(one, design.loops(one)[0].closed)["line-of-sight jitter"]
    start = {"name": "pi", "method": "pi", "crossover_hz": 30, "integral_hz": 3, "tune": True}
    tuned = job(limits={"disk_margin": 0.5, "jitter": 0.7 * given}, design=[start])
    found = design.loops(tuned)[0].closed
    assert found.passed
    assert budget_of(tuned, found)["line-of-sight jitter"] <= 0.7 * given


def test_a_structured_design_makes_jitter_small_within_its_limits():
    one = job()
    given = design.loops(one)[0].closed
    structured = {"name": "pi", "method": "structured", "structure": "pid", "evaluations": 80}
    goal = job(soft={"jitter": 1e-7}, design=[structured])
    found = design.loops(goal)[0].closed
    reached = budget_of(goal, found)["line-of-sight jitter"]
    assert found.passed
    assert reached < 0.6 * budget_of(one, given)["line-of-sight jitter"]
    assert found.goals[0].value == pytest.approx(reached, rel=1e-6)


def test_a_structured_design_leaves_the_contrast_that_is_asked():
    one = job()
    given = design.loops(one)[0].closed
    reached = budget_of(one, given)["contrast of the image"]
    structured = {"name": "pi", "method": "structured", "structure": "pid", "evaluations": 80}
    asked = 1.0 - 0.6 * (1.0 - reached)
    found = design.loops(job(limits={"disk_margin": 0.5, "contrast": asked}, design=[structured]))[0].closed
    assert found.passed
    assert reached < asked <= budget_of(one, found)["contrast of the image"]


SINGLE = camera_loop(limits={"jitter": 1e-5}, gimbals=["az"], sensors=["yaw_gyro"], name="yaw")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"budget": None}, "jitter needs a budget of the line of sight"),
        ({"loop": SINGLE + camera_loop(gimbals=["el"], sensors=["pitch_gyro"])}, r"use \[budget.limits\]"),
    ],
)
def test_a_limit_that_the_job_has_no_budget_for_is_refused(changes, words):
    data = camera_job(budget=BUDGET, loop=camera_loop(limits={"jitter": 1e-5})) | changes
    with pytest.raises(InputError, match=words):
        pc.read_job({key: item for key, item in data.items() if item is not None})
