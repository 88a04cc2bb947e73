"""The paper's rule for any tree: A constant, BᵀA_R B and G_R to first order, G_A dropped. And what symmetry removes."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from platform_ctrl import linearise, matrices
from tree_cases import platforms, slope

quick = settings(max_examples=12, deadline=None)


def root_and_gimbal_torques(platform, q, u, u_dot):
    """[A0 + (BᵀA_R B)(q)] u̇ + G_R(q) u, with Omega × BᵀL in the root's rows: what the paper linearises."""
    here, rest = matrices(platform, q), matrices(platform)
    held = np.array([rotor.control == "regulated" for rotor in platform.rotors], float)
    axial = here.B.T @ (held[:, None] * here.A_R) @ here.B
    out = (rest.A + axial) @ u_dot + here.G_R @ u
    out[:3] += np.cross(u[:3], (here.B.T @ here.L)[:3])
    return out


@quick
@given(platforms(max_gimbals=5), st.integers(0, 2**32 - 1))
def test_every_matrix_follows_from_the_papers_rule(platform, seed):
    rng = np.random.default_rng(seed)
    n = len(platform.gimbals)
    Omega = rng.normal(size=3)
    model = linearise(platform, Omega=Omega, terms="paper")
    still = np.concatenate([Omega, np.zeros(n)])
    none, zero = np.zeros(n), np.zeros(3 + n)
    size = 1 + np.abs(model.G).max() + np.abs(model.K).max() + np.abs(model.G_Omega).max()

    def torque(q, u, u_dot):
        return root_and_gimbal_torques(platform, q, u, u_dot)[3:]

    np.testing.assert_allclose(model.Q0, torque(none, still, zero), atol=1e-10 * size)
    np.testing.assert_allclose(model.K, slope(lambda q: torque(q, still, zero), none, 1e-5), atol=1e-7 * size)
    rates = slope(lambda r: torque(none, still + np.concatenate([np.zeros(3), r]), zero), none, 1e-5)
    np.testing.assert_allclose(model.G, rates, atol=1e-7 * size)
    omegas = slope(lambda w: torque(none, still + np.concatenate([w, none]), zero), np.zeros(3), 1e-5)
    np.testing.assert_allclose(model.G_Omega, omegas, atol=1e-7 * size)
    for axis in range(3):
        change = np.zeros(3 + n)
        change[axis] = 1.0
        found = slope(lambda q, change=change: torque(q, still, change) - torque(q, still, zero), none, 1e-5)
        np.testing.assert_allclose(model.M_Omega_q[:, axis], found, atol=1e-7 * size)


@quick
@given(platforms(max_gimbals=4), st.integers(0, 2**32 - 1))
def test_at_rest_paper_and_exact_are_the_same(platform, seed):
    exact, paper = (linearise(platform, terms=terms) for terms in ("exact", "paper"))
    for name in ("M", "G", "K", "M_Omega", "G_Omega", "Q0"):
        np.testing.assert_allclose(getattr(exact, name), getattr(paper, name), atol=1e-10)
