"""Linear in the angles, not in Omega(t): against the table of coefficients, `linearise` and the full equations."""

import itertools

import numpy as np
import pytest
import sympy
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

import three_gyro_paper
from platform_ctrl import element_forces, inverse_dynamics, linearise, parameter_varying, read_platform
from tree_cases import platforms, with_elements, with_torquers

FORMS = pytest.mark.parametrize("form", ["rates", "momenta"])
SEEDS = st.integers(0, 2**32 - 1)


@pytest.fixture(scope="module")
def platform():
    return read_platform("three_gyro_platform")


def by_monomial(matrix):
    """The coefficients of a SymPy matrix that is polynomial in Omega and Omega', by monomial."""
    variables = [sympy.Symbol(f"Omega{axis}{dot}") for dot in ("", "_dot") for axis in (1, 2, 3)]
    out = {}
    for i, j in np.ndindex(matrix.shape):
        for powers, c in sympy.Poly(matrix[i, j], *variables).terms() if matrix[i, j] != 0 else ():
            names = [str(variable).replace("_dot", "'") for variable in variables]
            factors = [name + "^2" * (power == 2) for name, power in zip(names, powers, strict=True) if power]
            out.setdefault("*".join(factors) or "1", np.zeros(matrix.shape))[i, j] = c
    return out


@pytest.mark.parametrize("terms", ["exact", "paper"])
def test_coefficients_of_the_three_gyro_platform_are_those_of_the_table(terms):
    platform = three_gyro_paper.unequal_platform()
    model = parameter_varying(platform, terms=terms)
    rows = three_gyro_paper.gimbal_rows(terms).subs(three_gyro_paper.numbers(platform))
    motion = [[sympy.Symbol(angle + dots) for angle in platform.angle_names] for dots in ("_ddot", "_dot", "")]
    M, G, K = (rows.jacobian(variables).expand() for variables in motion)
    constant = rows.subs(dict.fromkeys(itertools.chain(*motion), 0))
    changes = sympy.symbols("Omega1_dot Omega2_dot Omega3_dot")
    np.testing.assert_allclose(model.M, np.array(M, dtype=float), rtol=1e-12, atol=1e-14)
    M_Omega = np.array(constant.jacobian(changes), dtype=float)
    np.testing.assert_allclose(model.M_Omega, M_Omega, rtol=1e-12, atol=1e-14)
    Q0 = constant.subs(dict.fromkeys(changes, 0)).expand()
    for polynomial, expected in ((model.G, G), (model.K, K), (model.Q0, Q0)):
        dense = by_monomial(expected)
        assert set(polynomial.monomials) == set(dense)
        for name, coefficients in dense.items():
            ours = polynomial[name].reshape(coefficients.shape)
            np.testing.assert_allclose(ours, coefficients, rtol=1e-12, atol=1e-13, err_msg=name)


@settings(max_examples=25, deadline=None)
@given(platforms(max_gimbals=4), SEEDS, st.sampled_from(["exact", "paper"]))
def test_at_constant_rate_it_is_the_linear_model_at_that_rate(platform, seed, terms):
    rng = np.random.default_rng(seed)
    platform = with_elements(platform, rng)
    q, Omega = rng.uniform(-1, 1, len(platform.gimbals)), rng.normal(size=3) * 3
    frozen = parameter_varying(platform, q=q, terms=terms).at(Omega)
    model = linearise(platform, Omega, terms, q)
    size = 1.0 + np.abs(model.K).max() + np.abs(model.G).max() + np.abs(model.Q0).max()
    np.testing.assert_allclose(frozen.M, model.M)
    np.testing.assert_allclose(frozen.G, model.damping, atol=1e-12 * size)
    np.testing.assert_allclose(frozen.K, model.stiffness, atol=1e-12 * size)
    np.testing.assert_allclose(frozen.forcing, model.Q0, atol=1e-12 * size)


