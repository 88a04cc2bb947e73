"""Sampling with lag and delay against finer sampling, closed forms and python-control."""

from __future__ import annotations

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from platform_ctrl import analysis


def random_plant(seed: int) -> control.StateSpace:
    rng = np.random.default_rng(seed)
    return control.ss(
        rng.normal(size=(4, 4)) - np.eye(4),
        rng.normal(size=(4, 3)),
        rng.normal(size=(2, 4)),
        rng.normal(size=(2, 3)),
        inputs=["Q4", "Q5", "Q7"],
        outputs=["alpha4", "beta5"],
        states=["a", "b", "c", "d"],
    )


@pytest.mark.parametrize("seed", range(4))
def test_without_delay_it_is_the_zero_order_hold(seed: int) -> None:
    plant = random_plant(seed)
    ours, reference = analysis.sampled(plant, 0.2), control.c2d(plant, 0.2, method="zoh")
    for name in "ABCD":
        np.testing.assert_allclose(getattr(ours, name), getattr(reference, name), atol=1e-12)
    assert ours.dt == 0.2
    assert list(ours.state_labels) == ["a", "b", "c", "d"]


@given(st.integers(0, 10**6), st.integers(0, 35))
@settings(max_examples=25, deadline=None)
def test_any_delay_agrees_with_sampling_ten_times_as_fast(seed: int, tenths: int) -> None:
    plant, lag, period, count = random_plant(seed), [0.0, 0.05, 0.3], 0.1, 12
    u = np.random.default_rng(seed).normal(size=(3, count))
    coarse = analysis.sampled(plant, period, delay=tenths * 0.01, lag=lag)
    fine = analysis.sampled(plant, 0.01, lag=lag)
    late = np.concatenate([np.zeros((3, tenths)), np.repeat(u, 10, axis=1)], axis=1)[:, : 10 * count]
    expected = analysis.time_response(fine, 0.01 * np.arange(10 * count), late)[:, ::10]
    found = analysis.time_response(coarse, period * np.arange(count), u)
    np.testing.assert_allclose(found, expected, atol=1e-10 * np.abs(expected).max())


def test_a_delay_of_whole_periods_up_to_rounding_adds_no_extra_state() -> None:
    plant = control.ss([[-1.0]], [[1.0]], [[1.0]], 0)
    # 0.3 / 0.1 is 2.9999999999999996.
    assert analysis.sampled(plant, 0.1, delay=0.3).nstates == 4


def test_a_delayed_integrator_splits_its_step_between_two_samples() -> None:
    system = analysis.sampled(control.ss([[0.0]], [[1.0]], [[1.0]], 0), 1.0, delay=0.25)
    out = analysis.time_response(system, np.arange(5.0), [1.0, 0.0, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(out, [0.0, 0.75, 1.0, 1.0, 1.0], atol=1e-14)


def test_widely_spread_poles_keep_their_digits() -> None:
    A = np.array([[-1e-3, 0.0], [0.0, -1e9]])
    system = analysis.sampled(control.ss(A, [[1.0], [1e9]], np.eye(2), 0), 1e-3)
    np.testing.assert_allclose(system.A, [[np.exp(-1e-6), 0.0], [0.0, 0.0]], rtol=1e-12)
    np.testing.assert_allclose(system.B, [[-np.expm1(-1e-6) * 1e3], [1.0]], rtol=1e-11)
