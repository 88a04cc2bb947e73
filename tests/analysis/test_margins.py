"""Disk margins against python-control, closed forms, and perturbations that really destabilise."""

from __future__ import annotations

import math

import control
import numpy as np
import pytest

from platform_ctrl import PlatformCtrlError, analysis
from platform_ctrl.analysis.margins import disk_to_gain_phase
from platform_ctrl.analysis.mu import MuBounds, best_phases, best_scalings, mu_bounds
from random_loops import stable_loop


def best_mu_bounds(M: np.ndarray) -> MuBounds:
    near = mu_bounds(M)
    found = [best_scalings(one, D) for one, D in zip(M, near.D, strict=True)]
    upper, D = np.array([size for size, _ in found]), np.array([D for _, D in found])
    reached = [best_phases(one, *pair) for one, *pair in zip(M, D, near.Q, strict=True)]
    lower = np.minimum([size for size, _ in reached], upper)
    return MuBounds(upper=upper, lower=lower, D=D, Q=np.array([Q for _, Q in reached]))


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


def test_a_siso_margin_has_its_closed_form() -> None:
    # L = k/s: (S - T)/2 = (s - k)/(s + k)/2, all-pass: alpha = 2 at every frequency.
    found = analysis.disk_margin(control.ss([[0.0]], [[1.0]], [[3.0]], 0))
    assert (found.alpha, found.upper, found.unstructured) == pytest.approx((2.0, 2.0, 2.0))


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
