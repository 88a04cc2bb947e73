"""Disk margins against python-control, closed forms, and perturbations that really destabilise."""

from __future__ import annotations

import math

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from platform_ctrl import PlatformCtrlError, analysis
from platform_ctrl.analysis.disks import disk_to_gain_phase
from platform_ctrl.analysis.mu import best_mu_bounds
from random_loops import stable_loop

seeds = st.integers(0, 2**31 - 1)


def complex_matrices(seed: int, count: int, m: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.normal(size=(count, m, m)) + 1j * rng.normal(size=(count, m, m))


@pytest.mark.parametrize("m", [1, 2, 3])
def test_up_to_three_channels_the_bounds_of_mu_meet(m: int) -> None:
    M = complex_matrices(m, 200, m)
    d = np.exp(3.0 * np.random.default_rng(m).normal(size=(200, m)))
    M = M * d[:, :, None] / d[:, None, :]
    found = best_mu_bounds(M)
    reached = np.linalg.norm(M * found.D[:, :, None] / found.D[:, None, :], 2, axis=(-2, -1))
    assert np.all(reached <= found.upper * (1.0 + 1e-12))
    np.testing.assert_allclose(reached, found.upper, rtol=2e-6)
    # What the phases reach, worked out anew, is the lower bound.
    radius = np.abs(np.linalg.eigvals(found.Q[:, :, None] * M)).max(axis=-1)
    np.testing.assert_allclose(radius, found.lower, rtol=1e-6)
    assert np.all(found.lower <= found.upper)
    # The power iteration may end at a lower hill now and then.
    assert np.quantile(found.lower / found.upper, 0.02) > 1.0 - 3e-6


@pytest.mark.parametrize("m", [2, 3, 5, 8])
def test_mu_agrees_with_slycot(m: int) -> None:
    slycot = pytest.importorskip("slycot")
    M = complex_matrices(10 + m, 12, m)
    reference = [slycot.ab13md(one, np.ones(m, int), 2 * np.ones(m, int))[0] for one in M]
    np.testing.assert_allclose(best_mu_bounds(M).upper, reference, rtol=1e-5)


@given(seeds)
@settings(max_examples=25, deadline=None)
def test_mu_lies_between_spectral_radius_and_norm_and_ignores_scaling(seed: int) -> None:
    m = 2 + seed % 5
    M = complex_matrices(seed, 3, m)
    found = best_mu_bounds(M)
    assert np.all(np.abs(np.linalg.eigvals(M)).max(axis=-1) <= found.upper * (1.0 + 1e-9))
    assert np.all(np.abs(np.einsum("kii->ki", M)).max(axis=-1) <= found.lower * (1.0 + 1e-6))
    assert np.all(found.lower <= found.upper)
    assert np.all(found.upper <= np.linalg.norm(M, 2, axis=(-2, -1)) * (1.0 + 1e-5))
    d = np.exp(2.0 * np.random.default_rng(seed).normal(size=(3, m)))
    np.testing.assert_allclose(best_mu_bounds(M * d[:, :, None] / d[:, None, :]).upper, found.upper, rtol=2e-5)


def test_mu_of_a_diagonal_a_triangular_a_rank_one_and_a_zero_matrix() -> None:
    diagonal = np.diag([1.0, -2.0, 0.5j])
    triangular = np.triu(np.ones((3, 3))) + 0j
    a, b = np.array([1.0, 2.0, 3.0]), np.array([4.0, 1.0, 1j])
    found = best_mu_bounds(np.stack([diagonal, triangular, np.outer(a, b), np.zeros((3, 3))]))
    np.testing.assert_allclose(found.upper[[0, 2, 3]], [2.0, np.sum(np.abs(a * b)), 0.0], rtol=2e-6)
    # The bound 1 is approached, not reached, as the scaling of a triangular matrix grows.
    assert 1.0 <= found.upper[1] < 1.01
    # One triple eigenvalue with one eigenvector: rounding moves it by its cube root.
    assert found.lower[1] == pytest.approx(1.0, rel=3e-5)


def test_mu_of_loops_side_by_side_is_that_of_the_worst_of_them() -> None:
    pairs = complex_matrices(5, 120, 2).reshape(30, 4, 2, 2)
    M = np.zeros((30, 8, 8), dtype=np.complex128)
    for i in range(4):
        M[:, 2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = pairs[:, i]
    alone = best_mu_bounds(pairs.reshape(120, 2, 2)).upper.reshape(30, 4).max(axis=1)
    np.testing.assert_allclose(best_mu_bounds(M).upper, alone, rtol=1e-5)


@pytest.mark.parametrize("dt", [0.0, 0.2])
@pytest.mark.parametrize(("m", "seed"), [(1, 1), (2, 2), (3, 3), (4, 4)])
def test_disk_margin_agrees_with_python_control_at_its_frequency(m: int, seed: int, dt: float) -> None:
    if m > 1:
        pytest.importorskip("slycot")
    L = stable_loop(seed, m, 6, dt)
    for skew in (0.0, 0.5):
        found = analysis.disk_margin(L, skew=skew)
        w = np.geomspace(1e-2, math.pi / dt * 0.999 if dt else 1e3, 60)
        w = np.unique(np.append(w, found.frequency if math.isfinite(found.frequency) else 1e6))
        reference = control.disk_margins(L, w, skew=skew)[0]
        assert float(found) == pytest.approx(reference, rel=1e-5)
        assert found.proved
        assert found.unstructured <= found.lower == found.alpha <= found.upper


@given(seeds)
@settings(max_examples=8, deadline=None)
def test_no_frequency_has_a_smaller_margin(seed: int) -> None:
    dt = 0.1 if seed % 2 else 0.0
    L = stable_loop(seed, 2 + seed % 2, 5, dt)
    w = np.geomspace(1e-3, math.pi / dt if dt else 1e3, 300)
    found = analysis.disk_margin(L, frequency=w)
    assert found.lower_response.shape == (300,)
    assert np.all(found.lower_response >= found.alpha * (1.0 - 2e-4))
    assert np.all(found.upper_response >= found.lower_response * (1.0 - 1e-9))
    assert np.all(found.unstructured_response <= found.lower_response * (1.0 + 1e-3))


@pytest.mark.parametrize("seed", range(3))
def test_a_perturbation_of_the_upper_bound_makes_the_loop_unstable_and_none_below_does(seed: int) -> None:
    # Static perturbations that are complex do what the margin allows; they may sit in either channel.
    L = stable_loop(100 + seed, 2, 4)
    found = analysis.disk_margin(L)
    rng = np.random.default_rng(seed)
    phases = np.exp(1j * rng.uniform(-np.pi, np.pi, size=(4000, 2)))

    def growth(alpha: float) -> float:
        f = (1.0 + 0.5 * alpha * phases) / (1.0 - 0.5 * alpha * phases)
        closed = L.A - (L.B * f[:, None, :]) @ L.C
        return float(np.linalg.eigvals(closed).real.max())

    assert growth(0.999 * found.lower) < 0.0
    assert growth(1.05 * found.upper) > 0.0


def test_a_siso_margin_has_its_closed_form() -> None:
    # L = k/s: (S - T)/2 = (s - k)/(s + k)/2, all-pass: alpha = 2 at every frequency.
    found = analysis.disk_margin(control.ss([[0.0]], [[1.0]], [[3.0]], 0))
    assert (found.alpha, found.upper, found.unstructured) == pytest.approx((2.0, 2.0, 2.0))


def test_a_margin_between_the_points_of_a_grid_is_found() -> None:
    # Two lightly damped channels with a small coupling: peaks 1e-4 of their frequency wide.
    zeta, w1, w2 = 1e-4, 10.0, 10.003
    A = np.zeros((4, 4))
    A[:2, :2] = [[0.0, w1], [-w1, -2.0 * zeta * w1]]
    A[2:, 2:] = [[0.0, w2], [-w2, -2.0 * zeta * w2]]
    B = np.array([[0.0, 0.0], [1.0, 0.2], [0.0, 0.0], [0.1, 1.0]])
    C = 0.05 * np.array([[0.0, 1.0, 0.0, 0.1], [0.0, 0.3, 0.0, 1.0]])
    found = analysis.disk_margin(control.ss(A, B, C, 0))
    w = np.linspace(9.5, 10.5, 20001)
    dense = analysis.disk_margin(control.ss(A, B, C, 0), frequency=w)
    assert found.alpha == pytest.approx(dense.lower_response.min(), rel=3e-4)
    assert found.proved


def test_an_unstable_loop_has_no_margin() -> None:
    found = analysis.disk_margin(control.ss(np.eye(2), 0.5 * np.eye(2), np.eye(2), 0), frequency=[1.0, 2.0])
    assert float(found) == found.upper == found.unstructured == 0.0
    np.testing.assert_array_equal(found.lower_response, [0.0, 0.0])


def test_a_loop_without_states_has_a_margin() -> None:
    # S - T = (1 - k)/(1 + k).
    assert float(analysis.disk_margin(control.ss([], [], [], [[3.0]]))) == pytest.approx(4.0)
    assert float(analysis.disk_margin(control.ss([], [], [], 3.0 * np.eye(2)))) == pytest.approx(4.0)


def test_loop_margins_are_siso_margins_with_the_other_channels_closed() -> None:
    plant = control.ss(
        [[0.0, 0.0], [0.0, 0.0]], [[1.0, 0.4], [-0.3, 2.0]], np.eye(2), 0, inputs=["Q9", "Q10"], outputs=["a", "b"]
    )
    lag = control.ss(-10.0 * np.eye(2), 10.0 * np.eye(2), [[-2.0, 1.0], [-1.0, -4.0]], 0)
    for at, names in (("input", ("y[0]", "y[1]")), ("output", ("u[0]", "u[1]"))):
        found = analysis.loop_margins(plant, lag, at=at)
        L = analysis.loop_transfer(plant, lag, at=at)
        assert found.channels == names
        for i, other in ((0, 1), (1, 0)):
            # Close the other channel around L, then measure the one that is left.
            A = L.A - L.B[:, [other]] @ L.C[[other]]
            single = control.ss(A, L.B[:, [i]], L.C[[i]], 0)
            assert found.alpha[i] == pytest.approx(float(analysis.disk_margin(single)), rel=1e-7)
            assert found.alpha[i] >= float(analysis.disk_margin(L)) * (1.0 - 1e-6)


@pytest.mark.parametrize(("alpha", "skew"), [(0.5, 0.0), (0.9, 0.4), (0.6, -0.8), (1.2, 0.0)])
def test_gain_and_phase_lie_on_the_edge_of_the_disk(alpha: float, skew: float) -> None:
    low, high, phase = disk_to_gain_phase(alpha, skew)
    for f in (low, high, np.exp(1j * phase)):
        # f = (1 + (1 - skew)/2 alpha delta) / (1 - (1 + skew)/2 alpha delta) solved for delta.
        delta = (f - 1.0) / (0.5 * alpha * ((1.0 - skew) + f * (1.0 + skew)))
        assert abs(delta) == pytest.approx(1.0)


def test_a_disk_margin_of_two_allows_any_gain_and_a_right_angle() -> None:
    assert disk_to_gain_phase(2.0) == pytest.approx((0.0, math.inf, math.pi / 2.0))
    assert disk_to_gain_phase(0.0) == pytest.approx((1.0, 1.0, 0.0))


def test_what_is_no_loop_is_refused() -> None:
    with pytest.raises(PlatformCtrlError, match="square"):
        analysis.disk_margin(control.ss(-np.eye(2), np.eye(2), np.ones((1, 2)), 0))
    with pytest.raises(PlatformCtrlError, match="singular"):
        analysis.disk_margin(control.ss([[-1.0]], [[1.0]], [[1.0]], -1.0))
    with pytest.raises(PlatformCtrlError, match="skew"):
        analysis.disk_margin(control.ss([[-1.0]], [[1.0]], [[1.0]], 0), skew=math.nan)


@pytest.mark.parametrize("k", [1316.669, 23.937, 2791.389])
def test_a_bandwidth_at_a_point_of_the_grid_is_found_whatever_rounding_says(k):
    """S = s/(s + k) reaches 1/sqrt(2) at k, which the Hamiltonian puts on the grid; the next point lies beyond."""
    plant = control.ss([[0.0]], [[k]], [[1.0]], [[0.0]])
    assert analysis.bandwidth(plant, control.ss([], [], [], [[-1.0]])) == pytest.approx(k, rel=1e-12)
