"""Precession theory (15): where it may be used, what cures it where not, and how far it is from the full equations."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from platform_ctrl.errors import ArgumentError, MechanicsError
from platform_ctrl.mechanics.linearisation import linearise
from platform_ctrl.mechanics.precession import choice
from platform_ctrl.mechanics.precession.result import precession
from platform_ctrl.mechanics.state_space import state_space
from platform_ctrl.plant.force_elements import Cage, Erection, Friction, Spring
from platform_ctrl.plant.reading import read_platform
from tree_cases import platforms, with_torquers

L, J4, J5, J9, J10 = 0.15, 8e-4, 2e-4, 5e-4, 2e-4
NUTATION_457, NUTATION_910 = np.sqrt(2) * L / np.sqrt(J4 * J5), L / np.sqrt(J9 * J10)


@pytest.fixture(scope="module")
def platform():
    return read_platform("three_gyro_platform")


def with_momenta(platform, *momenta):
    rotors = (dataclasses.replace(r, angular_momentum=float(h)) for r, h in zip(platform.rotors, momenta, strict=True))
    return dataclasses.replace(platform, rotors=tuple(rotors))


def two_pairs(platform, stiffness, momenta=(L, L), inertia=4e-4, coupling=0.3):
    """Return the equations of two gyros whose gimbals share inertia and nothing else."""
    base = linearise(
        dataclasses.replace(platform, gimbals=platform.gimbals[:4], torquers=(), rotors=platform.rotors[:1])
    )
    turn = np.array([[0.0, 1.0], [-1.0, 0.0]])
    M, none = inertia * np.eye(4), np.zeros((2, 2))
    M[0, 2] = M[2, 0] = coupling * inertia
    G = np.block([[momenta[0] * turn, none], [none, momenta[1] * turn]])
    return dataclasses.replace(base, M=M, G=G, K=np.diag(stiffness), M_Omega_q=np.zeros((4, 3, 4)))


def chain(n, momentum=50.0):
    """Return n gimbals in a row, about axes 1 and 2 in turn, with a rotor about axis 3 in every third."""
    gimbals = [
        {
            "name": f"g{k}",
            "parent": f"g{k - 1}" if k else "base",
            "axis": [0, 1, 0] if k % 2 else [1, 0, 0],
            "inertia": [1, 1, 1],
        }
        for k in range(n)
    ]
    rotors = [
        {
            "name": f"r{k}",
            "carrier": f"g{k}",
            "axis": [0, 0, 1],
            "axial_inertia": 0.1,
            "transverse_inertia": 0.06,
            "angular_momentum": momentum + k,
        }
        for k in range(0, n, 3)
    ]
    root = {"name": "base", "inertia": [1, 1, 1]}
    return read_platform({"schema": 1, "name": "chain", "root": root, "gimbal": gimbals, "rotor": rotors})


def gyro_pairs(rng):
    """Return one or two gyros in two gimbals each, on the root or one on the other, some on soft springs."""
    gimbals, rotors, parent = [], [], "base"
    for k in range(int(rng.integers(1, 3))):
        axes, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        for name, on, axis in ((f"o{k}", parent, axes[0]), (f"i{k}", f"o{k}", axes[1])):
            points = rng.uniform(0.2, 1.0, 3)
            gimbals.append({"name": name, "parent": on, "axis": list(axis), "inertia": list(points.sum() - points)})
        size = float(rng.choice([-1.0, 1.0]) * 50.0 * 10.0 ** rng.uniform(0, 1))
        inertia = {"axial_inertia": 0.3, "transverse_inertia": 0.2}
        rotors.append({"name": f"r{k}", "carrier": f"i{k}", "axis": list(axes[2]), "angular_momentum": size, **inertia})
        parent = f"i{k}" if rng.random() < 0.5 else "base"
    springs = [{"gimbal": g["name"], "stiffness": float(10.0 ** rng.uniform(-2, 0))} for g in gimbals[::2]]
    root = {"name": "base", "inertia": [3, 3, 3]}
    return read_platform(
        {"schema": 1, "name": "pairs", "root": root, "gimbal": gimbals, "rotor": rotors, "spring": springs}
    )


def slow_poles(model, part):
    full = state_space(model, gimbals=part.gimbals).poles()
    return full[np.argsort(np.abs(full))][: len(part.precession_roots)]


def largest_gap(one, other):
    gap = np.abs(np.asarray(one)[:, None] - np.asarray(other)[None, :])
    return max(gap.min(axis=0).max(), gap.min(axis=1).max())


# The paper's platform: 9-10 may be treated so, 4-5-7 may not.


def test_a_torqued_two_axis_gyro_precesses_about_the_other_axis(platform):
    """(27), rows 9 and 10 without J: L β̇10 = Q9 − L Omega1, −L α̇9 = Q10 + L Omega3."""
    sys = precession(linearise(platform), gimbals=("9", "10")).state_space()
    assert sys.state_labels == sys.output_labels == ["alpha9", "beta10"]
    assert sys.input_labels == ["Q9", "Q10", "Omega1", "Omega2", "Omega3"]
    np.testing.assert_array_equal(sys.A, 0)
    np.testing.assert_allclose(sys.B, [[0, -1 / L, 0, 0, -1], [1 / L, 0, -1, 0, 0]], atol=1e-15)
    np.testing.assert_array_equal(sys.C, np.eye(2))
    np.testing.assert_array_equal(sys.D, 0)


def test_nutation_frequencies_of_the_paper(platform):
    whole = precession(linearise(platform))
    three, two = whole.parts
    assert three.nutation == pytest.approx([NUTATION_457])
    assert two.nutation == pytest.approx([NUTATION_910])
    assert three.singular_values[:2] == pytest.approx([NUTATION_457, NUTATION_457])
    assert two.singular_values == pytest.approx([NUTATION_910, NUTATION_910])
    assert (three.rank, two.rank) == (2, 2)


def test_4_5_7_needs_one_momentum_state_that_of_beta5_against_beta7(platform):
    whole = precession(linearise(platform))
    three, two = whole.parts
    assert two.admissible
    assert not two.reasons
    assert not two.cures
    assert not three.admissible
    assert not whole.admissible
    assert three.reasons == (
        "4-5-7: G_R is 3 x 3 and skew, so its determinant is 0: beta5 - beta7 has no gyroscopic stiffness",
    )
    assert three.cures[0] == "keep one momentum state, that of beta5 - beta7 (momentum_states=True)"
    assert whole.momentum_states == 1
    np.testing.assert_allclose(three.null_directions.T, [[0, 1, -1]], atol=1e-12)
    with pytest.raises(MechanicsError, match=r"4-5-7: G_R is 3 x 3.*keep one momentum state"):
        whole.state_space()
    with pytest.raises(MechanicsError, match="no gyroscopic stiffness"):
        whole.error([1.0])


@pytest.mark.parametrize("momenta", [(0.15, 0.12), (0.1, 0.3)])
def test_with_unequal_rotors_the_direction_without_stiffness_is_the_one_that_their_torques_on_4_cancel_in(
    platform, momenta
):
    """L6 β̇5 + L8 β̇7 = 0: the direction (0, L8, −L6)."""
    part = precession(linearise(with_momenta(platform, *momenta, L))).part("4")
    direction = part.null_directions[:, 0]
    np.testing.assert_allclose(direction / direction[1], [0, 1, -momenta[0] / momenta[1]], atol=1e-12)
    np.testing.assert_allclose(part.G @ direction, 0, atol=1e-15)


def test_the_cured_model_of_the_paper_written_down(platform):
    """√2-pair (4, 5 + 7) precesses, β5 − β7 is a double integrator, π = J5 β̇5 − J7 β̇7 + (J5 + J7) Omega3."""
    sys = precession(linearise(platform)).state_space(momentum_states=True)
    assert sys.state_labels == ["alpha4", "beta5", "beta7", "alpha9", "beta10", "pi_beta5"]
    assert sys.output_labels == ["alpha4", "beta5", "beta7", "alpha9", "beta10"]
    A, B = np.zeros((6, 6)), np.zeros((6, 8))
    A[1, 5], A[2, 5] = 0.5 / J5, -0.5 / J5
    B[0, [1, 2, 6]] = -0.5 / L, -0.5 / L, -1.0  # −2 L α̇4 = Q5 + Q7 + 2 L Omega2
    B[1, [0, 7]], B[2, [0, 7]] = (0.5 / L, -1.0), (0.5 / L, 1.0)  # L (β̇5 + β̇7) = Q4; β̇5 − β̇7 = −2 Omega3 + ...
    B[3, [4, 7]], B[4, [3, 5]] = (-1 / L, -1.0), (1 / L, -1.0)
    B[5, [1, 2]] = 1.0, -1.0
    np.testing.assert_allclose(sys.A, A, atol=1e-9)
    np.testing.assert_allclose(sys.B, B, atol=1e-12)


@pytest.mark.parametrize("momenta", [(L, L, L), (0.15, 0.12, L)])
def test_what_is_0_in_theory_is_0_in_the_matrices(platform, momenta):
    """Only π drives by itself, along (0, L8, −L6); torques about 4 turn 5 and 7, those about 5 and 7 turn 4."""
    sys = precession(linearise(with_momenta(platform, *momenta))).state_space(momentum_states=True)
    A, B = np.zeros((6, 6), dtype=bool), np.zeros((6, 5), dtype=bool)
    A[[1, 2], 5] = B[[1, 2], 0] = B[0, [1, 2]] = B[5, [1, 2]] = B[3, 4] = B[4, 3] = True
    np.testing.assert_array_equal(sys.A != 0, A)
    np.testing.assert_array_equal(sys.B[:, :5] != 0, B)


def test_a_spring_that_is_a_million_million_times_softer_than_another_stays(platform):
    springs = (Spring(gimbal="9", stiffness=0.3), Spring(gimbal="10", stiffness=3e-13))
    model = linearise(dataclasses.replace(platform, springs=springs))
    A = precession(model, ("9", "10")).state_space().A
    np.testing.assert_allclose(A, [[0, 3e-13 / L], [-0.3 / L, 0]], rtol=1e-9, atol=0)


@pytest.mark.parametrize(
    ("momentum", "name", "state"),
    [(0.14992, "beta5 - beta7", "pi_beta5"), (0.1490, "0.99 beta5 - beta7", "pi_beta7")],
)
def test_a_direction_is_called_after_its_largest_angle_and_among_equals_after_the_first(
    platform, momentum, name, state
):
    """Equal to a thousandth is equal: (0, L8, −L6) with L8 = 0.99947 L6 is β5 against β7."""
    whole = precession(linearise(with_momenta(platform, 0.15, momentum, L)))
    assert whole.part("4").direction_names == (name,)
    assert whole.state_space(momentum_states=True).state_labels[-1] == state


def test_rates_of_the_platform_are_no_obstacle_and_the_root_is_the_gyroscopic_restraint(platform):
    """Omega2 restrains gyro 11 about both axes by L Omega2: it precesses with Omega2, in the model and in truth."""
    model = linearise(platform, Omega=(0, 1.5, 0), terms="paper")
    part = precession(model, gimbals=("9", "10")).parts[0]
    assert part.admissible
    np.testing.assert_allclose(part.precession_roots.imag, [1.5, -1.5], rtol=1e-12)
    assert largest_gap(part.precession_roots, slow_poles(model, part)) < 1.5 * 2 * 1.5 / NUTATION_910
    assert part.root_error == pytest.approx(largest_gap(part.precession_roots, slow_poles(model, part)), rel=1e-6)


@pytest.mark.parametrize("terms", ["exact", "paper"])
def test_slow_poles_of_4_5_7_on_a_turning_platform_come_out_right_with_one_momentum_state(platform, terms):
    model = linearise(with_momenta(platform, 0.15, 0.12, L), Omega=(0.3, -0.8, 0.5), terms=terms)
    part = precession(model, gimbals=("4", "5", "7")).parts[0]
    poles = precession(model, gimbals=("4", "5", "7")).state_space(momentum_states=True).poles()
    slow = slow_poles(model, part)
    assert np.abs(slow).max() > 4.0  # L6 and L8 do not balance: a fast divergence
    assert largest_gap(poles, slow) < 0.005 * np.abs(slow).max()
    assert largest_gap(part.precession_roots, poles) < 1e-6


def test_equal_rotors_on_a_platform_that_rolls_leave_slow_poles_to_the_dropped_terms(platform):
    """With L6 = L8 and Omega1 the paper's terms leave s⁴ = 0; with inertia it is s² (s² − 2 Omega1²)."""
    Omega1 = 0.3
    model = linearise(platform, Omega=(Omega1, 0, 0), terms="paper")
    part = precession(model, gimbals=("4", "5", "7")).parts[0]
    np.testing.assert_array_equal(part.precession_roots, 0)
    assert part.multiple_roots
    assert part.root_error == pytest.approx(np.sqrt(2) * Omega1, rel=1e-4)
    # Far above Omega1 it does not matter: one momentum state still serves a loop there, and the error says so.
    assert part.momentum_directions.shape == (3, 1)
    frequency = np.array([3.0, 6.0])
    assert part.error(frequency, momentum_states=True) == pytest.approx(2 * (Omega1 / frequency) ** 2, rel=0.05)
    assert precession(model, ("4", "5", "7"), loop_frequency=0.5).parts[0].momentum_directions.shape == (3, 3)


