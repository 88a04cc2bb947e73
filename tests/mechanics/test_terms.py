"""All terms together are the equation; their sizes, senses and costs are what the paper says of them."""

import dataclasses
import itertools
import unicodedata
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from platform_ctrl.errors import ArgumentError
from platform_ctrl.mechanics.equations import inverse_dynamics
from platform_ctrl.mechanics.forces import element_forces
from platform_ctrl.mechanics.linearisation import linearise
from platform_ctrl.mechanics.parameter_varying import parameter_varying
from platform_ctrl.mechanics.state_space import subsystems
from platform_ctrl.mechanics.term_table import combination, coordinate, rates
from platform_ctrl.mechanics.terms import pole_change, poles, terms
from platform_ctrl.plant.force_elements import Cage, Erection, Friction, Spring, Unbalance
from platform_ctrl.plant.reading import read_platform
from tree_cases import platforms

SEEDS = st.integers(0, 2**32 - 1)
TREES = platforms(max_gimbals=4, controls=("regulated", "free", "servo"))
L, J9, J10 = 0.15, 5e-4, 2e-4


@pytest.fixture(scope="module")
def platform():
    return read_platform("three_gyro_platform")


@pytest.fixture(scope="module")
def table(platform):
    return terms(platform, (1.0, 1.0, 1.0), np.full(5, 0.1))


def one(table, gimbal, label):
    (found,) = [term for term in table.of(gimbal) if term.label == unicodedata.normalize("NFC", label)]
    return found


def with_elements(platform, rng):
    names = platform.gimbal_names
    return dataclasses.replace(
        platform,
        springs=(Spring(gimbal=names[0], stiffness=float(rng.normal()), rest=0.3),),
        frictions=(Friction(gimbal=names[-1], viscous=0.4),),
        cages=(Cage(gimbal=names[0], stiffness=2.0, damping=0.1, angle=-0.2),),
        unbalances=tuple(Unbalance(body=name, moment=rng.normal(size=3)) for name in (platform.root_name, names[-1])),
        erections=(Erection(gimbal=names[0], senses=names[-1], axis=np.array([0.6, 0.0, 0.8]), gain=0.7),),
        specific_force=rng.normal(size=3) * 3,
    )


def summed(found, names):
    """M, G, K and the forcing that terms make together."""
    n = len(names)
    matrices, forcing = np.zeros((3, n, n)), np.zeros(n)
    for term in found:
        row = names.index(term.gimbal)
        if term.derivative is None:
            forcing[row] += term.factor
        else:
            matrices[term.derivative, row, names.index(term.column)] += term.factor
    return (*matrices[::-1], forcing)


@settings(max_examples=25, deadline=None)
@given(TREES, SEEDS)
def test_all_terms_together_are_the_equation(platform, seed):
    rng = np.random.default_rng(seed)
    platform = with_elements(platform, rng)
    n = len(platform.gimbals)
    q, deviation, q_dot, q_ddot = rng.uniform(-1, 1, (4, n))
    Omega, Omega_dot = rng.normal(size=(2, 3))
    table = terms(platform, Omega, q_dot, angles=deviation, accelerations=q_ddot, Omega_dot=Omega_dot, q=q)
    M, G, K, forcing = summed(table.terms, platform.gimbal_names)

    def torque(size):
        angles, velocity = q + size * deviation, np.concatenate([Omega, size * q_dot])
        acceleration = np.concatenate([Omega_dot, size * q_ddot])
        return (
            inverse_dynamics(platform, angles, velocity, acceleration) - element_forces(platform, angles, velocity)
        )[3:]

    step = 1e-4
    scale = 1.0 + max(term.size for term in table.terms)
    np.testing.assert_allclose(forcing, torque(0.0), atol=1e-10 * scale)
    slope = (torque(step) - torque(-step)) / (2 * step)
    np.testing.assert_allclose(M @ q_ddot + G @ q_dot + K @ deviation, slope, atol=1e-5 * scale)


