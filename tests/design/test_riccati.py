"""Riccati equations of the published collections that have solutions in closed form, and what has none.

P. Benner, A. J. Laub, V. Mehrmann, A Collection of Benchmark Examples for the Numerical Solution of Algebraic Riccati
Equations I (CAREX) and II (DAREX), 1995.
"""

from __future__ import annotations

import numpy as np
import pytest

from platform_ctrl.design.riccati import Equation, riccati_solution, stabilising
from platform_ctrl.errors import UnscalableError

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
