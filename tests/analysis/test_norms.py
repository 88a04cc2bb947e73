"""Norms and bandwidth against closed forms, slycot and identities."""

from __future__ import annotations

import math

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from platform_ctrl import analysis

seeds = st.integers(0, 2**31 - 1)


def random_system(seed: int, n: int = 6, m: int = 2, p: int = 3, dt: float = 0.0) -> control.StateSpace:
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    if dt > 0.0:
        A *= rng.uniform(0.3, 0.99) / np.abs(np.linalg.eigvals(A)).max()
    else:
        A -= (np.linalg.eigvals(A).real.max() + 10.0 ** rng.uniform(-3, 0)) * np.eye(n)
    return control.ss(A, rng.normal(size=(n, m)), rng.normal(size=(p, n)), rng.normal(size=(p, m)), dt)


def badly_scaled(system: control.StateSpace, spread: float = 1e6) -> control.StateSpace:
    s = np.geomspace(1.0 / spread, spread, system.nstates)
    return control.ss(system.A * s[:, None] / s, system.B * s[:, None], system.C / s, system.D, system.dt)


def resonator(zeta: float, frequency: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    A = frequency * np.array([[0.0, 1.0], [-1.0, -2.0 * zeta]])
    return A, np.array([[0.0], [frequency]]), np.array([[1.0, 0.0]])


@given(seeds)
@settings(max_examples=20, deadline=None)
def test_tustins_map_keeps_the_norm(seed: int) -> None:
    system = random_system(seed)
    mapped = control.sample_system(system, 0.05, method="bilinear")
    norm, frequency = analysis.hinf_norm(mapped)
    assert norm == pytest.approx(analysis.hinf_norm(system)[0], rel=1e-7)
    at = analysis.frequency_response(system, [2 / 0.05 * math.tan(0.025 * frequency)])[..., 0]
    assert np.linalg.norm(at, 2) == pytest.approx(norm, rel=1e-6)


@pytest.mark.parametrize("zeta", [0.7, 1e-3])
def test_h2_norm_of_a_second_order_system_is_its_closed_form(zeta: float) -> None:
    A, B, C = resonator(zeta, 30.0)
    assert analysis.h2_norm(control.ss(A, B, C, 0)) == pytest.approx(math.sqrt(30.0 / (4.0 * zeta)), rel=1e-10)


@given(seeds)
@settings(max_examples=20, deadline=None)
def test_h2_norm_agrees_with_the_impulse_response(seed: int) -> None:
    system = random_system(seed, dt=0.1)
    total, state = float(np.sum(system.D**2)), system.B
    for _ in range(6000):
        total += float(np.sum((system.C @ state) ** 2))
        state = system.A @ state
    assert analysis.h2_norm(badly_scaled(system)) == pytest.approx(math.sqrt(total), rel=1e-9)


def test_bandwidth_of_an_integrating_loop_is_its_closed_form() -> None:
    # L = k/s: |S| = w / sqrt(w^2 + k^2) = 1/sqrt(2) at w = k.
    plant = control.ss([[0.0]], [[1.0]], [[1.0]], 0)
    controller = control.ss([], [], [], [[-7.0]])
    assert analysis.bandwidth(plant, controller) == pytest.approx(7.0, rel=1e-9)
    assert analysis.bandwidth(plant, controller, at="input") == pytest.approx(7.0, rel=1e-9)


@pytest.mark.parametrize("k", [1316.669, 23.937, 2791.389])
def test_a_bandwidth_at_a_point_of_the_grid_is_found_whatever_rounding_says(k):
    """S = s/(s + k) reaches 1/sqrt(2) at k, which the Hamiltonian puts on the grid; the next point lies beyond."""
    plant = control.ss([[0.0]], [[k]], [[1.0]], [[0.0]])
    assert analysis.bandwidth(plant, control.ss([], [], [], [[-1.0]])) == pytest.approx(k, rel=1e-12)


def test_bandwidth_sees_a_narrow_notch_of_the_loop_below_the_main_crossing() -> None:
    # A notch at 3 rad/s opens the loop in a band of 6e-5 rad/s, which a grid steps over.
    zeta = 1e-6
    s = control.tf([1, 0], [1])
    L = 100 / s * (s * s + 2 * zeta * 3 * s + 9) / (s * s + 2 * zeta * 3.001 * s + 3.001**2)
    plant = control.ss(L)
    controller = control.ss([], [], [], [[-1.0]])
    found = analysis.bandwidth(plant, controller)
    assert 2.99 < found < 3.0
    S = 1.0 / (1.0 + analysis.frequency_response(plant, [found])[0, 0, 0])
    assert abs(S) == pytest.approx(math.sqrt(0.5), rel=1e-6)
