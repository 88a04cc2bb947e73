"""The paper's equations one by one: on any platform, and from (20) on from the energy of the nine bodies."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import three_gyro_paper
from body_geometry import directions, guides, inertias
from platform_ctrl import inverse_dynamics, linearise, matrices, rotor_momenta
from rotors_as_gimbals import with_rotors_as_gimbals
from small_trees import tree
from three_gyro_energy import (
    ACCELERATIONS,
    ANGLES,
    AXIAL,
    CARRIED,
    HALF,
    MOMENTA,
    OMEGA,
    OMEGA_ROTORS,
    RATES,
    SPINS,
    T1,
    T2,
    T_A,
    R,
    S,
    T,
    degree,
    direction_matrix,
    gimbal_row,
    kept,
    mass_matrix,
    polynomial,
    polynomials,
    root_rows,
    times,
)
from tree_cases import platforms, slope, state

quick = settings(max_examples=12, deadline=None)
seeds = st.integers(0, 2**32 - 1)
H = 1e-6


def energy_of_bodies(platform, q, u):
    """½ Σ ωᵀ I ω over all bodies, the rotors among them."""
    bodies = with_rotors_as_gimbals(platform)
    spins = rotor_momenta(platform, q, u).spin
    angles = np.concatenate([q, np.zeros(len(spins))])
    rates = directions(bodies, angles).jacobians @ np.concatenate([u, spins])
    return 0.5 * np.einsum("bi,bij,bj", rates, inertias(bodies, angles), rates)


# Sections 2 and 3: any platform.


@quick
@given(platforms(), seeds)
def test_01_energy_is_that_of_the_carriers_and_of_the_rotors_about_their_axes(platform, seed):
    q, u, _ = state(platform, seed)
    m, now = matrices(platform, q, u), rotor_momenta(platform, q, u)
    ours = 0.5 * u @ m.A @ u + 0.5 * now.rate @ m.A_R @ now.rate
    assert ours == pytest.approx(energy_of_bodies(platform, q, u), rel=1e-10)


@quick
@given(platforms(), seeds)
def test_02_rotors_turn_at_their_spin_and_what_carries_them(platform, seed):
    """Against the body rates themselves: the rotor's rate along its axis."""
    q, u, _ = state(platform, seed)
    at, now = directions(platform, q), rotor_momenta(platform, q, u)
    carriers = at.jacobians[1 + platform.carriers] @ u
    np.testing.assert_allclose(now.rate, now.spin + np.einsum("ri,ri->r", carriers, at.spin_axes), atol=1e-10)


@quick
@given(platforms(), seeds)
def test_03_B_holds_cosines_between_rotor_axes_and_guiding_axes(platform, seed):
    q, _, _ = state(platform, seed)
    at, B = directions(platform, q), matrices(platform, q).B
    for rotor, body in enumerate(1 + platform.carriers):
        np.testing.assert_allclose(B[rotor, :3], at.spin_axes[rotor], atol=1e-14)
        for k in range(len(q)):
            cosine = at.axes[k] @ at.spin_axes[rotor] if guides(platform, body, k) else 0.0
            assert B[rotor, 3 + k] == pytest.approx(cosine, abs=1e-14)
    assert np.abs(B).max(initial=0.0) <= 1 + 1e-14


@quick
@given(platforms(controls=("free",)), seeds)
def test_05_the_routhian_is_the_energy_less_what_the_cyclic_momenta_carry(platform, seed):
    q, u, _ = state(platform, seed)
    m, now = matrices(platform, q, u), rotor_momenta(platform, q, u)
    R2, R1 = 0.5 * u @ m.A @ u, now.p @ m.B @ u
    R0 = 0.5 * now.p @ (now.p / np.diag(m.A_R))
    routhian = R2 + R1 - R0
    size = 1 + abs(R2) + abs(R1) + R0
    assert routhian == pytest.approx(energy_of_bodies(platform, q, u) - now.p @ now.spin, abs=1e-10 * size)