# The rule itself.


@settings(max_examples=60, deadline=None)
@given(platforms(max_gimbals=5, controls=("regulated",)), st.integers(0, 2**32 - 1))
def test_subsystems_of_odd_order_are_always_singular_and_always_cured(platform, seed):
    Omega = np.random.default_rng(seed).normal(size=3)
    platform = with_torquers(platform)
    model = linearise(platform, Omega=Omega)
    whole = precession(model)
    for part in whole.parts:
        n = len(part.gimbals)
        assert part.rank % 2 == 0
        assert part.admissible == (not part.reasons) == (not part.cures)
        if n % 2:
            assert part.rank < n
            # What can stand in for G there is a spring, be it the gyroscopic restraint L Omega.
            assert part.restrained or not part.admissible
        assert part.null_directions.shape == (n, n - part.rank)
        np.testing.assert_allclose(part.G @ part.null_directions, 0, atol=1e-8 * np.abs(part.G).max(initial=1.0))
        sys = precession(model, gimbals=part.gimbals).state_space(momentum_states=True)
        assert np.all(np.isfinite(np.hstack([sys.A, sys.B])))
        kept = part.momentum_directions.shape[1]
        # Springs hold what no momentum is kept for, at times a weak gyroscopic pair too: those angles follow the
        # torques at once and are no states.
        if kept:
            assert sys.nstates == n + kept
        else:
            assert sys.nstates in range(part.rank, -1, -2)


