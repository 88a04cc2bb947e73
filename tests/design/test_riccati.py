"""Riccati equations of the published collections: held to all digits, and refused for true reasons alone."""

from __future__ import annotations

import control
import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import solve_continuous_are, solve_continuous_lyapunov, solve_discrete_are

from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.riccati.lq import lqr
from platform_ctrl.errors import IllPosedError, NotStabilisableError
from riccati_examples import Example, carex, darex

# CAREX 11 has a pair of eigenvalues on the imaginary axis, DAREX 2 and 4 have costs without a least value.
REFUSED = {"CAREX 11", "DAREX 2", "DAREX 4"}
# 421 states take seconds: benchmarks/riccati.py.
EXAMPLES = [example for example in (*map(carex, range(1, 20)), *map(darex, range(1, 20)))]
NAMES = [example.name for example in EXAMPLES]
SMALL = [example for example in EXAMPLES if len(example.A) <= 13]


def plant(example: Example) -> control.StateSpace:
    n, m = example.B.shape
    dt = 1.0 if example.discrete else 0.0
    return control.StateSpace(example.A, example.B, np.eye(n), np.zeros((n, m)), dt, remove_useless_states=False)


def solved(example: Example) -> FloatArray:
    return lqr(plant(example), example.Q, example.R, example.N).X


def residual(example: Example, X: FloatArray) -> float:
    """Return the residual over the largest term, in 40 digits up to 30 states, else in doubles."""
    if len(X) > 30:
        matrices, solve = (*example[1:6], X), np.linalg.solve
    else:
        matrices, solve = tuple(mpmath.matrix(item.tolist()) for item in (*example[1:6], X)), _solve
    with mpmath.workdps(40):
        A, B, Q, R, N, P = matrices
        if example.discrete:
            terms, cross, weight = [_product(A.T, P, A), -P, Q], _product(A.T, P, B) + N, R + _product(B.T, P, B)
        else:
            terms, cross, weight = [_product(A.T, P), _product(P, A), Q], _product(P, B) + N, R
        terms.append(-_product(cross, solve(weight, cross.T)))
        total = terms[0] + terms[1] + terms[2] + terms[3]
        norms = [np.linalg.norm(np.array(item.tolist(), dtype=np.float64)) for item in (total, *terms)]
    return norms[0] / max(norms[1:])


def _product(*matrices):
    out = matrices[0]
    for item in matrices[1:]:
        out = out @ item if isinstance(item, np.ndarray) else out * item
    return out


def _solve(matrix, right):
    return mpmath.inverse(matrix) * right


@pytest.mark.parametrize("example", [one for one in EXAMPLES if one.name not in REFUSED], ids=lambda one: one.name)
def test_equations_hold_to_the_last_digits(example: Example) -> None:
    X = solved(example)
    theirs = (solve_discrete_are if example.discrete else solve_continuous_are)(*example[1:5], s=example.N)
    floor = 5e-16 if len(X) <= 30 else 1e-12
    assert residual(example, X) <= max(floor, residual(example, 0.5 * (theirs + theirs.T)) / 100)
    if example.X is not None:
        # The parameter of DAREX 18, 1 - 1e-8, has lost eight digits as a double.
        to = 1e-8 if example.name == "DAREX 18" else 1e-11
        np.testing.assert_allclose(X, example.X, rtol=0, atol=to * np.abs(example.X).max())


def eigenvalues(example: Example) -> np.ndarray:
    """Return the eigenvalues of the Hamiltonian matrix, of discrete examples those of A' X A ..., in 60 digits."""
    with mpmath.workdps(60):
        A, B, Q, R, N = (mpmath.matrix(item.tolist()) for item in example[1:6])
        inverse = mpmath.inverse(R)
        left, S = A - B * inverse * N.T, B * inverse * B.T
        n = A.rows
        H = mpmath.zeros(2 * n)
        H[:n, :n], H[:n, n:], H[n:, :n], H[n:, n:] = left, -S, N * inverse * N.T - Q, -left.T
        values = mpmath.eig(H, left=False, right=False)
        return np.array([complex(one) for one in values])


@pytest.mark.parametrize("number", [1, 2, 3, 4, 5, 7, 8, 9, 10, 12, 13, 14])
def test_poles_of_the_loop_are_the_stable_eigenvalues_of_the_hamiltonian_matrix(number: int) -> None:
    example = carex(number)
    stable = eigenvalues(example)
    stable = stable[stable.real < 0]
    assert len(stable) == len(example.A)
    found = lqr(plant(example), example.Q, example.R, example.N).poles
    for pole in found:
        assert np.abs(stable - pole).min() < 1e-9 * max(abs(pole), 1e-3 * np.abs(found).max())


