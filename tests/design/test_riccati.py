"""Riccati equations of the published collections: held to all digits, and refused for true reasons alone."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
from scipy.linalg import solve_continuous_are, solve_discrete_are

from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.riccati.equations import Equation, riccati_solution
from riccati_examples import Example, carex, darex

# CAREX 11 has a pair of eigenvalues on the imaginary axis, DAREX 2 and 4 have costs without a least value.
REFUSED = {"CAREX 11", "DAREX 2", "DAREX 4"}
# 421 states take seconds: benchmarks/riccati.py.
EXAMPLES = [example for example in (*map(carex, range(1, 20)), *map(darex, range(1, 20)))]
NAMES = [example.name for example in EXAMPLES]
SMALL = [example for example in EXAMPLES if len(example.A) <= 13]


def solved(example: Example) -> FloatArray:
    found = riccati_solution(Equation(*example[1:6], discrete=example.discrete))
    assert found is not None
    return found[0]


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
