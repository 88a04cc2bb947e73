"""Rates and small rotations of bodies against inertial space in linear models, against turning matrices."""

import control
import numpy as np
import pytest
from scipy.linalg import logm
from scipy.spatial.transform import Rotation

import platform_ctrl as pc
from every_key import every_plant_key
from sensed import sensed

GIMBAL = {
    "schema": 1,
    "name": "camera on a skew gimbal",
    "root": {"name": "vehicle", "inertia": [5.0, 6.0, 7.0]},
    "gimbal": [
        {"name": "azimuth", "parent": "vehicle", "axis": [0.1, 0.0, 1.0], "inertia": [0.03, 0.03, 0.04]},
        {"name": "elevation", "parent": "azimuth", "axis": [0, 1, 0], "inertia": [0.02, 0.015, 0.018]},
    ],
    "torquer": [{"gimbal": "azimuth"}, {"gimbal": "elevation"}],
    "rate_sensor": [
        {"body": "elevation", "axis": [0, 1, 0], "name": "pitch_gyro"},
        {"body": "elevation", "axis": [0, 0.2, 1], "name": "yaw_gyro", "bandwidth_hz": 80.0, "scale_error": 0.01},
        {"body": "vehicle", "axis": [0, 0, 1]},
        {"body": "elevation", "axis": [0, 1, 0], "frame": "parent", "name": "tacho"},
    ],
    "attitude_sensor": [{"body": "elevation", "axis": [0, 0, 1], "name": "tracker"}],
    "line_of_sight": {"body": "elevation", "direction": [1, 0, 0]},
}
PLATFORM = pc.read_platform(GIMBAL)
TRIM = np.array([0.4, 0.9])
LOS_RATES, LOS_ANGLES = ("los_rate1", "los_rate2", "los_roll_rate"), ("los_angle1", "los_angle2", "los_roll")


def attitude(q: np.ndarray, root: Rotation) -> Rotation:
    outer = np.array([0.1, 0.0, 1.0]) / np.linalg.norm([0.1, 0.0, 1.0])
    return root * Rotation.from_rotvec(q[0] * outer) * Rotation.from_rotvec([0, q[1], 0])


def turned(rate: np.ndarray, root_rate: np.ndarray, trim: np.ndarray) -> np.ndarray:
    """The body's rate in its own axes, from the difference of two attitudes."""
    h = 1e-6
    before, after = (attitude(trim + sign * h * rate, Rotation.from_rotvec(sign * h * root_rate)) for sign in (-1, 1))
    matrix = logm((before.inv() * after).as_matrix()) / (2.0 * h)
    return np.array([matrix[2, 1], matrix[0, 2], matrix[1, 0]])


def rates_of(names: list[str], rate: np.ndarray, root_rate: np.ndarray) -> np.ndarray:
    """What the linear model shows at these rates of gimbals and root."""
    model = pc.linearise(PLATFORM, q=TRIM)
    out = sensed(PLATFORM, names, TRIM)
    x = np.zeros(out.nstates)
    x[2:4] = model.M @ rate + model.M_Omega @ root_rate
    return np.asarray(out.C @ x + out.D @ [0, 0, *root_rate])


@pytest.mark.parametrize("seed", range(3))
def test_a_gyro_reads_the_rate_of_its_body_against_inertial_space(seed):
    rng = np.random.default_rng(seed)
    rate, root_rate = rng.normal(size=2), rng.normal(size=3)
    expected = turned(rate, root_rate, TRIM)
    found = rates_of(["elevation_Omega1", "elevation_Omega2", "elevation_Omega3"], rate, root_rate)
    np.testing.assert_allclose(found, expected, atol=1e-8)
    np.testing.assert_allclose(rates_of(["pitch_gyro"], rate, root_rate), expected[1], atol=1e-8)
    np.testing.assert_allclose(rates_of(list(LOS_RATES), rate, root_rate), expected[[1, 2, 0]], atol=1e-8)
    np.testing.assert_allclose(rates_of(["tacho", "Omega3"], rate, root_rate), [rate[1], root_rate[2]], atol=1e-12)


def test_a_body_that_is_turned_with_the_root_rate_of_its_trim_changes_its_components():
    """About a constant Omega the components of Omega in the body change as the gimbals turn."""
    Omega, h = np.array([0.3, -0.2, 0.5]), 1e-6
    out = sensed(PLATFORM, ["elevation_Omega1", "elevation_Omega2", "elevation_Omega3"], TRIM, Omega)
    rate = sensed(PLATFORM, ["q_azimuth_rate", "q_elevation_rate"], TRIM, Omega)
    for k in range(2):
        change = h * np.eye(2)[k]
        parts = [attitude(TRIM + sign * change, Rotation.identity()).inv().apply(Omega) for sign in (1, -1)]
        # The angle alone: the gimbals' rates stay zero.
        x = np.eye(4)[k]
        np.testing.assert_allclose(rate.C @ x, 0.0, atol=1e-12)
        np.testing.assert_allclose(out.C @ x, (parts[0] - parts[1]) / (2.0 * h), atol=1e-8)


def test_rotations_are_integrals_of_rates_and_no_integral_is_taken_twice():
    out = sensed(PLATFORM, ["tracker", *LOS_ANGLES, *LOS_RATES], TRIM)
    assert out.nstates == 4 + 3
    s = 2.0 + 5.0j
    response = np.asarray(out(s))
    np.testing.assert_allclose(s * response[1:4], response[4:7], rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(response[0], response[2], rtol=1e-9, atol=1e-10)
    assert sensed(PLATFORM, ["tracker", "los_angle2"], TRIM).nstates == 4 + 1


def test_a_slow_gyro_is_a_butterworth_low_pass_with_its_scale_factor():
    weights = PLATFORM.outputs["yaw_gyro"]
    out = sensed(PLATFORM, ["yaw_gyro", *weights], TRIM)
    w = 2.0 * np.pi * 80.0
    low_pass = control.tf([w * w], [1.0, np.sqrt(2.0) * w, w * w])
    for s in (1.0 + 30.0j, 1j * w):
        rows = np.asarray(out(s))
        expected = 1.01 * low_pass(s) * (np.array(list(weights.values())) @ rows[1:])
        np.testing.assert_allclose(rows[0], expected, rtol=1e-9)


def test_every_sensor_is_in_linear_models() -> None:
    platform = pc.read_platform(every_plant_key())
    every = [sensor.name for sensor in platform.sensors]
    assert sensed(platform, every, root="free").output_labels == every != []
    assert {sensor.unit for sensor in platform.sensors} <= {"rad", "rad/s"}
