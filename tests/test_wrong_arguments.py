"""Public calls with a wrong argument: refused in one sentence that says what was given and what was expected."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import control
import numpy as np
import pytest

import platform_ctrl as pc
from platform_ctrl import analysis, design, export, simulation

PLATFORM = pc.read_platform("three_gyro_platform")
MODEL = pc.linearise(PLATFORM)
SYS = pc.state_space(MODEL, gimbals=("9", "10"))[["alpha9", "beta10"], ["Q9", "Q10"]]
P = control.ss(-np.eye(2), np.ones((2, 3)), np.ones((3, 2)), np.zeros((3, 3)))
Q, V = np.zeros((4, 5)), np.zeros((4, 8))
STILL = simulation.Scenario(platform=PLATFORM, mode="caged", duration=0.0, delay=0.0)

WRONG: dict[str, tuple[Callable[[], Any], str]] = {
    "a model that is not shipped": (lambda: pc.read_platform("three_gyros"), "three_gyro"),
    "too few angles": (lambda: pc.matrices(PLATFORM, [0.0, 0.0]), "5"),
    "an angle that is no number": (lambda: pc.matrices(PLATFORM, [np.nan] * 5), "finite"),
    "too many rates": (lambda: pc.matrices(PLATFORM, [0.0] * 5, [0.0] * 9), "8"),
    "accelerations of another shape": (lambda: pc.inverse_dynamics(PLATFORM, [0.0] * 5, [0.0] * 8, [0.0]), "8"),
    "torques that are infinite": (lambda: pc.forward_dynamics(PLATFORM, [0.0] * 5, [0.0] * 8, [np.inf] * 8), "finite"),
    "two platform rates": (lambda: pc.linearise(PLATFORM, Omega=(0.0, 0.0)), "3"),
    "terms of nobody": (lambda: pc.linearise(PLATFORM, terms="papers"), "paper"),
    "a gimbal that is not there": (lambda: pc.state_space(MODEL, gimbals=("9", "11")), "11"),
    "a root that is neither": (lambda: pc.state_space(MODEL, root="loose"), "loose"),
    "a form of equations": (lambda: pc.equations(PLATFORM, form="word"), "word"),
    "no plant for a synthesis": (lambda: design.hinf([1, 2], 1, 1), "control.StateSpace"),
    "more measurements than outputs": (lambda: design.hinf(P, 4, 1), "nmeas"),
    "controls that are none": (lambda: design.h2(P, 1, 0), "ncon"),
    "a job that is a number": (lambda: design.loops(3), "job"),
    "a frequency below zero": (lambda: analysis.frequency_response(SYS, [-1.0]), "frequency"),
    "a response of no system": (lambda: analysis.frequency_response("SYS", [1.0]), "StateSpace"),
    "a norm of a list": (lambda: analysis.hinf_norm([[1.0]]), "control.StateSpace"),
    "a margin of a loop that is not square": (lambda: analysis.disk_margin(P[[0, 1], [0]]), "disk_margin"),
    "a skew beyond its range": (lambda: analysis.disk_margin(SYS, skew=np.nan), "skew"),
    "inputs of another length": (lambda: analysis.time_response(SYS, np.arange(3.0), np.ones((2, 4))), "time_response"),
    "times that do not increase": (lambda: analysis.time_response(SYS, [0.0, 3.0, 1.0], np.ones((2, 3))), "increase"),
    "gimbals of a free root": (lambda: pc.state_space(MODEL, root="free", gimbals=("9", "10")), "leave it out"),
    "a gimbal apart from the one it is coupled to": (lambda: pc.state_space(MODEL, gimbals=("9",)), "coupled"),
    "a period of zero": (lambda: simulation.simulate(STILL, [], period=0.0), "period"),
    "a scenario that is none": (lambda: simulation.simulate(3, [], period=1e-3), "Scenario"),
    "a time step below zero": (lambda: simulation.rollout(PLATFORM, Q, V, step=-1e-3, steps=1), "step"),
    "half a step": (lambda: simulation.rollout(PLATFORM, Q, V, step=1e-3, steps=0.5), "steps"),
    "runs of different numbers": (lambda: simulation.rollout(PLATFORM, Q[:2], V, step=1e-3, steps=1), "velocity"),
    "systems that are none": (lambda: export.write_systems(3, "systems.json"), "systems must be"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_argument_is_refused_in_a_sentence(name: str) -> None:
    call, said = WRONG[name]
    with pytest.raises(pc.PlatformCtrlError) as error:
        call()
    assert "\n" not in str(error.value)
    assert said in str(error.value)