@settings(max_examples=25, deadline=None)
@given(TREES, SEEDS)
def test_the_terms_that_the_paper_keeps_are_its_equation(platform, seed):
    rng = np.random.default_rng(seed)
    platform = with_elements(platform, rng)
    n = len(platform.gimbals)
    q, Omega, Omega_dot = rng.uniform(-1, 1, n), rng.normal(size=3), rng.normal(size=3)
    table = terms(platform, Omega, np.ones(n), Omega_dot=Omega_dot, q=q)
    kept = [term for term in table.terms if term.kept]
    paper = parameter_varying(platform, q=q, terms="paper").at(Omega, Omega_dot)
    scale = 1.0 + max(abs(term.factor) for term in table.terms)
    expected = (paper.M, paper.G, paper.K, paper.forcing)
    for got, matrix in zip(summed(kept, platform.gimbal_names), expected, strict=True):
        np.testing.assert_allclose(got, matrix, atol=1e-12 * scale)
    assert len(kept) + len(table.dropped_by_the_paper()) == len(table.terms)


def test_rows_5_and_9_are_those_of_the_exact_equations(table):
    labels = {term.label for term in table.of("5")}
    assert labels == {
        unicodedata.normalize("NFC", label)
        for label in (
            *("J5 β̈5", "−L6 α̇4", "L6 Ω1 β5", "J5 Ω̇3", "−L6 Ω2"),
            *("J Ω1 α̇4", "J5 Ω̇1 α4", "J Ω2 Ω3 α4", "J Ω1² β5", "J Ω2² β5", "J Ω1 Ω2"),
        )
    }
    assert one(table, "9", "C11 Ω̇2 β10").coefficient == pytest.approx(1.2e-4)
    assert one(table, "9", "J Ω̇2 β10").coefficient == pytest.approx(1.0e-4 - (1.3e-4 + 0.7e-4))  # I10_2 − I10_3
    assert one(table, "7", "−J7 Ω̇3").factor == pytest.approx(-2e-4 * 2 * np.pi)


def test_gyroscopic_action_dominates_and_what_the_paper_drops_is_small(table):
    for gimbal in ("4", "5", "7", "9", "10"):
        moving = [term for term in table.of(gimbal) if term.derivative is not None]
        assert moving[0].kind == "gyroscopic action"
        action = moving[0].size
        for term in moving:
            if term.kind == "nutation":
                assert term.size < 0.05 * action  # at one cycle a second
            if term.kind in ("rotor acceleration", "inertia acceleration", "Coriolis", "centrifugal"):
                assert term.size < 0.002 * action
        assert max(term.share for term in table.of(gimbal) if not term.kept) < 0.003
    dropped = table.dropped_by_the_paper()
    assert all(not term.kept for term in dropped)
    assert [term.size for term in dropped] == sorted((term.size for term in dropped), reverse=True)


def test_near_the_nutation_the_acceleration_is_as_large_as_the_gyroscopic_action(platform):
    table = terms(platform, (1.0, 1.0, 1.0), np.full(5, 0.1), frequency=L / np.sqrt(J9 * J10))
    ratio = one(table, "9", "J9 α̈9").size * one(table, "10", "J10 β̈10").size
    assert ratio == pytest.approx(one(table, "9", "L11 β̇10").size * one(table, "10", "−L11 α̇9").size)


def test_a_restraint_is_stable_where_rotor_and_platform_turn_in_the_same_sense(platform):
    along, against = (terms(platform, (rate, 0.0, 0.0), np.full(5, 0.1)) for rate in (1.0, -1.0))
    assert one(along, "5", "L6 Ω1 β5").sense == "stable"
    assert one(along, "7", "−L8 Ω1 β7").sense == "unstable"
    assert one(against, "5", "L6 Ω1 β5").sense == "unstable"
    assert one(against, "7", "−L8 Ω1 β7").sense == "stable"
    # The pair turns in opposite senses: gimbal 4 has none.
    pair = one(along, "4", "(L6 − L8) Ω1 α4")
    assert pair.kind == "gyroscopic restraint"
    assert pair.size == 0.0
    assert pair.sense is None


