"""Responses over frequency and time against closed forms; long delays against all their states."""

from __future__ import annotations

import control
import numpy as np
import pytest
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


T = 1e-3


def delayed(n: int, lengths: tuple[int, ...]) -> control.StateSpace:
    """Return a stable system of n states some of which act on the others through chains of delays, read on the way."""
    rng = np.random.default_rng(3)
    size = n + sum(lengths)
    A, B, C = np.zeros((size, size)), np.zeros((size, 2)), np.zeros((3, size))
    A[:n, :n] = 0.3 * rng.normal(size=(n, n)) / np.sqrt(n)
    B[:n], C[:, :n] = rng.normal(size=(n, 2)), rng.normal(size=(3, n))
    first = n
    for k, length in enumerate(lengths):
        A[first, k] = 1.0
        for i in range(first + 1, first + length):
            A[i, i - 1] = 2.0 if i == first + 5 else 1.0
        A[k + 1, first + length - 1] = 0.1
        C[1, first + length // 3] = 0.5
        first += length
    return control.ss(A, B, C, rng.normal(size=(3, 2)), T)


def test_responses_behind_long_delays_are_those_of_all_states() -> None:
    system = delayed(8, (250, 250))
    w = np.concatenate([[0.0], np.geomspace(1e-3, np.pi / T, 40)])
    exact = [system.C @ np.linalg.solve(z * np.eye(508) - system.A, system.B) + system.D for z in np.exp(1j * w * T)]
    np.testing.assert_allclose(analysis.frequency_response(system, w), np.moveaxis(exact, 0, -1), rtol=0.0, atol=1e-12)


def test_the_norm_behind_long_delays_is_slycots() -> None:
    pytest.importorskip("slycot")
    system = delayed(8, (60, 70))
    assert analysis.hinf_norm(system)[0] == pytest.approx(control.linfnorm(system)[0], rel=1e-8)
