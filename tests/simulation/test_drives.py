"""Feedforward of dry friction in simulated runs."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import control
import numpy as np
import pytest

from driven_gimbal import COULOMB, COULOMB_RATE, FRICTION, INERTIA, RATE_HZ, VISCOUS, driven_job
from platform_ctrl import read_job
from platform_ctrl.simulation import Scenario, simulate, simulate_batch

PERIOD = 1.0 / RATE_HZ
TACHO = FRICTION | {"sensors": ["tacho"]}


def scenario_of(*drives: dict[str, object]) -> Scenario:
    job = read_job(driven_job(*drives))
    return job.scenario(job.manoeuvres[0])


def damping(gain: float) -> control.StateSpace:
    return control.ss([], [], [], [[-gain]], PERIOD, inputs=["gyro"], outputs=["Qouter"])


def by_hand(law: Any, gain: float, samples: int, steps: int = 200) -> np.ndarray:
    """A rate w of the inertia with friction against a base that turns at Omega(t), by small steps of its own."""
    out, w = np.zeros(samples), 0.0
    whole = 2.0 * INERTIA  # both bodies turn about the axis

    def base(t: float) -> float:
        return 0.1 * math.sin(4.0 * math.pi * t)

    def slope(t: float, w: float, u: float) -> float:
        slide = w - base(t)
        return (u - COULOMB * math.tanh(slide / COULOMB_RATE) - VISCOUS * slide) / whole

    for k in range(samples):
        out[k] = w
        t, h = k * PERIOD, PERIOD / steps
        v = -base(t) if not law.feedback else w - base(t)
        u = -gain * w + law.friction * min(max(v / law.friction_rate, -1.0), 1.0)
        for m in range(steps):
            middle = w + 0.5 * h * slope(t + m * h, w, u)
            w += h * slope(t + (m + 0.5) * h, middle, u)
    return out


@pytest.mark.parametrize("drive", [FRICTION, FRICTION | {"friction": 0.026}, TACHO])
def test_an_inertia_with_fed_forward_friction_moves_as_by_hand(drive: dict[str, object]) -> None:
    scenario = dataclasses.replace(scenario_of(drive), duration=0.6)
    run = simulate(scenario, [damping(1.0)], period=PERIOD, noise=False)
    expected = by_hand(scenario.drives[0], 1.0, len(run.t))
    body = run.rate[:, 0] + run.Omega[:, 2]
    np.testing.assert_allclose(body, expected, rtol=0.0, atol=2e-5 * np.abs(expected).max())


def test_many_runs_are_those_of_one() -> None:
    one = scenario_of(FRICTION)
    most = dataclasses.replace(one.drives[0], friction=0.01, friction_rate=0.05)
    q = np.array([0.0, 0.6])
    scenarios = [dataclasses.replace(one, q=q, drives=drives) for drives in (one.drives, (most,), ())]
    closed = [damping(0.5)]
    alone = [simulate(scenario, closed, period=PERIOD) for scenario in scenarios]
    both = simulate_batch(scenarios, closed, period=PERIOD)
    np.testing.assert_array_equal(both.gimbal_rate, [np.abs(run.rate).max(axis=0) for run in alone])
    assert len(np.unique(both.gimbal_rate[:, 0])) == 3
