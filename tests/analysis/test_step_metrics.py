"""Overshoot, settling and remaining errors against formulas of sampled loops of first and second order."""

import numpy as np
import pytest

import platform_ctrl as pc
from camera_job import camera_job, camera_loop
from platform_ctrl import analysis, design
from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.analysis.direct_metrics import overshoot, ramp_error, settling_time, steady_error, step_responses
from platform_ctrl.job.requirements import requirement

T = 0.01


def first_order(pole: float, gain: float = 1.0) -> StateArrays:
    """y[k] = gain (1 − pole^k): an integrator closed over one sample."""
    return StateArrays(np.array([[pole]]), np.array([[1.0 - pole]]), np.array([[gain]]), np.zeros((1, 1)), T)


def test_a_first_order_loop_settles_by_its_pole_and_lags_a_ramp_by_its_time_constant():
    loop = first_order(0.9)
    steps = step_responses(loop, -np.log(0.9) / T)
    samples = np.ceil(np.log(0.02) / np.log(0.9))
    assert settling_time(steps, T) == pytest.approx([samples * T])
    assert overshoot(steps) == pytest.approx([0.0], abs=1e-12)
    assert steady_error(loop) == pytest.approx([0.0])
    # The integral of the error over a unit step: T/(1 − pole).
    assert ramp_error(loop) == pytest.approx([T / 0.1])


def test_a_loop_that_falls_short_has_a_steady_error_and_never_settles():
    loop = first_order(0.9, gain=0.95)
    assert steady_error(loop) == pytest.approx([0.05])
    assert settling_time(step_responses(loop, -np.log(0.9) / T), T) == [np.inf]
    assert ramp_error(loop) == [np.inf]


@pytest.mark.parametrize("damping", [0.2, 0.5])
def test_a_second_order_loop_overshoots_as_in_the_textbook(damping):
    """exp(−π ζ/√(1 − ζ²)), sampled finely."""
    w, step = 10.0, 1e-4
    A = np.array([[0.0, 1.0], [-w * w, -2.0 * damping * w]])
    from scipy.linalg import expm

    whole = expm(np.block([[A, np.array([[0.0], [w * w]])], [np.zeros((1, 3))]]) * step)
    loop = StateArrays(whole[:2, :2], whole[:2, 2:], np.array([[1.0, 0.0]]), np.zeros((1, 1)), step)
    expected = np.exp(-np.pi * damping / np.sqrt(1.0 - damping**2))
    assert overshoot(step_responses(loop, damping * w)) == pytest.approx([expected], rel=1e-5)
    assert ramp_error(loop) == pytest.approx([2.0 * damping / w], abs=step)


def test_requirements_measure_every_channel_of_a_pointing_loop():
    loops = camera_loop("pointing", "classical", design=[{"name": "pi", "method": "classical"}])
    found = design.loops(pc.read_job(camera_job(loop=loops)))[0].closed
    values = {
        kind: requirement(kind, 1.0).check(found.plants, found.controller).value
        for kind in ("overshoot", "settling time", "steady-state error", "ramp error")
    }
    # With integral action behind two integrals a ramp leaves no error.
    assert values["steady-state error"] == 0.0
    assert values["ramp error"] == pytest.approx(0.0, abs=1e-9)
    loop = analysis.closed_loop(found.plants.system()[["yaw_error", "pitch_error"], ["Qaz", "Qel"]], found.controller)
    t = 5e-4 * np.arange(20_000)
    worst, settled = 0.0, 0.0
    for name in ("yaw_error", "pitch_error"):
        y = -analysis.time_response(loop[name, f"noise_{name}"], t, np.ones((1, len(t))), squeeze=False)[0]
        worst = max(worst, float(y.max() - 1.0))
        settled = max(settled, t[np.flatnonzero(np.abs(y - 1.0) > 0.02)[-1] + 1])
    assert values["overshoot"] == pytest.approx(worst, rel=1e-6)
    assert values["settling time"] == pytest.approx(settled, rel=1e-9)
