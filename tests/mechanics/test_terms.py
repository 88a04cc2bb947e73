"""All terms together are the equation; their sizes, senses and costs are what the paper says of them."""

import dataclasses
import unicodedata
from pathlib import Path

import numpy as np
import pytest
from hypothesis import strategies as st

from oracle_trees import for_all
from platform_ctrl import element_forces, inverse_dynamics, parameter_varying, read_platform, terms
from tree_cases import platforms, with_elements

SEEDS = st.integers(0, 2**32 - 1)
TREES = platforms(max_gimbals=2, controls=("regulated", "free", "servo"))
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


@for_all(st.tuples(TREES, SEEDS), 2)
def test_all_terms_together_are_the_equation(drawn):
    platform, seed = drawn
    rng = np.random.default_rng(seed)
    platform = with_elements(platform, rng)
    n = len(platform.gimbals)
    deviation, q_dot, q_ddot = rng.uniform(-1, 1, (3, n))
    Omega, Omega_dot = rng.normal(size=(2, 3))
    table = terms(platform, Omega, q_dot, angles=deviation, accelerations=q_ddot, Omega_dot=Omega_dot)
    M, G, K, forcing = summed(table.terms, platform.gimbal_names)

    def torque(size):
        angles, velocity = size * deviation, np.concatenate([Omega, size * q_dot])
        acceleration = np.concatenate([Omega_dot, size * q_ddot])
        return (
            inverse_dynamics(platform, angles, velocity, acceleration) - element_forces(platform, angles, velocity)
        )[3:]

    step = 1e-4
    scale = 1.0 + max(term.size for term in table.terms)
    np.testing.assert_allclose(forcing, torque(0.0), atol=1e-10 * scale)
    slope = (torque(step) - torque(-step)) / (2 * step)
    np.testing.assert_allclose(M @ q_ddot + G @ q_dot + K @ deviation, slope, atol=1e-5 * scale)


@for_all(st.tuples(TREES, SEEDS), 2)
def test_the_terms_that_the_paper_keeps_are_its_equation(drawn):
    platform, seed = drawn
    rng = np.random.default_rng(seed)
    platform = with_elements(platform, rng)
    n = len(platform.gimbals)
    Omega, Omega_dot = rng.normal(size=(2, 3))
    table = terms(platform, Omega, np.ones(n), Omega_dot=Omega_dot)
    kept = [term for term in table.terms if term.kept]
    paper = parameter_varying(platform, terms="paper").at(Omega, Omega_dot)
    scale = 1.0 + max(abs(term.factor) for term in table.terms)
    expected = (paper.M, paper.G, paper.K, paper.forcing)
    for got, matrix in zip(summed(kept, platform.gimbal_names), expected, strict=True):
        np.testing.assert_allclose(got, matrix, atol=1e-12 * scale)


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


def test_near_the_nutation_the_acceleration_is_as_large_as_the_gyroscopic_action(platform):
    table = terms(platform, (1.0, 1.0, 1.0), np.full(5, 0.1), frequency=L / np.sqrt(J9 * J10))
    ratio = one(table, "9", "J9·α̈9").size * one(table, "10", "J10·β̈10").size
    assert ratio == pytest.approx(one(table, "9", "L11·β̇10").size * one(table, "10", "−L11·α̇9").size)


def test_a_restraint_is_stable_where_rotor_and_platform_turn_in_the_same_sense(platform):
    along, against = (terms(platform, (rate, 0.0, 0.0), np.full(5, 0.1)) for rate in (1.0, -1.0))
    assert one(along, "5", "L6·Ω1·β5").sense == "stable"
    assert one(along, "7", "−L8·Ω1·β7").sense == "unstable"
    assert one(against, "5", "L6·Ω1·β5").sense == "unstable"
    assert one(against, "7", "−L8·Ω1·β7").sense == "stable"
    # The pair turns in opposite senses: gimbal 4 has none.
    pair = one(along, "4", "Ω1·α4·(L6 − L8)")
    assert pair.kind == "gyroscopic restraint"
    assert pair.size == 0.0
    assert pair.sense is None


def test_a_free_rotor_is_named_by_its_p_and_has_no_axial_inertia(platform):
    rotors = tuple(dataclasses.replace(rotor, control="free") for rotor in platform.rotors)
    table = terms(dataclasses.replace(platform, rotors=rotors), (1, 1, 1), np.full(5, 0.1))
    assert one(table, "9", "p11·β̇10").factor == pytest.approx(0.15)
    assert not any(term.kind == "rotor acceleration" for term in table.terms)


def test_the_page_shows_what_is_printed(table):
    page = (Path(__file__).parents[2] / "docs" / "theory" / "terms.md").read_text(encoding="utf-8")
    shown = page.split("```text\n")[1].split("\n```")[0]
    assert shown == table.text(gimbals=("9",))
