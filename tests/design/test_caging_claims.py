"""What caging designs claim besides their margins: the Omega that they hold."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from platform_ctrl.design import loops
from platform_ctrl.design.loop import LoopOutcome, largest_Omega_name, with_largest_rates
from platform_ctrl.design.methods import read_job
from platform_ctrl.job.job import Job
from platform_ctrl.verification.controllers import outcomes_from

DATA: dict[str, Any] = {
    "schema": 2,
    "name": "one gyro",
    "plant": "three_gyro_platform",
    "operation": {"Omega": [0.0, 0.0, 0.0]},
    "uncertainty": {"spin": 0.1},
    "sampling": {"rate_hz": 2000, "delay": 0.0005},
    "loop": [
        {
            "name": "caging 9-10",
            "kind": "caging",
            "gimbals": ["9", "10"],
            "use": "closed",
            "limits": {"bandwidth_hz": 20},
            "design": [
                {"name": "other", "method": "classical", "crossover_hz": 30, "integral_hz": 2},
                {"name": "closed", "method": "classical", "crossover_hz": 40, "integral_hz": 2},
            ],
        }
    ],
}


@pytest.fixture(scope="module")
def job() -> Job:
    return read_job(DATA)


@pytest.fixture(scope="module")
def outcome(job: Job) -> LoopOutcome:
    return loops(job)[0]


def test_the_closed_design_alone_claims_the_rates_at_which_a_torquer_holds_a_gyro_at_its_limit(
    outcome: LoopOutcome,
) -> None:
    (other,) = outcome.alternatives
    assert other.claims == {}
    # A caged gyro needs L Omega about each of its gimbals: 0.15 N m s against 0.25 N m, with 10 % more spin for less.
    expected = {}
    for axis in (1, 3):
        expected[largest_Omega_name(axis)] = 0.25 / 0.15
        expected[largest_Omega_name(axis, worst_case=True)] = 0.25 / (1.1 * 0.15)
    assert outcome.closed.claims == pytest.approx(expected, rel=1e-9)


def test_controllers_that_are_given_claim_the_same(job: Job, outcome: LoopOutcome) -> None:
    again = outcomes_from(job, [outcome.closed.controller], [outcome.alternatives[0].controller])[0]
    assert again.closed.claims == pytest.approx(outcome.closed.claims, rel=1e-9)
    assert again.alternatives[0].claims == pytest.approx(outcome.alternatives[0].claims, rel=1e-9)


def test_a_torquer_without_limit_and_a_loop_that_is_not_stable_claim_nothing(outcome: LoopOutcome) -> None:
    closed = dataclasses.replace(outcome.closed, claims={})
    assert closed.plants is not None
    assert closed.measures is not None
    free = dataclasses.replace(closed.plants, torque_limit=np.full(2, np.inf))
    assert with_largest_rates(dataclasses.replace(closed, plants=free)).claims == {}
    decay = -closed.measures.decay
    unstable = dataclasses.replace(closed, measures=dataclasses.replace(closed.measures, decay=decay))
    assert with_largest_rates(unstable).claims == {}


def test_where_one_uncertain_plant_is_not_stable_the_nominal_claim_stays(outcome: LoopOutcome) -> None:
    measures = outcome.closed.measures
    assert measures is not None
    decay = np.where(np.arange(len(measures.decay)) == 1, -1.0, measures.decay)
    one = dataclasses.replace(outcome.closed, claims={}, measures=dataclasses.replace(measures, decay=decay))
    claims = with_largest_rates(one).claims
    assert claims[largest_Omega_name(1)] == outcome.closed.claims[largest_Omega_name(1)]
    assert largest_Omega_name(1, worst_case=True) not in claims