def test_what_is_admissible_under_soft_springs_errs_by_a_third_at_the_most():
    """X_r s² X ≤ (ω/ν)/(1 − ρ/ω) ‖X‖ with ν the smallest singular value of G, ρ = ‖G⁻¹ K‖."""
    judged, refused, errors = 0, 0, []
    for seed in range(80):
        rng = np.random.default_rng(seed)
        model = linearise(gyro_pairs(rng), Omega=rng.normal(size=3) * 10.0 ** rng.uniform(-3, -1))
        for free in precession(model).parts:
            gimbals, nu = free.gimbals, free.singular_values[-1]
            omega = float(nu * rng.uniform(0.02, 0.5))
            part = precession(model, gimbals, loop_frequency=omega).parts[0]
            root = np.linalg.cholesky(part.M)
            rho = np.linalg.norm(root.T @ np.linalg.solve(part.G, part.stiffness) @ np.linalg.inv(root.T), 2)
            assert rho < 0.1 * omega
            if part.admissible:
                judged += 1
                errors.append(part.error([omega])[0])
                assert errors[-1] <= omega / nu / (1.0 - rho / omega) * (1.0 + 1e-9)
                assert errors[-1] < 1.02 / 3.0
            else:
                refused += 1
                assert omega > 0.98 * nu / 3.0
    assert judged > 50
    assert refused > 20
    assert max(errors) > 0.3


