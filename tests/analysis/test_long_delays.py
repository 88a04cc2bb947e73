"""Systems with long delays: responses, norms and crossings against what has the delays as powers of z."""

from __future__ import annotations

import numpy as np
import pytest

from platform_ctrl.analysis.norms import hinf_norm
from platform_ctrl.analysis.singular_values import FrequencyAxis
from platform_ctrl.analysis.system import System

T = 1e-3


def delayed(n: int, lengths: tuple[int, ...]) -> System:
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
    return System(A, B, C, rng.normal(size=(3, 2)), T)


@pytest.mark.parametrize("lengths", [(60, 70), (250, 250)])
def test_responses_behind_long_delays_are_those_of_all_states(lengths: tuple[int, ...]) -> None:
    A, B, C, D, _ = system = delayed(8, lengths)
    w = np.concatenate([[0.0], np.geomspace(1e-3, np.pi / T, 40)])
    exact = [C @ np.linalg.solve(z * np.eye(len(A)) - A, B) + D for z in np.exp(1j * w * T)]
    np.testing.assert_allclose(FrequencyAxis(system).response(w), exact, rtol=0.0, atol=1e-12)


def test_norms_and_crossings_behind_long_delays_are_those_of_the_hamiltonian(monkeypatch: pytest.MonkeyPatch) -> None:
    system = delayed(8, (60, 70))
    norm, frequency = hinf_norm(system)
    found = FrequencyAxis(system).crossings(0.9 * norm)
    monkeypatch.setattr("platform_ctrl.analysis.response._LATE", 10_000)
    assert hinf_norm(system) == pytest.approx((norm, frequency), rel=1e-8)
    axis = FrequencyAxis(system)
    exact = axis.crossings(0.9 * norm)
    exact = exact[np.abs(axis.gains(exact) / (0.9 * norm) - 1.0) < 1e-9]
    assert exact.size
    assert np.abs(found[:, None] / exact - 1.0).min(axis=0).max() < 1e-8


def test_states_that_follow_each_other_in_a_ring_stay() -> None:
    A = np.roll(np.eye(60), 1, axis=0)
    system = System(A, np.zeros((60, 1)), np.ones((1, 60)), np.ones((1, 1)), T)
    np.testing.assert_allclose(FrequencyAxis(system).response(np.array([0.3, 700.0]))[:, 0, 0], 1.0)
