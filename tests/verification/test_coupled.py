"""The coupled check against an independent model in absolute rates, and the non-linear run against the linear one."""

import dataclasses

import control
import numpy as np
import pytest

from platform_ctrl import analysis, design, verification
from platform_ctrl.analysis.interconnection import interconnected
from platform_ctrl.design.methods import read_job
from platform_ctrl.mechanics.linearisation import linearise
from platform_ctrl.mechanics.state_space import state_space
from platform_ctrl.verification.coupled import coupled_check
from platform_ctrl.verification.coupled_plant import coupled_plant
from platform_ctrl.verification.simulated import largest, simulate_manoeuvre
from single_runs import simulated


@pytest.fixture(scope="module")
def job():
    """The main job with its classical designs as they stand in the file."""
    job = read_job("examples/three_gyro_platform.toml")
    return dataclasses.replace(
        job,
        loops=tuple(
            dataclasses.replace(
                spec, designs=tuple(dataclasses.replace(d, tune=False) for d in spec.designs if d.name == spec.use)
            )
            for spec in job.loops
        ),
    )


@pytest.fixture(scope="module")
def loops(job):
    return design.loops(job)


@pytest.fixture(scope="module")
def controllers(loops):
    return [outcome.closed.controller for outcome in loops]


@pytest.fixture(scope="module")
def result(job, loops):
    short = [
        dataclasses.replace(m, duration=m.duration if m.mode == "caged" else 0.8) for m in job.manoeuvres if m.axis == 1
    ]
    return verification.check_job(dataclasses.replace(job, manoeuvres=tuple(short)), loops)


@pytest.mark.parametrize("unequal", [False, True])
def test_free_platform_in_absolute_rates(job, unequal):
    """q̇ = w − E Omega, J ẇ = Q − G w, J_p Omega' = M − Eᵀ Q: no gyroscopic term in the platform's rows.

    At rest and with the root's own momentum h0 (which is not zero when L6 ≠ L8) in M.
    """
    platform = job.platform
    if unequal:
        rotors = tuple(
            dataclasses.replace(r, angular_momentum=m) for r, m in zip(platform.rotors, (0.18, 0.11, 0.15), strict=True)
        )
        platform = dataclasses.replace(platform, rotors=rotors)
    model = linearise(platform)
    E = np.array([[0, 1, 0], [0, 0, 1], [0, 0, -1], [0, 0, 1], [1, 0, 0]], float)
    J = model.M
    J_p = model.root_inertia - E.T @ J @ E
    n = 5
    mobility, turn = np.linalg.inv(J), np.linalg.inv(J_p)
    A = np.zeros((13, 13))
    A[:n, n : 2 * n] = np.eye(n)
    A[:n, 2 * n :] = -E
    A[n : 2 * n, n : 2 * n] = -mobility @ model.G
    B = np.zeros((13, 8))
    B[n : 2 * n, :n] = mobility
    B[2 * n :, :n] = -turn @ E.T
    B[2 * n :, n:] = turn
    C = np.zeros((8, 13))
    C[:n, :n] = np.eye(n)
    C[n:, 2 * n :] = np.eye(3)
    ours = state_space(model, root="free")
    for s in (3j, 40.0 + 10j, 470j, 2000j):
        expected = C @ np.linalg.solve(s * np.eye(13) - A, B)
        np.testing.assert_allclose(ours(s), expected, rtol=1e-9, atol=1e-12 * np.abs(expected).max())


def test_the_whole_meets_its_requirements(result):
    assert [f"{r.subject}: {r.name}" for r in result.requirements if not r.passed and r.stage != "decoupled"] == []
    stages = {r.stage for r in result.requirements}
    assert stages == {"decoupled", "coupled", "simulated"}
    assert result.subsystems == (("4", "5", "7"), ("9", "10"))


def test_coupled_poles_are_python_controls(job, controllers, result):
    plant = coupled_plant(job, linearise(job.platform), controllers).system
    loop = control.feedback(plant, result.coupled.controller, sign=1)
    ours, theirs = np.sort(np.abs(result.coupled.poles)), np.sort(np.abs(control.poles(loop)))
    np.testing.assert_allclose(ours[-6:], theirs[-6:], atol=1e-7)
    assert result.coupled.stable


