from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import control
import numpy as np
import pytest

from platform_ctrl import analysis, design
from platform_ctrl.design.fixed_structure.norm import AugmentedLoop, WorstNorm, augmented
from platform_ctrl.design.fixed_structure.structures import Parametrised, Structure, Units
from platform_ctrl.design.partition import Partition
from platform_ctrl.design.synthesis import Synthesis

PROBLEMS = json.loads((Path(__file__).parents[1] / "data" / "compleib.json").read_text())["problems"]

# Published problems that take a second each; benchmarks/structured.py goes through all of them.
QUICK = ("AC17", "NN2", "EB1", "PSM", "AC8")

STRUCTURES: dict[str, Structure] = {
    "static": design.Static(),
    "static, diagonal": design.Static(pattern="diagonal"),
    "second order": design.StateSpaceOrder(states=2),
    "PID": design.PID(),
    "PID, cross-axis": design.PID(P="cross", I="cross", D="diagonal", filter_order=1),
    "PID, filtered derivative": design.PID(filtered="derivative"),
    "PI without filter": design.PID(D="none", filter_order=0),
    "PI and an observer": design.Series(
        blocks=(
            design.PID(D="none", P="diagonal", I="diagonal", filter_order=0, fixed={"kp11": 1.0}),
            design.StateSpaceOrder(states=1),
        )
    ),
}


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


def random_plant(rng: np.random.Generator, n: int = 5) -> Partition:
    def draw(*shape: int) -> np.ndarray[Any, Any]:
        return rng.standard_normal(shape)

    return Partition(
        A=draw(n, n) - 3.0 * np.eye(n), B1=draw(n, 2), B2=draw(n, 2), C1=draw(3, n), C2=draw(2, n),
        D11=0.1 * draw(3, 2), D12=0.1 * draw(3, 2), D21=0.1 * draw(2, 2), D22=0.1 * draw(2, 2),
    )  # fmt: skip


@pytest.fixture(scope="module")
def best() -> Synthesis:
    return design.hinf(gyro(), 2, 2, method="riccati")


@pytest.mark.parametrize("name", STRUCTURES)
def test_the_slopes_of_a_structure_are_its_differences(name: str) -> None:
    rng = np.random.default_rng(4)
    whole = Parametrised(STRUCTURES[name], 2, 2, Units(gain=np.array([[1.0, 2.0], [0.5, 3.0]]), rate=2.0))
    x = whole.start + 0.3 * rng.standard_normal(whole.start.size)
    J, step = whole.jacobian(x), 1e-6
    assert J.shape == (*whole.matrix(x).shape, x.size)
    for k in range(x.size):
        e = step * np.eye(x.size)[k]
        slope = (whole.matrix(x + e) - whole.matrix(x - e)) / (2 * step)
        np.testing.assert_allclose(J[..., k], slope, rtol=1e-6, atol=1e-6 * (1.0 + np.abs(J).max()))


def test_a_pid_has_the_transfer_function_that_it_says() -> None:
    gains = {"kp11": 2.0, "ki11": 3.0, "kd11": 0.5, "filter1": 40.0, "damping1": 0.6}
    s = 1j * np.array([0.1, 1.0, 10.0, 100.0])
    F = 40.0**2 / (s**2 + 2 * 0.6 * 40.0 * s + 40.0**2)
    for structure, expected in (
        (design.PID(), (2.0 + 3.0 / s + 0.5 * s) * F),
        (design.PID(filtered="derivative"), 2.0 + 3.0 / s + 0.5 * s * F),
    ):
        units = Units(gain=np.ones((1, 1)), rate=1.0)
        names = [one.name for one in structure.parameters(1, 1, units)]
        A, B, C, D, _ = structure.block(np.array([gains[name] for name in names]), 1, 1)
        found = [(C @ np.linalg.solve(one * np.eye(len(A)) - A, B) + D)[0, 0] for one in s]
        np.testing.assert_allclose(found, expected, rtol=1e-10)


def test_peaks_and_their_slopes_are_those_of_the_closed_loop() -> None:
    rng = np.random.default_rng(1)
    plant = augmented(random_plant(rng), 1)
    whole = Parametrised(design.StateSpaceOrder(states=1), 2, 2, Units(gain=np.ones((2, 2)), rate=1.0))
    x = whole.start + 0.1 * rng.standard_normal(whole.start.size)
    found = WorstNorm([plant], whole)(x)
    loop = AugmentedLoop(plant, whole.matrix(x))
    norm = analysis.hinf_norm(control.ss(loop.A, loop.B, loop.C, loop.D))[0]
    assert found.stable
    assert found.values.max() == pytest.approx(norm, rel=1e-8)
    top = int(np.argmax(found.values))
    for k in range(x.size):
        e = 1e-4 * np.eye(x.size)[k]
        up, down = (WorstNorm([plant], whole)(x + d).values.max() for d in (e, -e))
        assert found.gradients[top, k] == pytest.approx((up - down) / 2e-4, rel=1e-4, abs=1e-6)


def test_a_peak_far_narrower_than_the_distance_of_poles_is_found() -> None:
    """A resonance with a damping of 1e-7, beside a slow pole that leads at low frequency."""
    A = np.array([[-1.0, 0, 0], [0, -2e-6, 10.0], [0, -10.0, -2e-6]])
    B, C = np.array([[0.5], [0.0], [1e-5]]), np.array([[1.0, 1.0, 0.0]])
    none = np.zeros((1, 1))
    plant = Partition(A=A, B1=B, B2=0 * B, C1=C, C2=0 * C, D11=none, D12=none, D21=none, D22=none)
    loop = AugmentedLoop(plant, none)
    frequency = loop.peaks(np.zeros(0))
    assert loop.gains(frequency).max() == pytest.approx(analysis.hinf_norm(control.ss(A, B, C, none))[0], rel=1e-8)


@pytest.mark.parametrize("name", QUICK)
def test_static_gains_reach_the_published_norms(name: str) -> None:
    P, nmeas, ncon = problem(name)
    found = design.structured(P, nmeas, ncon, structure=design.Static(), starts=4)
    assert found.gamma <= 1.001 * PROBLEMS[name]["best"]
    assert found.gamma == pytest.approx(analysis.hinf_norm(found.closed_loops[0])[0], rel=1e-9)
    assert found.gamma >= (1.0 - 1e-3) * found.gamma_optimal


def test_a_sampled_plant_gets_a_sampled_controller_of_the_same_norm() -> None:
    P = gyro().sample(0.2, method="bilinear")
    sampled = design.structured(P, 2, 2, structure=design.StateSpaceOrder(states=1), starts=4)
    flat = design.structured(gyro(), 2, 2, structure=design.StateSpaceOrder(states=1), starts=4)
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
    found = design.structured(gyro(), 2, 2, structure=structure, starts=3)
    p = found.parameters
    assert p["kp11"] == p["kp22"] == -0.5
    assert 1.0 <= p["filter1"] <= 4.0
    free = design.structured(gyro(), 2, 2, structure=design.PID(I="none", filter_order=1), starts=3)
    assert free.gamma <= found.gamma * (1 + 1e-6)


def test_an_infimum_at_infinite_gain_is_approached() -> None:
    """|x/w| = 1/(k - 1) beside a direct path of one: less with every larger gain, never below one."""
    P = control.ss([[1.0]], [[1.0, 0.0, 1.0]], [[1.0], [0.0], [1.0]], [[0, 0, 0], [1, 0, 0], [0, 0, 0]])
    found = design.structured(P, 1, 1, structure=design.Static(), starts=2)
    assert 1.0 <= found.gamma < 1.0 + 1e-6
