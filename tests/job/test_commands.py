"""Commands of a run are read, written and judged."""

from __future__ import annotations

import numpy as np

from commanded_gimbal import commanded_job
from platform_ctrl import read_job
from platform_ctrl.design import loops
from platform_ctrl.job.reading import job_data
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
