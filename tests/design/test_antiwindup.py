"""Loops at their torque limits: what Omega they survive, anti-windup and its region of attraction; by simulation."""

from __future__ import annotations

import dataclasses

import control
import numpy as np
import pytest

from limited_response import LIMIT, LOAD, PERIOD, STOP, gimbal, half_cosine, limited_response, loop, pid
from platform_ctrl.analysis import time_response
from platform_ctrl.design.antiwindup.compensator import AntiWindup, anti_windup, largest_Omega, with_excess
from platform_ctrl.design.antiwindup.loop import limited_loop
from platform_ctrl.design.caging_claims import caging_largest_Omega, caging_loop_limits, caging_plant, intersample_gains
from platform_ctrl.design.classical.caging import classical_controller
from platform_ctrl.design.partition import channels
from platform_ctrl.errors import ArgumentError, InfeasibleError
from platform_ctrl.job.job import Job
from platform_ctrl.job.reading import read_job
from platform_ctrl.mechanics.linearisation import linearise
from platform_ctrl.mechanics.state_space import state_space
from platform_ctrl.simulation import HalfCosine
from single_runs import simulated


@pytest.fixture(scope="module")
def designed() -> AntiWindup:
    return anti_windup(loop(), Omega=1.0)


def test_the_equilibrium_holds_the_load_and_the_manoeuvre_is_covered() -> None:
    one = loop()
    assert one.u_steady == pytest.approx([-LOAD])
    assert one.angle_steady == pytest.approx([0.0])
    assert one.static_Omega == pytest.approx(LIMIT / LOAD)
    b = half_cosine(one, hold=0.2, after=0.3)
    assert 0.99 < np.abs(b).max() <= 1.0
    run = limited_response(one, 1.2, b)
    assert run.Omega.max() == pytest.approx(1.2, rel=1e-5)
    assert abs(run.Omega[-1]) < 1e-5
    held = np.searchsorted(run.t, 0.69)
    assert run.command[held] == pytest.approx([-1.2 * LOAD], rel=1e-3)


def test_below_the_limits_the_response_is_that_of_the_linear_loop() -> None:
    one = loop()
    b = half_cosine(one, hold=0.1, after=0.1)
    run = limited_response(one, 0.5, b)
    assert np.array_equal(run.command, run.torque)
    linear = control.StateSpace(one.A, one.B_w, one.C, np.zeros((1, 1)), PERIOD)
    assert np.allclose(time_response(linear, run.t, 0.5 * b), run.angle[:, 0], atol=1e-12)


def test_certified_is_below_simulated_is_below_static() -> None:
    one = loop()
    found = largest_Omega(one)
    assert found.verification.proved
    assert found.static_Omega == one.static_Omega
    b = half_cosine(one, hold=0.5, after=0.5)
    low, high = found.Omega, 1.2 * found.static_Omega
    for _ in range(12):
        middle = 0.5 * (low + high)
        run = limited_response(one, middle, b)
        fine = np.abs(run.angle).max() <= STOP and np.abs(run.angle[-1]).max() < 1e-5
        low, high = (middle, high) if fine else (low, middle)
    assert 0.9 * found.static_Omega < found.Omega <= low <= 1.001 * found.static_Omega


