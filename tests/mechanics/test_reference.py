"""Published-style reference motions: inverse and forward dynamics, A*, B and BᵀL of seven trees."""

import json
from pathlib import Path

import numpy as np
import pytest

from platform_ctrl import forward_dynamics, inverse_dynamics, matrices
from tree_cases import platform_of_case

CASES = json.loads((Path(__file__).parents[1] / "data" / "dynamics-cases.json").read_text())["groups"]
STATES = [
    pytest.param(group["tree"], state, id=f"{group['tree']['name']}-{k}")
    for group in CASES
    for k, state in enumerate(group["states"])
]


@pytest.mark.parametrize(("tree", "state"), STATES)
def test_inverse_dynamics_gives_the_reference_torques(tree, state):
    platform = platform_of_case(tree)
    tau = np.array(state["tau"])
    ours = inverse_dynamics(platform, state["q"], state["u"], state["u_dot"])
    assert np.all(np.abs(ours - tau) <= 1e-9 * np.abs(tau) + 1e-11 * np.abs(tau).max())


@pytest.mark.parametrize(("tree", "state"), STATES)
def test_matrix_form_gives_the_reference_torques(tree, state):
    platform = platform_of_case(tree)
    tau, u, u_dot = (np.array(state[key]) for key in ("tau", "u", "u_dot"))
    m = matrices(platform, state["q"], u)
    ours = m.A_star @ u_dot + (m.G_A + m.G_R + m.G_root) @ u
    assert np.all(np.abs(ours - tau) <= 1e-9 * np.abs(tau) + 1e-11 * np.abs(tau).max())
    np.testing.assert_allclose(m.A_star, state["A"], rtol=1e-11, atol=1e-12 * np.abs(state["A"]).max())
    np.testing.assert_allclose(m.B, np.array(state["B"]).reshape(m.B.shape), atol=1e-13)
    np.testing.assert_allclose(m.B.T @ m.L, state["h"], atol=1e-11 * (1 + np.abs(state["h"]).max()))


@pytest.mark.parametrize(("tree", "state"), STATES)
def test_forward_dynamics_undoes_inverse_dynamics(tree, state):
    platform = platform_of_case(tree)
    u_dot = np.array(state["u_dot"])
    ours = forward_dynamics(platform, state["q"], state["u"], state["tau"])
    speed = np.abs(forward_dynamics(platform, state["q"], state["u"], np.zeros(len(u_dot)))).max()
    np.testing.assert_allclose(ours, u_dot, atol=1e-8 * (1 + speed), rtol=1e-9)
