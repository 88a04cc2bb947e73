"""Frequency and time responses against closed forms and python-control."""

from __future__ import annotations

import control
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from platform_ctrl import analysis

seeds = st.integers(0, 2**31 - 1)


def test_a_double_integrator_sampled_fast_keeps_its_digits_at_low_frequency() -> None:
    period, w = 1e-4, np.geomspace(1e-3, 1e3, 30)
    plant = analysis.sampled(control.ss([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], [[1.0, 0.0]], 0), period)
    z_minus_1 = np.expm1(1j * w * period)
    truth = 0.5 * period**2 * (z_minus_1 + 2.0) / z_minus_1**2
    np.testing.assert_allclose(analysis.frequency_response(plant, w)[0, 0], truth, rtol=1e-9)


def test_undamped_oscillation_keeps_its_phase_over_thousands_of_samples() -> None:
    system = control.ss([[0.0, 3.0], [-3.0, 0.0]], [[0.0], [0.0]], np.eye(2), np.zeros((2, 1)))
    t = np.arange(20001) / 128.0
    out = analysis.time_response(system, t, np.zeros(t.size), initial_state=[1.0, 0.0])
    np.testing.assert_allclose(out, [np.cos(3.0 * t), -np.sin(3.0 * t)], rtol=0, atol=2e-11)


@given(seeds)
@settings(max_examples=15, deadline=None)
def test_time_response_of_a_discrete_system_is_its_recurrence(seed: int) -> None:
    rng = np.random.default_rng(seed)
    A = 0.5 * rng.normal(size=(3, 3))
    B, C, D = rng.normal(size=(3, 1)), rng.normal(size=(2, 3)), rng.normal(size=(2, 1))
    u = rng.normal(size=2 + seed % 60)
    x, reference = np.zeros((3, 1)), []
    for one in u:
        reference.append(C @ x + D * one)
        x = A @ x + B * one
    out = analysis.time_response(control.ss(A, B, C, D, 0.1), 0.1 * np.arange(u.size), u)
    expected = np.hstack(reference)
    np.testing.assert_allclose(out, expected, atol=1e-11 * max(1.0, np.abs(expected).max()))