def test_dropping_an_inertia_loses_the_nutation_and_leaves_the_slow_poles(platform):
    table = terms(platform, (0.0, 2.0, 0.0), np.full(5, 0.1), Omega_dot=(0.0, 0.0, 0.0))
    nutation = one(table, "9", "J9 α̈9")
    assert nutation.poles_lost == 2
    assert nutation.pole_change < 0.005  # of the drift at Omega2, of the order J Omega/L
    # Without the restraint of one axis the pole moves from i Omega2 to √(J Omega2/L) times that: what J Omega² leaves.
    J = 2e-5  # I9_2 + I10_2 + C11 − I9_1 − I10_1 − A11
    left = 1.0 - np.sqrt(J * 2.0 / L)
    assert one(table, "9", "L11 Ω2 α9").pole_change == pytest.approx(left, abs=0.002)
    assert one(table, "9", "L11 Ω2 α9").poles_lost == 0
    # Of the order J Omega/L as well.
    assert all(term.pole_change < 0.005 for term in table.of("9") if term.derivative is not None and not term.kept)
    assert one(table, "9", "J9 Ω̇3").pole_change is None


def test_the_row_of_4_shows_that_small_torques_may_move_poles_much(table):
    """α4 has no restraint, so what is small in its torque decides how it drifts."""
    small = [term for term in table.of("4") if term.kind == "centrifugal" and term.column == "4"]
    assert all(term.share < 1e-4 and term.pole_change > 0.1 for term in small)


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 4), SEEDS)
def test_poles_are_the_roots_of_the_determinant_also_without_some_inertias(k, seed):
    rng = np.random.default_rng(seed)
    M, G, K = rng.normal(size=(3, k, k))
    constrained = rng.random(k) < 0.4
    M[constrained] = 0.0
    found = poles(M, G, K)
    assert len(found) == 2 * k - constrained.sum()
    for s in found:
        sizes = np.linalg.svd(s**2 * M + s * G + K, compute_uv=False)
        assert sizes[-1] < 1e-6 * (abs(s) ** 2 + abs(s) + 1)


def test_infinite_poles_of_a_chain_of_constraints_are_all_taken_out():
    # L β̇ = Q alone in the row of α: β is fixed by it, and α follows from β̈.
    G = np.array([[0.0, 1.0], [-1.0, 0.0]])
    np.testing.assert_allclose(poles(np.diag([0.0, 1.0]), G, np.zeros((2, 2))), [0.0, 0.0], atol=1e-12)
    rigid = poles(np.diag([0.0, 1.0]), np.zeros((2, 2)), np.array([[0.0, 1.0], [1.0, 0.0]]))
    assert len(rigid) == 0
    # Two constraints that say the same leave a motion undetermined.
    assert len(poles(np.zeros((2, 2)), np.zeros((2, 2)), np.ones((2, 2)))) == 0
    assert len(poles(np.zeros((1, 1)), np.zeros((1, 1)), np.zeros((1, 1)))) == 0
    assert pole_change(np.array([1j, -1j]), rigid, 0.1) == (0.0, 2)


def test_poles_are_matched_not_sorted():
    before = np.array([-1.0, -2.0, -10.0, 0.0])
    assert pole_change(before, np.array([0.001, -10.0, -1.0, -2.2]), slowest=0.01) == (pytest.approx(0.1), 0)
    assert pole_change(before, np.array([-2.0, -0.9, 0.0]), slowest=0.01) == (pytest.approx(0.1), 1)


def test_amplitudes_follow_from_the_frequency_unless_given(platform):
    table = terms(platform, (1.0, 2.0, 0.0), [0.1, 0.2, 0.3, 0.4, -0.5], frequency=4.0)
    np.testing.assert_allclose(table.angles, np.array([0.1, 0.2, 0.3, 0.4, 0.5]) / 4)
    np.testing.assert_allclose(table.accelerations, np.array([0.1, 0.2, 0.3, 0.4, 0.5]) * 4)
    np.testing.assert_allclose(table.Omega_dot, [4.0, 8.0, 0.0])
    assert one(table, "10", "−L11 α̇9").size == pytest.approx(0.15 * 0.4)
    assert one(table, "10", "L11 Ω2 β10").size == pytest.approx(0.15 * 2 * 0.5 / 4)


