"""Loops of two degrees of freedom against the formulas of textbooks: u = K (y − F r) + J sᵏ F r."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import pytest
from scipy.signal import bilinear, dlsim, lfilter

from commanded_gimbal import INERTIA, RATE_HZ, commanded_job
from given_controllers import outcomes
from platform_ctrl import read_job
from platform_ctrl.design import loops
from platform_ctrl.simulation import simulate, simulate_batch
from platform_ctrl.verification import check_job

PERIOD, HZ = 1.0 / RATE_HZ, 4.0
OMEGA = 2.0 * np.pi * HZ
LIMITS = {
    "overshoot": 0.5,
    "settling_time": 9.0,
    "steady_error": 0.1,
    "ramp_error": 9.0,
    "tracking": 5.0,
    "tracking_hz": 2.0,
}
FILTER, BOTH = {"filter_hz": HZ}, {"filter_hz": HZ, "acceleration": True}


def job_of(kind: str, command: dict[str, Any] | None) -> dict[str, Any]:
    reading = "gyro" if kind == "rate" else "heading"
    run = [{"reading": reading, "step": 1e-3, "at": 0.1}, {"reading": reading, "ramp": 5e-4, "at": 0.4}]
    job = commanded_job(run, kind, **({} if command is None else {"command": command}))
    job["loop"][0]["limits"] = LIMITS
    return job


@functools.cache
def made(kind: str, shaping: str = "") -> Any:
    command = {"": None, "filter": FILTER, "both": BOTH}[shaping]
    return loops(read_job(job_of(kind, command)))[0].closed


def metrics(design: Any) -> dict[str, float]:
    return {one.name: one.value for one in design.results}


@pytest.mark.parametrize("kind", ["rate", "pointing"])
def test_what_is_done_with_commands_leaves_the_feedback_as_it_is(kind: str) -> None:
    plain, both = made(kind), made(kind, "both")
    assert plain.plants is not None
    for name in ("A", "B", "C", "D"):
        np.testing.assert_array_equal(getattr(plain.own_controller, name), getattr(both.own_controller, name))
    np.testing.assert_allclose(both.measures.disk_margin, plain.measures.disk_margin, rtol=1e-12)  # type: ignore[union-attr]
    assert both.controller.nstates == plain.controller.nstates + 2
    np.testing.assert_array_equal(plain.controller.B[:, 1], -plain.controller.B[:, 0])


@pytest.mark.parametrize(("kind", "order"), [("rate", 1), ("pointing", 2)])
def test_the_run_is_that_of_filter_feedforward_and_loop_by_themselves(kind: str, order: int) -> None:
    job, design = read_job(job_of(kind, BOTH)), made(kind, "both")
    run = simulate(job.scenario(job.manoeuvres[0]), [design.controller], period=PERIOD, noise=False)
    # The step as it is, and the ramp advanced: 2 r(t + τ) − r(t), τ the filter's time constant as it is sampled.
    tau = 0.5 * PERIOD / np.tan(0.5 * OMEGA * PERIOD)
    ramp = [np.where(t >= 0.4 - 1e-9, 5e-4 * (t - 0.4), 0.0) for t in (run.t, run.t + tau)]
    step = np.where(run.t >= 0.1 - 1e-9, 1e-3, 0.0)
    np.testing.assert_allclose(run.reading_command[:, 0], step + ramp[0], atol=1e-15)
    r = step + 2.0 * ramp[1] - ramp[0]
    # Tustin's rule, prewarped at the filter's frequency.
    fs = OMEGA / (2.0 * np.tan(0.5 * OMEGA * PERIOD))
    denominator = [1.0, 2.0 * OMEGA, OMEGA**2]
    filtered = lfilter(*bilinear([OMEGA**2], denominator, fs), r)
    forward = INERTIA * lfilter(*bilinear([OMEGA**2, *[0.0] * order], denominator, fs), r)
    # The gimbal turns by ∬u/J, u held over a sample; a small angle is what the attitude sensor reads of it.
    A, B = np.array([[1.0, PERIOD], [0.0, 1.0]]), np.array([PERIOD**2 / 2.0, PERIOD]) / INERTIA
    C = np.array([0.0, 1.0]) if kind == "rate" else np.array([1.0, 0.0])
    K = design.own_controller
    D = K.D[0, 0]
    closed = np.block([[A + D * np.outer(B, C), np.outer(B, K.C[0])], [np.outer(K.B[:, 0], C), K.A]])
    into = np.vstack([np.array([-D * B, B]).T, np.array([-K.B[:, 0], 0.0 * K.B[:, 0]]).T])
    seen = np.concatenate([C, np.zeros(len(K.A))])[None]
    _, y, _ = dlsim((closed, into, seen, np.zeros((1, 2)), PERIOD), np.array([filtered, forward]).T)
    reading = run.rate[:, 0] if kind == "rate" else run.q[:, 0]
    np.testing.assert_allclose(reading, y[:, 0], rtol=0.0, atol=1e-6 * np.abs(y).max())


TIMES = [0.05 * k for k in range(21)]
WAVE = [0.1 * float(np.sin(2.0 * np.pi * t)) for t in TIMES]
PATHS: dict[str, dict[str, Any]] = {
    "ramp": {"ramp": 0.5, "at": 0.1},
    "smooth table": {"t": TIMES, "value": WAVE, "smooth": True},
    "trapezium": {"t": [0.0, 0.3, 0.8, 1.0], "value": [0.0, 0.0, 0.2, 0.2]},
}


def following(kind: str, path: dict[str, Any], limit: float = 1.0, friction: float = 0.0, **command: Any) -> Any:
    """Return what becomes of a run along a path, from half a second on."""
    key, reading = ("rate_following_error", "gyro") if kind == "rate" else ("angle_following_error", "heading")
    data = commanded_job([{"reading": reading, **path}], kind, {key: limit}, command={"filter_hz": 5.0} | command)
    data["manoeuvre"][0]["settle"] = 0.5
    data["plant"]["friction"] = [{"gimbal": "yaw", "viscous": friction}] if friction else []
    job = read_job(data)
    return check_job(job, loops(job))


def error_of(result: Any) -> Any:
    return next(one for one in result.requirements if "behind a commanded" in one.name)


@pytest.mark.parametrize(("kind", "path"), [("rate", "ramp"), ("pointing", "smooth table"), ("rate", "trapezium")])
def test_a_path_that_is_known_is_followed_without_the_lag_of_the_filter(kind: str, path: str) -> None:
    result = following(kind, PATHS[path])
    # The filter alone is 2/ω late.
    rate = 0.4 if path == "trapezium" else 0.5 if path == "ramp" else 0.2 * np.pi
    assert error_of(result).value < 0.12 * rate * 2.0 / (2.0 * np.pi * 5.0)
    # A campaign measures it as the run does.
    [run], controllers = result.runs, [outcome.closed.controller for outcome in result.loops]
    scenario = result.job.scenario(run.manoeuvre)
    batch = simulate_batch([scenario], controllers, period=PERIOD, noise=False)
    found = batch.rate_following_error if kind == "rate" else batch.angle_following_error
    assert found.max() == pytest.approx(error_of(result).value, rel=1e-9)


def test_the_inverse_of_the_plant_has_its_viscous_friction() -> None:
    without, with_inverse = (
        error_of(following("rate", PATHS["ramp"], friction=0.5, acceleration=inverse)).value
        for inverse in (False, True)
    )
    assert without > 4e-3
    assert with_inverse < 0.2 * without


def test_where_lag_remains_the_filter_is_named() -> None:
    result = following("pointing", {"step": 0.1, "at": 0.45}, limit=1e-3)
    assert not error_of(result).passed
    assert "filter_hz = 5" in error_of(result).evidence
    late = next(one for one in made("rate", "both").results if one.name == "ramp error")
    assert f"filter_hz = {HZ:g}" in late.evidence


def test_steady_and_ramp_errors_are_those_of_the_final_value_theorem() -> None:
    plain, filtered, both = (metrics(made("rate", shaping)) for shaping in ("", "filter", "both"))
    # Integrators of plant and controller leave no error behind a ramp; the filter leaves 2/ω, as it is sampled.
    lag = PERIOD / np.tan(0.5 * OMEGA * PERIOD)
    assert plain["ramp error"] < 1e-9
    np.testing.assert_allclose([filtered["ramp error"], both["ramp error"]], lag, rtol=1e-6)
    assert plain["steady-state error"] == filtered["steady-state error"] == both["steady-state error"] == 0.0


def test_with_feedforward_the_loop_answers_as_its_filter() -> None:
    plain, both = metrics(made("rate")), metrics(made("rate", "both"))
    assert plain["overshoot"] > 0.05
    assert both["overshoot"] < 1e-3
    # (1 + ωt) exp(−ωt) is down to 2 % at ωt = 5.834.
    assert both["settling time"] == pytest.approx(5.834 / OMEGA, rel=0.02)
    w = 2.0 * np.pi * LIMITS["tracking_hz"]
    assert both["tracking error"] == pytest.approx(abs(1.0 - OMEGA**2 / (1j * w + OMEGA) ** 2), rel=0.01)
    assert plain["tracking error"] < both["tracking error"]


def test_a_controller_that_was_written_is_measured_again_as_it_was() -> None:
    job, design = read_job(job_of("rate", BOTH)), made("rate", "both")
    (again,) = outcomes(job, [design.controller])
    assert metrics(again.closed) == metrics(design)
    np.testing.assert_array_equal(again.closed.controller.B, design.controller.B)


def test_all_loops_together_are_checked_with_commands_at_zero() -> None:
    job = read_job(job_of("rate", BOTH))
    found = check_job(job, loops(job), prove=True)
    assert found.coupled.stable
    assert found.coupled.controller.input_labels == ["gyro"]
    assert found.proofs["", ""].proved == 1
