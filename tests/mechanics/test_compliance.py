"""Drives that give way: two inertias on a shaft against closed form, in linear models and in runs."""

import tomllib

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import platform_ctrl as pc
from one_axis import job_of, loop_of
from platform_ctrl import analysis, design, simulation

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
    system = pc.state_space(pc.linearise(platform))
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


def test_equations_have_the_stiffness_of_a_drive_and_name_the_modes_that_they_leave_out():
    shape = {"frequency": 500.0, "damping": 0.01, "participation": {"Qg": 1.0}}
    platform = pc.read_platform(
        drive() | {"mode": [{"name": "arm"} | shape], "friction": [{"gimbal": "g_motor", "viscous": 0.3}]}
    )
    found, model = pc.equations(platform, "sympy"), pc.linearise(platform, terms="paper")
    for row, terms in enumerate(found.rows["partially_linear"]):
        numbers = {str(v): float(found.evaluate(c, velocity=np.zeros(6))) for c, v in terms}
        for k in range(3):
            assert numbers.get(str(found.q[k]), 0.0) == pytest.approx(model.stiffness[row, k], abs=1e-12)
            assert numbers.get(str(found.rates[k]), 0.0) == pytest.approx(model.damping[row, k], abs=1e-12)
    assert {"ks_g", "ds_g", "d_g_motor"} <= {one.name for one in found.symbols}
    assert "mode arm is left out" in pc.equations(platform)
    # At angles that twist the drive its torque counts once.
    twisted = pc.parameter_varying(platform, q=[0.0, 0.0, 0.01])
    expected = pc.linearise(platform, q=[0.0, 0.0, 0.01])
    np.testing.assert_allclose(twisted.at([0.0, 0.0, 0.0]).forcing, expected.Q0)


def hanging():
    """A pendulum of 2 kg, 0.1 m out, that a geared motor holds through a drive; a second one on it."""
    data = drive() | {"torquer": []}
    data["root"] |= {"gravity": [0.0, 0.0, -9.81], "mode": "held"}
    mass = {"mass": 2.0, "centre": [0.1, 0.0, 0.0], "inertia": [0.01, 0.01, 0.01]}
    data["gimbal"] = [data["gimbal"][0] | mass | {"axis": [0, -1, 0]}]
    current = {"torque_constant": 0.1, "resistance": 1.0, "supply": 48.0, "current_loop": {"bandwidth_hz": 500.0}}
    return data | {"motor": [{"gimbal": "g", "rotor_inertia": 1e-5, "gear": 50} | current]}


def test_a_start_in_equilibrium_winds_the_drive_up_by_the_weight_that_it_holds():
    platform = pc.read_platform(hanging())
    assert [one.name for one in platform.torquers] == ["Qg"]  # after the gimbal, not its motor side
    at = simulation.Scenario(
        platform=platform, mode="caged", duration=0.05, delay=0.0, q=[0.4, 0.0], start="equilibrium"
    )
    weight = 2.0 * 9.81 * 0.1 * np.cos(0.4)
    assert at.q == pytest.approx([0.4, 0.4 + weight / K], rel=1e-12)
    none = control.StateSpace([], [], [], [[0.0]], 1e-3, inputs=["q"], outputs=["Qg"])
    run = simulation.simulate(at, [none], period=1e-3, step=1e-4, noise=False)
    np.testing.assert_allclose(run.q, np.tile(at.q, (len(run.t), 1)), rtol=0, atol=1e-12)


def test_a_loop_that_names_the_load_is_told_of_the_motor_side():
    plant = hanging()
    for kind, sensors in (("caging", ()), ("pointing", "q")):
        with pytest.raises(pc.PlatformCtrlError, match='torquer on "g_motor": take a rate or pointing loop'):
            pc.read_job(job_of(plant, loop_of("g", sensors, kind=kind)))


def test_a_loop_reads_the_load_of_a_drive_that_it_turns_by_its_motor_side():
    plant = hanging() | {"line_of_sight": {"body": "g", "direction": [1, 0, 0]}}
    loop = loop_of(["g_motor"], "q", "hinf", limits={"disk_margin": 0.3}, design={"inertial_bandwidth_hz": 0.5})
    [found] = design.loops(job_of(plant, loop, operation={"Omega": [0.01, 0.01, 0.01]}))
    plants = found.closed.plants
    assert plants.sight == ("los_rate1",)
    # At 10 Hz, below the resonance, the motor turns motor side and load together.
    w = 2 * np.pi * 1.0
    z = np.exp(1j * w * plants.period)
    G = plants.C[0] @ np.linalg.solve(z * np.eye(plants.A.shape[-1]) - plants.A[0], plants.B[0]) + plants.arrays.D[0]
    whole = 0.03 + J1 + 50**2 * 1e-5
    assert abs(G[0, 0]) == pytest.approx(1.0 / (whole * w**2), rel=0.05)
    assert found.closed.passed


def test_sensors_friction_and_springs_may_be_on_the_motor_side():
    on = {"gimbal": "g_motor"}
    more = {"angle_sensor": [on | {"name": "motor"}], "rate_sensor": [on], "friction": [on | {"viscous": 0.1}]}
    platform = pc.read_platform(drive() | more | {"spring": [on | {"stiffness": 1.0}]})
    assert [one.name for one in platform.sensors] == ["q", "q_motor_rate", "motor"]
    assert pc.read_platform(tomllib.loads(platform.to_toml())).to_toml() == platform.to_toml()
    carried = {
        "gimbal": [*drive()["gimbal"], {"name": "k", "parent": "g_motor", "axis": [1, 0, 0], "inertia": [1] * 3}]
    }
    with pytest.raises(pc.PlatformCtrlError, match="parent must be the name of the root or a gimbal"):
        pc.read_platform(drive() | carried)