def test_ranks_shares_and_errors_belong_together(table):
    for gimbal in table.platform.gimbal_names:
        row = table.of(gimbal)
        assert [term.rank for term in row] == list(range(1, len(row) + 1))
        assert row[0].share == pytest.approx(1.0)
        assert all(a.size >= b.size * (1 - 1e-8) for a, b in itertools.pairwise(row))
        assert sum(term.torque_error for term in row) == pytest.approx(1.0)


def test_elements_are_terms_too(platform):
    platform = with_elements(platform, np.random.default_rng(0))
    dry = Friction(gimbal="10", coulomb=(0.02, 0.04))
    table = terms(dataclasses.replace(platform, frictions=(dry,)), (1, 0, 0), np.full(5, 0.1))
    assert {"spring", "friction", "cage", "unbalance", "erection"} <= {term.kind for term in table.terms}
    assert one(table, "10", "d10 β̇10").size == pytest.approx(4 / np.pi * 0.03)
    assert all(term.kept for term in table.terms if term.kind in ("spring", "friction", "unbalance"))
    still = terms(dataclasses.replace(platform, frictions=(dry,)), (1, 0, 0), np.zeros(5))
    assert all(term.size == 0.0 for term in still.of("10") if term.derivative is not None)


def test_the_specific_force_given_stands_in_for_the_platforms_own(platform):
    platform = with_elements(platform, np.random.default_rng(0))
    f = np.array([4.0, -8.0, 2.0])
    loaded = dataclasses.replace(platform, specific_force=f)

    def rows(platform, **given):
        table = terms(platform, (1, 0, 0), np.full(5, 0.1), **given)
        return [(term.label, term.factor, term.pole_change) for term in table.terms]

    assert rows(platform, specific_force=f) == rows(loaded)
    assert rows(platform) != rows(loaded)


def test_an_inertia_has_a_gimbals_number_only_where_it_is_that_gimbals(platform, table):
    """Turned by 0.2 rad, gimbal 5 feels Ω̇3 with J5 cos 0.2: near J5, yet something else."""
    turned = terms(platform, (1.0, 1.0, 1.0), np.full(5, 0.1), q=(0.2, 0, 0, 0, 0))
    assert one(table, "5", "J5 Ω̇3").coefficient == pytest.approx(2e-4)
    assert one(turned, "5", "J Ω̇3").coefficient == pytest.approx(2e-4 * np.cos(0.2))


def test_rounding_is_no_term(platform):
    """With gimbal 4 a quarter turned everything points along other axes, and cos 90° is 6e-17."""
    counts = [
        [len(terms(platform, (1, 1, 1), np.ones(5), q=(angle, 0, 0, 0, 0)).of(g)) for g in ("5", "7", "9", "10")]
        for angle in (0.0, np.pi / 2)
    ]
    assert counts[0] == counts[1]


def test_a_weak_coupling_counts_beside_a_stiff_cage(platform):
    """The erection on 4 follows 10: however stiff the cage of another gimbal, their poles belong together."""
    across = Erection(gimbal="4", senses="10", axis=np.array([0.0, 0.0, 1.0]), gain=1e-7)
    platform = dataclasses.replace(
        platform,
        erections=(across,),
        specific_force=np.array([0.0, 9.81, 0.0]),
        cages=(Cage(gimbal="9", stiffness=1e6),),
    )
    table = terms(platform, (0.5, 0.0, 0.0), np.full(5, 0.1))
    (coupling,) = [term for term in table.of("4") if term.kind == "erection"]
    assert (coupling.column, abs(coupling.factor)) == ("10", pytest.approx(1e-7))
    assert coupling.poles_lost == 0
    model = linearise(platform, (0.5, 0.0, 0.0))
    assert subsystems(model) == (platform.gimbal_names,)
    # The poles that a nutation's loss is measured against are those of all five.
    assert one(table, "9", "J9 α̈9").poles_lost == 2