@quick
@given(platforms(controls=("free",)), seeds)
def test_06_gyroscopic_forces_come_from_the_linear_part_of_the_routhian(platform, seed):
    q, u, _ = state(platform, seed)
    n = len(q)

    def linear(angles):
        m = matrices(platform, angles)
        return np.array([m.L @ m.B @ u])

    def momenta(angles):
        m = matrices(platform, angles)
        return m.B.T @ m.L

    force = np.zeros(3 + n)
    force[3:] = slope(linear, q)[0]
    force -= slope(momenta, q) @ u[3:]
    m = matrices(platform, q, u)
    np.testing.assert_allclose(force, -m.G_R @ u, atol=1e-7 * (1 + np.abs(m.G_R).max() * np.abs(u).max()))


@quick
@given(platforms(controls=("regulated",)), seeds)
def test_09_regulated_rotors_split_the_energy_in_three(platform, seed):
    q, u, _ = state(platform, seed)
    m = matrices(platform, q, u)
    parts = (0.5 * u @ m.A_star @ u, m.L @ m.B @ u, 0.5 * m.L @ (m.L / np.diag(m.A_R)))
    assert sum(parts) == pytest.approx(energy_of_bodies(platform, q, u), abs=1e-10 * sum(map(abs, parts)))


@quick
@given(platforms(controls=("regulated",)), seeds)
def test_10_lagranges_equations_of_the_two_parts_give_the_gimbal_rows(platform, seed):
    q, u, u_dot = state(platform, seed)

    def momenta(angles, rates):
        m = matrices(platform, angles)
        return (m.A_star @ rates + m.B.T @ m.L)[3:]

    def energy(angles):
        m = matrices(platform, angles)
        return np.array([0.5 * u @ m.A_star @ u + m.L @ m.B @ u])

    ahead, behind = (momenta(q + s * H * u[3:], u + s * H * u_dot) for s in (1, -1))
    expected = inverse_dynamics(platform, q, u, u_dot)[3:]
    size = 1 + np.abs(expected).max() + np.abs(matrices(platform).L).max(initial=0.0)
    np.testing.assert_allclose((ahead - behind) / (2 * H) - slope(energy, q)[0], expected, atol=1e-7 * size)


@quick
@given(platforms(), seeds)
def test_13_and_14_G_A_and_G_R_are_the_derivatives_that_the_paper_writes(platform, seed):
    q, u, _ = state(platform, seed)
    n, m = len(q), matrices(platform, q, u)
    inertial, gyroscopic = np.zeros((3 + n, 3 + n)), np.zeros((3 + n, 3 + n))
    inertial[:, 3:] = slope(lambda x: matrices(platform, x).A_star @ u, q)
    gyroscopic[:, 3:] = slope(lambda x: matrices(platform, x).B.T @ m.L, q)
    size = 1 + np.abs(m.G_A).max() + np.abs(m.G_R).max()
    np.testing.assert_allclose(m.G_A, inertial - 0.5 * inertial.T, atol=1e-7 * size)
    np.testing.assert_allclose(m.G_R, gyroscopic - gyroscopic.T, atol=1e-7 * size)


# Two gyros with two gimbals each, rotor axes 3 and 1.
GYROS = tree(
    [5.0, 6.0, 7.0],
    [
        ("a1", "base", 1, 0.3, "alpha1"),
        ("b1", "a1", 2, 0.3, "beta1"),
        ("a2", "base", 2, 0.3, "alpha2"),
        ("b2", "a2", 3, 0.3, "beta2"),
    ],
    [("1", "b1", 3, 0.2, 0.1, 18.0), ("2", "b2", 1, 0.2, 0.1, 14.0)],
)


