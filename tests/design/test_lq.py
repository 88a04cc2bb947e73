"""State feedback, Kalman filter and LQG: textbook cases, python-control, simulation-free identities, and refusals."""

from __future__ import annotations

import control
import numpy as np
import pytest

from platform_ctrl.analysis.norms import h2_norm
from platform_ctrl.design.riccati.lq import lqe, lqg, lqr
from platform_ctrl.design.riccati.pole_placement import pole_placement
from platform_ctrl.errors import ArgumentError, DesignError, IllPosedError, NotStabilisableError

DOUBLE = control.ss([[0.0, 1], [0, 0]], [[0.0], [1]], [[1.0, 0]], 0)


def gyro(dt=0.0):
    """Two axes of a gyro in SI units, states angles and momenta; sampled where dt > 0."""
    L, J9, J10 = 0.15, 5e-4, 2e-4
    A = np.zeros((4, 4))
    A[:2, 2:] = np.diag([1 / J9, 1 / J10])
    A[2, 3], A[3, 2] = -L / J10, L / J9
    B, C = np.vstack([np.zeros((2, 2)), np.eye(2)]), np.hstack([np.eye(2), np.zeros((2, 2))])
    names = {"inputs": ["Q9", "Q10"], "outputs": ["alpha9", "beta10"]}
    system = control.ss(A, B, C, 0, **names)
    return control.sample_system(system, dt) if dt else system


WEIGHTS = (np.diag([1e6, 1e6, 10.0, 10.0]), np.diag([400.0, 400.0]))
NOISE = (np.diag([0.0, 0.0, 1e-6, 1e-6]), np.diag([1e-12, 1e-12]))


def random_system(seed, n=5, m=2, p=3, dt=0.0, D=False):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    A = 1.2 * A / np.abs(np.linalg.eigvals(A)).max() if dt else A
    return control.ss(A, rng.normal(size=(n, m)), rng.normal(size=(p, n)), rng.normal(size=(p, m)) if D else 0, dt)


def random_weights(seed, n, m):
    G = np.random.default_rng(seed).normal(size=(n + m, n + m))
    W = G @ G.T
    return W[:n, :n], W[n:, n:], W[:n, n:]


@pytest.mark.parametrize("dt", [0, 0.1])
def test_every_state_feedback_is_minus_the_gain_times_the_state(dt):
    system = control.ss([[1.0, 0.1], [0.3, 1.2]], [[0.0], [1.0]], np.eye(2), 0, dt)
    with_integrals = control.ss(system.A, system.B, [[1.0, 0.0]], 0, dt)
    A = np.block([[system.A, np.zeros((2, 1))], [np.array([[1.0, 0.0, 1.0 if dt else 0.0]])]])
    B = np.vstack([system.B, [[0.0]]])
    quadratic, placed = lqr(system, np.eye(2), np.eye(1)), pole_placement(system, [0.2, 0.3] if dt else [-2.0, -3.0])
    for K, a, b in (
        (quadratic.state_gain, system.A, system.B),
        (placed.state_gain, system.A, system.B),
        (lqr(with_integrals, np.eye(2), np.eye(1), integral=np.eye(1)).state_gain, A, B),
    ):
        poles = np.linalg.eigvals(a - b @ K)
        assert (np.abs(poles).max() < 1.0) if dt else (poles.real.max() < 0.0)


def test_double_integrator_has_its_textbook_gains():
    feedback = lqr(DOUBLE, np.diag([1.0, 0.0]), np.eye(1))
    np.testing.assert_allclose(feedback.state_gain, [[1.0, np.sqrt(2)]], rtol=1e-12)
    np.testing.assert_allclose(feedback.X, [[np.sqrt(2), 1], [1, np.sqrt(2)]], rtol=1e-12)
    estimator = lqe(DOUBLE, np.diag([0.0, 1.0]), np.eye(1))
    np.testing.assert_allclose(estimator.observer_gain, [[np.sqrt(2)], [1.0]], rtol=1e-12)


