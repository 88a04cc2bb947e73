"""Systems with long delays: responses and norms against those of all their states."""

from __future__ import annotations

import control
import numpy as np
import pytest

from platform_ctrl import analysis

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
