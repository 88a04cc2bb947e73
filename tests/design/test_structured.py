from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import control
import numpy as np
import pytest

from platform_ctrl import analysis, design

PROBLEMS = json.loads((Path(__file__).parents[1] / "data" / "compleib.json").read_text())["problems"]

# Published problems that take a second each; benchmarks/structured.py goes through all of them.
QUICK = ("AC17", "NN2", "EB1", "PSM", "AC8")


def problem(name: str) -> tuple[control.StateSpace, int, int]:
    p: dict[str, Any] = {key: np.array(item, float) for key, item in PROBLEMS[name].items() if isinstance(item, list)}
    D22 = np.zeros((len(p["C"]), p["B"].shape[1]))
    P = control.ss(
        p["A"],
        np.hstack([p["B1"], p["B"]]),
        np.vstack([p["C1"], p["C"]]),
        np.block([[p["D11"], p["D12"]], [p["D21"], D22]]),
    )
    return P, len(p["C"]), p["B"].shape[1]


def gyro(nutation: float = 1.0) -> control.StateSpace:
    """A symmetric gyro, J = 1: torque disturbance and pick-off noise in, angles and torques out."""
    skew = nutation * np.array([[0.0, 1.0], [-1.0, 0.0]])
    none, one = np.zeros((2, 2)), np.eye(2)
    push, angle = np.vstack([none, one]), np.hstack([one, none])
    return control.ss(
        np.block([[none, one], [none, -skew]]),
        np.hstack([push, np.zeros((4, 2)), push]),
        np.vstack([angle, np.zeros((2, 4)), angle]),
        np.block([[none, none, none], [none, none, one], [none, 0.1 * one, none]]),
        inputs=["d1", "d2", "n1", "n2", "Q1", "Q2"],
        outputs=["a1", "a2", "q1", "q2", "alpha", "beta"],
    )


@pytest.mark.parametrize("name", QUICK)
def test_static_gains_reach_the_published_norms(name: str) -> None:
    P, nmeas, ncon = problem(name)
    found = design.structured(P, nmeas, ncon, structure=design.Static(), starts=4)
    assert found.gamma <= 1.001 * PROBLEMS[name]["best"]
    assert found.gamma == pytest.approx(analysis.hinf_norm(found.closed_loops[0])[0], rel=1e-9)
    assert found.gamma >= (1.0 - 1e-3) * found.gamma_optimal


def test_a_sampled_plant_gets_a_sampled_controller_of_the_same_norm() -> None:
    P = gyro().sample(0.2, method="bilinear")
    sampled, flat = (
        design.structured(one, 2, 2, structure=design.StateSpaceOrder(states=1), starts=2) for one in (P, gyro())
    )
    assert sampled.controller.dt == 0.2
    # Two searches, which end at a kink of both.
    assert sampled.gamma == pytest.approx(flat.gamma, rel=1e-3)


def test_bounds_and_fixed_numbers_are_kept() -> None:
    structure = design.PID(
        I="none",
        filter_order=1,
        fixed={"kp11": -0.5, "kp22": -0.5},
        bounds={"filter1": (1.0, 4.0)},
    )
    found = design.structured(gyro(), 2, 2, structure=structure, starts=1)
    p = found.parameters
    assert p["kp11"] == p["kp22"] == -0.5
    assert 1.0 <= p["filter1"] <= 4.0


def test_an_infimum_at_infinite_gain_is_approached() -> None:
    """|x/w| = 1/(k - 1) beside a direct path of one: less with every larger gain, never below one."""
    P = control.ss([[1.0]], [[1.0, 0.0, 1.0]], [[1.0], [0.0], [1.0]], [[0, 0, 0], [1, 0, 0], [0, 0, 0]])
    found = design.structured(P, 1, 1, structure=design.Static(), starts=2)
    assert 1.0 <= found.gamma < 1.0 + 1e-6
