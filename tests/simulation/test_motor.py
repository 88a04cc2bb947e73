"""Motors from their data sheets: what they turn, and what current and voltage leave of their torque."""

import control
import numpy as np
import pytest

import platform_ctrl as pc
from one_axis import job_of, loop_of, one_axis
from platform_ctrl import simulation
from platform_ctrl.job.resolve import resolver

KT, R, SUPPLY, GEAR, ETA = 0.05, 2.0, 12.0, -10.0, 0.8
J, JM = 0.02, 1e-5


def plant(**motor):
    keys = {"torque_constant": KT, "resistance": R, "supply": SUPPLY, "gear": GEAR, "efficiency": ETA}
    own = {"gimbal": "g", "rotor_inertia": JM, "current_limit": 4.0, "current_loop": {"bandwidth_hz": 1500.0}}
    return one_axis([J, J, J], pickoff=[{"gimbal": "g"}], motor=[keys | own | motor])


def test_a_motor_with_a_current_loop_is_the_torquer_of_its_gimbal():
    platform = pc.read_platform(plant())
    [torquer] = platform.torquers
    assert torquer.name == "Qg"
    assert torquer.limit == pytest.approx(ETA * 10.0 * KT * 4.0)
    assert torquer.lag == pytest.approx(1.0 / (2.0 * np.pi * 1500.0))
    assert pc.read_platform(platform).to_toml() == platform.to_toml()
    assert "torquer" not in platform.to_toml()
    system = pc.state_space(pc.linearise(platform))
    assert system.input_labels[0] == "Qg"


def test_its_torque_ends_where_the_back_emf_takes_the_supply():
    # Without a current limit the motor runs up to its idling speed, torque falling in proportion to the rate.
    platform = pc.read_platform(plant(current_limit=100.0))
    full = control.StateSpace([], [], [], [[1e6]], 1e-3, inputs=["q"], outputs=["Qg"])
    one = simulation.Scenario(platform=platform, mode="caged", duration=3.0, delay=0.0, q=[1e-3])
    run = simulation.simulate(one, [full], period=1e-3, noise=False)
    stall, slope = ETA * 10.0 * KT * SUPPLY / R, ETA * (10.0 * KT) ** 2 / R
    idle, inertia = stall / slope, J + GEAR**2 * JM
    assert idle == pytest.approx(SUPPLY / (10.0 * KT))
    expected = idle * (1.0 - np.exp(-slope / inertia * run.t))
    np.testing.assert_allclose(run.rate[:, 0], expected, rtol=0, atol=0.01 * idle)
    assert run.rate[-1, 0] == pytest.approx(idle, rel=1e-3)


def test_a_torque_is_over_its_limit_where_the_supply_does_not_leave_it_at_the_rate():
    # Full command up to the idling speed, then braking: there the supply adds to the back-EMF.
    data = plant(current_limit=100.0) | {"rate_sensor": [{"body": "g", "axis": [0, 0, 1], "name": "gyro"}]}
    torque = 0.3 * ETA * 10.0 * KT * SUPPLY / R
    run = {"name": "spin up", "mode": "caged", "duration": 0.3, "initial": {"q": 0.1}, "limits": {"torque_share": 1.0}}
    loop = loop_of("g", ["gyro"], "pi", kind="rate", limits={"disk_margin": 0.1})
    job = pc.read_job(job_of(data, loop, operation={"Omega": [0.0, 0.0, 1.0]}, manoeuvre=[run]))
    # 30 % of the stall torque: more than is left beyond 70 % of the idling speed.
    steady = control.StateSpace([], [], [], [[10.0 * torque]], 1e-3, inputs=["q"], outputs=["Qg"])
    scenario = job.scenario(job.manoeuvres[0])
    out = simulation.simulate(scenario, [steady], period=1e-3, step=1e-4)
    batch = simulation.simulate_batch([scenario], [steady], period=1e-3, step=1e-4)
    share = batch.torque_share[0, 0]
    [motor] = job.platform.torquers
    command, rate = out.command[:, 0], out.rate[:, 0]
    left = np.clip(motor.stall - motor.back_emf * np.sign(command) * rate, 1e-9 * motor.limit, motor.limit)
    assert np.abs(command).max() < 100.0 * motor.limit
    assert share == pytest.approx((np.abs(command) / left).max(), rel=1e-9)
    assert share > 1.2 * np.abs(command).max() / motor.limit
    assert out.saturated[0] == np.sum(np.abs(command) >= left)


def test_readings_that_are_turned_to_the_joints_do_not_move_the_torques_in_the_record():
    loop = {"bandwidth_hz": 1500.0, "rate_hz": 20e3}
    gyro = {"body": "g", "axis": [0, 0, 1], "name": "gyro"}
    platform = pc.read_platform(plant(inductance=1e-3, current_loop=loop) | {"rate_sensor": [gyro]})
    held = control.StateSpace([], [], [], [[-1.0]], 1e-3, inputs=["q"], outputs=["Qg"])
    plain, resolved = (
        simulation.simulate(
            simulation.Scenario(platform=platform, mode="caged", duration=0.02, delay=0.0, q=[0.1], resolvers=laws),
            [held],
            period=1e-3,
        )
        for laws in ((), (resolver(platform, ["g"], ["gyro"], 5.0),))
    )
    assert resolved.reading.shape[1] == plain.reading.shape[1] + 1
    np.testing.assert_array_equal(resolved.torque, plain.torque)
    np.testing.assert_array_equal(resolved.command, plain.command)
