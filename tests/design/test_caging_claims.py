"""What caging designs claim besides their margins: the Omega that they hold."""

from __future__ import annotations

import copy
import tomllib
from typing import Any

import control
import pytest

from given_controllers import outcomes
from platform_ctrl import platform_source, read_job
from platform_ctrl.design import loops
from report_jobs import caging, classical, job

DATA: dict[str, Any] = job(
    operation={"Omega": [0.0, 0.0, 0.0]},
    uncertainty={"spin": 0.1},
    loop=[caging(classical("other", 30), classical("closed", 40), limits={"bandwidth_hz": 20})],
)


NOMINAL, WORST = "largest Omega{} without saturation, rad/s", "largest Omega{} without saturation, worst case, rad/s"


@pytest.fixture(scope="module")
def outcome() -> Any:
    return loops(DATA)[0]


def test_the_closed_design_alone_claims_the_rates_at_which_a_torquer_holds_a_gyro_at_its_limit(outcome: Any) -> None:
    (other,) = outcome.alternatives
    assert other.claims == {}
    # A caged gyro needs L Omega about each of its gimbals: 0.15 N m s against 0.25 N m, with 10 % more spin for less.
    expected = {NOMINAL.format(axis): 0.25 / 0.15 for axis in (1, 3)}
    expected |= {WORST.format(axis): 0.25 / (1.1 * 0.15) for axis in (1, 3)}
    assert outcome.closed.claims == pytest.approx(expected, rel=1e-9)


def test_controllers_that_are_given_claim_the_same(outcome: Any) -> None:
    again = outcomes(read_job(DATA), [outcome.closed.controller], [outcome.alternatives[0].controller])[0]
    assert again.closed.claims == pytest.approx(outcome.closed.claims, rel=1e-9)
    assert again.alternatives[0].claims == pytest.approx(outcome.alternatives[0].claims, rel=1e-9)


def changed(spin: float, limited: bool = True) -> Any:
    data = copy.deepcopy(DATA)
    data["plant"], data["uncertainty"] = tomllib.loads(platform_source("three_gyro_platform")), {"spin": spin}
    for torquer in data["plant"]["torquer"] if not limited else ():
        torquer.pop("limit")
    return read_job(data)


def test_a_torquer_without_limit_and_a_loop_that_is_not_stable_claim_nothing(outcome: Any) -> None:
    K = outcome.closed.controller
    assert outcomes(changed(0.1, limited=False), [K])[0].closed.claims == {}
    strong = control.ss(K.A, K.B, 4 * K.C, 4 * K.D, K.dt, inputs=K.input_labels, outputs=K.output_labels)
    [unstable] = outcomes(read_job(DATA), [strong])
    assert unstable.closed.measures.decay[0] < 0.0
    assert unstable.closed.claims == {}


def test_where_one_uncertain_plant_is_not_stable_the_nominal_claim_stays(outcome: Any) -> None:
    [one] = outcomes(changed(0.9), [outcome.closed.controller])
    assert one.closed.measures.decay[0] > 0.0 > one.closed.measures.decay.min()
    assert one.closed.claims[NOMINAL.format(1)] == pytest.approx(outcome.closed.claims[NOMINAL.format(1)])
    assert WORST.format(1) not in one.closed.claims
