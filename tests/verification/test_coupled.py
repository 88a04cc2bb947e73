"""The coupled check against an independent model in absolute rates, and the non-linear run against the linear one."""

import dataclasses

import control
import numpy as np
import pytest

from platform_ctrl import analysis, design, linearise, read_job, verification
from platform_ctrl.verification.coupled import coupled_check
from platform_ctrl.verification.coupled_plant import coupled_plant
from platform_ctrl.verification.simulated import largest, simulate_manoeuvre


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


def test_coupled_poles_are_python_controls(job, controllers, result):
    plant = coupled_plant(job, linearise(job.platform), controllers).system
    loop = control.feedback(plant, result.coupled.controller, sign=1)
    ours, theirs = np.sort(np.abs(result.coupled.poles)), np.sort(np.abs(control.poles(loop)))
    np.testing.assert_allclose(ours[-6:], theirs[-6:], atol=1e-7)
    assert result.coupled.stable


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