def test_labels_are_those_of_the_field():
    def composed(text):
        return unicodedata.normalize("NFC", text)

    assert coordinate("alpha4", 2) == composed("α̈4")
    assert coordinate("q_outer", 1) == composed("q̇_outer")
    assert coordinate("roll", 2) == "d²(roll)/dt²"
    assert rates("Omega1*Omega2") == "Ω1 Ω2"
    assert rates("Omega3^2") == "Ω3²"
    assert combination(["L6", "L8"], np.array([1.0, -1.0])) == "(L6 − L8)"
    assert combination(["L6", "L8"], np.array([0.0, -1.0])) == "−L8"
    assert combination(["L6", "L8"], np.array([1e-13, -1.0])) == "−L8"
    assert combination(["L6", "L8"], np.array([1e-11, -1.0])) == "(1e-11 L6 − L8)"
    assert combination(["a", "b"], np.array([-0.6, 0.8])) == "(−0.6 a + 0.8 b)"


def test_a_free_rotor_is_named_by_its_p_and_has_no_axial_inertia(platform):
    rotors = tuple(dataclasses.replace(rotor, control="free") for rotor in platform.rotors)
    table = terms(dataclasses.replace(platform, rotors=rotors), (1, 1, 1), np.full(5, 0.1))
    assert one(table, "9", "p11 β̇10").factor == pytest.approx(0.15)
    assert not any(term.kind == "rotor acceleration" for term in table.terms)


def test_without_gimbals_or_rotors_it_answers(platform):
    bare = dataclasses.replace(platform, gimbals=(), rotors=(), torquers=(), pickoffs=())
    nothing = terms(bare, (1, 1, 1), [])
    assert nothing.terms == ()
    assert "no gimbals" in nothing.text()
    gimbals = terms(dataclasses.replace(platform, rotors=()), (0, 0, 0), np.full(5, 0.1))
    inertia = one(gimbals, "9", "J9 α̈9")
    assert (inertia.pole_change, inertia.poles_lost) == (0.0, 4)  # nothing else says how the pair moves
    assert {term.kind for term in gimbals.terms if term.size > 0} == {"inertia"}


def test_the_text_is_aligned_and_leaves_out_what_is_small(platform, table):
    text = table.text()
    heads = [line for line in text.splitlines() if line.startswith("gimbal")]
    assert [line.split(":")[0] for line in heads] == [f"gimbal {name}" for name in platform.gimbal_names]
    lines = [line for line in text.splitlines() if " N m " in line or " kept" in line or " dropped" in line]
    plain = ["".join(letter for letter in line if not unicodedata.combining(letter)) for line in lines]
    start = plain[0].index("paper")
    assert all(line[start : start + 4] in ("kept", "drop", "pape") for line in plain[: 1 + 15])
    assert "(L6 − L8) Ω3" not in text  # zero here
    assert len(table.text(smallest=0.01).splitlines()) < len(text.splitlines())
    assert "same sense" in table.legend()
    assert "spring:" not in table.legend()


def test_mistakes_are_one_line(platform, table):
    with pytest.raises(ArgumentError, match="frequency"):
        terms(platform, (1, 0, 0), np.ones(5), frequency=0.0)
    with pytest.raises(ArgumentError, match=r"rates must .*got \(4,\)"):
        terms(platform, (1, 0, 0), np.ones(4))
    with pytest.raises(ArgumentError, match=r"gimbal must .*got '6'"):
        table.of("6")
    with pytest.raises(ArgumentError, match=r"gimbals must .*got '6'"):
        table.text(gimbals=("6",))
    for string in ("9", "10"):
        with pytest.raises(
            ArgumentError, match=f"gimbals must be a sequence of names or None, got the string '{string}'"
        ):
            table.text(gimbals=string)
    with pytest.raises(ArgumentError, match="gimbals must be a sequence of names or None, got 9"):
        table.text(gimbals=9)


def test_the_page_shows_what_is_printed(table):
    page = (Path(__file__).parents[2] / "docs" / "terms.md").read_text(encoding="utf-8")
    shown = page.split("```text\n")[1].split("\n```")[0]
    assert shown == table.text(gimbals=("9",))


def test_bodies_with_words_for_names_are_subscripts():
    table = terms(read_platform("gyro_horizon"), (0.0, 0.0, 0.1), (0.01, 0.01))
    assert {"J_outer d²(roll)/dt²", "L_rotor d(roll)/dt"} <= {term.label for term in table.terms}
