"""What holds for every platform, every state."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from platform_ctrl import forward_dynamics, matrices
from platform_ctrl.errors import ArgumentError, MechanicsError
from small_trees import tree
from tree_cases import exact_slope, platforms, state

seeds = st.integers(0, 2**32 - 1)
quick = settings(max_examples=20, deadline=None)


@quick
@given(platforms(), seeds)
def test_gyroscopic_matrix_is_skew_and_mass_matrix_positive_definite(platform, seed):
    q, u, _ = state(platform, seed)
    m = matrices(platform, q, u)
    np.testing.assert_array_equal(m.G_R, -m.G_R.T)
    np.testing.assert_allclose(m.A_star, m.A_star.T)
    assert np.linalg.eigvalsh(m.A_star)[0] > 0
    held = np.array([r.control == "regulated" for r in platform.rotors], float)
    np.testing.assert_allclose(m.A_star, m.A + m.B.T @ (held[:, None] * m.A_R) @ m.B, atol=1e-12)


@quick
@given(platforms(), seeds)
def test_torque_free_motion_changes_neither_energy_nor_momentum(platform, seed):
    """T2 and the root rows' angular momentum in inertial axes: their rates of change are zero."""
    q, u, _ = state(platform, seed)
    u_dot = forward_dynamics(platform, q, u, np.zeros(len(u)))
    m = matrices(platform, q, u)
    A_dot = sum(rate * exact_slope(lambda q: matrices(platform, q).A_star, q, k) for k, rate in enumerate(u[3:]))
    B_dot = sum(rate * exact_slope(lambda q: matrices(platform, q).B, q, k) for k, rate in enumerate(u[3:]))
    energy_rate = u @ m.A_star @ u_dot + 0.5 * u @ A_dot @ u
    momentum = (m.A_star @ u + m.B.T @ m.L)[:3]
    momentum_rate = (m.A_star @ u_dot + A_dot @ u + B_dot.T @ m.L)[:3] + np.cross(u[:3], momentum)
    size = np.abs(u_dot).max() * np.abs(m.A_star).max() + np.abs(momentum).max()
    assert abs(energy_rate) < 1e-10 * size * (1 + np.abs(u).max())
    np.testing.assert_allclose(momentum_rate, 0.0, atol=1e-10 * size)


def test_gimbal_lock_is_named_not_solved():
    """Three gimbals whose first and last axes fall together, without inertia of the middle one about that axis."""
    platform = tree(1.0, [("outer", "base", 1, 1e-30), ("middle", "outer", 2, 1e-30), ("inner", "middle", 3, 1.0)])
    q = np.array([0.0, np.pi / 2, 0.0])
    with pytest.raises(MechanicsError, match="can move without moving any inertia"):
        forward_dynamics(platform, q, np.zeros(6), np.zeros(6))
    assert np.all(np.isfinite(forward_dynamics(platform, 0 * q, np.zeros(6), np.ones(6))))


@pytest.mark.parametrize(("lightest", "regular"), [(1e-11, True), (1e-15, False)])
def test_a_mass_matrix_is_singular_where_no_digit_is_left(lightest, regular):
    """Two gimbals on one axis: the outer one's own inertia is all that tells them apart."""
    platform = tree(1e3, [("outer", "base", 1, lightest), ("inner", "outer", 1, 1.0)])
    if regular:
        moved = forward_dynamics(platform, np.zeros(2), np.zeros(5), [0, 0, 0, 1e-11, 0.0])
        np.testing.assert_allclose(moved[3], 1.0, rtol=1e-2)
    else:
        with pytest.raises(MechanicsError, match="outer, inner can move without"):
            forward_dynamics(platform, np.zeros(2), np.zeros(5), np.zeros(5))


def test_gimbals_in_a_ring_are_refused_not_followed_for_ever():
    with pytest.raises(ArgumentError, match="must form a tree, they form a ring"):
        matrices(tree(1.0, [("a", "b", 1, 1.0), ("b", "a", 1, 1.0)]))
