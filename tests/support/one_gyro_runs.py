"""The gyro 9-10 with manoeuvres and simple controllers: runs that others are held against."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from typing import Any

import control

from one_gyro_job import JOB
from platform_ctrl.job.job import Job, manoeuvre_scenario
from platform_ctrl.job.reading import read_job
from platform_ctrl.simulation import simulate
from platform_ctrl.simulation.closed_loop import Trajectory

MANOEUVRES = """
[[manoeuvre]]
name = "turn"
mode = "caged"
axis = 1
rate = 1.0
rise = 0.02
hold = 0.01
duration = 0.06
initial = { alpha9 = 0.0001 }
limits = {}

[[manoeuvre]]
name = "it's a step"
mode = "stabilised"
axis = 2
torque = 0.1
duration = 0.03
initial = { Omega3 = 0.01 }
limits = {}
"""


def by_numbers(names: list[tuple[str, str]], period: float) -> list[control.StateSpace]:
    """Lags with a gain, a controller for each pair of reading and torquer."""
    return [
        control.ss([[0.9]], [[0.1]], [[-40.0]], [[-60.0 - k]], period, inputs=[y], outputs=[u], name=f"{y} to {u}")
        for k, (y, u) in enumerate(names)
    ]


def one_gyro() -> tuple[Job, list[control.StateSpace]]:
    """The job with its manoeuvres, and a controller that acts across the gyro's axes."""
    job = read_job(tomllib.loads(JOB + MANOEUVRES))
    return job, by_numbers([("alpha9", "Q10"), ("beta10", "Q9")], job.sampling.period)


def flown(job: Job, controllers: list[control.StateSpace], name: str, **more: Any) -> Trajectory:
    """The whole run of a manoeuvre of the job."""
    [one] = [manoeuvre for manoeuvre in job.manoeuvres if manoeuvre.name == name]
    scenario = replace(manoeuvre_scenario(job, one), **more)
    return simulate(scenario, controllers, period=job.sampling.period)
