"""The method "lmi" of jobs: limits on a plant written by hand from (27), bounds, and what it says of failures."""

import copy
import functools
import tomllib
from pathlib import Path
from typing import Any

import control
import numpy as np
import pytest

from platform_ctrl import design
from platform_ctrl.errors import ArgumentError, InfeasibleError

EXAMPLES = Path(__file__).parents[2] / "examples"
JOB = tomllib.loads((EXAMPLES / "three_gyro_platform.toml").read_text())
# Of the shipped plant: lag of the torquers and delay, s, and rms of the pick-offs' noise, rad.
LAG, DELAY, PERIOD, NOISE = 2e-4, 5e-4, 5e-4, 5e-6
LOOPS = {"caging 4-5-7": ("4", "5", "7"), "caging 9-10": ("9", "10")}


def job_of(loop: str, **changes: dict[str, float]) -> dict[str, object]:
    """The shipped job with the LMI design of one loop alone; `limits` and `options` are changed."""
    job = {key: copy.deepcopy(JOB[key]) for key in ("schema", "name", "plant", "operation", "uncertainty", "sampling")}
    spec = copy.deepcopy(next(one for one in JOB["loop"] if one["name"] == loop))
    spec["design"] = [one | changes.get("options", {}) for one in spec["design"] if one["name"] == "LMI"]
    spec["limits"] |= changes.get("limits", {})
    return job | {"loop": [spec | {"use": "LMI"}]}


@functools.cache
def designed(name: str) -> Any:
    return design.loops(job_of(name))[0]


@pytest.mark.parametrize("name", LOOPS)
def test_the_claims_are_the_performance_and_the_plants_that_share_one_lyapunov_matrix(name):
    made = designed(name)
    claims = made.closed.claims
    backoff, slack = made.closed.options["backoff"], 0.03
    assert claims["gamma_optimal"] <= claims["gamma"] <= (1 + backoff) * (1 + slack) * claims["gamma_optimal"] * 1.001
    assert claims["plants"] == len(made.closed.plants.labels)
    expected = {"caging 9-10": 17, "caging 4-5-7": 41}
    assert claims["plants with one Lyapunov matrix"] == expected[made.spec.name]


def test_a_limit_out_of_reach_is_said_with_the_tightest_inequality():
    with pytest.raises(
        InfeasibleError, match=r"9-10, LMI: none found: .* times their bounds at best; the tightest is"
    ) as caught:
        design.loops(job_of("caging 9-10", limits={"disk_margin": 1.9}))
    assert "\n" not in str(caught.value)


def test_the_tuner_brings_weights_that_miss_a_limit_within_it():
    slow = job_of("caging 9-10", options={"bandwidth_hz": 68.0, "tune": True})
    assert all(result.passed for result in design.loops(slow)[0].closed.results)


def test_python_control_designs_on_the_generalised_plant_and_the_loop_judges():
    name = "caging 9-10"
    loop = designed(name)
    k = len(LOOPS[name])
    P = design.generalised_plant(loop, torque=0.06)
    assert P.input_labels == [f"{kind}{j + 1}" for kind in ("n", "d", "u") for j in range(k)]
    assert P.output_labels[-k:] == [f"measured{j + 1}" for j in range(k)]
    bound = design.hinf(P, k, k, method="riccati")
    # With 15 states, 6 w and 9 z slycot says "too small value of gamma" whatever it is.
    B, D = (np.insert(matrix, 2 * k, 0.0, axis=1) for matrix in (P.B, P.D))
    assert control.hinfsyn(control.ss(P.A, B, P.C, D), k, k)[2] == pytest.approx(bound.gamma_optimal, rel=0.01)
    closed = design.with_controller(loop, bound.controller, name="mine", torque=0.06)
    assert closed.use == "mine"
    assert closed.closed.measures.decay[0] > 0.0
    assert {one.name for one in closed.designs} == {"LMI", "mine"}
    # The generalised plant closed by K has the poles of the sampled loop, by the bilinear map.
    w = P.lft(bound.controller).poles()
    A, B, C = (closed.closed.plant.A, closed.closed.plant.B[:, :k], closed.closed.plant.C[:k])
    K = closed.closed.controller
    z = np.linalg.eigvals(np.block([[A + B @ K.D @ C, B @ K.C], [K.B @ C, K.A]]))
    mapped = (1 + w * PERIOD / 2) / (1 - w * PERIOD / 2)
    for pole in z[np.abs(z) > 0.3]:
        assert np.abs(mapped - pole).min() < 1e-5
    # The same controller, sampled, by its signals.
    again = design.with_controller(loop, K, name="again")
    np.testing.assert_allclose(again.closed.measures.disk_margin, closed.closed.measures.disk_margin, rtol=1e-9)


def test_a_controller_or_a_weight_that_does_not_fit_is_refused():
    loop = designed("caging 9-10")
    with pytest.raises(ArgumentError, match="must have 2 inputs and 2 outputs, as the generalised plant has"):
        design.with_controller(loop, control.ss([], [], [], np.eye(3)))
    with pytest.raises(ArgumentError, match=r"generalised_plant: option 'bandwidth' has no meaning .* did you mean"):
        design.generalised_plant(loop, bandwidth=30.0)
