"""The main job with three controllers, and a recorded run of it."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import pytest

from generated_c import classical_entry, designed_entry, pid_entry, state_space
from platform_ctrl import read_job, simulation

EXAMPLE = Path(__file__).parents[2] / "examples" / "three_gyro_platform.toml"


@pytest.fixture(scope="session")
def job() -> Any:
    return read_job(EXAMPLE)


@pytest.fixture(scope="session")
def entries(job: Any) -> list[dict[str, Any]]:
    """A classical loop, a matrix PID and the platform servo, whose inputs are commands of both."""
    return [classical_entry(job, ("4", "5", "7")), pid_entry(job, ("9", "10")), designed_entry(job, 2)]


@pytest.fixture(scope="session")
def recorded(job: Any, entries: list[dict[str, Any]]) -> Any:
    """A run with all three, below all limits."""
    scenario = dataclasses.replace(job.scenario(job.manoeuvres[3]), duration=0.3)
    run = simulation.simulate(scenario, [state_space(one) for one in entries], period=job.sampling.period)
    assert run.completed
    assert run.saturated.sum() == 0
    return run
