"""What syntheses rest on: Riccati equations of the published collections, certificates, the bounded real inequality.

P. Benner, A. J. Laub, V. Mehrmann, A Collection of Benchmark Examples for the Numerical Solution of Algebraic Riccati
Equations I (CAREX) and II (DAREX), 1995.
"""

from __future__ import annotations

import control
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.linalg import block_diag

from design.test_hinf import coprime_problem, gyro, random_plant
from platform_ctrl.analysis import hinf_norm
from platform_ctrl.analysis.system import System
from platform_ctrl.design import hinf
from platform_ctrl.design.inequalities import LinearLoop, cp, sharing, solve
from platform_ctrl.design.partition import autoscale, partition, whole
from platform_ctrl.design.riccati import (
    Equation,
    _floor,
    _least_gamma,
    _normal_form,
    _trial,
    riccati_solution,
    stabilising,
)
from platform_ctrl.design.synthesis import certify
from platform_ctrl.errors import DesignError, NotCertifiedError, UnscalableError

TURN = np.eye(3) - 2.0 / 3.0  # orthogonal and symmetric


def turned(*diagonal: float) -> np.ndarray:
    return TURN @ np.diag(diagonal) @ TURN


def carex_7(e: float = 1e-3) -> tuple:
    root = np.hypot(1.0, e)
    x12 = 1.0 / (2.0 + root)
    X = [[(1.0 + root) / e**2, x12], [x12, 0.25 * (1.0 - e * x12) * (1.0 + e * x12)]]
    return np.diag([1.0, -2.0]), np.array([[e], [0.0]]), np.ones((2, 2)), np.eye(1), X


def carex_9(e: float = 1e6) -> tuple:
    X = [[np.sqrt(1.0 + 2.0 * e) / e, 1.0], [1.0, np.sqrt(1.0 + 2.0 * e)]]
    return np.array([[0.0, e], [0.0, 0.0]]), np.array([[0.0], [1.0]]), np.eye(2), np.eye(1), X


def carex_12(e: float = 1e3) -> tuple:
    x = e**2 + np.sqrt(e**4 + 1.0), 2.0 * e**2 + np.sqrt(4.0 * e**4 + e), 3.0 * e**2 + e * np.sqrt(9.0 * e**2 + 1.0)
    return turned(e, 2.0 * e, 3.0 * e), np.eye(3), turned(1.0 / e, 1.0, e), e * np.eye(3), turned(*x)


NINE = np.array([[9.0, 6.0], [6.0, 4.0]])
A2, B2 = np.array([[4.0, 3.0], [-4.5, -3.5]]), np.array([[1.0], [-1.0]])
SHIFT, LAST = np.eye(2, k=1), np.array([[0.0], [1.0]])
CONTINUOUS = {
    "CAREX 1": (SHIFT, LAST, np.diag([1.0, 2.0]), np.eye(1), [[2.0, 1.0], [1.0, 2.0]]),
    "CAREX 2": (A2, B2, NINE, np.eye(1), (1.0 + np.sqrt(2.0)) * NINE),
    "CAREX 7": carex_7(),
    "CAREX 9": carex_9(),
    "CAREX 12": carex_12(),
}
DISCRETE = {
    # The weight on the control is zero.
    "DAREX 1": (np.array([[2.0, -1.0], [1.0, 0.0]]), [[1.0], [0.0]], np.diag([0.0, 1.0]), np.zeros((1, 1)), np.eye(2)),
    "DAREX 3": (SHIFT, LAST, [[1.0, 2.0], [2.0, 4.0]], np.eye(1), [[1.0, 2.0], [2.0, 2.0 + np.sqrt(5.0)]]),
    "DAREX 14": (A2, B2, NINE, 1e6 * np.eye(1), 0.5 * (1.0 + np.sqrt(1.0 + 4e6)) * NINE),
    "DAREX 16": (1e6 * SHIFT, LAST, np.eye(2), np.eye(1), np.diag([1.0, 1.0 + 1e12])),
}


@pytest.mark.parametrize("name", [*CONTINUOUS, *DISCRETE])
def test_published_solutions_are_found(name: str) -> None:
    A, B, Q, R, expected = map(np.asarray, (CONTINUOUS | DISCRETE)[name])
    equation = Equation(A, B, Q, R, np.zeros(B.shape), name in DISCRETE)
    found = riccati_solution(equation, "it")
    np.testing.assert_allclose(found.X, expected, rtol=0, atol=1e-8 * np.abs(expected).max())
    assert found.relative < 1e-12
    poles = np.linalg.eigvals(A + B @ found.F)
    assert np.all(np.abs(poles) < 1.0) if name in DISCRETE else np.all(poles.real < 0.0)


def test_a_mode_on_the_boundary_that_costs_nothing_is_refused() -> None:
    A, B, Q = np.diag([1.0, 0.5]), np.ones((2, 1)), np.diag([0.0, 1.0])
    with pytest.raises(UnscalableError, match=r"it has no stabilising solution: .* on the unit circle"):
        riccati_solution(Equation(A, B, Q, np.eye(1), np.zeros((2, 1)), True), "it")
    # The H-infinity bisection asks for these.
    assert stabilising(Equation(A - np.eye(2), B, Q, np.eye(1), np.zeros((2, 1)), False)) is None


