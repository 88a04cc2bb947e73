"""Drives that give way: two inertias on a shaft against closed form, in linear models and in runs."""

import tomllib

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import platform_ctrl as pc
from platform_ctrl import analysis, simulation
from platform_ctrl.mechanics.outputs import observed

J1, J2, K, C = 0.02, 0.05, 300.0, 0.04


def drive(**compliance):
    """A load on a shaft, its torquer and encoders on both sides; the second gimbal is carried by the load."""
    gimbals = [
        {"name": "g", "parent": "base", "axis": [0, 0, 1], "inertia": [0.05, 0.05, J2], "angle": "q"},
        {"name": "h", "parent": "g", "axis": [1, 0, 0], "inertia": [1e-9, 1e-9, 1e-9]},
    ]
    return {
        "schema": 1,
        "name": "drive",
        "root": {"name": "base", "inertia": [1.0, 1.0, 1.0]},
        "gimbal": gimbals,
        "torquer": [{"gimbal": "g"}],
        "pickoff": [{"gimbal": "g"}],
        "compliance": [{"gimbal": "g", "stiffness": K, "damping": C, "inertia": J1} | compliance],
    }


@given(st.floats(1e-3, 10.0), st.floats(1.0, 1e4), st.one_of(st.just(0.0), st.floats(1e-6, 1.0)))
def test_a_drive_has_a_resonance_and_on_the_motor_side_the_zero_of_its_load(inertia, stiffness, damping):
    platform = pc.read_platform(drive(inertia=inertia, stiffness=stiffness, damping=damping))
    w = np.sqrt(stiffness / J2) * np.array([0.01, 0.5, 0.9, 1.5, 10.0])
    system = pc.state_space(pc.linearise(platform))
    assert system.output_labels == ["q", "q_h", "q_motor"]
    found = analysis.frequency_response(system, w)[:, system.input_labels.index("Qg")]
    s = 1j * w
    shaft = damping * s + stiffness
    whole = inertia * J2 * s**4 + (inertia + J2) * shaft * s**2
    np.testing.assert_allclose(found[0], shaft / whole, rtol=1e-5)
    np.testing.assert_allclose(found[2], (J2 * s**2 + shaft) / whole, rtol=1e-5)


def test_the_motor_side_of_a_geared_motor_turns_with_the_base_as_its_gear_says():
    Jm, N = 5e-5, 20.0
    data = drive() | {"motor": [{"gimbal": "g", "rotor_inertia": Jm, "gear": N}]}
    del data["compliance"][0]["inertia"]
    system = pc.state_space(pc.linearise(pc.read_platform(data)))
    w = np.array([1.0, 30.0, 100.0])
    found = analysis.frequency_response(system, w)[:, system.input_labels.index("Omega3")]
    s, J = 1j * w, N**2 * Jm
    # Base acceleration a: J2 (q'' + a) = T, N^2 Jm q1'' + N Jm a = -T.
    shaft = C * s + K
    A = np.array([[J2 * s**2 + shaft, -shaft], [-shaft, J * s**2 + shaft]]).transpose(2, 0, 1)
    expected = np.linalg.solve(A, -np.array([J2 * s, N * Jm * s]).T[..., None])[..., 0]
    np.testing.assert_allclose(found[[0, 2]].T, expected, rtol=1e-6)


def test_a_drive_may_be_given_by_the_frequency_of_its_load():
    data = drive(frequency_hz=12.0)
    del data["compliance"][0]["stiffness"]
    platform = pc.read_platform(data)
    [found] = platform.compliances
    np.testing.assert_allclose(found.stiffness, (2 * np.pi * 12.0) ** 2 * (J2 + 1e-9), rtol=1e-12)


def test_a_run_of_a_sampled_loop_is_that_of_the_exact_matrices():
    platform = pc.read_platform(drive())
    period, k = 2e-3, 1.5
    controller = control.StateSpace([], [], [], [[-k]], period, inputs=["q"], outputs=["Qg"])
    one = simulation.Scenario(platform=platform, mode="caged", duration=0.3, delay=0.0, q=[0.01, 0.0, 0.012])
    run = simulation.simulate(one, [controller], period=period, step=1e-4, noise=False)
    system = observed(pc.state_space(pc.linearise(platform)), platform, ["q"])
    sampled = control.sample_system(system, period, method="zoh")
    x, expected = np.array([0.01, 0.0, 0.012, 0.0, 0.0, 0.0]), []
    for _ in run.t:
        expected.append(x[[0, 2]])
        x = sampled.A @ x - sampled.B[:, 0] * k * x[0]
    np.testing.assert_allclose(run.q[:, [0, 2]], expected, rtol=0, atol=1e-8)


def test_a_plant_with_a_drive_is_written_as_it_was_read():
    platform = pc.read_platform(drive())
    again = pc.read_platform(tomllib.loads(platform.to_toml()))
    assert again.to_toml() == platform.to_toml()
    assert again.gimbal_names == ("g", "h", "g_motor")


@pytest.mark.parametrize(
    ("compliance", "words"),
    [
        ({"inertia": 0.0}, "it has no motor side: give its inertia, or a"),
        ({"stiffness": -1.0}, "stiffness must be a number > 0"),
        ({"frequency_hz": 3.0}, 'give either "stiffness" or "frequency_hz", not both'),
        ({"gimbal": "k"}, "gimbal must be the name of a gimbal"),
    ],
)
def test_a_drive_that_cannot_be_is_refused(compliance, words):
    with pytest.raises(pc.PlatformCtrlError, match=words):
        pc.read_platform(drive(**compliance))