def test_loop_by_loop_margins_by_breaking_one_channel(job, result):
    """The plain way: close all other channels with python-control, sweep the one that is left."""
    plant, K = result.coupled.plant, result.coupled.controller
    closed = analysis.closed_loop(plant, K)
    w = np.geomspace(2.0, 0.999 * np.pi / job.sampling.period, 3000)
    response = closed(np.exp(1j * w * job.sampling.period))
    for k in range(len(result.coupled.channels)):
        T = -response[k, k]
        swept = 1.0 / np.abs(0.5 - T).max()
        assert result.coupled.coupled[k] == pytest.approx(swept, rel=2e-3)


def test_simultaneous_margin_is_a_margin(result):
    """Complex gains 1 + δ inside the disk in all channels at once keep the loop stable; upper bound ≥ lower bound."""
    margin = result.coupled.simultaneous
    assert 0 < margin.unstructured <= margin.lower <= margin.upper
    assert margin.lower <= result.coupled.coupled.min() * (1 + 1e-9)
    rng = np.random.default_rng(7)
    plant, K = result.coupled.plant, result.coupled.controller
    alpha = 0.98 * margin.lower
    for _ in range(20):
        delta = alpha * rng.choice([-1.0, 1.0], len(result.coupled.channels))
        factor = np.diag((1 + delta / 2) / (1 - delta / 2))
        scaled = control.StateSpace(K.A, K.B, factor @ K.C, factor @ K.D, K.dt)
        scaled.input_labels, scaled.output_labels = K.input_labels, K.output_labels
        assert np.abs(np.linalg.eigvals(analysis.closed_loop(plant, scaled).A)).max() < 1.0


def test_the_platform_turns_the_gyros_reactions_into_little(result):
    assert result.coupled.cost.max() < 0.02
    np.testing.assert_allclose(result.coupled.cost, 1 - result.coupled.coupled / result.coupled.decoupled)


def test_small_non_linear_motion_is_the_linear_coupled_motion(job, controllers):
    """From a small tilt of gimbal 9 all loops bring the angles back as the sampled linear model says."""
    plant = coupled_plant(job, linearise(job.platform), controllers).system
    seen = [s.name for s in job.platform.pickoffs]
    whole = interconnected(controllers, seen, list(plant.input_labels), job.sampling.period)
    K = whole.to_control(seen, plant.input_labels)
    closed = analysis.closed_loop(plant, K)
    tilt = np.array([0, 0, 0, 1e-6, 0])
    run = simulated(
        job.platform,
        controllers,
        period=job.sampling.period,
        delay=job.sampling.delay,
        duration=0.2,
        mode="stabilised",
        noise=False,
        q=tilt,
        step=5e-5,
    )
    x = np.zeros(len(closed.A))
    x[3] = 1e-6
    q = []
    for _ in run.t:
        q.append((closed.C @ x)[-5:])
        x = closed.A @ x
    np.testing.assert_allclose(run.q, np.array(q), atol=2e-6 * 1e-6 * 1e3)


def test_a_weak_torquer_loses_the_gyro_and_the_verdict_says_so(job, controllers):
    """0.05 N m holds 0.33 rad/s at most: at 1 rad/s the gimbal runs away, and no requirement hides it."""
    weak = dataclasses.replace(
        job.platform,
        torquers=tuple(dataclasses.replace(t, limit=0.05 if t.gimbal else t.limit) for t in job.platform.torquers),
    )
    job = dataclasses.replace(job, platform=weak)
    run = simulate_manoeuvre(job, job.manoeuvres[0], controllers)
    assert not any(r.passed for r in run.results)
    assert largest(job, run.manoeuvre, run.trajectory)["torque_share"][0] > 1.0


def test_without_a_platform_loop_the_platform_is_carried(job, controllers):
    """Caging loops alone: Omega given, no coupling to pay for; one loop alone leaves the other gyros out."""
    model = linearise(job.platform)
    both = coupled_check(job, model, controllers[:2])
    assert both.stable
    assert both.plant.input_labels == ["Q4", "Q5", "Q7", "Q9", "Q10"]
    np.testing.assert_array_equal(both.cost, 0.0)
    lone = coupled_check(job, model, [controllers[1]])
    assert lone.stable
    assert lone.plant.output_labels == ["alpha9", "beta10"]
    np.testing.assert_allclose(lone.coupled, both.coupled[3:], rtol=1e-7)
