"""Overshoot, settling and remaining errors against formulas of sampled loops of first and second order."""

import numpy as np
import pytest

import platform_ctrl as pc
from camera_job import camera_job, camera_loop
from platform_ctrl import design
from platform_ctrl.analysis.system import System
from platform_ctrl.analysis.time_responses import overshoot, ramp_error, settling_time, steady_error, step_responses
from platform_ctrl.design.plants import job_signals, linear_plants, loop_cases
from platform_ctrl.job.requirements import requirement

T = 0.01


def first_order(pole: float, gain: float = 1.0) -> System:
    """y[k] = gain (1 − pole^k): an integrator closed over one sample."""
    return System(np.array([[pole]]), np.array([[1.0 - pole]]), np.array([[gain]]), np.zeros((1, 1)), T)


def test_a_first_order_loop_settles_by_its_pole_and_lags_a_ramp_by_its_time_constant():
    loop = first_order(0.9)
    steps = step_responses(loop, -np.log(0.9) / T)
    # Between two samples a straight line.
    samples = np.floor(np.log(0.02) / np.log(0.9))
    before, after = 0.9**samples, 0.9 ** (samples + 1)
    expected = T * (samples + (before - 0.02) / (before - after))
    assert settling_time(*steps) == pytest.approx([expected])
    assert overshoot(*steps) == pytest.approx([0.0], abs=1e-12)
    assert steady_error(loop) == pytest.approx([0.0])
    # The integral of the error over a unit step: T/(1 − pole).
    assert ramp_error(loop) == pytest.approx([T / 0.1])


def test_a_loop_that_falls_short_has_a_steady_error_and_never_settles():
    loop = first_order(0.9, gain=0.95)
    assert steady_error(loop) == pytest.approx([0.05])
    assert settling_time(*step_responses(loop, -np.log(0.9) / T)) == [np.inf]
    assert ramp_error(loop) == [np.inf]


@pytest.mark.parametrize("damping", [0.2, 0.5])
def test_a_second_order_loop_overshoots_as_in_the_textbook(damping):
    """exp(−π ζ/√(1 − ζ²)), sampled finely."""
    w, step = 10.0, 1e-4
    A = np.array([[0.0, 1.0], [-w * w, -2.0 * damping * w]])
    from scipy.linalg import expm

    whole = expm(np.block([[A, np.array([[0.0], [w * w]])], [np.zeros((1, 3))]]) * step)
    loop = System(whole[:2, :2], whole[:2, 2:], np.array([[1.0, 0.0]]), np.zeros((1, 1)), step)
    expected = np.exp(-np.pi * damping / np.sqrt(1.0 - damping**2))
    assert overshoot(*step_responses(loop, damping * w)) == pytest.approx([expected], rel=1e-5)
    assert ramp_error(loop) == pytest.approx([2.0 * damping / w], abs=step)


def test_requirements_measure_every_channel_of_a_pointing_loop():
    loops = camera_loop("pointing", "classical", design=[{"name": "pi", "method": "classical"}])
    job = pc.read_job(camera_job(loop=loops))
    found = design.loops(job)[0].closed
    values = {
        kind: requirement(kind, 1.0).check(found.plants, found.controller).value
        for kind in ("overshoot", "settling time", "steady-state error", "ramp error")
    }
    # With integral action behind two integrals a ramp leaves no error.
    assert values["steady-state error"] == 0.0
    assert values["ramp error"] == pytest.approx(0.0, abs=1e-9)
    time, steps = fine_steps(job, found.plants.period, System.of(found.controller, "K"))
    assert values["overshoot"] == pytest.approx(steps.max() - 1.0, rel=1e-3)
    settled = [time[np.flatnonzero(np.abs(y - 1.0) > 0.02)[-1]] for y in steps]
    assert values["settling time"] == pytest.approx(max(settled), abs=2.0 * time[1])
    # The samples alone would look better.
    at_samples = steps[:, :: round(found.plants.period / time[1])]
    assert at_samples.max() < steps.max() - 1e-4


def fine_steps(job, period: float, K: System) -> tuple[np.ndarray, np.ndarray]:
    """Steps of each command of u = K (y - r), held with its delay, through the continuous plant in steps of T/40."""
    from scipy.linalg import expm

    signals = job_signals(job, job.loops[0])
    plant = linear_plants(signals, loop_cases(job, signals)[:1]).system.at(0)
    lag = np.array([one.lag for one in signals.torquers])
    A, B, C = plant.A, plant.B[:, : len(lag)], plant.C[: len(signals.sensors)]
    n, m, fine = len(A), B.shape[1], 40
    whole = np.zeros((n + 2 * m, n + 2 * m))
    whole[:n, :n], whole[:n, n : n + m] = A, B
    if lag.all():
        whole[n : n + m, n : n + m], whole[n : n + m, n + m :] = -np.diag(1.0 / lag), np.diag(1.0 / lag)
    step = expm(whole * period / fine)
    late = round(job.sampling.delay / period * fine)
    assert late == pytest.approx(job.sampling.delay / period * fine)
    out = []
    for k in range(len(C)):
        x, x_K, u, held, y = np.zeros(n + 2 * m), np.zeros(len(K.A)), np.zeros(m), {}, []
        for i in range(fine * 4000):
            if i % fine == 0:
                error = C @ x[:n] - np.eye(len(C))[k]
                held[i + late] = K.C @ x_K + K.D @ error
                x_K = K.A @ x_K + K.B @ error
            u = held.pop(i, u)
            if lag.all():
                x[n + m :] = u
            else:
                x[n : n + m] = u
            y.append(C[k] @ x[:n])
            x = step @ x
        out.append(y)
    return period / fine * np.arange(fine * 4000), np.array(out)