def test_the_one_that_is_refused_among_the_continuous_has_eigenvalues_on_the_axis() -> None:
    example = carex(11)
    assert np.abs(eigenvalues(example).real).max() < 1e-25
    with pytest.raises(IllPosedError, match=r"lqr: .*no stabilising solution: .*eigenvalues on the imaginary axis"):
        solved(example)


@pytest.mark.parametrize("number", [2, 4])
def test_the_two_that_are_refused_among_the_discrete_have_no_least_cost(number: int) -> None:
    example = darex(number)
    with pytest.raises(IllPosedError, match=r"lqr: the cost has no least value, since R \+ B'XB is not"):
        solved(example)
    # A stabilising feedback with one impulse: the larger the impulse, the lower the cost.
    A, B, Q, R, N = example[1:6]
    X = solve_discrete_are(A, B, Q, R, s=N)
    W = R + B.T @ X @ B
    F = -np.linalg.solve(W, B.T @ X @ A + N.T)
    values, vectors = np.linalg.eigh(W)
    assert values[0] < 0
    costs = []
    for size in (0.0, 1.0, 10.0, 100.0):
        x, cost = np.ones(len(A)), 0.0
        for k in range(400):
            u = F @ x + (size * vectors[:, 0] if k == 0 else 0.0)
            cost += x @ Q @ x + 2 * x @ N @ u + u @ R @ u
            x = A @ x + B @ u
        assert np.abs(x).max() < 1e-6
        costs.append(cost)
    assert costs[3] < costs[2] < costs[1] < costs[0]
    assert costs[3] - costs[0] == pytest.approx(1e4 * values[0], rel=1e-6)


@pytest.mark.parametrize("weight", [0.0, 1e-300, 1e-60, 1e-20])
def test_the_least_effort_that_stabilises_is_found_for_any_small_weight(weight: float) -> None:
    # Without a weight of the states the unstable poles are mirrored: X⁻¹ = Y with A Y + Y A' = B B'.
    A = np.array([[1.0, 2.0, 0.0], [-2.0, 1.0, 0.3], [0.0, 0.0, 0.5]])
    B = np.array([[0.0], [1.0], [1.0]])
    feedback = lqr(control.ss(A, B, np.eye(3), 0), weight * np.eye(3), [[1.0]])
    np.testing.assert_allclose(feedback.X, np.linalg.inv(solve_continuous_lyapunov(A, B @ B.T)), rtol=1e-10)
    np.testing.assert_allclose(np.sort_complex(feedback.poles), np.sort_complex(-np.linalg.eigvals(A)), rtol=1e-9)
    # Beside a stable pole, which costs nothing.
    both = control.ss(np.diag([1.0, -3.0]), [[1.0], [1.0]], np.eye(2), 0)
    np.testing.assert_allclose(lqr(both, weight * np.eye(2), [[1.0]]).state_gain, [[2.0, 0.0]], atol=1e-12)