def test_wrong_controllers_and_norms_below_the_least_are_not_certified():
    P, _, _ = coprime_problem(*gyro())
    good = hinf(P, 2, 2, method="riccati")
    K = System.of(good.controller, "K")

    def certified(controller, least=good.gamma_optimal, **more):
        options = {"least": least, "backoff": 0.02, "method": "test"} | more
        return certify(P, partition(P, 2, 2), controller, **options)

    assert certified(K).gamma == pytest.approx(good.gamma, rel=1e-6)
    with pytest.raises(DesignError, match="has a pole at") as refused:
        certified(K._replace(C=-K.C, D=-K.D))
    assert refused.value.problem is P
    with pytest.raises(DesignError, match="the closed loop has the norm"):
        certified(K, 0.9 * good.gamma_optimal)
    with pytest.raises(DesignError, match="the closed loop has the norm"):
        certified(K._replace(C=1.2 * K.C))
    with pytest.raises(NotCertifiedError, match="no finite H2 norm"):
        certified(K, norm="h2")


def test_slycot_agrees_to_six_digits_where_its_own_loop_has_the_norm_that_it_claims():
    slycot = pytest.importorskip("slycot")
    for n, seed in ((3, 0), (3, 2), (10, 5), (15, 2), (20, 4)):
        p = autoscale(partition(random_plant(seed, n), 2, 2)).plant
        A, B, C, D, _ = whole(p)
        claimed, *_, Ac, Bc, Cc, Dc, _ = slycot.sb10ad(n, 6, 6, 2, 2, 1e3, A, B, C, D)
        true = hinf_norm(control.ss(Ac, Bc, Cc, Dc))[0]
        result = hinf(control.ss(A, B, C, D), 2, 2, method="riccati")
        if n == 3 and seed == 0:
            assert claimed < 0.2 * result.gamma < 0.1 * true
        else:
            assert result.gamma_optimal == pytest.approx(claimed, rel=1e-6)
            assert true == pytest.approx(claimed, rel=1e-4)


@settings(max_examples=15, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    n=st.integers(1, 8),
    ports=st.tuples(*[st.integers(1, 3)] * 2),
    more=st.tuples(*[st.integers(0, 3)] * 2),
    stable=st.booleans(),
)
# X, and Y, becomes infinite a second time past the least gamma.
@example(seed=1828, n=8, ports=(1, 2), more=(0, 0), stable=False)
@example(seed=5035, n=6, ports=(3, 2), more=(0, 0), stable=False)
# D12 is square: X is zero but for rounding, and gamma ends where Y does.
@example(seed=1781, n=3, ports=(2, 1), more=(0, 1), stable=False)
def test_just_above_the_least_gamma_there_are_solutions_and_just_below_none(seed, n, ports, more, stable):
    (nu, ny), (z, w) = ports, more
    P = random_plant(seed, n, ny + w, nu + z, ny, nu, stable)
    normal = _normal_form(autoscale(partition(P, ny, nu)).plant)
    sides = normal, normal.dual
    least = _least_gamma(sides, P)
    if least < 1e-3:
        return  # Nothing stands in the way of gamma = 0 but rounding.

    def reached(gamma):
        found = _trial(sides, gamma)
        return found is not None and 0.0 <= found.radius < gamma**2

    assert reached(least * (1 + 1e-6))
    assert least <= max(_floor(normal), 1e-6) * (1 + 1e-6) or not reached(least * (1 - 1e-6))


def test_loops_without_a_common_matrix_share_none():
    # Each is stable; their product is not.
    first, second = np.array([[0.5, 2.0], [0.0, 0.5]]), np.array([[0.5, 0.0], [2.0, 0.5]])
    assert np.abs(np.linalg.eigvals(first @ second)).max() > 1.0
    assert sharing(np.array([first, second, 0.9 * first])) == 2


def weighted() -> control.StateSpace:
    """A gyroscopic pair behind a lag, with torque disturbance and noise, weighted rate and control."""
    A = block_diag(np.array([[0, 0, 1, 0], [0, 0, 0, 1], [0, 0, 0, -5.0], [0, 0, 5.0, 0]]), -20 * np.eye(2))
    A[2:4, 4:] = np.eye(2)
    B1, B2 = np.zeros((6, 4)), np.zeros((6, 2))
    B1[2:4, :2], B2[4:] = np.eye(2), 20 * np.eye(2)
    C1, C2 = np.zeros((4, 6)), np.hstack([np.eye(2), np.zeros((2, 4))])
    C1[:2, :2] = np.eye(2)
    D = np.zeros((6, 6))
    D[2:4, 4:], D[4:, 2:4] = 0.1 * np.eye(2), 0.1 * np.eye(2)
    return control.ss(A, np.hstack([B1, B2]), np.vstack([C1, C2]), D)


def test_the_bounded_real_inequality_has_the_norm_of_the_riccati_equations_and_of_slycot():
    P = weighted()
    scaled = autoscale(partition(P, 2, 2))
    loop, square = LinearLoop(scaled.plant, direct=True), cp.Variable()
    least = cp.Problem(cp.Minimize(square), [loop.V >> 0, loop.hinf_below(range(4), range(4), 1.0, square)])
    solve(least, "test", "", 30.0, 1e-7)
    gamma = float(np.sqrt(square.value)) * scaled.gain
    assert gamma == pytest.approx(hinf(P, 2, 2, method="riccati").gamma_optimal, rel=1e-3)
    assert gamma == pytest.approx(control.hinfsyn(P, 2, 2)[2], rel=0.01)
