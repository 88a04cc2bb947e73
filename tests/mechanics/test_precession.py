"""Precession theory (15): where it may be used, what cures it where not, and how far it is from the full equations."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plant_parts import Erection, Friction
from platform_ctrl import linearise, precession, read_platform, state_space
from platform_ctrl.errors import MechanicsError
from tree_cases import platforms, with_torquers

L, J4, J5, J9, J10 = 0.15, 8e-4, 2e-4, 5e-4, 2e-4
NUTATION_457, NUTATION_910 = np.sqrt(2) * L / np.sqrt(J4 * J5), L / np.sqrt(J9 * J10)


@pytest.fixture(scope="module")
def platform():
    return read_platform("three_gyro_platform")


def with_momenta(platform, *momenta):
    rotors = (dataclasses.replace(r, angular_momentum=float(h)) for r, h in zip(platform.rotors, momenta, strict=True))
    return dataclasses.replace(platform, rotors=tuple(rotors))


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


def of(part, name):
    """Return the part's rows and columns of a matrix of the model."""
    rows = [part.model.gimbal_names.index(gimbal) for gimbal in part.gimbals]
    return getattr(part.model, name)[np.ix_(rows, rows)]


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
    assert (three.null_directions.shape, two.null_directions.shape) == ((3, 1), (2, 0))


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
    np.testing.assert_allclose(of(part, "G") @ direction, 0, atol=1e-15)


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


def test_rates_of_the_platform_are_no_obstacle_and_the_root_is_the_gyroscopic_restraint(platform):
    """Omega2 restrains gyro 11 about both axes by L Omega2: it precesses with Omega2, in the model and in truth."""
    model = linearise(platform, Omega=(0, 1.5, 0), terms="paper")
    part = precession(model, gimbals=("9", "10")).parts[0]
    assert part.admissible
    np.testing.assert_allclose(part.precession_roots.imag, [1.5, -1.5], rtol=1e-12)
    assert largest_gap(part.precession_roots, slow_poles(model, part)) < 1.5 * 2 * 1.5 / NUTATION_910
    assert part.root_error == pytest.approx(largest_gap(part.precession_roots, slow_poles(model, part)), rel=1e-6)


# The rule itself.


@settings(max_examples=12, deadline=None)
@given(platforms(max_gimbals=5, controls=("regulated",)), st.integers(0, 2**32 - 1))
def test_subsystems_of_odd_order_are_always_singular_and_always_cured(platform, seed):
    Omega = np.random.default_rng(seed).normal(size=3)
    platform = with_torquers(platform)
    model = linearise(platform, Omega=Omega)
    whole = precession(model)
    for part in whole.parts:
        n = len(part.gimbals)
        rank = n - part.null_directions.shape[1]
        assert rank % 2 == 0
        assert part.admissible == (not part.reasons) == (not part.cures)
        if n % 2:
            assert rank < n
            assert not part.admissible
        np.testing.assert_allclose(
            of(part, "G") @ part.null_directions, 0, atol=1e-8 * np.abs(of(part, "G")).max(initial=1.0)
        )
        sys = precession(model, gimbals=part.gimbals).state_space(momentum_states=True)
        assert np.all(np.isfinite(np.hstack([sys.A, sys.B])))
        kept = part.momentum_directions.shape[1]
        assert sys.nstates == n + kept


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
            root = np.linalg.cholesky(of(part, "M"))
            rho = np.linalg.norm(
                root.T @ np.linalg.solve(of(part, "G"), of(part, "stiffness")) @ np.linalg.inv(root.T), 2
            )
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


@settings(max_examples=12, deadline=None)
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
        root = np.linalg.cholesky(of(part, "M"))
        full, reduced = root.T @ full.reshape(n, n) @ root, root.T @ reduced @ root
        error = np.linalg.norm(reduced - full, 2) / np.linalg.norm(full, 2)
        size = max(np.linalg.cond(full), 1.0)
        assert part.error([frequency], True)[0] == pytest.approx(error, rel=1e-6, abs=1e-11 * size)


def test_the_error_of_a_free_gyro_is_frequency_over_nutation(platform):
    part = precession(linearise(platform)).part("9")
    frequency = np.array([1e-3, 1.0, 47.0, 400.0, NUTATION_910, 1000.0])
    assert part.error(frequency) == pytest.approx(frequency / NUTATION_910, rel=1e-5)


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
    assert precession(model, ("9", "10"), loop_frequency=NUTATION_910 / 2.99, separation=2.5).admissible
    # Refused, but measured all the same; and cured by all momenta, which is the full model.
    assert above.error([100.0]) == pytest.approx([100 / NUTATION_910], rel=1e-5)
    assert above.error([100.0], momentum_states=True) == pytest.approx([0.0], abs=1e-12)
    cured = precession(model, ("9", "10"), loop_frequency=300.0).state_space(momentum_states=True)
    full = state_space(model, gimbals=("9", "10"))
    np.testing.assert_allclose(np.asarray(cured(200j)), np.asarray(full(200j)), rtol=1e-9, atol=1e-12)


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
    assert part.reasons == (f"9-10: what would be dropped grows: pole at {growth:.4g}+{part.nutation[0]:.4g}j rad/s",)
    assert part.cures == (
        "keep all momenta, that is the full equations (momentum_states=True)",
        "or damp it, or make it stiffer",
    )
    # Friction that takes more than levelling gives: d (1/J9 + 1/J10)/2 against it.
    for share, good in ((1.05, True), (0.8, False)):
        d = 2.0 * share * growth / (1.0 / J9 + 1.0 / J10)
        damped = dataclasses.replace(levelled, frictions=tuple(Friction(gimbal=g, viscous=d) for g in ("9", "10")))
        assert precession(linearise(damped, specific_force=force), ("9", "10")).admissible == good
