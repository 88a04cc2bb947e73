"""Every coefficient of the three-gyro platform's linear equations against the exact and the paper's formulas."""

import functools
from itertools import chain

import numpy as np
import pytest
import sympy

import three_gyro_paper
from platform_ctrl.mechanics.equations import inverse_dynamics
from platform_ctrl.mechanics.linearisation import linearise
from platform_ctrl.plant.platform import Gimbal, Platform, Rotor

I4, I5, I7 = (0.9, 0.7, 0.8), (0.31, 0.25, 0.28), (0.29, 0.27, 0.24)
I9, I10 = (0.55, 0.6, 0.52), (0.33, 0.36, 0.21)
C6, C8, C11, A6, A8, A11 = 0.11, 0.12, 0.13, 0.08, 0.07, 0.09
L6, L8, L11 = 21.0, 17.0, 13.0
K5 = (I5[0] + C6, I5[1] + A6, I5[2] + A6)
K7 = (I7[0] + C8, I7[1] + A8, I7[2] + A8)
K10 = (I10[0] + A11, I10[1] + C11, I10[2] + A11)
S = tuple(a + b + c for a, b, c in zip(I4, K5, K7, strict=True))
N = tuple(a + b for a, b in zip(I9, K10, strict=True))


def _gimbal(name, parent, axis, inertia, angle):
    return Gimbal(name=name, parent=parent, axis=np.array(axis, float), inertia=np.diag(inertia), angle=angle)


def _rotor(name, carrier, axis, C, A, L):
    return Rotor(
        name=name,
        carrier=carrier,
        axis=np.array(axis, float),
        axial_inertia=C,
        transverse_inertia=A,
        angular_momentum=L,
    )


PLATFORM = Platform(
    name="three-gyro platform",
    root_name="platform",
    root_inertia=np.array([[12.0, 0.3, -0.2], [0.3, 10.0, 0.4], [-0.2, 0.4, 14.0]]),
    gimbals=(
        _gimbal("4", "platform", (0, 1, 0), I4, "alpha4"),
        _gimbal("5", "4", (0, 0, 1), I5, "beta5"),
        _gimbal("7", "4", (0, 0, -1), I7, "beta7"),
        _gimbal("9", "platform", (0, 0, 1), I9, "alpha9"),
        _gimbal("10", "9", (1, 0, 0), I10, "beta10"),
    ),
    rotors=(
        _rotor("6", "5", (1, 0, 0), C6, A6, L6),
        _rotor("8", "7", (-1, 0, 0), C8, A8, L8),
        _rotor("11", "10", (0, 1, 0), C11, A11, L11),
    ),
)


# The moments of inertia of the tables in three_gyro_paper: of all that turns with a gimbal, without C.
NUMBERS = {
    "J4": S[1], "J4_1": S[0] - C6 - C8, "J4_3": S[2],
    "J5": K5[2], "J5_1": K5[0] - C6, "J5_2": K5[1],
    "J7": K7[2], "J7_1": K7[0] - C8, "J7_2": K7[1],
    "J9": N[2], "J9_1": N[0], "J9_2": N[1] - C11,
    "J10": K10[0], "J10_2": K10[1] - C11, "J10_3": K10[2],
    "L6": L6, "L8": L8, "L11": L11, "C6": C6, "C8": C8, "C11": C11,
}  # fmt: skip
ANGLES = ("alpha4", "beta5", "beta7", "alpha9", "beta10")


@functools.cache
def tables(terms):
    """Constant part of −Q, and the coefficients of q̈, q̇ and q, as functions of Omega and Omega'."""
    if terms == "exact":
        rows = [sum(variable * c for variable, c in row.items()) for row in three_gyro_paper.EXACT_ROWS.values()]
    else:
        both = zip(three_gyro_paper.ROWS.values(), three_gyro_paper.TORQUES, strict=True)
        rows = [left - right + torque for (left, right), torque in both]
    rows = sympy.Matrix(rows).subs({sympy.Symbol(name): number for name, number in NUMBERS.items()})
    motion = [[sympy.Symbol(angle + dots) for angle in ANGLES] for dots in ("_ddot", "_dot", "")]
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


def test_the_difference_of_the_pair_is_a_double_integrator_for_equal_momenta():
    equal = linearise(PLATFORM)
    direction = np.array([0.0, L8, -L6, 0.0, 0.0])
    np.testing.assert_allclose(equal.G @ direction, 0.0, atol=1e-12)
    np.testing.assert_allclose(equal.K @ direction, 0.0, atol=1e-12)


def test_exact_form_is_the_derivative_of_the_non_linear_equations():
    """Row by row: the exact linear form follows inverse dynamics to second order in the angles."""
    Omega = np.array([0.3, -0.8, 0.5])
    model = linearise(PLATFORM, Omega=Omega)
    rng = np.random.default_rng(3)
    direction, rate, acceleration, omega, omega_dot = (rng.normal(size=k) for k in (5, 5, 5, 3, 3))
    errors = []
    for size in (1e-2, 1e-3):
        exact = inverse_dynamics(
            PLATFORM,
            size * direction,
            np.concatenate([Omega + size * omega, size * rate]),
            np.concatenate([size * omega_dot, size * acceleration]),
        )[3:]
        linear = model.Q0 + size * (
            model.M @ acceleration
            + model.G @ rate
            + model.K @ direction
            + model.M_Omega @ omega_dot
            + model.G_Omega @ omega
        )
        errors.append(np.abs(exact - linear).max())
    assert errors[1] < 0.011 * errors[0]