def test_no_manoeuvre_leaves_the_ellipsoid() -> None:
    one = loop()
    found = largest_Omega(one)
    rng = np.random.default_rng(0)
    # Of either sign and switching at once; a rate that has reached its bound turns back.
    for length in (20, 200):
        b = np.repeat(rng.choice([-1.0, 1.0], 4000 // length), length)
        b[1::2] = -b[::2]
        run = limited_response(one, found.Omega, b)
        assert np.abs(run.Omega).max() < found.Omega
        assert found.ellipsoid.level(run.state).max() <= 1.0 + 1e-9
        assert np.abs(run.command).max() <= LIMIT
        assert np.abs(run.angle).max() <= STOP


@pytest.mark.parametrize(("rise", "share"), [(0.5, 0.99), (0.1, 0.85)])
def test_the_ellipsoid_gives_away_little_against_the_exact_peak(rise: float, share: float) -> None:
    one = loop(rise)
    found = largest_Omega(one)
    state, u, y = one.B_w[:, 0], np.zeros(1), np.zeros(1)
    for _ in range(20000):
        u, y, state = u + np.abs(one.K @ state), y + np.abs(one.C @ state), one.A @ state
    assert not np.any(np.abs(state) > 1e-9 * np.abs(one.B_w).max())
    # Where |b| <= 1 is all that is known, the sum of the absolute impulse response is the largest value.
    peak = min((one.limits / (u + np.abs(one.u_steady))).min(), (one.stops / (y + np.abs(one.angle_steady))).min())
    assert share * peak < found.Omega < peak


def test_torques_beyond_their_limits_allow_no_less() -> None:
    one = loop()
    plain, more = largest_Omega(one), largest_Omega(one, saturating=True)
    assert more.verification.proved
    assert plain.Omega <= more.Omega < one.static_Omega


def test_a_claim_too_large_is_not_proved() -> None:
    found = largest_Omega(loop())
    wrong = dataclasses.replace(found.ellipsoid, Omega=1.02 * found.Omega)
    assert not wrong.verify().proved
    assert "positive definite" in wrong.verify().reason


@pytest.mark.parametrize(("factor", "named"), [(0.9, "the invariance"), (1.1, "the limit of torque")])
def test_an_ellipsoid_of_another_size_is_rejected(factor: float, named: str) -> None:
    found = largest_Omega(loop()).ellipsoid
    shown = dataclasses.replace(found, Q=factor * found.Q).verify()
    assert not shown.proved
    assert shown.reason.startswith(named)


def test_anti_windup_enlarges_the_proved_region(designed: AntiWindup) -> None:
    assert designed.verification.proved
    assert designed.without.verify().proved
    assert designed.reach > 1.02 * designed.reach_without
    assert np.any(designed.gain)


def test_everything_that_starts_in_the_region_stays_and_returns(designed: AntiWindup) -> None:
    one, rng = designed.loop, np.random.default_rng(1)
    root = np.linalg.cholesky(designed.ellipsoid.Q)
    b = np.concatenate([half_cosine(one, hold=0.0, after=0.0), np.zeros(1500)])
    exceeded = 0
    starts = [root @ (d / np.linalg.norm(d)) for d in rng.standard_normal((12, len(root)))]
    starts.append(designed.reach * one.impulse("torque"))
    for start in starts:
        run = limited_response(one, designed.Omega, b, gain=designed.gain, start=0.9999 * start)
        assert designed.ellipsoid.level(run.state).max() <= 1.0 + 1e-7
        assert np.abs(run.angle).max() <= STOP
        assert designed.ellipsoid.level(run.state[-1:])[0] < 1e-3
        exceeded += bool(np.any(run.command != run.torque))
    assert exceeded


def test_simulated_shocks_exceed_what_is_proved(designed: AntiWindup) -> None:
    one, b = designed.loop, np.zeros(2000)

    def largest(gain: np.ndarray) -> float:
        low, high = 0.0, 20.0 * designed.reach
        for _ in range(12):
            middle = 0.5 * (low + high)
            run = limited_response(one, 0.0, b, gain=gain, start=middle * one.impulse("torque"))
            fine = np.abs(run.angle).max() <= STOP and np.abs(run.angle[-1]).max() < 1e-5
            low, high = (middle, high) if fine else (low, middle)
        return low

    assert designed.reach <= largest(designed.gain)
    assert designed.reach_without <= largest(0.0 * designed.gain)


def test_the_controller_takes_the_excess_as_an_input(designed: AntiWindup) -> None:
    K = with_excess(pid(), designed.gain)
    assert list(K.input_labels) == ["angle", "excess_torque"]
    assert np.array_equal(K.B[:, 1:], designed.gain)
    assert not np.any(K.D[:, 1:])
    assert np.array_equal(designed.controller.B, K.B)


def test_failures_raise_errors_that_name_the_cause() -> None:
    with pytest.raises(InfeasibleError, match="takes all of a limit"):
        anti_windup(loop(), Omega=2.0)
    with pytest.raises(ArgumentError, match="without limits the loop"):
        limited_loop(gimbal(), control.ss([], [], [], [[1.0]], PERIOD, inputs=["angle"], outputs=["torque"]), "Omega",
                     limits=LIMIT)  # fmt: skip
    with pytest.raises(ArgumentError, match="limits"):
        limited_loop(gimbal(), pid(), "Omega", limits=-1.0)
    with pytest.raises(ArgumentError, match="disturbance"):
        limited_loop(gimbal(), pid(), "Omega9", limits=LIMIT)
    with pytest.raises(ArgumentError, match="plant must be continuous"):
        limited_loop(pid(), pid(), "Omega", limits=LIMIT)


@pytest.fixture(scope="module")
def job() -> Job:
    return read_job("examples/three_gyro_platform.toml")


@pytest.fixture(scope="module")
def caging(job: Job) -> control.StateSpace:
    """A hand-tuned caging loop of gimbals 9 and 10."""
    model = linearise(job.platform)
    options = {
        "crossover_hz": 60.0, "integral_hz": 2.0, "damping_hz": 78.0, "damping2_hz": 92.0, "lead_hz": 7.0,
        "rolloff_hz": 900.0,
    }  # fmt: skip
    block = classical_controller(options, channels(model, [3, 4]), job.sampling.period)
    return control.StateSpace(*block, inputs=["alpha9", "beta10"], outputs=["Q9", "Q10"])


def test_the_caging_loop_keeps_its_limits_on_the_non_linear_plant_up_to_the_proved_rate(
    job: Job, caging: control.StateSpace
) -> None:
    found = caging_largest_Omega(
        dataclasses.replace(job, uncertainty=dataclasses.replace(job.uncertainty, inertia=0.0)), caging
    )
    assert [one.axis for one in found] == [1, 3]
    first = found[0]
    assert first.nominal.static_Omega == pytest.approx(0.25 / 0.15)
    assert 0.97 * first.nominal.static_Omega < first.nominal.Omega < first.nominal.static_Omega
    # A rotor with ten per cent more momentum needs ten per cent more torque.
    assert first.worst_case == pytest.approx(first.nominal.Omega / 1.1, rel=0.01)
    assert "L11+10%" in first.worst_case_label

    def run(rate: float) -> bool:
        out = simulated(
            job.platform, [caging], period=job.sampling.period, delay=job.sampling.delay, duration=2.0, mode="caged",
            profile=HalfCosine(axis=1, rate=rate, rise=first.rise, hold=0.7), noise=False, step=2.5e-4,
        )  # fmt: skip
        held = [list(out.angle_names).index(name) for name in ("alpha9", "beta10")]
        return bool(not out.stop_contacts[held].any() and np.abs(out.q[-1, held]).max() < 1e-4)

    assert run(first.nominal.Omega)
    assert not run(1.02 * first.nominal.static_Omega)


def test_a_caging_loop_between_its_samples(job: Job, caging: control.StateSpace) -> None:
    gains = intersample_gains(job, caging)
    # A constant torque is taken up by the integrator; the peak is that of the loop, a little above L2 at the samples.
    assert 0.0 < gains.torque_rejection < 1.0
    assert gains.torque_frequency is not None
    assert 0.0 < gains.torque_frequency < np.pi / job.sampling.period
    assert gains.Omega_rejection > 0.0
    plant, torques, angles = caging_plant(job, caging)
    assert (torques, angles) == (2, 2)
    rest = state_space(linearise(job.platform), gimbals=("9", "10"))
    assert np.allclose(plant.A[:4, :4], rest.A)
    with pytest.raises(ArgumentError, match="outputs must be among"):
        intersample_gains(job, control.ss([], [], [], [[1.0]], 1e-3, inputs=["alpha9"], outputs=["nothing"]))
    with pytest.raises(ArgumentError, match="axis"):
        caging_loop_limits(job, caging, 4)
