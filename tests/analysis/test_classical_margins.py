"""Gain and phase margins against textbook loops and against a dense grid of frequencies."""

import control
import numpy as np
import pytest

import platform_ctrl as pc
from camera_job import camera_job
from platform_ctrl import design
from platform_ctrl.analysis.margins import margins_of_channel
from platform_ctrl.analysis.system import System
from platform_ctrl.job.requirements import requirement


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
