"""What a user of python-control expects: loops closed by names, names of states that last, values that travel."""

from __future__ import annotations

import copy
import dataclasses
import pickle
from collections.abc import Callable, Iterator
from typing import Any

import control
import numpy as np
import pytest

import platform_ctrl as pc
from platform_ctrl import analysis, design, simulation
from platform_ctrl.analysis.arrays import state_arrays
from platform_ctrl.analysis.poles import is_stable
from platform_ctrl.design.loop import LoopDesign

MODEL = pc.linearise(pc.read_platform("three_gyro_platform"))
PERIOD = 0.0005
RATES = ["Omega1", "Omega2", "Omega3"]
STATES = ["alpha9", "beta10", "p_alpha9", "p_beta10"]
JOB = {
    "schema": 2,
    "name": "one loop",
    "plant": "three_gyro_platform",
    "operation": {"Omega": [0.0, 0.0, 0.0], "seed": 7},
    "sampling": {"rate_hz": 2000, "delay": 0.0005},
    "loop": [
        {
            "name": "caging 9-10",
            "kind": "caging",
            "gimbals": ["9", "10"],
            "use": "classical",
            "limits": {"bandwidth_hz": 20, "disk_margin": 0.3},
            "design": [{"name": "classical", "method": "classical", "crossover_hz": 40, "integral_hz": 2}],
        }
    ],
}


@pytest.fixture(scope="module")
def loop() -> LoopDesign:
    return design.loops(JOB)[0].closed


def test_interconnect_closes_the_loop_of_a_design_by_the_names_of_its_signals(loop: LoopDesign) -> None:
    made = loop
    assert made.plant is not None
    angles = list(made.controller.input_labels)
    assert made.plant.input_labels == [*made.controller.output_labels, *RATES]
    theirs = control.interconnect([made.plant, made.controller], inputs=RATES, outputs=angles)
    ours = analysis.closed_loop(made.plant, made.controller)
    assert is_stable(theirs)
    w = np.geomspace(1.0, 6000.0, 30)
    expected = analysis.frequency_response(ours[angles, RATES], w)
    np.testing.assert_allclose(analysis.frequency_response(theirs, w), expected, rtol=1e-8)


def test_the_rate_of_the_platform_is_held_but_neither_late_nor_lagging(loop: LoopDesign) -> None:
    plant = loop.plant
    assert plant is not None
    angles = list(plant.output_labels)
    # By python-control alone: a zero-order hold before the continuous plant.
    direct = control.sample_system(pc.state_space(MODEL, gimbals=("9", "10")), PERIOD)[angles, RATES]
    t, u = PERIOD * np.arange(60), np.random.default_rng(1).normal(size=(3, 60))
    found = analysis.time_response(analysis.arrays.selected(plant, angles, RATES), t, u)
    np.testing.assert_allclose(found, control.forced_response(direct, t, u).outputs, rtol=0, atol=1e-13)


def test_designs_of_a_job_name_the_states_of_their_plant(loop: LoopDesign) -> None:
    assert loop.plant is not None
    assert loop.plant.state_labels[:4] == STATES
    assert all(name.startswith(("lag_Q", "Q9_held", "Q10_held")) for name in loop.plant.state_labels[4:])


def test_names_of_states_last(loop: LoopDesign) -> None:
    assert loop.plant is not None
    gyro = pc.state_space(MODEL, gimbals=("9", "10"))
    assert gyro.state_labels == STATES
    part = analysis.arrays.selected(gyro, ["beta10"], ["Q9"])
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


def arrays_of(item: Any) -> Iterator[tuple[np.ndarray, bool]]:
    """Walk through the arrays of a value and its state spaces, and whether they are the value's own."""
    if isinstance(item, np.ndarray):
        yield item, True
    elif isinstance(item, control.StateSpace):
        yield from ((getattr(item, name), False) for name in "ABCD")
    elif dataclasses.is_dataclass(item):
        for field in dataclasses.fields(item):
            yield from arrays_of(getattr(item, field.name))
    elif isinstance(item, tuple | list):
        for one in item:
            yield from arrays_of(one)
    elif isinstance(item, dict):
        for one in item.values():
            yield from arrays_of(one)


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


def test_values_come_back_from_pickle_and_deepcopy_with_read_only_arrays(result: Any) -> None:
    for again in (pickle.loads(pickle.dumps(result)), copy.deepcopy(result)):
        given, found = list(arrays_of(result)), list(arrays_of(again))
        assert len(given) == len(found)
        for (before, _), (after, own) in zip(given, found, strict=True):
            np.testing.assert_array_equal(after, before)
            assert not (own and after.flags.writeable)
            assert after is not before or not before.size


def test_the_repr_of_a_value_is_a_summary(result: Any) -> None:
    lines = repr(result).splitlines()
    assert len(lines) <= 20
    assert max(map(len, lines)) <= 120
    assert lines[0].startswith(type(result).__name__)
    assert "[[" not in repr(result)
    table = result._repr_html_()
    assert table.startswith("<table>")
    assert table.count("<tr>") <= 20


def test_a_state_space_comes_back_with_its_names_and_computes_with_its_own_matrices() -> None:
    gyro = analysis.sampled(pc.state_space(MODEL, gimbals=("9", "10")), PERIOD)
    for again in (pickle.loads(pickle.dumps(gyro)), copy.deepcopy(gyro), copy.copy(gyro)):
        assert type(again) is control.StateSpace
        for name in ("input_labels", "output_labels", "state_labels", "dt", "name"):
            assert getattr(again, name) == getattr(gyro, name)
        x, u = np.arange(4.0), np.arange(5.0)
        before = gyro.dynamics(0.0, x, u)
        np.testing.assert_array_equal(again.dynamics(0.0, x, u), before)
        again.A = 2.0 * again.A
        np.testing.assert_array_equal(gyro.dynamics(0.0, x, u), before)
        assert not np.array_equal(again.dynamics(0.0, x, u), before)


def test_systems_of_other_shapes_travel_too() -> None:
    for system in (
        control.ss([], [], [], [[1.0, 2.0]]),
        control.ss(np.zeros((2, 2)), np.zeros((2, 0)), np.eye(2), np.zeros((2, 0))),
    ):
        state_arrays(system, "test")
        again = pickle.loads(pickle.dumps(system))
        assert again.D.shape == system.D.shape
        assert (again.nstates, again.ninputs, again.noutputs) == (system.nstates, system.ninputs, system.noutputs)


def test_squeeze_follows_the_configuration_of_python_control(monkeypatch: pytest.MonkeyPatch) -> None:
    system, t = control.ss([[-1.0]], [[1.0]], [[1.0]], [[0.0]]), np.linspace(0.0, 1.0, 5)
    assert analysis.time_response(system, t, np.ones(5)).shape == (5,)
    monkeypatch.setitem(control.config.defaults, "control.squeeze_time_response", False)
    assert analysis.time_response(system, t, np.ones(5)).shape == (1, 5)
    assert control.forced_response(system, t, np.ones(5)).outputs.shape == (1, 5)
