"""State-space models: signals, physics of section 4 of the paper, and agreement with the second-order equations."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from platform_ctrl import (
    element_forces,
    forward_dynamics,
    inverse_dynamics,
    linearise,
    read_platform,
    state_space,
    subsystems,
)
from platform_ctrl.errors import ArgumentError
from small_trees import tree
from tree_cases import platforms, with_elements, with_torquers

L, J4, J5, J9, J10 = 0.15, 8e-4, 2e-4, 5e-4, 2e-4


@pytest.fixture(scope="module")
def platform():
    return read_platform("three_gyro_platform")


def test_signal_names_and_order(platform):
    sys = state_space(linearise(platform))
    assert sys.input_labels == ["Q4", "Q5", "Q7", "Q9", "Q10", "Omega1", "Omega2", "Omega3"]
    assert sys.output_labels == ["alpha4", "beta5", "beta7", "alpha9", "beta10"]
    free = state_space(linearise(platform), root="free")
    assert free.input_labels == ["Q4", "Q5", "Q7", "Q9", "Q10", "M1", "M2", "M3"]
    assert free.output_labels == ["alpha4", "beta5", "beta7", "alpha9", "beta10", "Omega1", "Omega2", "Omega3"]
    assert sys[["alpha9"], ["Omega1"]].ninputs == 1


@pytest.mark.parametrize("Omega", [(0, 0, 0), (1, 0, 0), (0.3, -0.8, 0.5)])
@pytest.mark.parametrize("terms", ["exact", "paper"])
def test_the_gimbals_fall_apart_into_4_5_7_and_9_10(platform, Omega, terms):
    assert subsystems(linearise(platform, Omega=Omega, terms=terms)) == (("4", "5", "7"), ("9", "10"))


def test_yaw_and_pitch_of_a_balanced_two_axis_gimbal_are_coupled_by_a_rate_across_both_alone():
    two = tree(1.0, [("yaw", "base", 3, [0.05, 0.06, 0.07]), ("pitch", "yaw", 2, [0.02, 0.03, 0.04])])
    apart, together = (("yaw",), ("pitch",)), (("yaw", "pitch"),)
    for Omega, expected in (((0, 0, 0), apart), ((0, 0.5, 0), apart), ((0, 0, 0.5), apart), ((0.5, 0, 0), together)):
        model = linearise(two, Omega=Omega)
        assert subsystems(model) == expected
        # What Omega' multiplies is there all the same: for manoeuvres.
        assert np.abs(model.M_Omega_q[0, :, 1]).max() > 0.01
    still = state_space(linearise(two), gimbals=["yaw"])
    assert still.nstates == 2
    with pytest.raises(ArgumentError, match=r"yaw and pitch are coupled at Omega1 = 0\.5 rad/s"):
        state_space(model, gimbals=["yaw"])


@settings(max_examples=30, deadline=None)
@given(platforms(max_gimbals=4), st.integers(0, 2**32 - 1), st.sampled_from(["exact", "paper"]))
def test_momentum_states_solve_the_second_order_equations(platform, seed, terms):
    """q(s) from the state space satisfies (M s² + G s + K) q = Q − (M_Omega s + G_Omega) ω at any s."""
    rng = np.random.default_rng(seed)
    platform = with_torquers(platform)
    model = linearise(platform, Omega=rng.normal(size=3), terms=terms)
    sys = state_space(model)
    s = complex(rng.normal(), 3 * rng.normal()) * 2
    response = np.asarray(sys(s))
    n = len(platform.gimbals)
    left = (model.M * s**2 + model.G * s + model.K) @ response
    right = np.hstack([np.eye(n), -(model.M_Omega * s + model.G_Omega)])
    np.testing.assert_allclose(left, right, atol=1e-8 * (1 + np.abs(right).max()))


@settings(max_examples=25, deadline=None)
@given(platforms(max_gimbals=4), st.integers(0, 2**32 - 1))
def test_a_free_root_with_force_elements_moves_as_the_non_linear_equations_about_the_trim(platform, seed):
    """Angles, rates and specific force that the model gives for each input solve the differentiated equations."""
    rng = np.random.default_rng(seed)
    platform = with_elements(with_torquers(platform), rng)
    n = len(platform.gimbals)
    q, Omega, f = rng.uniform(-1, 1, n), rng.normal(size=3), platform.specific_force
    trim = np.concatenate([Omega, np.zeros(n)])
    held = inverse_dynamics(platform, q, trim, np.zeros(3 + n)) - element_forces(platform, q, trim)

    def acceleration(x):
        angles, velocity, drive, force = np.split(x, np.cumsum([n, 3 + n, 3 + n]))
        forces = element_forces(platform, angles, velocity, force)
        return forward_dynamics(platform, angles, velocity, held + drive + forces)

    at = np.concatenate([q, trim, np.zeros(3 + n), f])
    np.testing.assert_allclose(acceleration(at), 0.0, atol=1e-8)
    h = 1e-6
    slope = np.stack(
        [(acceleration(at + h * e) - acceleration(at - h * e)) / (2 * h) for e in np.eye(len(at))], axis=-1
    )
    sys = state_space(linearise(platform, Omega=Omega, q=q), root="free", specific_force=True)
    s = complex(rng.uniform(0.5, 2.0), rng.normal() * 3)
    response = np.asarray(sys(s))
    angles, rates = response[:n], response[n:]
    # The model's inputs are Q, M, f; those of the equations M, Q, f.
    inputs = np.eye(n + 6)[[*range(n, n + 3), *range(n), *range(n + 3, n + 6)]]
    motion = np.vstack([angles, rates, s * angles, inputs])
    scale = 1 + (np.abs(slope) @ np.abs(motion)).max()
    np.testing.assert_allclose(slope @ motion, s * np.vstack([rates, s * angles]), atol=1e-7 * scale)