def test_16_to_18_B_of_rotors_in_two_gimbals_has_a_slanted_column_and_zeros_beside_it():
    assert GYROS.angle_names == ("alpha1", "beta1", "alpha2", "beta2")  # (16), as the file has them
    q = np.array([0.02, 0.03, -0.01, 0.04])
    B0, B = matrices(GYROS).B, matrices(GYROS, q).B
    np.testing.assert_allclose(B0[:, :3], [[0, 0, 1], [1, 0, 0]], atol=1e-15)
    np.testing.assert_allclose(B0[:, 3:], 0.0, atol=1e-15)  # the normal position is that of B0 alone
    # cos(alpha', 3^i) = ± sin(beta) by the sense in which beta turns; cos(beta', 3^i) = 0; elsewhere nothing guides.
    pattern = np.zeros((2, 4))
    pattern[0, 0], pattern[1, 2] = np.sin(q[1]), np.sin(q[3])
    np.testing.assert_allclose(np.abs(B[:, 3:]), np.abs(pattern), atol=1e-15)
    np.testing.assert_allclose((B - B0)[:, :3], [[q[1], -q[0], 0], [0, q[3], -q[2]]], atol=1.5e-3)


@quick
@given(platforms(controls=("regulated",)), seeds)
def test_19_the_linear_equations_need_only_A0_B0_and_the_linear_part_of_B(platform, seed):
    m, n = matrices(platform), len(platform.gimbals)
    model = linearise(platform)
    np.testing.assert_allclose(model.M, (m.A + m.B.T @ m.A_R @ m.B)[3:, 3:], atol=1e-12)
    B_A = slope(lambda x: matrices(platform, x).B.T @ m.L, np.zeros(n))[3:]
    np.testing.assert_allclose(model.G, B_A - B_A.T, atol=1e-7 * (1 + np.abs(m.L).max(initial=0.0)))
    np.testing.assert_allclose(model.K, 0.0, atol=1e-12)


# Section 4: the platform of nine bodies, from its energy.

L6, L8, L11 = (S[name] for name in MOMENTA)
C6 = S["C6"]
W1, W2, W3 = (S[name] for name in OMEGA)


def test_04_and_22_momenta_are_those_of_the_energy():
    assert [S[name] for name in MOMENTA] == [polynomial(x) for x in three_gyro_paper.MOMENTA]
    for spin, axial, rate in zip(SPINS, AXIAL, OMEGA_ROTORS, strict=True):
        assert T.diff(S[spin]) == S[axial] * rate  # (4)
    with_spins = T1.compose([(S[name], S[c] * S[f]) for name, c, f in zip(MOMENTA, AXIAL, SPINS, strict=True)])
    T0 = HALF * sum(S[c] * S[f] ** 2 for c, f in zip(AXIAL, SPINS, strict=True))
    assert T - (T2 + with_spins + T0) == 0  # (9) with (8) and (22)


def test_20_and_21_velocities_and_B_to_second_order():
    """With + in row 2, column 1, where the scan prints −."""
    assert [S[name] for name in RATES] == [polynomial(x) for x in three_gyro_paper.VELOCITY]
    assert direction_matrix(2) == polynomials(three_gyro_paper.B0 + three_gyro_paper.B_A)


def test_23_mass_matrix_has_eight_rows():
    assert mass_matrix(T_A, 0) == polynomials(three_gyro_paper.A)


def axial_matrix(order):
    B = direction_matrix(order)
    axial = [S[name] for name in AXIAL]
    size = range(8)
    return [
        [kept(sum(c * times(row[i], row[j]) for c, row in zip(axial, B, strict=True)), order) for j in size]
        for i in size
    ]


def test_24_the_additional_mass_matrix_to_first_order():
    """The matrix that the scan lost."""
    expected = polynomials(three_gyro_paper.BTA_RB)
    assert axial_matrix(1) == expected
    assert kept_all(mass_matrix(T2 - T_A, 1)) == expected


def kept_all(matrix, order=1):
    return [[kept(entry, order) for entry in row] for row in matrix]


def coriolis(mass):
    """(13) of a mass matrix; the root's columns are zero before transposing."""
    u = [S[name] for name in RATES]
    momenta = [sum(entry * rate for entry, rate in zip(row, u, strict=True)) for row in mass]
    N = [[R.zero] * 3 + [momentum.diff(S[angle]) for angle in ANGLES] for momentum in momenta]
    return [[N[i][j] - HALF * N[j][i] for j in range(8)] for i in range(8)]


