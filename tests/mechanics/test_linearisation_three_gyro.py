"""Every coefficient of the three-gyro platform's linear equations against the exact and the paper's formulas."""

import functools
from itertools import chain

import numpy as np
import pytest
import sympy

import three_gyro_paper
from platform_ctrl.mechanics.linearisation import linearise

PLATFORM = three_gyro_paper.unequal_platform()


@functools.cache
def tables(terms):
    """Constant part of −Q, and the coefficients of q̈, q̇ and q, as functions of Omega and Omega'."""
    rows = three_gyro_paper.gimbal_rows(terms).subs(three_gyro_paper.numbers(PLATFORM))
    motion = [[sympy.Symbol(angle + dots) for angle in PLATFORM.angle_names] for dots in ("_ddot", "_dot", "")]
    constant = rows.subs(dict.fromkeys(chain(*motion), 0))
    moving = [sympy.Symbol(f"Omega{axis}{dot}") for dot in ("", "_dot") for axis in (1, 2, 3)]
    return [sympy.lambdify(moving, part) for part in (constant, *(rows.jacobian(variables) for variables in motion))]


def coefficients(terms, Omega, Omega_dot):
    """Rows 4, 5, 7, 9, 10: (constant part of −Q, coefficients of q̈, q̇, q)."""
    constant, *others = (np.array(part(*Omega, *Omega_dot), dtype=float) for part in tables(terms))
    return constant[:, 0], *others


@pytest.mark.parametrize("terms", ["exact", "paper"])
@pytest.mark.parametrize("Omega", [(0, 0, 0), (0.7, 0, 0), (0, -0.4, 0), (0, 0, 0.9), (0.3, -0.8, 0.5)])
def test_every_coefficient_of_the_gimbal_equations(terms, Omega):
    model = linearise(PLATFORM, Omega=Omega, terms=terms)
    for rate_change in np.eye(3):
        constant, acceleration, rate, angle = coefficients(terms, Omega, 0.6 * rate_change)
        np.testing.assert_allclose(model.Q0 + model.M_Omega @ (0.6 * rate_change), constant, atol=1e-12)
        np.testing.assert_allclose(model.M, acceleration, atol=1e-13)
        np.testing.assert_allclose(model.G, rate, atol=1e-12)
        changing = np.einsum("iaj,a->ij", model.M_Omega_q, 0.6 * rate_change)
        np.testing.assert_allclose(model.K + changing, angle, atol=1e-12)


@pytest.mark.parametrize("terms", ["exact", "paper"])
def test_coefficient_of_a_change_of_rate(terms):
    """G_Omega is the derivative of the constant part in Omega."""
    Omega = np.array([0.3, -0.8, 0.5])
    model = linearise(PLATFORM, Omega=Omega, terms=terms)
    for axis in range(3):
        step = np.zeros(3)
        step[axis] = 1e-3
        up, down = (coefficients(terms, Omega + sign * step, np.zeros(3))[0] for sign in (1, -1))
        # The constant part is quadratic in Omega: the central difference is exact but for rounding.
        np.testing.assert_allclose(model.G_Omega[:, axis], (up - down) / 2e-3, atol=1e-9)