@settings(max_examples=25, deadline=None)
@given(platforms(max_gimbals=4), st.integers(0, 2**32 - 1))
def test_the_error_is_the_distance_of_the_two_state_space_models(platform, seed):
    rng = np.random.default_rng(seed)
    model = linearise(with_torquers(platform), Omega=0.1 * rng.normal(size=3))
    whole = precession(model)
    frequency = float(rng.uniform(0.5, 20.0))
    for part in whole.parts:
        n = len(part.gimbals)
        full = np.asarray(state_space(model, gimbals=part.gimbals)(1j * frequency))[:, :n]
        reduced = np.asarray(precession(model, part.gimbals).state_space(momentum_states=True)(1j * frequency)).reshape(
            n, n + 3
        )[:, :n]
        root = np.linalg.cholesky(part.M)
        full, reduced = root.T @ full.reshape(n, n) @ root, root.T @ reduced @ root
        error = np.linalg.norm(reduced - full, 2) / np.linalg.norm(full, 2)
        each = np.linalg.norm(np.linalg.solve(full, reduced - full), 2)
        size = max(np.linalg.cond(full), 1.0)
        assert part.error([frequency], True)[0] == pytest.approx(error, rel=1e-6, abs=1e-11 * size)
        assert part.error([frequency], True, each_direction=True)[0] == pytest.approx(each, rel=1e-6, abs=1e-10 * size)
        assert error <= each * (1 + 1e-9) + 1e-10 * size


def test_the_error_of_a_free_gyro_is_frequency_over_nutation(platform):
    part = precession(linearise(platform)).part("9")
    frequency = np.array([1e-3, 1.0, 47.0, 400.0, NUTATION_910, 1000.0])
    assert part.error(frequency) == pytest.approx(frequency / NUTATION_910, rel=1e-5)
    assert part.error(frequency, each_direction=True) == pytest.approx(frequency / NUTATION_910, rel=1e-5)


def test_the_error_of_the_cured_model_falls_with_frequency_twice_as_steeply_where_the_inertia_dominates(platform):
    """The exact response of β5 − β7, 1/ω², outshines that of the pair; in its own direction the pair errs by ω/ν."""
    part = precession(linearise(platform)).part("4")
    frequency = np.array([1.0, 10.0, 100.0])
    ratio = frequency / NUTATION_457
    assert part.error(frequency, True, each_direction=True) == pytest.approx(ratio, rel=1e-6)
    assert part.error(frequency, True) == pytest.approx(ratio**2 / (1 - ratio), rel=1e-6)


@pytest.mark.parametrize("factor", [4.0, 25.0])
def test_faster_rotors_make_the_model_better_in_proportion(platform, factor):
    Omega, frequency = (0.0, 0.1, -0.3), [2.0, 30.0]
    errors = [
        precession(
            linearise(with_momenta(platform, *(s * np.array([0.15, 0.12, 0.15]))), Omega=Omega), None, 30.0
        ).error(frequency, momentum_states=True, each_direction=True)
        for s in (factor, 4.0 * factor)
    ]
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.02)


def test_the_loop_has_to_stay_below_a_third_of_nutation(platform):
    model = linearise(platform)
    below = precession(model, ("9", "10"), loop_frequency=NUTATION_910 / 3.01).parts[0]
    above = precession(model, ("9", "10"), loop_frequency=NUTATION_910 / 2.99).parts[0]
    assert below.admissible
    assert below.separation == pytest.approx(3.01)
    assert not above.admissible
    assert above.separation == pytest.approx(2.99)
    assert "nutation at 474.3 rad/s lies less than 3 times above the loop at 158.6 rad/s" in above.reasons[0]
    assert "close the loop below 158.1 rad/s" in above.cures[1]
    assert above.highest_frequency == pytest.approx(NUTATION_910 / 3)
    assert precession(model, ("9", "10"), loop_frequency=NUTATION_910 / 2.99, separation=2.5).admissible
    # Refused, but measured all the same; and cured by all momenta, which is the full model.
    assert above.error([100.0]) == pytest.approx([100 / NUTATION_910], rel=1e-5)
    assert above.error([100.0], momentum_states=True) == pytest.approx([0.0], abs=1e-12)
    cured = precession(model, ("9", "10"), loop_frequency=300.0).state_space(momentum_states=True)
    full = state_space(model, gimbals=("9", "10"))
    np.testing.assert_allclose(np.asarray(cured(200j)), np.asarray(full(200j)), rtol=1e-9, atol=1e-12)


