"""What a user of python-control expects: loops closed by names, names of states that last, values that travel."""

from __future__ import annotations

import copy
import dataclasses
import pickle
import tomllib
from collections.abc import Callable
from typing import Any

import control
import numpy as np
import pytest

import one_gyro_job
import platform_ctrl as pc
from platform_ctrl import analysis, design, simulation

MODEL = pc.linearise(pc.read_platform("three_gyro_platform"))
PERIOD = 0.0005
RATES = ["Omega1", "Omega2", "Omega3"]
STATES = ["alpha9", "beta10", "p_alpha9", "p_beta10"]
JOB = tomllib.loads(one_gyro_job.JOB)


@pytest.fixture(scope="module")
def loop() -> Any:
    return design.loops(JOB)[0].closed


def test_interconnect_closes_the_loop_of_a_design_by_the_names_of_its_signals(loop: Any) -> None:
    made = loop
    assert made.plant is not None
    angles = list(made.controller.input_labels)
    assert made.plant.input_labels == [*made.controller.output_labels, *RATES]
    theirs = control.interconnect([made.plant, made.controller], inputs=RATES, outputs=angles)
    ours = analysis.closed_loop(made.plant, made.controller)
    assert analysis.damping(theirs).ratio.min() > 0.0
    w = np.geomspace(1.0, 6000.0, 30)
    expected = analysis.frequency_response(ours[angles, RATES], w)
    np.testing.assert_allclose(analysis.frequency_response(theirs, w), expected, rtol=1e-8)


def test_names_of_states_last(loop: Any) -> None:
    assert loop.plant is not None
    gyro = pc.state_space(MODEL, gimbals=("9", "10"))
    assert gyro.state_labels == STATES
    i, j = [gyro.output_labels.index("beta10")], [gyro.input_labels.index("Q9")]
    part = control.ss(
        gyro.A, gyro.B[:, j], gyro.C[i], gyro.D[i][:, j], inputs=["Q9"], outputs=["beta10"], states=gyro.state_labels
    )
    assert part.state_labels == STATES
    for made in (part, gyro, loop.plant):
        assert made.state_labels[:4] == STATES
    sampled = analysis.sampled(part, PERIOD, delay=PERIOD, lag=0.001)
    assert sampled.state_labels == [*STATES, "lag_Q9", "Q9_held1"]
    plant, controller = loop.plant, loop.controller
    own, its = list(plant.state_labels), [f"controller_{name}" for name in controller.state_labels]
    assert analysis.closed_loop(plant, controller).state_labels == own + its
    assert analysis.loop_transfer(plant, controller, at="input").state_labels == own + its
    assert analysis.loop_transfer(plant, controller, at="output").state_labels == its + own


RESULTS: dict[str, Callable[[], Any]] = {
    "platform": lambda: MODEL.platform,
    "model": lambda: MODEL,
    "job": lambda: pc.read_job(JOB),
    "matrices": lambda: pc.matrices(MODEL.platform, np.zeros(5)),
    "terms": lambda: pc.terms(MODEL.platform, Omega=(1, 1, 1), rates=[0.01] * 5),
    "precession": lambda: pc.precession(MODEL, gimbals=("9", "10")),
    "rollout": lambda: simulation.rollout(MODEL.platform, [[0.01] * 5], [[0.02] * 8], step=1e-4, steps=2),
    "outcome": lambda: design.loops(JOB)[0],
}


@pytest.fixture(scope="module", params=RESULTS)
def result(request: pytest.FixtureRequest) -> Any:
    return RESULTS[request.param]()


def test_a_value_comes_back_from_pickle_and_deepcopy_with_read_only_arrays(result: Any) -> None:
    for again in (pickle.loads(pickle.dumps(result)), copy.deepcopy(result)):
        for field in dataclasses.fields(result):
            before, after = getattr(result, field.name), getattr(again, field.name)
            if isinstance(before, np.ndarray):
                np.testing.assert_array_equal(after, before)
                assert not after.flags.writeable