@given(st.floats(-3.0, 3.0), st.floats(-6.0, 2.0))
@settings(max_examples=40, deadline=None)
def test_an_indefinite_weight_is_refused_only_where_a_scalar_has_no_stabilising_solution(a: float, q: float) -> None:
    a, q = round(a, 6), round(q, 6)
    # 2 a x - x² + q = 0: x = a + root of a² + q, where that is positive.
    system = control.ss(a, 1.0, 1.0, 0.0)
    rest = a * a + q
    if rest > 1e-9:
        found = lqr(system, [[q]], [[1.0]])
        np.testing.assert_allclose(found.X, [[a + np.sqrt(rest)]], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(found.poles, [-np.sqrt(rest)], rtol=1e-7)
    elif rest < 0.0:
        with pytest.raises(IllPosedError, match="no stabilising solution"):
            lqr(system, [[q]], [[1.0]])


def test_cheap_control_is_no_reason_to_refuse() -> None:
    # x'' = u with the weight r of u: poles at r^-1/4 times those of a Butterworth filter, the norm of H grows with 1/r.
    system = control.ss([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], np.eye(2), 0)
    for r in 10.0 ** np.arange(-40, 41, 8):
        found = lqr(system, np.diag([1.0, 0.0]), [[r]])
        np.testing.assert_allclose(found.state_gain, [[r**-0.5, np.sqrt(2.0) * r**-0.25]], rtol=1e-12)


def test_four_eigenvalues_that_meet_on_the_axis_are_seen() -> None:
    system = control.ss([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], np.eye(2), 0)
    with pytest.raises(IllPosedError, match="do not reach the mode at 0"):
        lqr(system, np.zeros((2, 2)), [[1.0]])
    sampled = control.ss([[1.0, 1.0], [0.0, 1.0]], [[0.5], [1.0]], np.eye(2), 0, 1.0)
    with pytest.raises(IllPosedError, match="do not reach the mode at z = 1"):
        lqr(sampled, np.zeros((2, 2)), [[1.0]])


def test_a_sampled_plant_needs_no_weight_of_its_inputs() -> None:
    # One step ahead: x[k + 1] = 0 is the best that u can do.
    system = control.ss([[2.0]], [[0.5]], [[1.0]], 0, 0.1)
    np.testing.assert_allclose(lqr(system, [[3.0]], [[0.0]]).state_gain, [[4.0]], rtol=1e-14)
    integrator = control.ss([[1.0]], [[0.5]], [[1.0]], 0, 0.1)
    assert lqr(integrator, [[1.0]], [[0.0]]).poles == pytest.approx(0.0)
    with pytest.raises(IllPosedError, match="do not reach the mode at z = 1"):
        lqr(integrator, [[0.0]], [[0.0]])
    with pytest.raises(IllPosedError, match=r"otherwise the best input has impulses, but is 0 for u\[0\]"):
        lqr(control.ss(2.0, 0.5, 1.0, 0.0), [[3.0]], [[0.0]])


def test_weights_of_more_inputs_than_states_need_not_be_as_large_as_what_they_bring_about() -> None:
    # R + B'XB has rank one but for R, fifteen decades below: positive definite all the same.
    system = control.ss([[1.5]], [[1e4, 2e4, -1e4]], [[1.0]], 0, 1.0)
    found = lqr(system, [[1e4]], 1e-4 * np.eye(3))
    gain = 1.5 * np.array([1e4, 2e4, -1e4]) / 6e8
    np.testing.assert_allclose(found.state_gain[:, 0], gain, rtol=1e-9)


@pytest.mark.parametrize("discrete", [False, True])
def test_no_semidefinite_weight_of_any_size_is_refused(discrete: bool) -> None:
    rng = np.random.default_rng(5)
    for _ in range(60):
        n, m = int(rng.integers(1, 6)), int(rng.integers(1, 4))
        A = rng.normal(size=(n, n)) * (1.0 if discrete else 10.0 ** rng.uniform(-3, 3))
        B = rng.normal(size=(n, m)) * 10.0 ** rng.uniform(-4, 4)
        C = rng.normal(size=(int(rng.integers(0, n + 1)), n)) * 10.0 ** rng.uniform(-8, 4)
        example = Example("", A, B, C.T @ C, np.eye(m), np.zeros((n, m)), None, discrete)
        found = lqr(plant(example), example.Q, example.R)
        assert (np.abs(found.poles).max() < 1.0) if discrete else (found.poles.real.max() < 0.0)
        # Without a weight X is zero, and what a doubling iteration leaves of it may have either sign.
        assert np.linalg.eigvalsh(found.X)[0] >= -1e-12 * np.abs(found.X).max() - 1e-100


def test_what_a_schur_form_cannot_part_is_found_in_many_digits() -> None:
    # Twelve decades between the poles: SciPy's loop is unstable with either balancing.
    A = np.diag([1e-4, 1e8, -1.0]) + np.array([[0.0, 1.0, 2.0], [0.5, 0.0, 1.0], [1.0, -1.0, 0.0]])
    B, Q = np.array([[1e-3], [1e6], [1.0]]), np.diag([1e-12, 0.0, 1e-12])
    found = lqr(control.ss(A, B, np.eye(3), 0), Q, [[1.0]])
    example = Example("", A, B, Q, np.eye(1), np.zeros((3, 1)), None, False)
    stable = eigenvalues(example)
    stable = stable[stable.real < 0]
    for pole in found.poles:
        assert np.abs(stable - pole).min() < 1e-6 * abs(pole)


@pytest.mark.parametrize("small", [1e-6, 1e-11])
def test_a_plant_is_stabilisable_however_small_the_entry_by_which_it_is(small: float) -> None:
    # The mode that grows is reached by way of the other one: the same plant in other units.
    A, B, Q = np.array([[1.0, small], [0.0, -2.0]]), np.array([[0.0], [1.0]]), np.diag([1.0 / small**2, 1.0])
    one = lqr(control.ss([[1.0, 1.0], [0.0, -2.0]], B, np.eye(2), 0), np.eye(2), [[1.0]])
    found = lqr(control.ss(A, B, np.eye(2), 0), Q, [[1.0]])
    np.testing.assert_allclose(found.state_gain, one.state_gain / [small, 1.0], rtol=1e-12)
    # As rounding, in states that mix both, it is nothing: what the input does not reach, it does not stabilise.
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(2, 2)))[0]
    lost = control.ss(turn @ np.diag([1.0, -2.0]) @ turn.T, turn @ [[0.0], [1.0]], np.eye(2), 0)
    with pytest.raises(NotStabilisableError, match="no control u moves the mode at 1"):
        lqr(lost, np.eye(2), [[1.0]])