def test_slow_nutation_of_one_pair_is_cured_by_two_momentum_states(platform):
    model = two_pairs(platform, np.zeros(4), momenta=(L, 0.01 * L))
    part = precession(model, loop_frequency=30.0).parts[0]
    assert part.rank == 4
    assert not part.admissible
    assert "nutation at" in part.reasons[0]
    assert part.momentum_directions.shape == (4, 2)
    assert precession(model, loop_frequency=0.1 * part.highest_frequency).admissible
    frequency = np.array([5.0, 30.0])
    fast = part.singular_values[0]
    assert np.all(part.error(frequency, True, True) < 2.5 * frequency / fast)


def test_non_zero_multiple_roots_are_refused(platform):
    single = two_pairs(platform, [1.0, 1.0, 1.5, 1.5])
    double = two_pairs(platform, [1.0, 1.0, 1.0, 1.0])
    assert precession(single).admissible
    part = precession(double).parts[0]
    assert part.multiple_roots
    assert not part.admissible
    assert "multiple: what is dropped decides how it splits" in part.reasons[0]
    # And it does: one double root, two poles.
    poles = np.sort(slow_poles(double, part).imag)[2:]
    assert poles[1] - poles[0] > 0.01
    assert abs(part.precession_roots[0]) == pytest.approx(1 / L)


def test_a_multiple_root_at_zero_with_all_its_eigenvectors_is_no_obstacle(platform):
    part = precession(two_pairs(platform, np.zeros(4))).parts[0]
    np.testing.assert_array_equal(part.precession_roots, 0)
    assert part.admissible
    assert not part.multiple_roots


@pytest.mark.parametrize(("stiffness", "admissible"), [(0.3, True), (300.0, False)])
def test_a_spring_about_one_axis_leaves_a_double_root_that_inertia_does_not_split(platform, stiffness, admissible):
    """s² (J9 J10 s² + L² + c J10): the root is shared; the error is c J10/L² as ω → 0, small for a soft spring."""
    model = linearise(dataclasses.replace(platform, springs=(Spring(gimbal="9", stiffness=stiffness),)))
    part = precession(model, ("9", "10")).parts[0]
    np.testing.assert_array_equal(part.precession_roots, 0)
    assert not part.multiple_roots
    assert part.error([1e-3])[0] == pytest.approx(stiffness * J10 / L**2, rel=1e-2)
    assert part.admissible == admissible
    if not admissible:
        assert "stiffness drives" in part.reasons[0]


@pytest.mark.parametrize("gain", [1e-3, 0.5])
def test_levelling_damps_precession_and_makes_nutation_grow(platform, gain):
    """Torques −k1 β10, k2 α9 crosswise: precession decays with k/L, nutation grows with (k1 + k2)/(2 L) undamped."""
    erections = (
        Erection(gimbal="9", senses="10", axis=np.array([0.0, 0.0, 1.0]), gain=gain),
        Erection(gimbal="10", senses="10", axis=np.array([1.0, 0.0, 0.0]), gain=gain / 2),
    )
    levelled = dataclasses.replace(platform, erections=erections)
    force = [0.0, 9.81, 0.0]
    part = precession(linearise(levelled, specific_force=force), ("9", "10")).parts[0]
    np.testing.assert_allclose(part.precession_roots.real, [-gain / 2 / L, -gain / L], rtol=1e-9)
    growth = 0.75 * gain / L
    assert part.reasons == (f"9-10: what would be dropped grows: pole at {growth:.4g} +{part.nutation[0]:.4g}j rad/s",)
    assert part.cures == ("keep all momenta, that is the full equations", "or damp it, or make it stiffer")
    # Friction that takes more than levelling gives: d (1/J9 + 1/J10)/2 against it.
    for share, good in ((1.05, True), (0.8, False)):
        d = 2.0 * share * growth / (1.0 / J9 + 1.0 / J10)
        damped = dataclasses.replace(levelled, frictions=tuple(Friction(gimbal=g, viscous=d) for g in ("9", "10")))
        assert precession(linearise(damped, specific_force=force), ("9", "10")).admissible == good


def test_rotors_that_all_but_balance_leave_slow_poles_to_the_dropped_terms_as_well(platform):
    """No multiple root says so then: the roots, ∝ √(L6 − L8), have not yet reached the poles, ±√2 Omega1."""
    model = linearise(with_momenta(platform, 0.15, 0.15001, L), Omega=(0.3, 0, 0), terms="paper")
    for loop_frequency, cured in ((0.9, False), (1.1, True)):
        part = precession(model, ("4", "5", "7"), loop_frequency=loop_frequency).parts[0]
        assert not part.multiple_roots
        assert loop_frequency / 3 == pytest.approx(part.root_error, rel=0.2)
        missed = f"4-5-7: its roots miss the slow poles of the full equations by up to {part.root_error:.4g} rad/s"
        assert (missed in part.reasons) == (not cured)
        assert part.momentum_directions.shape == (3, 1 if cured else 3)
        assert part.root_error == pytest.approx(largest_gap(part.precession_roots, slow_poles(model, part)), rel=1e-6)


