"""What sensors on bodies and the line of sight read in runs, against rotation matrices and their differences."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy import signal

from oracle_trees import rotation, turn
from platform_ctrl import Platform
from platform_ctrl.errors import ArgumentError
from platform_ctrl.simulation import HalfCosine, Scenario, simulate, simulate_batch
from sighted_gimbal import sighted, skewed

PERIOD = 1e-3
START = np.array([0.3, -0.4])
RATE = np.array([0.8, -1.1])


def scenario(platform: Platform, mode: Any = "caged", duration: float = 0.2) -> Scenario:
    caged = mode == "caged"
    about = np.array([0.2, -0.5, 0.3])
    return Scenario(
        platform=platform,
        mode=mode,
        duration=duration,
        delay=0.0,
        profile=HalfCosine(axis=2, rate=0.6, rise=0.25, hold=0.0) if caged else None,
        Omega=np.zeros(3) if caged else np.array([0.3, -0.7, 0.5]),
        q=START,
        rate=RATE,
        attitude=np.array([np.sqrt(1.0 - about @ about), *about]),
        seed=4,
    )


def bodies(platform: Platform, run: Any) -> np.ndarray:
    """Rotation of the payload, from its axes to inertial axes, at every sample: (N, 3, 3)."""
    yaw, pitch = platform.gimbals
    return np.array(
        [rotation(e) @ turn(yaw.axis, q[0]) @ turn(pitch.axis, q[1]) for e, q in zip(run.attitude, run.q, strict=True)]
    )


def rates_of(R: np.ndarray) -> np.ndarray:
    """Rate in body axes from differences of fourth order, without the first and last two samples."""
    change = (R[:-4] - 8.0 * R[1:-3] + 8.0 * R[3:-1] - R[4:]) / (12.0 * PERIOD)
    W = R[2:-2].transpose(0, 2, 1) @ change
    return np.stack([W[:, 2, 1], W[:, 0, 2], W[:, 1, 0]], axis=1)


def rotations_of(R: np.ndarray) -> np.ndarray:
    E = R[0].T @ R
    return 0.5 * np.stack([E[:, 2, 1] - E[:, 1, 2], E[:, 0, 2] - E[:, 2, 0], E[:, 1, 0] - E[:, 0, 1]], axis=1)


@pytest.mark.parametrize("mode", ["caged", "stabilised"])
@pytest.mark.parametrize("make", [lambda plant: plant, skewed], ids=["along the axes", "skew"])
def test_sensors_and_line_of_sight_read_what_rotation_matrices_give(mode, make) -> None:
    platform = make(sighted())
    run = simulate(scenario(platform, mode), [], period=PERIOD)
    R = bodies(platform, run)
    rates, turned = rates_of(R), rotations_of(R)
    reading = dict(zip(run.pickoff_names, run.reading.T, strict=True))
    for one in platform.rate_sensors:
        tilted = np.zeros(3) if one.misalignment is None else np.cross(one.misalignment, one.axis)
        expected = rates @ (one.axis + tilted)
        np.testing.assert_allclose(reading[one.name][2:-2], expected, rtol=0.0, atol=1e-7)
    np.testing.assert_allclose(reading["tracker"], turned @ platform.attitude_sensors[0].axis, rtol=0.0, atol=1e-14)
    np.testing.assert_allclose(reading["encoder"], run.q[:, 1], rtol=0.0, atol=0.5000001e-6)
    across = platform.line_of_sight.across
    np.testing.assert_allclose(run.line_of_sight[2:-2, :3], rates @ across.T, rtol=0.0, atol=1e-7)
    np.testing.assert_allclose(run.line_of_sight[:, 3:], turned @ across.T, rtol=0.0, atol=1e-14)
    assert np.abs(rates).max() > 0.5  # it has moved
    assert np.abs(turned).max() > 0.1


def test_a_rate_against_the_parent_is_the_joints_share_of_the_axis() -> None:
    axis = [0.0, 0.6, 0.8]
    platform = sighted(rate_sensor=[{"name": "tacho", "body": "pitch", "axis": axis, "frame": "parent"}])
    run = simulate(scenario(platform), [], period=PERIOD)
    np.testing.assert_allclose(run.reading[:, 2], 0.6 * run.rate[:, 1], rtol=1e-15)


def gyro(run: Any) -> np.ndarray:
    return run.reading[:, run.pickoff_names.index("gyro2")]


def with_gyro(**errors: object) -> Platform:
    return sighted(rate_sensor=[{"name": "gyro2", "body": "pitch", "axis": [0, 1, 0], **errors}])


@cache
def true_rate() -> np.ndarray:
    return gyro(simulate(scenario(with_gyro()), [], period=PERIOD))


def read(**errors: object) -> np.ndarray:
    return gyro(simulate(scenario(with_gyro(**errors)), [], period=PERIOD))


def test_scale_and_bias_come_before_quantisation() -> None:
    wrong = 1.02 * true_rate() - 0.3
    np.testing.assert_allclose(read(scale_error=0.02, bias=-0.3), wrong, rtol=0.0, atol=1e-15)
    rounded = read(scale_error=0.02, bias=-0.3, quantisation=0.01)
    np.testing.assert_allclose(rounded, 0.01 * np.floor(wrong / 0.01 + 0.5), rtol=0.0, atol=1e-15)


def test_a_low_pass_follows_straight_lines_between_samples() -> None:
    omega = 2.0 * np.pi * 60.0
    lowpass = signal.StateSpace(
        [[0.0, 1.0], [-(omega**2), -np.sqrt(2.0) * omega]], [[0.0], [omega**2]], [[1.0, 0.0]], 0.0
    )
    value = true_rate()
    t = PERIOD * np.arange(len(value))
    _, deviation, _ = signal.lsim(lowpass, value - value[0], t, interp=True)  # settled at t = 0
    np.testing.assert_allclose(read(bandwidth_hz=60.0), value[0] + deviation, rtol=0.0, atol=1e-12)


def test_filter_delay_errors_and_hold_act_in_this_order() -> None:
    tracker = {"name": "tracker", "body": "pitch", "axis": [0, 1, 0]}
    # A delay counts in whole periods, rounded up, and starts with the first value.
    slow = {"bandwidth_hz": 40.0, "delay": 0.0034, "scale_error": 0.1, "bias": 0.05, "rate_hz": 200.0}

    def angle(**keys: float) -> np.ndarray:
        return simulate(scenario(sighted(attitude_sensor=[tracker | keys])), [], period=PERIOD).reading[:, -1]

    filtered = angle(bandwidth_hz=40.0)
    seen = 1.1 * np.concatenate([np.full(4, filtered[0]), filtered[:-4]]) + 0.05
    held = seen[5 * (np.arange(len(seen)) // 5)]
    np.testing.assert_allclose(angle(**slow), held, rtol=0.0, atol=1e-15)


def test_a_held_sensor_has_the_noise_density_of_its_own_rate() -> None:
    tracker = {"name": "tracker", "body": "base", "axis": [0, 1, 0], "noise_rms": 1e-3, "noise_bandwidth_hz": 500.0}
    platform = sighted(
        attitude_sensor=[tracker | {"rate_hz": 250.0}], line_of_sight={"body": "base", "direction": [1, 0, 0]}
    )
    still = Scenario(platform=platform, mode="caged", duration=8.0, delay=0.0)
    reading = simulate(still, [], period=PERIOD).reading[:, -1]
    np.testing.assert_array_equal(reading[:-1:4], reading[3::4])
    assert np.std(reading[::4]) == pytest.approx(1e-3 * np.sqrt(0.5 / 4e-3 / 500.0), rel=0.05)


def test_a_batch_gives_mean_and_rms_of_the_settled_samples() -> None:
    platform = sighted()
    runs = [replace(scenario(platform), settle=0.05 * k, rate=RATE * (k + 1)) for k in range(3)]
    batch = simulate_batch(runs, [], period=PERIOD)
    for k, one in enumerate(runs):
        run = simulate(one, [], period=PERIOD)
        rows = slice(50 * k, None)
        assert batch.settled[k] == 201 - 50 * k
        sight = run.line_of_sight[rows]
        np.testing.assert_allclose(batch.line_of_sight_mean[k], sight.mean(axis=0), rtol=1e-12, atol=1e-15)
        np.testing.assert_allclose(batch.line_of_sight_rms[k], sight.std(axis=0), rtol=1e-12, atol=1e-15)
        np.testing.assert_allclose(batch.Omega_rms[k], run.Omega[rows].std(axis=0), rtol=1e-12, atol=1e-15)
        np.testing.assert_array_equal(batch.gimbal_rate[k], np.abs(run.rate).max(axis=0))


def test_what_cannot_be_sampled_is_refused_in_a_sentence() -> None:
    tracker = {"name": "t", "body": "pitch", "axis": [0, 1, 0]}
    odd = sighted(attitude_sensor=[tracker | {"rate_hz": 300.0}])
    with pytest.raises(ArgumentError, match=r"sensor 't': a reading every 3\.33333 ms is not a whole number of sample"):
        simulate(scenario(odd), [], period=PERIOD)
    old = sighted(attitude_sensor=[tracker | {"delay": 2.0}])
    with pytest.raises(ArgumentError, match="sensor 't': a delay of 2 s is 2000 sample periods"):
        simulate(scenario(old), [], period=PERIOD)
    with pytest.raises(ArgumentError, match="settle must be"):
        simulate(replace(scenario(sighted()), settle=-1.0), [], period=PERIOD)
