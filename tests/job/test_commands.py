"""Commands of a run are read, written and judged."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from commanded_gimbal import commanded_job
from platform_ctrl import read_job
from platform_ctrl.design import loops
from platform_ctrl.errors import InputError
from platform_ctrl.job.writing import job_data
from platform_ctrl.verification.simulated import simulate_manoeuvre

GYRO = {"reading": "gyro", "step": 0.1}


def test_a_job_is_written_with_its_commands() -> None:
    commands = [GYRO | {"at": 0.5}, {"reading": "gyro", "t": [0.0, 0.5], "value": [0.0, 0.1], "smooth": True}]
    job = read_job(commanded_job(commands))
    assert job_data(job)["manoeuvre"][0]["command"] == [
        commands[0],
        commands[1],
    ]
    assert job.commanded == {"gyro"}


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ({"reading": "giro", "step": 1.0}, "is no sensor of the plant; did you mean"),
        ({"reading": "heading", "step": 1.0}, "read by no rate, pointing or tracking loop"),
        ({"reading": "yaw", "step": 1.0}, "yaw"),
        ({"reading": "gyro", "at": 0.5}, 'the key "step" is missing; a command needs step, ramp, amplitude'),
        ({"reading": "gyro", "step": 0.0}, "step must be a number other than 0"),
        (GYRO | {"at": 1.0}, "at must be before the end of the run, 1 s"),
        (GYRO | {"phase": 0.5}, "phase = 0.5 has no effect without amplitude"),
        (GYRO | {"smooth": True}, "smooth = true has no effect without value"),
        ({"reading": "gyro", "amplitude": 0.1}, 'the key "frequency_hz" is missing; amplitude has no effect'),
        ({"reading": "gyro", "amplitude": 0.1, "frequency_hz": 500.0}, "below half the sample rate, 500 Hz"),
        ({"reading": "gyro", "t": [0.0, 0.0], "value": [0.0, 0.1]}, "t must be two or more times that increase"),
        ({"reading": "gyro", "t": [0.0, 0.5], "value": [0.1]}, "value must have as many elements as t, 2, got 1"),
        ({"reading": "gyro", "value": [0.1, 0.2]}, 'the key "t" is missing'),
        ({"reading": "gyro", "step": 1000.0}, "step: 1000 rad/s cannot be meant"),
    ],
)
def test_a_command_that_makes_no_sense_is_refused_by_one_line(command: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError) as found:
        read_job(commanded_job([command]))
    assert words in str(found.value)
    assert "manoeuvre" in str(found.value)


def test_an_angle_in_degrees_is_noticed() -> None:
    with pytest.raises(InputError, match=r"step: 30 rad cannot be meant, at most 0.5 rad; .* are in rad, which"):
        read_job(commanded_job([{"reading": "heading", "step": 30.0}], kind="pointing"))


def test_a_limit_on_what_is_not_commanded_is_refused() -> None:
    with pytest.raises(
        InputError, match=r"angle_following_error has no effect: no .*command.* is of a reading in rad;"
    ):
        read_job(commanded_job([GYRO], limits={"angle_following_error": 0.1}))


def test_the_verdict_judges_how_a_command_is_followed() -> None:
    commands = [{"reading": "heading", "t": [0.1, 0.6], "value": [0.0, 0.3], "smooth": True}]
    job = commanded_job(commands, kind="pointing", limits={"angle_following_error": 1e-3})
    job["manoeuvre"][0]["settle"] = 0.8
    read = read_job(job)
    run = simulate_manoeuvre(read, read.manoeuvres[0], [one.closed.controller for one in loops(read)])
    (result,) = run.results
    assert result.passed
    behind = run.trajectory.reading[:, 2] - run.trajectory.reading_command[:, 0]
    assert result.value == abs(behind[run.trajectory.t >= 0.8 - 1e-9]).max()
    # An attitude sensor reads the sine of the angle.
    assert abs(np.sin(run.trajectory.q[-1, 0]) - 0.3) < 1e-3
