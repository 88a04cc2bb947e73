"""Drives that take a rate or an angle: bandwidth, limits, the inertia they turn, and loops around them."""

import math
import tomllib

import control
import numpy as np
import pytest

import platform_ctrl as pc
from platform_ctrl import analysis, design, simulation
from platform_ctrl.verification import check_job

HERTZ, J = 20.0, 0.05


def mount(command="rate", **servo):
    """A mount whose azimuth has an encoder and a gyro."""
    azimuth = {"name": "azimuth", "parent": "base", "axis": [0, 0, 1], "inertia": [J, J, J], "angle": "az"}
    return {
        "schema": 1,
        "name": "mount",
        "root": {"name": "base", "inertia": [1.0, 1.0, 1.0], "mode": "held"},
        "gimbal": [azimuth],
        "pickoff": [{"gimbal": "azimuth", "noise_rms": 1e-5}],
        "rate_sensor": [{"body": "azimuth", "axis": [0, 0, 1], "name": "gyro", "noise_rms": 1e-4}],
        "servo": [{"gimbal": "azimuth", "command": command, "bandwidth_hz": HERTZ} | servo],
    }


@pytest.mark.parametrize("command", ["rate", "angle"])
def test_a_command_arrives_3_db_down_at_the_bandwidth(command):
    platform = pc.read_platform(mount(command))
    system = pc.state_space(pc.linearise(platform))
    w = 2 * np.pi * HERTZ * np.array([1e-4, 1.0])
    found = analysis.frequency_response(system, w)[0, system.input_labels.index(f"{command}_azimuth")]
    gain = np.abs(found * 1j * w if command == "rate" else found)
    np.testing.assert_allclose(gain, [1.0, math.sqrt(0.5)], rtol=1e-6)
    assert pc.read_platform(tomllib.loads(platform.to_toml())).to_toml() == platform.to_toml()


@pytest.mark.parametrize("command", ["rate", "angle"])
def test_a_run_follows_the_linear_servo_and_stays_within_its_limits(command):
    limits = {"rate_limit": 1.0} | ({"acceleration_limit": 10.0} if command == "rate" else {})
    platform, T = pc.read_platform(mount(command, **limits)), 1e-3
    law = control.StateSpace([], [], [], [[-40.0 if command == "rate" else -1.0]], T, inputs=["az"])
    law.output_labels = [f"{command}_azimuth"]
    at = simulation.Scenario(platform=platform, mode="caged", duration=3.0, delay=0.0, q=[1.5])
    run = simulation.simulate(at, [law], period=T, step=1e-4, noise=False)
    rate = np.gradient(run.q[:, 0], T)
    if command == "rate":
        assert 0.99 < np.abs(rate).max() <= 1.0 + 1e-9
        assert 9.9 < np.abs(np.gradient(rate, T)).max() <= 10.0 + 1e-6
        assert np.abs(run.torque).max() <= 1.0
    else:  # pulled from 1.5 rad by the spring; the command follows at 1 rad/s
        assert np.abs(np.diff(run.torque[:, 0])).max() == pytest.approx(T, rel=1e-9)


def test_a_servo_turns_what_its_gimbal_carries_and_its_motor():
    data = mount() | {"motor": [{"gimbal": "azimuth", "rotor_inertia": 1e-5, "gear": 50.0}]}
    data["gimbal"].append({"name": "tilt", "parent": "azimuth", "axis": [0, 1, 0], "inertia": [1e-2] * 3})
    assert pc.read_platform(data).servos[0].inertia == pytest.approx(J + 1e-2 + 50**2 * 1e-5)
    data["compliance"] = [{"gimbal": "azimuth", "stiffness": 1e3, "inertia": 3e-3}]
    [servo] = pc.read_platform(data).servos
    assert servo.inertia == pytest.approx(J + 1e-2 + 50**2 * 1e-5 + 3e-3)
    assert (servo.gimbal, servo.name) == ("azimuth_motor", "rate_azimuth")


@pytest.mark.parametrize(
    ("kind", "sensor", "method"), [("pointing", "az", "lqg"), ("pointing", "az", "structured"), ("rate", "gyro", "pi")]
)
def test_a_job_with_a_loop_around_a_servo_passes(kind, sensor, method):
    turn = {"name": "turn", "mode": "caged", "duration": 2.0, "axis": 3, "rate": 0.2, "rise": 0.3, "hold": 0.5}
    loop = {"name": "L", "kind": kind, "gimbals": ["azimuth"], "sensors": [sensor], "use": "d"}
    job = pc.read_job(
        {
            "schema": 2,
            "name": "mount",
            "plant": mount(rate_limit=1.0, acceleration_limit=10.0),
            "operation": {"Omega": [0.1, 0.1, 0.1]},
            "sampling": {"rate_hz": 1000, "delay": 5e-4},
            "loop": [loop | {"limits": {"disk_margin": 0.4}, "design": [{"name": "d", "method": method}]}],
            "manoeuvre": [turn | {"limits": {"angle": 0.5, "torque_share": 1.0}}],
        }
    )
    result = check_job(job, design.loops(job))
    assert result.passed
    [controller] = [outcome.closed.controller for outcome in result.loops]
    assert controller.output_labels == ["rate_azimuth"]


@pytest.mark.parametrize(
    ("servo", "words"),
    [
        ({"command": "torque"}, 'command must be "rate" or "angle"'),
        ({"command": "angle", "acceleration_limit": 1.0}, "acceleration_limit = 1 has no effect with command"),
        ({"gimbal": "tilt"}, "gimbal must be the name of a gimbal"),
        ({"bandwidth_hz": 0.0}, "bandwidth_hz must be a number > 0"),
    ],
)
def test_a_servo_that_cannot_be_is_refused(servo, words):
    with pytest.raises(pc.PlatformCtrlError, match=words):
        pc.read_platform(mount(**servo))