def test_25_coriolis_matrix_with_A_constant():
    """The other matrix that the scan lost."""
    assert coriolis(axial_matrix(1)) == polynomials(three_gyro_paper.G_A)


def test_26_gyroscopic_matrix_to_first_order():
    """Row 3 with eight entries, where the scan has seven."""
    B = direction_matrix(2)
    momenta = [sum(S[m] * B[r][i] for r, m in enumerate(MOMENTA)) for i in range(8)]
    slopes = [[R.zero] * 3 + [kept(momentum.diff(S[angle]), 1) for angle in ANGLES] for momentum in momenta]
    ours = [[slopes[i][j] - slopes[j][i] for j in range(8)] for i in range(8)]
    assert ours == polynomials(three_gyro_paper.G_R)


def linear(row):
    """What is linear in the gimbals' angles, rates and accelerations together."""
    return kept(row, 1, (*ANGLES, *RATES[3:], *ACCELERATIONS[3:]))


@pytest.mark.parametrize("k", range(5))
def test_27_differs_from_the_energys_rows_by_inertia_terms_in_Omega_alone(k):
    """No L, no q'', no forcing Omega' is missing: only J Omega q', J Omega² q, J Omega' q and J Omega Omega."""
    on_the_left, on_the_right = list(three_gyro_paper.ROWS.values())[k]
    missing = linear(gimbal_row(k, T2 + T1)) - polynomial(on_the_left - on_the_right + three_gyro_paper.TORQUES[k])
    assert missing != 0
    for monomial in missing:
        assert degree(monomial, MOMENTA) == 0
        assert degree(monomial, ACCELERATIONS[3:]) == 0
        rates, changes = degree(monomial, RATES[:3]), degree(monomial, ACCELERATIONS[:3])
        angles, gimbals = degree(monomial), degree(monomial, RATES[3:])
        assert (rates, changes, angles, gimbals) in {(1, 0, 0, 1), (2, 0, 1, 0), (0, 1, 1, 0), (2, 0, 0, 0)}


@pytest.mark.parametrize("k", range(5))
def test_exact_gimbal_rows_are_those_of_the_energy(k):
    terms = list(three_gyro_paper.EXACT_ROWS.values())[k]
    assert linear(gimbal_row(k, T2 + T1)) == polynomial(sum(variable * c for variable, c in terms.items()))


def test_27_drops_terms_as_large_as_the_C_terms_that_it_keeps():
    """J5 Omega1' alpha4, −J7 Omega1' alpha4, J10 Omega2' alpha9; and I5_1 − I5_2 beside C6."""
    rows = [linear(gimbal_row(k, T2 + T1)) for k in range(5)]
    assert [
        rows[1].coeff(S["I5_3"] * S["Omega1_dot"] * S["alpha4"]),
        rows[2].coeff(S["I7_3"] * S["Omega1_dot"] * S["alpha4"]),
    ] == [1, -1]
    assert rows[4].coeff(S["I10_1"] * S["Omega2_dot"] * S["alpha9"]) == 1
    assert rows[0].diff(S["Omega1_dot"]).diff(S["beta5"]) == C6 + S["I5_1"] - S["I5_2"] - S["A6"]


def test_the_scans_signs_are_refuted_by_the_energy():
    """(27) row 5 with −L6 Omega2 on the right; (21) row 2 with −½: neither follows from the bodies."""
    row = linear(gimbal_row(1, T2 + T1))
    assert row.coeff(L6 * W2) == -1  # on the left: + on the right
    assert CARRIED[1].diff(W1).coeff(S["alpha4"] ** 2) == HALF


def test_the_root_precesses_under_its_rotors_although_26_has_a_zero_block():
    """−[h0]× with h0 = (L6 − L8, L11, 0): quasi-velocities."""
    rows = [kept(row, 0, (*ANGLES, *RATES[3:], *ACCELERATIONS)) for row in root_rows(T1)]
    assert rows == [-L11 * W3, (L6 - L8) * W3, L11 * W1 - (L6 - L8) * W2]
