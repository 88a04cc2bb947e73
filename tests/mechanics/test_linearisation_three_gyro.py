"""Every coefficient of the three-gyro platform's linear equations against the exact and the paper's formulas."""

import numpy as np
import pytest

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


def coefficients(terms, Omega, Omega_dot):
    """Rows 4, 5, 7, 9, 10: (constant part of −Q, coefficients of q̈, q̇, q)."""
    o1, o2, o3 = Omega
    d1, d2, d3 = Omega_dot
    e = 1.0 if terms == "exact" else 0.0

    def j(value):  # a term that the paper drops
        return e * value

    # Coefficients of Omega' q: exact, or the rotors' C alone.
    k5, k7 = (K5[0] - K5[1], -K7[0] + K7[1]) if e else (C6, -C8)
    k10 = K10[1] - K10[2] if e else C11
    constant = np.array(
        [
            S[1] * d2 + (L6 - L8) * o3 + j((S[0] - S[2]) * o1 * o3),
            K5[2] * d3 - L6 * o2 + j((-K5[0] + K5[1]) * o1 * o2),
            -K7[2] * d3 - L8 * o2 + j((K7[0] - K7[1]) * o1 * o2),
            N[2] * d3 + L11 * o1 + j((-N[0] + N[1]) * o1 * o2),
            K10[0] * d1 - L11 * o3 + j((-K10[1] + K10[2]) * o2 * o3),
        ]
    )
    acceleration = np.diag([S[1], K5[2], K7[2], N[2], K10[0]])
    rate, angle = np.zeros((5, 5)), np.zeros((5, 5))
    rate[0, 1] = L6 + j((K5[0] - K5[1] - K5[2]) * o1)
    rate[0, 2] = L8 + j((-K7[0] + K7[1] + K7[2]) * o1)
    rate[1, 0] = -L6 + j((-K5[0] + K5[1] + K5[2]) * o1)
    rate[2, 0] = -L8 + j((K7[0] - K7[1] - K7[2]) * o1)
    rate[3, 4] = L11 + j((-K10[0] + K10[1] - K10[2]) * o2)
    rate[4, 3] = -L11 + j((K10[0] - K10[1] + K10[2]) * o2)
    angle[0, 0] = (L6 - L8) * o1 + j((S[0] - S[2]) * (o1**2 - o3**2))
    angle[0, 1] = k5 * d1 + j((K5[0] - K5[1]) * o2 * o3)
    angle[0, 2] = k7 * d1 + j((-K7[0] + K7[1]) * o2 * o3)
    angle[1, 0] = j(K5[2] * d1 + (K5[0] - K5[1]) * o2 * o3)
    angle[1, 1] = L6 * o1 + j((K5[0] - K5[1]) * (o1**2 - o2**2))
    angle[2, 0] = j(-K7[2] * d1 + (-K7[0] + K7[1]) * o2 * o3)
    angle[2, 2] = -L8 * o1 + j((K7[0] - K7[1]) * (o1**2 - o2**2))
    angle[3, 3] = L11 * o2 + j((N[0] - N[1]) * (o1**2 - o2**2))
    angle[3, 4] = k10 * d2 + j((K10[1] - K10[2]) * o1 * o3)
    angle[4, 3] = j(K10[0] * d2 + (K10[1] - K10[2]) * o1 * o3)
    angle[4, 4] = L11 * o2 + j((K10[1] - K10[2]) * (o2**2 - o3**2))
    return constant, acceleration, rate, angle


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