def test_a_triple_chain_at_zero_is_an_obstacle(platform):
    """K v0 = 0, G v0 + K v1 = 0, G v1 + K v2 = 0: from here on inertia, M v0, would enter."""
    model = two_pairs(platform, np.zeros(4), coupling=0.0)
    K = np.array([[0, 0, 0, 0], [0, 0, 1, 0], [0, 1, 0, 0], [0, 0, 0, 1.0]])
    part = precession(dataclasses.replace(model, K=K)).parts[0]
    np.testing.assert_array_equal(part.precession_roots, 0)
    assert part.multiple_roots
    assert not part.admissible


def test_a_response_that_is_wrong_at_the_loop_is_refused_whatever_the_roots_say(monkeypatch):
    """A slow rotor on one of three gimbals, a stiff spring, friction: one slow root, 40 % off, all else far above."""
    bodies = {"g0": ("r", [0, 1, 0], 7e-4), "g1": ("g0", [-1, 0, 0], 9e-3), "g2": ("g0", [0.245, 0.215, -0.063], 7e-3)}
    platform = read_platform(
        {
            "schema": 1,
            "name": "slow",
            "root": {"name": "r", "inertia": [1, 1, 1]},
            "gimbal": [
                {"name": name, "parent": parent, "axis": axis, "inertia": [inertia, 0.75 * inertia, 0.9 * inertia]}
                for name, (parent, axis, inertia) in bodies.items()
            ],
            "rotor": [
                {
                    "name": "w",
                    "carrier": "g2",
                    "axis": [0, 1, 0],
                    "axial_inertia": 1e-4,
                    "transverse_inertia": 1e-4,
                    "spin": 11.0,
                }
            ],
            "spring": [{"gimbal": "g0", "stiffness": 292.5}],
            "friction": [{"gimbal": "g1", "viscous": 0.187}],
        }
    )
    model = linearise(platform, Omega=(-0.17, 0.24, -0.1), q=(0.12, 0.31, -0.06))
    assert not precession(model).admissible
    with monkeypatch.context() as patch:
        patch.setattr(choice, "_TWICE", np.inf)
        unmeasured = precession(model).part("g0")
    # Roots, separation and growth alone would let it pass.
    assert unmeasured.admissible
    assert unmeasured.error([unmeasured.loop_frequency])[0] > 2 / 3


# Restraints.


def test_a_damper_on_the_null_direction_is_a_cure(platform):
    dampers = tuple(Friction(gimbal=g, viscous=0.1) for g in ("5", "7"))
    model = linearise(dataclasses.replace(platform, frictions=dampers), Omega=(0.2, 0.1, -0.3))
    whole = precession(model, loop_frequency=50.0)
    part = whole.part("4")
    assert part.admissible
    assert part.restrained
    assert whole.state_space().nstates == 5
    assert largest_gap(whole.state_space().poles()[:3], np.zeros(3)) < 1.0
    assert largest_gap(part.precession_roots, slow_poles(model, part)) < 0.01
    assert part.error([5.0])[0] < 0.02


def test_slight_friction_is_no_restraint(platform):
    rubbing = dataclasses.replace(platform, frictions=tuple(Friction(gimbal=g, viscous=1e-4) for g in ("5", "7")))
    part = precession(linearise(rubbing)).part("4")
    assert not part.admissible
    assert "what restrains it acts up to 0.5 rad/s, 15.9 rad/s are needed" in part.reasons[0]
    assert part.momentum_directions.shape == (3, 1)
    assert part.precession_roots[-1] == pytest.approx(-0.5, rel=1e-6)


@pytest.mark.parametrize("gimbals", [("5",), ("5", "7")])
def test_springs_on_the_null_direction_are_a_cure_with_fewer_states(platform, gimbals):
    springs = tuple(Spring(gimbal=g, stiffness=4.0 / len(gimbals)) for g in gimbals)
    model = linearise(dataclasses.replace(platform, springs=springs))
    part = precession(model, loop_frequency=20.0).part("4")
    assert part.admissible
    assert part.restrained
    assert not part.multiple_roots
    sys = precession(model, ("4", "5", "7"), loop_frequency=20.0).state_space()
    assert sys.state_labels == ["alpha4", "y_beta5"]
    # Index 1: the held direction answers a torque at once, like a spring.
    held = np.array([0.0, 0.5, -0.5])
    torque = np.array([0.0, 1.0, -1.0])
    full = state_space(model, gimbals=("4", "5", "7"))
    for s in (0.1j, 1j):
        slow, true = (np.asarray(of(s))[:, :3] for of in (sys, full))
        np.testing.assert_allclose(held @ slow @ torque, held @ true @ torque, rtol=0.05)
        assert np.linalg.norm(slow - true, 2) < 0.05 * np.linalg.norm(true, 2)


