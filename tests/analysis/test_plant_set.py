"""The plants that a loop has to stand: spread, samples, grid of Omega, faults, and the platform's rate as an input."""

import dataclasses

import numpy as np
import pytest

from platform_ctrl import linearise, matrices, read_job, state_space
from platform_ctrl.analysis import frequency_response, sampled
from platform_ctrl.analysis.system import System
from platform_ctrl.design.cases import cases
from platform_ctrl.design.plants import plants_of
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.variation import Faults, Uncertainty
from platform_ctrl.plant.platform import OMEGA_NAMES

PERIOD = 5e-4
L, J9, J10 = 0.15, 5e-4, 2e-4
NUTATION = L / np.sqrt(J9 * J10)


def loop_plants(job, gimbals=("9", "10")):
    """The plants of the caging loop on some gimbals."""
    return plants_of(job, dataclasses.replace(job.loops[1], gimbals=gimbals))


@pytest.fixture(scope="module")
def job():
    return read_job("examples/three_gyro_platform.toml")


def with_everything(job, **changes):
    everything = {
        "uncertainty": Uncertainty(inertia=0.1, spin=0.2, samples=6),
        "Omega_grid": 3,
        "faults": Faults(slow_rotor=0.5, weak_torquer=0.25),
    }
    return dataclasses.replace(job, **(everything | changes))


@pytest.fixture(scope="module")
def full(job):
    return loop_plants(with_everything(job))


def motions(A):
    """Frequencies of the undamped motions of a sampled plant, rad/s, the fastest first."""
    z = np.linalg.eigvals(A)
    return np.sort(np.abs(np.angle(z[np.abs(np.abs(z) - 1.0) < 1e-6])) / PERIOD)[::-1]


def test_the_groups_stand_one_after_the_other(full):
    groups = full.groups
    counts = [groups.count(name) for name in ("nominal", "uncertainty", "Omega", "faults")]
    assert counts == [1, 8 + 6, 27 - 1, 1 + 2]
    assert list(groups) == sorted(groups, key=["nominal", "uncertainty", "Omega", "faults"].index)
    assert len(set(full.labels)) == len(groups) == len(full.A)


def test_samples_lie_inside_the_corners_and_are_all_different(job):
    nominal = job.platform
    J, momenta = np.diag(matrices(nominal).A_star)[3:], np.array([r.angular_momentum for r in nominal.rotors])
    found = [case for case in cases(with_everything(job), ("9", "10")) if case.group == "uncertainty"][8:]
    changes = np.array(
        [
            [
                *(np.diag(matrices(case.platform).A_star)[6:] / J[3:] - 1.0),
                case.platform.rotors[2].angular_momentum / momenta[2] - 1.0,
            ]
            for case in found
        ]
    )
    half_widths = np.array([0.1, 0.1, 0.2])
    assert np.all(np.abs(changes) < half_widths)
    assert np.ptp(changes, axis=0) == pytest.approx(2.0 * half_widths, rel=0.5)
    assert all(len(set(column)) == len(found) for column in changes.T)


def test_the_grid_of_Omega_holds_its_corners_and_leaves_out_rest(job):
    def rates(points, Omega=job.Omega):
        chosen = with_everything(job, Omega_grid=points, Omega=np.array(Omega))
        return {tuple(case.Omega) for case in cases(chosen, ("9", "10")) if case.group == "Omega"}

    assert rates(2) < rates(3)
    assert len(rates(5)) == 5**3 - 1
    assert (0.0, 0.0, 0.0) not in rates(3)
    assert rates(3, [2.0, 0.0, 0.0]) == {(-2.0, 0.0, 0.0), (2.0, 0.0, 0.0)}
    assert rates(4, [0.0, 0.0, 0.0]) == set()


@pytest.mark.parametrize("share", [0.25, 0.5, 0.9])
def test_a_slow_rotor_lowers_the_nutation_in_proportion(job, share):
    plants = loop_plants(with_everything(job, faults=Faults(slow_rotor=share)))
    slow = plants.groups.index("faults")
    assert motions(plants.A[0])[0] == pytest.approx(NUTATION, rel=1e-6)
    assert motions(plants.A[slow])[0] == pytest.approx(share * NUTATION, rel=1e-6)


def test_a_weak_torquer_scales_its_own_column_alone(full):
    for k, torquer in enumerate(("Q9", "Q10")):
        weak = full.labels.index(f"torquer {torquer} at 25% of its torque")
        scale = np.where(np.arange(2) == k, 0.25, 1.0)
        size = np.abs(full.response[0]).max(axis=(-2, -1), keepdims=True)
        assert np.all(np.abs(full.response[weak] - full.response[0] * scale) < 1e-9 * size)
        of_rate = full.disturbed_on_grid().read[..., -3:]
        size = np.abs(of_rate[0]).max()
        np.testing.assert_allclose(of_rate[weak], of_rate[0], rtol=1e-9, atol=1e-12 * size)


@pytest.mark.parametrize("gimbals", [("9", "10"), ("10", "9"), ("4", "5", "7")])
def test_Omega_acts_without_delay_and_lag_held_in_state_space_and_continuous_in_responses(job, gimbals):
    plants = loop_plants(job, gimbals)
    alone = state_space(linearise(job.platform), gimbals=gimbals)[list(plants.angles), list(OMEGA_NAMES)]
    held = System.of(plants.system()[:, list(OMEGA_NAMES)], "test")
    expected = frequency_response(System.of(sampled(alone, PERIOD, 0.0), "test"), plants.frequency, -3)
    np.testing.assert_allclose(frequency_response(held, plants.frequency, -3), expected, rtol=1e-8, atol=1e-12)
    continuous = frequency_response(System.of(alone, "test"), plants.frequency, -3)
    np.testing.assert_allclose(plants.disturbed_on_grid().read[0, ..., -3:], continuous, rtol=1e-8, atol=1e-12)


def test_one_gimbal_that_holds_still_turns_against_a_slow_platform_rate(job):
    """Free of torque a gyro keeps its direction in space: the gimbal angle is minus the integral of Omega."""
    plants = loop_plants(job)
    w = plants.frequency[:5]
    found = plants.disturbed_on_grid().read[0, :5, :, -3:]
    np.testing.assert_allclose(np.abs(found).max(axis=(-2, -1)), 1.0 / w, rtol=1e-3)


def test_a_controller_is_joined_by_the_names_of_its_signals(job):
    import control

    plants = loop_plants(job)
    D = np.array([[1.0, 2.0], [3.0, 4.0]])
    named = control.ss([], [], [], D, PERIOD, inputs=["beta10", "alpha9"], outputs=["Q9", "Q10"])
    np.testing.assert_array_equal(plants.joined(named).D, D[:, ::-1])
    empty = np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((2, 0))
    np.testing.assert_array_equal(plants.joined(System(*empty, D, PERIOD)).D, D)
    other = control.ss([], [], [], D, PERIOD, inputs=["alpha9", "alpha4"], outputs=["Q9", "Q10"])
    with pytest.raises(ArgumentError, match=r"must be .*alpha9.*beta10.*got .*alpha4"):
        plants.joined(other)