@settings(max_examples=25, deadline=None)
@given(platforms(max_gimbals=4), SEEDS)
def test_it_is_the_first_order_part_of_the_moment_balance(platform, seed):
    rng = np.random.default_rng(seed)
    n = len(platform.gimbals)
    platform = with_elements(platform, rng)
    q0, Omega, Omega_dot = rng.uniform(-1, 1, n), rng.normal(size=3), rng.normal(size=3)
    deviation, rates, accelerations = rng.normal(size=(3, n))
    step = 1e-4

    def torque(size):
        velocity = np.concatenate([Omega, size * rates])
        forces = inverse_dynamics(
            platform, q0 + size * deviation, velocity, np.concatenate([Omega_dot, size * accelerations])
        )
        return (forces - element_forces(platform, q0 + size * deviation, velocity))[3:]

    rows = parameter_varying(platform, q=q0).at(Omega, Omega_dot)
    linear = rows.M @ accelerations + rows.G @ rates + rows.K @ deviation
    size = 1.0 + np.abs(torque(0.0)).max() + np.abs(linear).max()
    np.testing.assert_allclose(rows.forcing, torque(0.0), atol=1e-11 * size)
    np.testing.assert_allclose(linear, (torque(step) - torque(-step)) / (2 * step), atol=1e-5 * size)


def monomials(names, rate, change):
    """Values of names such as 1, Omega1^2, Omega1*Omega2 and Omega1'."""
    known = {f"Omega{k + 1}{mark}": x for mark, given in (("", rate), ("'", change)) for k, x in enumerate(given)}
    powers = [[factor.partition("^") for factor in name.split("*") if factor != "1"] for name in names]
    return np.array([np.prod([known[base] ** int(power or 1) for base, _, power in one]) for one in powers])


@FORMS
def test_every_manoeuvre_stays_within_the_vertices(form):
    model = parameter_varying(three_gyro_paper.unequal_platform(), gimbals=("9", "10"), form=form)
    affine = model.affine
    most, fastest = np.array([1.0, 2.0, 0.5]), np.array([3.0, 10.0, 0.0])
    vertices = model.vertices(most, fastest)
    corners = np.array([vertex.parameters for vertex in vertices])
    assert len(vertices) == 2 ** len(affine.parameters)
    rng = np.random.default_rng(0)
    for _ in range(200):
        rho = monomials(affine.parameters, rng.uniform(-most, most), rng.uniform(-fastest, fastest))
        assert np.all((corners.min(axis=0) <= rho) & (rho <= corners.max(axis=0)))
    Omega, change = rng.uniform(-most, most), rng.uniform(-fastest, fastest)
    frozen = model.state_space(Omega, change).A
    flat = np.array([vertex.system.A.ravel() for vertex in vertices]).T
    scale = np.abs(flat).max(axis=1) + 1e-300
    found = linprog(
        np.zeros(len(vertices)),
        A_eq=np.vstack([flat / scale[:, None], np.ones(len(vertices))]),
        b_eq=np.append(frozen.ravel() / scale, 1.0),
    )
    assert found.success
    np.testing.assert_allclose(flat @ found.x / scale, frozen.ravel() / scale, atol=1e-6)


def test_a_grid_holds_the_frozen_systems(platform):
    model = parameter_varying(platform, gimbals=("9", "10"))
    points = model.grid(3, (1.0, 2.0, 0.0))
    rates = [tuple(point.Omega.tolist()) for point in points]
    assert rates == list(itertools.product((-1.0, 0.0, 1.0), (-2.0, 0.0, 2.0), (0.0,)))
    for point in points:
        np.testing.assert_array_equal(point.system.A, model.state_space(point.Omega).A)
    assert len(model.grid((1, 3, 1, 1, 5, 1), (1, 1, 1), (1, 1, 1))) == 15
    assert len(model.grid((1, 3, 1), (1, 1, 1), (1, 1, 1))) == 3


@settings(max_examples=10, deadline=None)
@given(platforms(max_gimbals=3), SEEDS)
def test_the_state_space_forms_are_the_second_order_rows(platform, seed):
    rng = np.random.default_rng(seed)
    platform = with_elements(with_torquers(platform), rng)
    n = len(platform.gimbals)
    q, rates, Q = rng.normal(size=(3, n))
    Omega = rng.normal(size=3)
    for form in ("rates", "momenta"):
        model = parameter_varying(platform, form=form)
        rows, x = model.at(Omega), model.state(q, rates, Omega)
        derivative = model.rhs(0.0, x, Omega, None, Q)
        np.testing.assert_allclose(derivative[:n], rates, atol=1e-9)
        # At a constant rate: d(state)/dt = state(q̇, q̈) without the constant part.
        accelerations = np.linalg.solve(rows.M, Q - rows.forcing - rows.G @ rates - rows.K @ q)
        change = model.state(rates, accelerations, Omega) - model.state(np.zeros(n), np.zeros(n), Omega)
        np.testing.assert_allclose(derivative, change, rtol=1e-8, atol=1e-8 * (1 + np.abs(change).max()))
