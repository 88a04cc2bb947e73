"""Metrics of loops against formulas: steps, gain and phase margins, damping, and grids that miss no resonance."""

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

import platform_ctrl as pc
from camera_job import camera_job
from platform_ctrl import design
from platform_ctrl.analysis.margins import margins_of_channel
from platform_ctrl.analysis.poles import following_grid, minimum_damping
from platform_ctrl.analysis.system import System
from platform_ctrl.analysis.time_responses import overshoot, ramp_error, settling_time, steady_error, step_responses
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
    whole = expm(np.block([[A, np.array([[0.0], [w * w]])], [np.zeros((1, 3))]]) * step)
    loop = System(whole[:2, :2], whole[:2, 2:], np.array([[1.0, 0.0]]), np.zeros((1, 1)), step)
    expected = np.exp(-np.pi * damping / np.sqrt(1.0 - damping**2))
    assert overshoot(*step_responses(loop, damping * w)) == pytest.approx([expected], rel=1e-5)
    assert ramp_error(loop) == pytest.approx([2.0 * damping / w], abs=step)


def sensitivity(L: control.StateSpace) -> System:
    return System.of(control.feedback(control.ss([], [], [], [[1.0]], L.dt), L), "S")


@pytest.mark.parametrize("gain", [0.2, 0.9])
def test_an_integrator_with_one_sample_of_delay_has_the_margins_of_its_formula(gain):
    """L = g/(z (z − 1)): real at ωT = π/3, where |L| = g; |L| = 1 at 2 sin(ωT/2) = g with −90° − 1.5 ωT of phase."""
    L = control.ss(control.tf([gain], [1.0, -1.0, 0.0], 0.01))
    found, phase = margins_of_channel(sensitivity(L))
    assert found == pytest.approx(1.0 / gain, rel=1e-9)
    assert phase == pytest.approx(0.5 * np.pi - 3.0 * np.arcsin(0.5 * gain), rel=1e-9)


def test_a_loop_that_may_lose_gain_has_a_margin_downwards():
    """A plant that diverges, z = 1.1, under L = g/(z − 1.1): stable for 0.1 < g < 2.1."""
    for gain, margin in ((0.15, 1.5), (1.9, 2.1 / 1.9)):
        L = control.ss(control.tf([gain], [1.0, -1.1], 0.01))
        found, _ = margins_of_channel(sensitivity(L))
        assert found == pytest.approx(margin, rel=1e-5)


def test_a_slow_pole_hides_no_gain_at_zero_frequency():
    """P = 1/(s - 0.2) under K = 0.3: |L(0)| = 1.5, and L turns away from there within a tenth of 1 rad/s."""
    L = control.sample_system(control.ss([[0.2]], [[1.0]], [[0.3]], 0), 4e-4)
    assert margins_of_channel(sensitivity(L))[0] == pytest.approx(1.5, rel=1e-9)
    slow = control.sample_system(control.ss([[2e-5]], [[1.0]], [[3e-5]], 0), 4e-4)
    assert margins_of_channel(sensitivity(slow))[0] == pytest.approx(1.5, rel=1e-6)


def test_an_unstable_loop_has_no_margin():
    job = pc.read_job(camera_job())
    found = design.loops(job)[0].closed
    K = control.ss(found.controller)
    reversed_sign = control.StateSpace(K.A, K.B, -K.C, -K.D, K.dt, inputs=K.input_labels, outputs=K.output_labels)
    for kind in ("gain margin", "phase margin"):
        assert requirement(kind, 1.0).check(found.plants, reversed_sign).value == 0.0


def test_minimum_damping_counts_slow_and_unstable_poles() -> None:
    slow, fast = [-0.01 + 1j, -0.01 - 1j], [-30.0 + 40j, -30.0 - 40j]
    poles = np.array([slow + fast, [2.0, 3.0, *fast], [*fast, *fast]])
    np.testing.assert_allclose(minimum_damping(poles), [0.01, -1.0, 0.6], rtol=1e-3)
    # What rounding makes of a double pole next to z = 1 has no damping.
    np.testing.assert_allclose(minimum_damping(np.array([1.0 - 1e-9 + 1e-8j, 1.0 - 1e-9 - 1e-8j, 0.5]), 1e-3), 1.0)
    assert minimum_damping(np.zeros(0, dtype=complex)) == 1.0


@settings(max_examples=40, deadline=None)
@given(st.floats(3e-3, 0.6), st.floats(20.0, 2000.0))
def test_the_grid_shows_the_peak_of_every_resonance(damping: float, frequency: float) -> None:
    s = frequency * (-damping + 1j * np.sqrt(1.0 - damping**2))
    w = following_grid(np.array([s, s.conjugate()]), 1.0, 1e4)
    gain = np.abs(frequency**2 / ((frequency**2 - w**2) + 2j * damping * frequency * w))
    assert gain.max() == pytest.approx(1.0 / (2.0 * damping * np.sqrt(1.0 - damping**2)), rel=0.02)


def test_no_response_is_evaluated_on_an_undamped_pole() -> None:
    w = following_grid(np.array([100j, -100j, 0.0]), 1.0, 1e4)
    assert np.abs(w - 100.0).min() > 0.01
    assert np.all(np.diff(w) > 0.0)
