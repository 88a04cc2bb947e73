"""Overshoot, settling and remaining errors against formulas of sampled loops of first and second order."""

import numpy as np
import pytest

from platform_ctrl.analysis.system import System
from platform_ctrl.analysis.time_responses import overshoot, ramp_error, settling_time, steady_error, step_responses

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
