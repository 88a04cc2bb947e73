"""Norms of sampled loops in continuous time, against fast sampling, continuous limits and what the samples hide."""

from __future__ import annotations

import control
import numpy as np
import pytest

from platform_ctrl import analysis
from platform_ctrl.analysis.arrays import StateArrays, state_arrays
from platform_ctrl.analysis.feedback import closed_loop
from platform_ctrl.analysis.norms import hinf_norm, stationary_covariance
from platform_ctrl.analysis.sampling import held_input, sampled
from platform_ctrl.errors import ArgumentError


def plant(seed: int = 0, D11: float = 0.0) -> control.StateSpace:
    """A lightly damped oscillator behind an actuator: two disturbances, two outputs, one control, one measurement."""
    rng = np.random.default_rng(seed)
    A = np.array([[0.0, 1.0, 0.0], [-4.0, -0.3, 1.0], [0.0, 0.0, -3.0]])
    B = np.hstack([rng.standard_normal((3, 2)), [[0.0], [0.0], [1.0]]])
    C = np.vstack([rng.standard_normal((2, 3)), [[1.0, 0.0, 0.0]]])
    D = np.zeros((3, 3))
    D[:2, :2], D[0, 2] = D11 * np.eye(2), 0.3
    return control.StateSpace(A, B, C, D)


def controller(period: float = 0.7) -> control.StateSpace:
    return control.StateSpace([[0.5]], [[1.0]], [[-0.3]], [[-0.5]], period)


