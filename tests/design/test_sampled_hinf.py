"""Sampled-data H-infinity synthesis, against fast sampling, the continuous limit and a design carried over."""

from __future__ import annotations

import control
import numpy as np
import pytest

from platform_ctrl import analysis
from platform_ctrl.analysis.sampling import held_input
from platform_ctrl.design.riccati.sampled_hinf import sampled_hinf
from platform_ctrl.design.synthesis import hinf
from platform_ctrl.errors import ArgumentError, IllPosedError, NotStabilisableError

FILTER = 20.0  # rad/s


def servo() -> control.StateSpace:
    """An inertia with a disturbance torque, its angle read with noise through an anti-alias filter; angle and cost."""
    A = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 0.0], [FILTER, 0.0, -FILTER]])
    B = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 1.0], [0.0, 0.1 * FILTER, 0.0]])
    C = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    D = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.1], [0.0, 0.0, 0.0]])
    return control.StateSpace(A, B, C, D, inputs=["torque", "noise", "control"], outputs=["angle", "cost", "measured"])


def continuous_design() -> tuple[control.StateSpace, float]:
    P = servo()
    D = P.D.copy()
    D[2, 1] = 1e-3  # a regular problem: a little noise behind the filter
    made = hinf(control.StateSpace(P.A, P.B, P.C, D), 1, 1, method="riccati")
    return made.controller, made.gamma_optimal


@pytest.mark.parametrize(("period", "delay"), [(0.1, 0.05), (0.3, 0.3)])
def test_the_loop_keeps_what_the_synthesis_promises(period: float, delay: float) -> None:
    made = sampled_hinf(servo(), 1, 1, period=period, delay=delay)
    assert made.gamma_optimal < made.gamma < 1.031 * made.gamma_optimal
    assert made.gamma == pytest.approx(analysis.intersample_norm(servo(), made.controller, 1, 1, delay)[0], rel=1e-9)
    assert np.abs(made.poles).max() < 1.0
    assert made.controller.dt == period
    assert list(made.controller.input_labels) == ["measured"]
    assert list(made.controller.output_labels) == ["control"]


def test_continuous_design_and_tustin_is_worse_at_a_slow_rate_and_then_unstable() -> None:
    P, (K, _) = servo(), continuous_design()
    made = sampled_hinf(P, 1, 1, period=0.1, delay=0.05)
    hoped, _ = analysis.intersample_norm(P, K.sample(0.1, method="bilinear"), 1, 1, 0.05)
    assert hoped > 2.0 * made.gamma
    with pytest.raises(ArgumentError, match="must be stable"):
        analysis.intersample_norm(P, K.sample(0.3, method="bilinear"), 1, 1, 0.3)


def test_the_least_norm_of_short_periods_is_the_continuous_one() -> None:
    _, least = continuous_design()
    found = [sampled_hinf(servo(), 1, 1, period=period).gamma_optimal for period in (0.02, 0.005)]
    assert found[0] > found[1] > 0.999 * least
    assert found[1] == pytest.approx(least, rel=0.01)


def test_the_least_norm_is_that_of_fast_sampling() -> None:
    P, period, pieces = servo(), 0.3, 24
    h = period / pieces
    Ad, Bd = held_input(P.A, P.B, h)
    x, z = np.eye(3, 3 + 2 * pieces + 1), []
    for k in range(pieces):
        w = np.eye(2, 3 + 2 * pieces + 1, 3 + 2 * k)
        wu = np.vstack([w, np.eye(1, 3 + 2 * pieces + 1, 3 + 2 * pieces)])
        z.append(P.C[:2] @ x + P.D[:2] @ wu)
        x = Ad @ x + Bd @ wu
    y = np.zeros((1, x.shape[1]))
    y[:, :3] = P.C[2:]
    out = np.vstack([*z, y])
    fast = control.StateSpace(x[:, :3], x[:, 3:], out[:, :3], out[:, 3:], period)
    least = hinf(fast, 1, 1, method="riccati").gamma_optimal
    assert sampled_hinf(P, 1, 1, period=period).gamma_optimal == pytest.approx(least, rel=0.01)


def test_failures_raise_errors_that_name_the_cause() -> None:
    P = servo()
    noisy = control.StateSpace(P.A, P.B, P.C, P.D + np.eye(3, 3, -1)[[0, 0, 2]])
    with pytest.raises(IllPosedError, match="anti-alias filter"):
        sampled_hinf(noisy, 1, 1, period=0.1)
    with pytest.raises(ArgumentError, match="period"):
        sampled_hinf(P, 1, 1, period=-1.0)
    with pytest.raises(ArgumentError, match=r"250 delayed controls .* more than 100"):
        sampled_hinf(P, 1, 1, period=0.01, delay=2.5)
    with pytest.raises(ArgumentError, match="backoff"):
        sampled_hinf(P, 1, 1, period=0.1, backoff=0.0)
    lost = control.StateSpace(
        np.diag([1.0, -1.0]), [[1.0, 0.0], [1.0, 1.0]], [[1.0, 1.0], [1.0, 1.0]], np.zeros((2, 2))
    )
    with pytest.raises(NotStabilisableError):
        sampled_hinf(lost, 1, 1, period=0.1)
