"""Closed loops and poles: identities, and closed forms."""

from __future__ import annotations

import math

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from platform_ctrl import PlatformCtrlError, analysis

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
def test_the_closed_loop_obeys_the_identities_of_its_sensitivities(seed: int, dt: float) -> None:
    plant, controller = pair(seed, dt)
    P, K, H = (
        stacked(analysis.frequency_response(system, W))
        for system in (plant, controller, analysis.closed_loop(plant, controller))
    )
    T_input, T_output, size = -H[:, :3, :3], -H[:, 3:, 3:], 1e-7 * max(1.0, np.abs(H).max() ** 2)
    for at, T, PK in (("input", T_input, K @ P), ("output", T_output, P @ K)):
        L = stacked(analysis.frequency_response(analysis.loop_transfer(plant, controller, at=at), W))
        eye = np.eye(T.shape[-1])
        np.testing.assert_allclose(L, -PK, atol=1e-9 * np.abs(PK).max())
        np.testing.assert_allclose((eye - T) @ (eye + L), np.broadcast_to(eye, L.shape), atol=size)
        np.testing.assert_allclose((eye - T) @ L, T, atol=size)
    np.testing.assert_allclose(P @ (np.eye(3) - T_input), H[:, 3:, :3], atol=size)
    np.testing.assert_allclose(K @ (np.eye(2) - T_output), H[:, :3, 3:], atol=size)


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


def test_a_pole_on_the_negative_axis_of_z_oscillates_at_the_nyquist_frequency() -> None:
    found = analysis.damping(control.ss(np.diag([-0.5, 0.0, 1.0]), np.ones((3, 1)), np.ones((1, 3)), 0, 0.1))
    oscillating = (math.log(0.5) + 1j * math.pi) / 0.1
    np.testing.assert_allclose(found.poles[:2], [0.0, oscillating], atol=1e-12)
    np.testing.assert_allclose(found.ratio, [0.0, -oscillating.real / abs(oscillating), 1.0], atol=1e-12)
