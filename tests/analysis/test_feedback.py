"""Closed loops and poles: identities, and closed forms."""

from __future__ import annotations

import math

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from platform_ctrl import PlatformCtrlError, analysis
from platform_ctrl.analysis.feedback import gang, sensitivities_of_plants
from platform_ctrl.analysis.poles import (
    continuous_poles,
    damping_ratio,
    minimum_damping,
)

seeds = st.integers(0, 2**31 - 1)
W = np.geomspace(0.05, 30.0, 25)


def pair(seed: int, dt: float, direct: bool = True) -> tuple[control.StateSpace, control.StateSpace]:
    rng = np.random.default_rng(seed)

    def system(n: int, m: int, p: int) -> control.StateSpace:
        A = rng.normal(size=(n, n))
        A = 0.8 * A / np.abs(np.linalg.eigvals(A)).max() if dt else A - 2.0 * np.eye(n)
        D = 0.3 * rng.normal(size=(p, m)) if direct else 0.0
        return control.ss(A, rng.normal(size=(n, m)), rng.normal(size=(p, n)), D, dt)

    return system(4, 3, 2), system(3, 2, 3)


def stacked(response: np.ndarray) -> np.ndarray:
    return np.moveaxis(response, -1, 0)


@given(seeds, st.sampled_from([0.0, 0.1]))
@settings(max_examples=20, deadline=None)
def test_the_gang_obeys_its_identities(seed: int, dt: float) -> None:
    plant, controller = pair(seed, dt)
    g = gang(plant, controller, W)
    P = stacked(analysis.frequency_response(plant, W))
    K = stacked(analysis.frequency_response(controller, W))
    for S, T, L, m in ((g.S_input, g.T_input, -K @ P, 3), (g.S_output, g.T_output, -P @ K, 2)):
        size = 1e-9 * max(1.0, np.abs(S).max(), np.abs(T).max())
        np.testing.assert_allclose(stacked(S) + stacked(T), np.broadcast_to(np.eye(m), L.shape), atol=size)
        np.testing.assert_allclose(stacked(S) @ (np.eye(m) + L), np.broadcast_to(np.eye(m), L.shape), atol=100 * size)
        np.testing.assert_allclose(stacked(S) @ L, stacked(T), atol=100 * size)
    size = 1e-8 * max(1.0, np.abs(g.angle_per_torque).max(), np.abs(g.torque_per_noise).max())
    np.testing.assert_allclose(P @ stacked(g.S_input), stacked(g.angle_per_torque), atol=size)
    np.testing.assert_allclose(K @ stacked(g.S_output), stacked(g.torque_per_noise), atol=size)


@given(seeds, st.sampled_from([0.0, 0.1]))
@settings(max_examples=15, deadline=None)
def test_closed_loop_agrees_with_gang_and_with_the_loop_transfer(seed: int, dt: float) -> None:
    plant, controller = pair(seed, dt)
    g = gang(plant, controller, W)
    H = analysis.frequency_response(analysis.closed_loop(plant, controller), W)
    size = 1e-9 * max(1.0, np.abs(H).max())
    np.testing.assert_allclose(H[:3, :3], -g.T_input, atol=size)
    np.testing.assert_allclose(H[3:, :3], g.angle_per_torque, atol=size)
    np.testing.assert_allclose(H[:3, 3:], g.torque_per_noise, atol=size)
    np.testing.assert_allclose(H[3:, 3:], -g.T_output, atol=size)
    for at, S in (("input", g.S_input), ("output", g.S_output)):
        L = stacked(analysis.frequency_response(analysis.loop_transfer(plant, controller, at=at), W))
        _, from_L = sensitivities_of_plants(-L, np.broadcast_to(np.eye(L.shape[-1]), L.shape))
        np.testing.assert_allclose(from_L, stacked(S), atol=1e-7 * max(1.0, np.abs(S).max() ** 2))


def test_the_convention_is_torque_equals_k_times_pick_off() -> None:
    # 1/s with u = -5 y: T = 5/(s + 5); a unit torque disturbance deflects by 1/5; no noise gets to the torque at DC.
    plant = control.ss([[0.0]], [[1.0]], [[1.0]], 0)
    loop = analysis.closed_loop(plant, control.ss([], [], [], [[-5.0]]))
    np.testing.assert_allclose(loop.poles(), [-5.0])
    np.testing.assert_allclose(
        analysis.frequency_response(loop, [0.0])[:, :, 0], [[-1.0, 0.0], [0.2, -1.0]], atol=1e-14
    )
    L = analysis.loop_transfer(plant, control.ss([], [], [], [[-5.0]]))
    np.testing.assert_allclose(analysis.frequency_response(L, [1.0])[0, 0, 0], 5.0 / 1j)


def test_signals_are_joined_by_name_and_the_rest_stays_open() -> None:
    plant = control.ss(
        -np.eye(3), np.eye(3), np.eye(3), 0, inputs=["Q9", "Q10", "Omega1"], outputs=["alpha9", "beta10", "alpha4"]
    )
    K = control.ss([], [], [], [[0.0, 3.0], [2.0, 0.0]], inputs=["beta10", "alpha9"], outputs=["Q10", "Q9"])
    loop = analysis.closed_loop(plant, K)
    assert list(loop.input_labels) == ["Q9", "Q10", "Omega1", "noise_beta10", "noise_alpha9"]
    assert list(loop.output_labels) == ["Q10", "Q9", "alpha9", "beta10", "alpha4"]
    # Q10 = 3 alpha9, Q9 = 2 beta10.
    np.testing.assert_allclose(loop.A, [[-1.0, 2.0, 0.0], [3.0, -1.0, 0.0], [0.0, 0.0, -1.0]])


def test_a_singular_algebraic_loop_is_named() -> None:
    plant = control.ss([[-1.0]], [[1.0]], [[1.0]], 2.0)
    with pytest.raises(PlatformCtrlError, match="algebraic loop"):
        analysis.closed_loop(plant, control.ss([], [], [], [[0.5]]))


def test_minimum_damping_counts_slow_and_unstable_poles() -> None:
    slow, fast = [-0.01 + 1j, -0.01 - 1j], [-30.0 + 40j, -30.0 - 40j]
    poles = np.array([slow + fast, [2.0, 3.0, *fast], [*fast, *fast]])
    np.testing.assert_allclose(minimum_damping(poles), [0.01, -1.0, 0.6], rtol=1e-3)
    # What rounding makes of a double pole next to z = 1 has no damping.
    np.testing.assert_allclose(minimum_damping(np.array([1.0 - 1e-9 + 1e-8j, 1.0 - 1e-9 - 1e-8j, 0.5]), 1e-3), 1.0)
    assert minimum_damping(np.zeros(0, dtype=complex)) == 1.0


def test_a_pole_on_the_negative_axis_of_z_oscillates_at_the_nyquist_frequency() -> None:
    s = continuous_poles(np.array([-0.5, 0.0, 1.0]), 0.1)
    np.testing.assert_allclose(s[0], (math.log(0.5) + 1j * math.pi) / 0.1)
    np.testing.assert_allclose(damping_ratio(s), [math.log(2.0) / math.hypot(math.log(2.0), math.pi), 1.0, 0.0])