@pytest.mark.parametrize("dt", [0.0, 0.1])
@pytest.mark.parametrize("seed", range(4))
def test_gains_are_those_of_python_control(seed, dt):
    system = random_system(seed, dt=dt)
    Q1, Q2, Q12 = random_weights(seed + 10, 5, 2)
    K, X, poles = (control.dlqr if dt else control.lqr)(system, Q1, Q2, Q12)
    ours = lqr(system, Q1, Q2, Q12)
    np.testing.assert_allclose(ours.state_gain, K, rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(ours.X, X, rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(np.sort_complex(ours.poles), np.sort_complex(poles), rtol=1e-6)
    R1, R2, _ = random_weights(seed + 20, 5, 3)
    L, Y, _ = (control.dlqe if dt else control.lqe)(system.A, np.eye(5), system.C, R1, R2)
    theirs = lqe(system, R1, R2)
    np.testing.assert_allclose(theirs.observer_gain, L, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(theirs.Y, Y, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("dt", [0.0, 5e-4])
def test_gyro_in_si_units_has_the_gains_of_the_scaled_gyro(dt):
    d = np.array([1e-3, 1e-3, 1e-5, 1e-5])
    plain = gyro(dt)
    scaled = control.ss(plain.A * d / d[:, None], plain.B / d[:, None], plain.C * d, plain.D, plain.dt)
    Q1, Q2 = WEIGHTS
    here, there = lqr(plain, Q1, Q2), lqr(scaled, Q1 * d * d[:, None], Q2)
    np.testing.assert_allclose(there.state_gain, here.state_gain * d, rtol=1e-8)
    R1, R2 = NOISE
    here, there = lqe(plain, R1, R2), lqe(scaled, R1 / d / d[:, None], R2)
    np.testing.assert_allclose(there.observer_gain, here.observer_gain / d[:, None], rtol=1e-9, atol=1e-6)


def closed(system, K):
    """A of the plant with u = K y."""
    E = np.linalg.inv(np.eye(system.ninputs) - K.D @ system.D)
    U, V = E @ K.D @ system.C, E @ K.C
    return np.block(
        [
            [system.A + system.B @ U, system.B @ V],
            [K.B @ (system.C + system.D @ U), K.A + K.B @ system.D @ V],
        ]
    )


@pytest.mark.parametrize("integral", [False, True])
@pytest.mark.parametrize("dt", [0.0, 0.1])
@pytest.mark.parametrize("direct", [True, False])
def test_lqg_has_the_poles_of_feedback_and_estimator_and_the_cost_that_it_claims(dt, integral, direct):
    system = random_system(3, p=2, dt=dt, D=True)
    Q1, Q2, Q12 = random_weights(5, 5, 2)
    R1, R2, R12 = random_weights(6, 5, 2)
    weight = np.diag([2.0, 3.0]) if integral else None
    design = lqg(system, Q1, Q2, R1, R2, Q12=Q12, R12=R12, integral=weight, direct=direct)
    both = np.concatenate([design.feedback.poles, design.estimator.poles])
    K = design.controller
    np.testing.assert_allclose(
        np.sort_complex(np.linalg.eigvals(closed(system, K))), np.sort_complex(both), rtol=1e-5, atol=1e-6
    )
    assert K.nstates == 5 + 2 * integral
    assert design.cost == pytest.approx(design.synthesis.gamma_optimal**2, rel=1e-8)
    assert design.cost == pytest.approx(h2_norm(design.synthesis.closed_loop) ** 2, rel=1e-9)
    if not direct or not dt:
        np.testing.assert_array_equal(K.D, np.zeros((2, 2)))


@pytest.mark.parametrize("dt", [0.0, 0.1])
@pytest.mark.parametrize("integral", [False, True])
def test_no_nearby_controller_costs_less(dt, integral):
    system = random_system(4, p=2, dt=dt)
    Q1, Q2, Q12 = random_weights(7, 5, 2)
    R1, R2, R12 = random_weights(8, 5, 2)
    design = lqg(system, Q1, Q2, R1, R2, Q12=Q12, R12=R12, integral=np.eye(2) if integral else None)
    P, K = design.synthesis.plant, design.synthesis.controller
    rng = np.random.default_rng(9)
    costs = []
    for _ in range(40):
        matrices = [m + 1e-3 * rng.normal(size=m.shape) * (dt > 0 or k < 3) for k, m in enumerate((K.A, K.B, K.C, K.D))]
        near = control.ss(*matrices, dt)
        loop = P.lft(near, design.synthesis.ncon, design.synthesis.nmeas)
        loop = control.ss(loop.A, loop.B, loop.C, loop.D if dt else 0 * loop.D, dt)
        costs.append(h2_norm(loop) ** 2)
    assert min(costs) > design.cost


@pytest.mark.parametrize("dt", [0.0, 5e-4])
def test_integral_action_leaves_no_error_under_a_constant_torque(dt):
    system = gyro(dt)
    design = lqg(system, *WEIGHTS, *NOISE, integral=1e9 * np.eye(2))
    K = design.controller
    A = closed(system, K)
    B = np.vstack([system.B, K.B @ system.D])
    rest = np.linalg.solve(np.eye(len(A)) - A if dt else -A, B)[:2]  # angles under unit torques
    without = lqg(system, *WEIGHTS, *NOISE).controller
    A0 = closed(system, without)
    B0 = np.vstack([system.B, without.B @ system.D])
    assert np.abs(rest).max() < 1e-9 * np.abs(np.linalg.solve(np.eye(8) - A0 if dt else -A0, B0)[:2]).max()
    assert K.input_labels == ["alpha9", "beta10"]
    assert K.output_labels == ["Q9", "Q10"]


def test_what_no_input_moves_or_no_weight_sees_is_named():
    stuck = control.ss([[0.0, 20], [-20, 0]], [[0.0], [0.0]], [[1.0, 0]], 0)
    with pytest.raises(NotStabilisableError, match=r"lqr: .* no control u moves the mode at .*20j"):
        lqr(stuck, np.eye(2), np.eye(1))
    with pytest.raises(NotStabilisableError, match=r"lqe: .* no measurement y sees"):
        lqe(control.ss(stuck.A, stuck.B, [[0.0, 0]], 0), np.eye(2), np.eye(1))
    with pytest.raises(IllPosedError, match="do not reach the mode at 0"):
        lqr(DOUBLE, np.diag([0.0, 1.0]), np.eye(1))
    with pytest.raises(IllPosedError, match=r"Q2 must be positive definite.* but is 0 for Q10"):
        lqr(gyro(), WEIGHTS[0], np.diag([1.0, 0.0]))
    with pytest.raises(IllPosedError, match=r"Q2 must be .* but is -1 for u\[0\]"):
        lqr(DOUBLE, np.eye(2), [[-1.0]])
    with pytest.raises(IllPosedError, match=r"R2 must be positive definite.* but is singular for "):
        lqe(gyro(), NOISE[0], np.ones((2, 2)))
    with pytest.raises(IllPosedError, match="no stabilising solution: its Hamiltonian pencil has eigenvalues on"):
        lqr(gyro(), -WEIGHTS[0], WEIGHTS[1])
    for negative in ((-NOISE[0], NOISE[1]), (NOISE[0], NOISE[1], 1e3 * np.ones((4, 2)))):
        with pytest.raises(IllPosedError, match="must be positive semidefinite: intensities of noise"):
            lqe(gyro(), *negative)
    with pytest.raises(IllPosedError, match="the cost of LQG is a norm squared"):
        lqg(gyro(), -WEIGHTS[0], WEIGHTS[1], *NOISE)


@pytest.mark.parametrize(
    ("given", "match"),
    [
        ((np.eye(3), np.eye(1)), r"lqr: Q1 must have shape \(2, 2\), got \(3, 3\)"),
        (([[1, 2], [0, 1]], np.eye(1)), "Q1 must be symmetric"),
        ((np.eye(2), np.eye(1), None, [[-1.0]]), "integral must be a positive semidefinite"),
        ((np.eye(2), [[np.nan]]), r"lqr: Q2 must be finite numbers of shape \(1, 1\), got one that is not"),
    ],
)
def test_arguments_that_make_no_sense_are_refused(given, match):
    with pytest.raises(ArgumentError, match=match):
        lqr(DOUBLE, *given)


@pytest.mark.parametrize("gain", [1e-9, 1e-6, 1e6])
def test_gains_of_a_torquer_in_any_unit_are_the_closed_form(gain):
    # x'' = gain u with the weights 1: poles near -1 and -gain, six decades apart.
    system = control.ss([[0.0, 1], [0, 0]], [[0.0], [gain]], [[1.0, 0]], 0)
    feedback = lqr(system, np.eye(2), np.eye(1))
    np.testing.assert_allclose(feedback.state_gain, [[1.0, np.sqrt(1.0 + 2.0 / gain)]], rtol=1e-9)


def test_plants_without_states_or_measurements_are_refused():
    static = control.ss([], [], [], [[1.0]])
    with pytest.raises(ArgumentError, match="must have states and at least one signal"):
        lqr(static, np.zeros((0, 0)), [[1.0]])
    blind = control.ss([[-1.0]], [[1.0]], np.zeros((0, 1)), np.zeros((0, 1)))
    with pytest.raises(ArgumentError, match="at least one signal for R2"):
        lqe(blind, [[1.0]], np.zeros((0, 0)))


def test_sampled_pole_at_minus_one_is_moved():
    system = control.ss([[-1.0]], [[1.0]], [[1.0]], 0, 0.1)
    assert np.abs(lqr(system, [[1.0]], [[1.0]]).poles).max() < 1.0
    assert np.abs(lqg(system, [[1.0]], [[1.0]], [[1.0]], [[1.0]]).poles).max() < 1.0


@pytest.mark.parametrize("dt", [0.0, 0.1])
@pytest.mark.parametrize(("a", "b"), [(2.0, 1e200), (1e160, 1e200), (-1e300, 1e300)])
def test_numbers_whose_squares_overflow_are_refused_and_no_library_prints(a, b, dt, capfd):
    with np.errstate(all="ignore"), pytest.raises(DesignError):
        lqr(control.ss([[a]], [[b]], [[1.0]], [[0.0]], dt), np.eye(1), np.eye(1))
    assert "On entry" not in "".join(capfd.readouterr())
