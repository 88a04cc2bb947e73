"""Loops of two degrees of freedom against the formulas of textbooks: u = K (y − F r) + J sᵏ F r."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.signal import bilinear, dlsim, lfilter

from commanded_gimbal import INERTIA, RATE_HZ, commanded_job
from platform_ctrl import read_job
from platform_ctrl.design import loops
from platform_ctrl.design.loop import LoopDesign
from platform_ctrl.errors import InputError
from platform_ctrl.export import write_c
from platform_ctrl.job.job import manoeuvre_scenario
from platform_ctrl.job.writing import job_data
from platform_ctrl.simulation import simulate
from platform_ctrl.verification import check_job
from platform_ctrl.verification.controllers import outcomes_from

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
def made(kind: str, shaping: str = "") -> LoopDesign:
    command = {"": None, "filter": FILTER, "both": BOTH}[shaping]
    return loops(read_job(job_of(kind, command)))[0].closed


def metrics(design: LoopDesign) -> dict[str, float]:
    return {one.name: one.value for one in design.results}


@pytest.mark.parametrize("kind", ["rate", "pointing"])
def test_what_is_done_with_commands_leaves_the_feedback_as_it_is(kind: str) -> None:
    plain, both = made(kind), made(kind, "both")
    assert plain.plants is not None
    for name in ("A", "B", "C", "D"):
        np.testing.assert_array_equal(getattr(plain.own_controller, name), getattr(both.own_controller, name))
    np.testing.assert_allclose(both.measures.disk_margin, plain.measures.disk_margin, rtol=1e-12)  # type: ignore[union-attr]
    assert len(both.certificates) == len(plain.certificates)
    assert both.controller.nstates == plain.controller.nstates + 2
    np.testing.assert_array_equal(plain.controller.B[:, 1], -plain.controller.B[:, 0])


@pytest.mark.parametrize(("kind", "order"), [("rate", 1), ("pointing", 2)])
def test_the_run_is_that_of_filter_feedforward_and_loop_by_themselves(kind: str, order: int) -> None:
    job, design = read_job(job_of(kind, BOTH)), made(kind, "both")
    run = simulate(manoeuvre_scenario(job, job.manoeuvres[0]), [design.controller], period=PERIOD, noise=False)
    r = run.reading_command[:, 0]
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
    (again,) = outcomes_from(job, [design.controller])
    assert metrics(again.closed) == metrics(design)
    np.testing.assert_array_equal(again.closed.controller.B, design.controller.B)
    assert job_data(job)["loop"][0]["design"][0]["command"] == BOTH


@pytest.mark.parametrize(
    ("kind", "command", "words"),
    [
        ("rate", {"acceleration": True}, 'the key "filter_hz" is missing'),
        ("rate", {"filter_hz": 0.0}, "filter_hz must be a number > 0, Hz"),
        ("rate", {"filter": 2.0}, 'unknown key "filter"'),
        ("caging", BOTH, "command has no effect in a caging loop"),
    ],
)
def test_options_that_make_no_sense_are_refused(kind: str, command: dict[str, Any], words: str) -> None:
    job = job_of("rate", command)
    if kind == "caging":
        loop = {"name": "loop", "kind": kind, "gimbals": ["yaw"], "use": "own", "design": job["loop"][0]["design"]}
        job |= {"loop": [loop | {"design": [loop["design"][0] | {"method": "classical"}]}], "manoeuvre": []}
    with pytest.raises(InputError) as found:
        read_job(job)
    assert words in str(found.value)


def test_all_loops_together_are_checked_with_commands_at_zero() -> None:
    job = read_job(job_of("rate", BOTH))
    found = check_job(job, loops(job))
    assert found.coupled.stable
    assert found.coupled.controller.input_labels == ["gyro"]
    assert found.proofs["", ""].certificates
    assert not found.proofs["", ""].unproved


def test_generated_code_takes_the_command_by_its_name(tmp_path: Path) -> None:
    job = read_job(job_of("rate", BOTH))
    write_c(job, [made("rate", "both").controller], tmp_path)
    [header] = [path.read_text(encoding="utf-8") for path in tmp_path.glob("commanded*.h")]
    assert "double gyro; /* rad/s */" in header
    assert "double gyro_command; /* rad/s */" in header
