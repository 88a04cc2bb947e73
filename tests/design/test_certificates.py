"""Every result of the suite with a model behind it carries a proof of its own loop, made from what it was given."""

from __future__ import annotations

from typing import Any

import control
import numpy as np
import pytest

import platform_ctrl as pc
from platform_ctrl.analysis.arrays import StateArrays, state_arrays
from platform_ctrl.analysis.feedback import closed_loop
from platform_ctrl.analysis.lifting import lifted_plant, sampled_plant
from platform_ctrl.design import complex_loop, complex_plant, from_crossover_and_margin, lqe, lqg, lqr, pole_placement
from platform_ctrl.design.cases import changed
from platform_ctrl.design.riccati.sampled_hinf import sampled_hinf
from platform_ctrl.errors import NotCertifiedError

PERIOD = 5e-4


def double(dt: float) -> control.StateSpace:
    if dt:
        return control.ss([[1.0, dt], [0.0, 1.0]], [[0.5 * dt**2], [dt]], [[1.0, 0.0]], 0, dt)
    return control.ss([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], [[1.0, 0.0]], 0)


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_quadratic_designs_prove_their_parts_and_their_cost(dt: float) -> None:
    G, eye = double(dt), np.eye(2)
    one = np.eye(1)
    feedback, estimator = lqr(G, eye, one, integral=one), lqe(G, eye, one)
    both = lqg(G, eye, one, eye, one, integral=one)
    for proof, poles in ((feedback.certificate, feedback.poles), (estimator.certificate, estimator.poles)):
        assert proof.verify().proved
        rate = -float((np.log(np.abs(poles)) / dt if dt else poles.real).max())
        assert 0.4 * rate < proof.bound < rate
    assert both.certificate.verify().proved
    assert both.certificate.bound**2 == pytest.approx(both.cost, rel=1e-4)


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_placed_poles_are_proved_stable_where_they_are(dt: float) -> None:
    G = double(dt)
    assert pole_placement(G, [0.5, 0.6] if dt else [-1.0, -2.0]).certificate.verify().proved
    with pytest.raises(NotCertifiedError, match="grows at"):
        _ = pole_placement(G, [1.1, 0.6] if dt else [1.0, -2.0]).certificate


def test_the_margin_from_crossover_and_margin_is_proved() -> None:
    model = pc.linearise(pc.read_platform("three_gyro_platform"))
    made = from_crossover_and_margin(
        model, ("9", "10"), crossover_hz=30, integral_hz=2, disk_margin=0.4, period=PERIOD, delay=PERIOD / 2
    )
    stable, torques, pickoffs = made.certificates
    assert all(one.verify().proved for one in (stable, torques, pickoffs))
    assert 1.0 / max(torques.bound, pickoffs.bound) == pytest.approx(made.disk_margin, rel=2e-6)


def test_a_complex_loop_is_proved_stable_unless_it_has_dead_time() -> None:
    model = pc.linearise(changed(pc.read_platform("three_gyro_platform"), {"10": 1.5}, {}))
    loop = {"crossover_hz": 30.0, "integral_hz": 2.0, "damping_hz": 45.0, "lead_hz": 7.0, "rolloff_hz": 900.0}
    options: list[dict[str, Any]] = [{"period": PERIOD, "delay": 3e-4}, {}]
    for given in options:
        made = complex_loop(complex_plant(model, ("9", "10"), **given), **loop)
        assert made.certificate.verify().proved
    late = complex_loop(complex_plant(model, ("9", "10"), delay=3e-4), **loop)
    with pytest.raises(NotCertifiedError, match=r"dead time of 0\.0003 s"):
        _ = late.certificate


def test_a_sampled_synthesis_proves_the_sampled_loop_and_reports_its_poles() -> None:
    A = [[0.0, 1.0, 0.0], [0.0, -0.2, 0.0], [1.0, 0.0, -0.01]]
    B, C = [[0.0, 0.0], [1.0, 1.0], [0.0, 0.0]], [[0.0, 0.0, 1.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]
    P = control.ss(A, B, C, [[0.0, 0.0], [0.0, 0.1], [0.0, 0.0]])
    made = sampled_hinf(P, 1, 1, period=0.2, delay=0.13)
    stable, level = made.certificates
    assert stable.verify().proved
    assert level.verify().proved
    assert level.bound <= 1.0
    F, G, H, D, _ = lifted_plant(sampled_plant(P, 1, 1, 0.2, 0.13, "test"), np.inf)
    loop = closed_loop(
        StateArrays(F, G[:, -1:], H[-1:], D[-1:, -1:], state_arrays(made.controller, "test").dt),
        state_arrays(made.controller, "test"),
    ).A
    np.testing.assert_allclose(np.sort(np.abs(made.poles)), np.sort(np.abs(np.linalg.eigvals(loop))), atol=1e-9)