def fast(P: control.StateSpace, K: control.StateSpace, pieces: int, delay: int) -> tuple[np.ndarray, ...]:
    """The loop (one control, one measurement) with w held and z read `pieces` times a period; `delay` in pieces."""
    A, B, C, D, _ = state_arrays(P, "fast")
    n, nw, nz, h = len(A), B.shape[1] - 1, len(C) - 1, K.dt / pieces
    Ad, Bd = held_input(A, B, h)
    # States [x, u[k-1], u[k-2]], then the inputs [w_1 .. w_N, u[k]].
    inputs = pieces * nw
    held = {j: np.eye(n + 2 + inputs + 1)[-1 if j == 0 else n + j - 1] for j in range(3)}
    x, z = np.eye(n, n + 2 + inputs + 1), []
    for k in range(pieces):
        u = held[-((k - delay) // pieces)][None]
        w = np.eye(nw, n + 2 + inputs + 1, n + 2 + k * nw)
        z.append(C[:nz] @ x + D[:nz] @ np.vstack([w, u]))
        x = Ad @ x + Bd @ np.vstack([w, u])
    whole = np.vstack([x, held[0], held[1], *z, np.hstack([C[nz:], np.zeros((1, 3 + inputs))])])
    S, Z = n + 2, pieces * nz
    closed = closed_loop(
        StateArrays(whole[:S, :S], whole[:S, S:], whole[S:, :S], whole[S:, S:], 0.0),
        StateArrays(K.A, K.B, K.C, K.D, 0.0),
        torques=[inputs],
        angles=[Z],
    )
    A, B, C, D, _ = closed
    return A, B[:, :inputs], C[1 : 1 + Z], D[1 : 1 + Z, :inputs]


@pytest.mark.parametrize(("eighths", "D11"), [(0, 0.0), (4, 0.0), (8, 0.0), (13, 0.0), (2, 2.0)])
def test_fast_sampling_converges_to_the_norm(eighths: int, D11: float) -> None:
    P, K = plant(D11=D11), controller()
    norm, frequency = analysis.intersample_norm(P, K, 1, 1, delay=eighths / 8 * K.dt)
    rough = [
        hinf_norm(StateArrays(*fast(P, K, N, eighths * N // 8), K.dt), allow_unstable=True)[0] for N in (8, 16, 32)
    ]
    errors = np.abs(np.array(rough) - norm) / norm
    assert errors[-1] < 3e-3
    # Second-order extrapolation of a first-order method.
    first = 2 * np.array(rough[1:]) - rough[:-1]
    assert (4 * first[1] - first[0]) / 3 == pytest.approx(norm, rel=1e-4)
    assert frequency is not None
    assert 0.0 < frequency < np.pi / K.dt


def test_fast_sampling_converges_to_the_h2_norm() -> None:
    P, K = plant(1), controller()
    P.D[0, 2] = 0.0
    found = analysis.intersample_h2(P, K, 1, 1, delay=0.25 * K.dt)
    rough = []
    for N in (16, 32, 64):
        A, B, C, D = fast(P, K, N, N // 4)
        # Unit density, held: variance 1/h a sample; the mean of z² over the pieces.
        power = np.trace(C @ stationary_covariance(A, B) @ C.T) + np.sum(D**2)
        rough.append(np.sqrt(power / (K.dt / N) / N))
    first = 2 * np.array(rough[1:]) - rough[:-1]
    assert (4 * first[1] - first[0]) / 3 == pytest.approx(found, rel=1e-4)


def test_short_periods_give_the_norms_of_the_continuous_loop() -> None:
    P, K = plant(2), control.StateSpace([[-2.0]], [[1.0]], [[-1.0]], [[-0.5]])
    A, B, C, D, _ = closed_loop(
        StateArrays(P.A, P.B, P.C, P.D, 0.0), StateArrays(K.A, K.B, K.C, K.D, 0.0), torques=[2], angles=[2]
    )
    limit = control.StateSpace(A, B[:, :2], C[1:3], D[1:3, :2])
    error, error2 = [], []
    for period in (0.02, 0.005):
        slow = K.sample(period, method="bilinear")
        error.append(abs(analysis.intersample_norm(P, slow, 1, 1)[0] / analysis.hinf_norm(limit)[0] - 1.0))
        error2.append(abs(analysis.intersample_h2(P, slow, 1, 1) / analysis.h2_norm(limit) - 1.0))
    assert error[1] < 5e-3
    assert error2[1] < 5e-3
    assert error[1] < 0.3 * error[0]
    assert error2[1] < 0.3 * error2[0]


def test_without_feedback_the_norm_is_the_continuous_one_at_any_period() -> None:
    P = plant(3)
    K = control.StateSpace([[0.5]], [[1.0]], [[0.0]], [[0.0]], 2.0)
    norm, frequency = analysis.intersample_norm(P, K, 1, 1, delay=0.3)
    direct, peak = analysis.hinf_norm(P[:2, :2])
    assert norm == pytest.approx(direct, rel=1e-6)
    assert analysis.intersample_h2(P, K, 1, 1) == pytest.approx(analysis.h2_norm(P[:2, :2]), rel=1e-9)
    # The peak lies above π/T: the frequency is its alias.
    turn = 2 * np.pi / K.dt
    assert frequency == pytest.approx(abs((peak + turn / 2) % turn - turn / 2), rel=1e-3)


def test_a_ripple_hidden_at_the_samples_is_seen() -> None:
    # An oscillation at the sample frequency, almost undamped: every sample meets it at the same phase.
    period = 0.5
    omega = 2 * np.pi / period
    A = np.array([[0.0, 1.0], [-(omega**2), -0.02]])
    P = control.StateSpace(
        np.block([[A, np.zeros((2, 1))], [np.zeros((1, 2)), -np.ones((1, 1))]]),
        [[0.0, 0.0], [1.0, 1.0], [0.0, 1.0]],
        [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
        np.zeros((2, 2)),
    )
    K = control.StateSpace([], [], [], [[-0.4]], period)
    A, B, C, D, _ = sampled(StateArrays(P.A, P.B, P.C, P.D, 0.0), period)
    A, B, C, D, _ = closed_loop(
        StateArrays(A, B, C, D, 0.0), StateArrays(K.A, K.B, K.C, K.D, 0.0), torques=[1], angles=[1]
    )
    at_samples, _ = hinf_norm(StateArrays(A, B[:, :1], C[1:2], D[1:2, :1], period), allow_unstable=True)
    norm, _ = analysis.intersample_norm(P, K, 1, 1)
    assert norm > 50 * at_samples


def test_a_direct_term_alone_belongs_to_no_frequency() -> None:
    P = control.StateSpace([[-1.0]], [[0.1, 1.0]], [[0.1], [1.0]], [[3.0, 0.0], [0.0, 0.0]])
    K = control.StateSpace([], [], [], [[-0.1]], 0.1)
    norm, frequency = analysis.intersample_norm(P, K, 1, 1)
    # Slow dynamics add what they have at zero frequency; the direct term is everywhere.
    assert norm == pytest.approx(3.0, rel=5e-3)
    assert norm >= 3.0
    assert frequency is None or frequency >= 0.0


def test_units_of_time_and_signals_scale_the_norm() -> None:
    P, K = plant(4), controller()
    norm, frequency = analysis.intersample_norm(P, K, 1, 1, delay=0.2)
    fastest = control.StateSpace(1e4 * P.A, 1e4 * P.B, P.C, P.D)
    fastest.B[:, :2] *= 1e-5
    quick = control.StateSpace(K.A, K.B, K.C, K.D, K.dt / 1e4)
    again, at = analysis.intersample_norm(fastest, quick, 1, 1, delay=0.2e-4)
    assert again == pytest.approx(1e-5 * norm, rel=1e-6)
    assert at == pytest.approx(1e4 * frequency, rel=1e-3)


def test_what_makes_no_sense_is_said_in_one_line() -> None:
    P, K = plant(), controller()
    noisy = plant()
    noisy.D[2, 0] = 1e-3
    with pytest.raises(ArgumentError, match="anti-alias filter"):
        analysis.intersample_norm(noisy, K, 1, 1)
    with pytest.raises(ArgumentError, match="must be stable"):
        analysis.intersample_norm(P, control.StateSpace([], [], [], [[-40.0]], 0.7), 1, 1)
    with pytest.raises(ArgumentError, match="K must be discrete"):
        analysis.intersample_norm(P, control.StateSpace([], [], [], [[-1.0]]), 1, 1)
    with pytest.raises(ArgumentError, match="nmeas"):
        analysis.intersample_norm(P, K, 9, 1)
    with pytest.raises(ArgumentError, match="inputs and"):
        analysis.intersample_norm(P, K, 2, 1)
    with pytest.raises(ArgumentError, match="P must be continuous"):
        analysis.intersample_norm(analysis.sampled(P, 0.7), K, 1, 1)
    with pytest.raises(ArgumentError, match="D11"):
        analysis.intersample_h2(plant(D11=1.0), K, 1, 1)


def test_a_pole_at_zero_is_not_on_the_boundary_of_stability() -> None:
    norm, _ = analysis.hinf_norm(control.StateSpace([[0.0]], [[1.0]], [[1.0]], [[0.0]], 1.0))
    assert norm == pytest.approx(1.0)