@settings(max_examples=20, deadline=None)
@given(st.floats(1.0, 2.0), st.floats(0.0, 0.002), st.floats(0.12, 0.18), st.floats(0.3, 20.0))
def test_a_restrained_model_solves_its_own_equations(stiffness, damping, L6, frequency):
    """jω D + S, D without the damping of the held direction itself, against the state equations made of them."""
    platform = with_momenta(read_platform("three_gyro_platform"), L6, L, L)
    cages = tuple(Cage(gimbal=g, stiffness=stiffness, damping=damping) for g in ("4", "5", "7"))
    model = linearise(dataclasses.replace(platform, cages=cages))
    whole = precession(model, ("4", "5", "7"), loop_frequency=10.0)
    part = whole.parts[0]
    v = part.null_directions
    held = v @ np.linalg.solve(v.T @ part.M @ v, v.T @ part.M)
    response = np.asarray(whole.state_space()(1j * frequency))[:, :3]
    stiff = 1j * frequency * part.damping @ (np.eye(3) - held) + part.stiffness
    np.testing.assert_allclose(stiff @ response, np.eye(3), atol=1e-9)
    full = np.asarray(state_space(model, gimbals=("4", "5", "7"))(1j * frequency))[:, :3]
    root = np.linalg.cholesky(part.M)
    each = np.linalg.norm(np.linalg.solve(root.T @ full @ root, root.T @ (response - full) @ root), 2)
    assert part.error([frequency], each_direction=True)[0] == pytest.approx(each, rel=1e-6)


@pytest.mark.parametrize("terms", ["exact", "paper"])
def test_a_restrained_model_answers_a_rate_of_the_platform_as_the_full_one_does(platform, terms):
    """At rest exactly, K q = −G_Omega ω; slowly nearly so. Held angles answer at once, the others by their rates."""
    springs = (Spring(gimbal="4", stiffness=1.0), *(Spring(gimbal=g, stiffness=c) for g, c in (("5", 2.0), ("7", 3.0))))
    sprung = dataclasses.replace(with_momenta(platform, 0.15, 0.12, L), springs=springs)
    model = linearise(sprung, Omega=(2.0, 1.0, -3.0), terms=terms)
    whole = precession(model, ("4", "5", "7"), loop_frequency=20.0)
    assert whole.admissible
    assert whole.parts[0].restrained
    sys, full = whole.state_space(), state_space(model, gimbals=("4", "5", "7"))
    turn = [sys.input_labels.index(name) for name in ("Omega1", "Omega2", "Omega3")]
    assert turn == [full.input_labels.index(name) for name in ("Omega1", "Omega2", "Omega3")]
    at_rest = np.real(full(0))[:, turn]
    np.testing.assert_allclose(np.real(sys(0))[:, turn], at_rest, rtol=1e-8, atol=1e-12)
    for k in range(3):
        slow, true = (np.asarray(of(0.1j))[:, turn[k]] for of in (sys, full))
        assert np.linalg.norm(slow - true) <= 0.02 * np.linalg.norm(true)


def test_the_stiffness_and_the_damping_that_are_named_suffice(platform):
    """Along β5 − β7: c5 + c7 = 2 J5 (3 ω)², d5 + d7 = 2 J5 (3 ω), both exceeded here by a half."""
    cure = precession(linearise(platform), loop_frequency=20.0).part("4").cures[1]
    stiffness, damping = 2 * J5 * 60.0**2, 2 * J5 * 60.0
    assert f"stiffness well above {stiffness:.3g} N m/rad or damping well above {damping:.3g} N m s" in cure
    for kind, amount in (("springs", stiffness), ("frictions", damping)):
        size = 0.75 * amount
        elements = {
            "springs": tuple(Spring(gimbal=g, stiffness=size) for g in ("5", "7")),
            "frictions": tuple(Friction(gimbal=g, viscous=size) for g in ("5", "7")),
        }[kind]
        restrained = linearise(dataclasses.replace(platform, **{kind: elements}))
        assert precession(restrained, loop_frequency=20.0).admissible


def test_a_negative_spring_restrains_nothing(platform):
    springs = tuple(Spring(gimbal=g, stiffness=-2.0) for g in ("5", "7"))
    part = precession(linearise(dataclasses.replace(platform, springs=springs)), loop_frequency=20.0).part("4")
    assert not part.admissible
    assert not part.restrained


def test_a_closed_cage_with_damping_counts_as_a_spring(platform):
    cages = (Cage(gimbal="5", stiffness=4.0, damping=0.004),)
    part = precession(linearise(dataclasses.replace(platform, cages=cages)), loop_frequency=20.0).part("4")
    assert part.admissible
    assert part.restrained


