"""Commands of a run: on a plant that is linear the response is that of linear system theory."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.signal import dlsim

from commanded_gimbal import INERTIA, RATE_HZ, commanded_job
from platform_ctrl import read_job
from platform_ctrl.design import loops
from platform_ctrl.errors import ArgumentError
from platform_ctrl.simulation import simulate, simulate_batch

PERIOD = 1.0 / RATE_HZ
COMMANDS: list[dict[str, Any]] = [
    {"reading": "gyro", "step": 0.2, "ramp": -0.1, "at": 0.1},
    {"reading": "gyro", "amplitude": 0.05, "frequency_hz": 7.0, "phase": 0.3},
    {"reading": "gyro", "t": [0.2, 0.3, 0.7], "value": [0.0, 0.3, 0.1], "smooth": True},
]


def controllers(job: Any) -> list[Any]:
    return [one.closed.controller for one in loops(job)]


def expected(t: np.ndarray) -> np.ndarray:
    begun = t >= 0.1 - 1e-12
    spline = CubicSpline([0.2, 0.3, 0.7], [0.0, 0.3, 0.1], bc_type="natural")
    out = np.where(begun, 0.2 - 0.1 * (t - 0.1), 0.0) + 0.05 * np.sin(14.0 * np.pi * t + 0.3)
    return np.asarray(out + spline(np.clip(t, 0.2, 0.7)))


def test_a_rate_loop_follows_its_command_as_linear_theory_says() -> None:
    job = read_job(commanded_job(COMMANDS))
    (K,) = controllers(job)
    run = simulate(job.scenario(job.manoeuvres[0]), [K], period=PERIOD, noise=False)
    command = expected(run.t)
    np.testing.assert_allclose(run.reading_command[:, 0], command, rtol=0.0, atol=1e-12)
    assert K.input_labels == ["gyro", "gyro_command"]
    # The rate grows by T/J times the torque held over a sample; u = K (rate - command).
    A = np.block([[np.ones((1, 1)) + PERIOD / INERTIA * K.D[:, :1], PERIOD / INERTIA * K.C], [K.B[:, :1], K.A]])
    B = np.concatenate([-PERIOD / INERTIA * K.D[:, 0], -K.B[:, 0]])[:, None]
    _, rate, _ = dlsim((A, B, np.eye(1, len(A)), np.zeros((1, 1)), PERIOD), command)
    np.testing.assert_allclose(run.rate[:, 0], rate[:, 0], rtol=0.0, atol=1e-6 * np.abs(rate).max())


def test_many_runs_are_those_of_one() -> None:
    job = read_job(commanded_job(COMMANDS))
    closed, scenario = controllers(job), job.scenario(job.manoeuvres[0])
    scenario = dataclasses.replace(scenario, settle=0.5)
    alone = simulate(scenario, closed, period=PERIOD)
    still = dataclasses.replace(scenario, commands=())
    both = simulate_batch([still, scenario], closed, period=PERIOD)
    error = np.abs(alone.reading[:, 1] - alone.reading_command[:, 0])[alone.t >= 0.5 - 1e-9].max()
    assert both.rate_following_error[1].max() == error
    assert both.rate_following_error[0].max() == both.angle_following_error.max() == 0.0


def test_commands_need_a_controller_that_takes_them() -> None:
    job = read_job(commanded_job(COMMANDS))
    scenario = job.scenario(job.manoeuvres[0])
    (K,) = controllers(read_job(commanded_job([]) | {"manoeuvre": []}))
    with pytest.raises(ArgumentError, match="no controller takes a command of 'gyro'"):
        simulate(scenario, [K], period=PERIOD)


@pytest.mark.parametrize(
    "fault",
    [
        {"kind": "pick-off drift", "rate": 0.5},
        {"kind": "pick-off stuck"},
        {"kind": "pick-off dropout", "probability": 0.9},
        {"kind": "pick-off dead", "until": 0.8},
    ],
    ids=lambda fault: fault["kind"],
)
@pytest.mark.parametrize("resolved", [False, True])
def test_what_fails_of_a_sensor_is_no_part_of_what_follows_a_command(fault: dict[str, Any], resolved: bool) -> None:
    """The loop follows what the sensor says; the error is that of the gimbal."""
    reading = "q_yaw_resolved_rate" if resolved else "gyro"
    data = commanded_job([{"reading": reading, "amplitude": 0.05, "frequency_hz": 7.0}])
    data["loop"][0] |= {"resolve": True} if resolved else {}
    data["fault"] = [{"name": "fails", "part": "gyro", "at": 0.5} | fault]
    data["manoeuvre"][0] |= {"faults": ["fails"]}
    job = read_job(data)
    scenario = dataclasses.replace(job.scenario(job.manoeuvres[0]), settle=0.6)
    run = simulate(scenario, controllers(job), period=PERIOD, noise=False)
    settled = run.t >= 0.6 - 1e-9
    said = run.reading[:, run.pickoff_names.index(reading)]
    error, seen = (np.abs(rate - run.reading_command[:, 0])[settled].max() for rate in (run.rate[:, 0], said))
    assert run.following_error == pytest.approx([error], rel=1e-9)
    assert seen != pytest.approx(error, rel=1e-3)