def test_the_spring_of_a_rate_gyro_turns_rate_into_angle():
    """c θ = Q + L Omega2 below the spring's own frequency √(c/J), which no precession takes part in."""
    plant = read_platform("rate_gyro")
    (spring,), (rotor,) = plant.springs, plant.rotors
    model = linearise(plant)
    whole = precession(model, loop_frequency=10.0)
    part = whole.parts[0]
    assert part.admissible
    assert part.restrained
    assert part.nutation == pytest.approx([np.sqrt(spring.stiffness / model.M[0, 0])])
    sys = whole.state_space()
    assert sys.nstates == 0
    np.testing.assert_allclose(sys.D, np.array([[1, 0, rotor.angular_momentum, 0]]) / spring.stiffness, atol=1e-15)
    np.testing.assert_allclose(np.asarray(state_space(model)(1e-3j))[:, :4], sys.D, rtol=1e-3, atol=1e-6)
    # 3 times as fast as the loop, as the line that asks for a spring says.
    soft = dataclasses.replace(plant, frictions=())
    for factor, good in ((1.01, True), (0.99, False)):
        c = factor * model.M[0, 0] * 30.0**2
        found = linearise(dataclasses.replace(soft, springs=(dataclasses.replace(spring, stiffness=c),)))
        assert precession(found, loop_frequency=10.0).admissible == good


# Wrong questions and the ends of the range.


def test_without_spin_no_rotor_gives_any_momentum(platform):
    for still in (with_momenta(platform, 0, 0, 0), dataclasses.replace(platform, rotors=())):
        whole = precession(linearise(still, Omega=(0.1, 0.2, 0.3)))
        assert whole.reasons == tuple(f"{p.name}: no rotor gives it any momentum" for p in whole.parts)
        assert all("full equations" in p.cures[0] for p in whole.parts)
        sys = whole.state_space(momentum_states=True)
        full = state_space(whole.model)
        np.testing.assert_allclose(np.asarray(sys(2j)), np.asarray(full(2j)), rtol=1e-9, atol=1e-6)


def test_a_single_gimbal_has_no_gyroscopic_pair(platform):
    """A rate gyro: its damper serves up to a frequency, and without one to compare with nothing is said."""
    gyro = dataclasses.replace(
        with_momenta(platform, L, L, L),
        gimbals=platform.gimbals[3:4],
        rotors=(dataclasses.replace(platform.rotors[2], carrier="9"),),
        torquers=(),
        pickoffs=(),
        frictions=(Friction(gimbal="9", viscous=0.1),),
    )
    whole = precession(linearise(gyro))
    assert whole.reasons == ("9: G_R is 1 x 1 and skew, so its determinant is 0: alpha9 has no gyroscopic stiffness",)
    assert whole.cures[1] == "9: or restrain alpha9 and give loop_frequency"
    assert whole.summary().splitlines()[0] == "9: precession theory not admissible; no loop frequency given"
    assert precession(linearise(gyro), loop_frequency=5.0).admissible


def test_a_platform_without_gimbals_has_nothing_to_refuse():
    platform = read_platform({"schema": 1, "name": "bare", "root": {"name": "base", "inertia": [1, 1, 1]}})
    whole = precession(linearise(platform))
    assert whole.admissible
    assert whole.parts == ()
    assert whole.summary() == "no gimbals: nothing precesses"
    assert whole.state_space().nstates == 0
    np.testing.assert_array_equal(whole.error([1.0, 2.0]), 0)


def test_twenty_gimbals_in_a_row():
    whole = precession(linearise(chain(20)))
    part = whole.parts[0]
    assert len(part.gimbals) == 20
    assert part.rank == 12
    assert part.direction_names[0] == "q_g0 - q_g2"
    assert whole.momentum_states == 8
    frequency = np.array([0.01, 0.1, 1.0])
    error = whole.error(frequency, momentum_states=True, each_direction=True)
    assert error == pytest.approx(frequency / part.nutation.min(), rel=1e-6)


def test_gimbal_lock_is_named():
    model = linearise(chain(2))
    locked = dataclasses.replace(model, M=np.ones((2, 2)))
    with pytest.raises(MechanicsError, match="gimbal lock"):
        precession(locked)


def test_a_summary_tells_verdict_figures_reasons_and_cures(platform):
    text = precession(linearise(platform), loop_frequency=50.0).summary()
    lines = text.splitlines()
    assert (
        lines[0] == "4-5-7: precession theory not admissible; nutation from 530.3 rad/s, judged for a loop at 50 rad/s"
    )
    assert lines[-1] == "9-10: precession theory admissible; nutation from 474.3 rad/s, judged for a loop at 50 rad/s"
    assert "restrain beta5 - beta7: stiffness well above 9 N m/rad or damping well above 0.06 N m s along it" in text


def test_wrong_questions_get_one_line(platform):
    model = linearise(platform)
    with pytest.raises(ArgumentError, match="coupled"):
        precession(model, gimbals=("9",))
    with pytest.raises(ArgumentError, match="loop_frequency"):
        precession(model, loop_frequency=0.0)
    with pytest.raises(ArgumentError, match="separation"):
        precession(model, separation=-1.0)
    with pytest.raises(ArgumentError, match="must be above 0"):
        precession(model, ("9", "10")).error([1.0, 0.0])
    with pytest.raises(ArgumentError, match="did you mean '10'"):
        precession(model).part("100")
