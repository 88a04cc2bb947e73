"""The caging loop of least rms: its claim recomputed, its robustness, and its place in a job."""

import dataclasses

import numpy as np
import pytest

from platform_ctrl.analysis.loop_metrics import measure
from platform_ctrl.design.jobs import loops
from platform_ctrl.design.loop import LoopProblem
from platform_ctrl.design.plants import loop_plants
from platform_ctrl.design.riccati.weighted_loop import hinf_design, lqg_design
from platform_ctrl.errors import DesignError
from platform_ctrl.job.reading import read_job
from platform_ctrl.mechanics.linearisation import linearise

JOB = {
    "schema": 2,
    "name": "caging 9-10",
    "plant": "three_gyro_platform",
    "operation": {"Omega": [1.0, 1.0, 1.0]},
    "uncertainty": {"inertia": 0.1, "spin": 0.1},
    "sampling": {"rate_hz": 2000, "delay": 0.0005},
    "loop": [
        {
            "name": "caging 9-10",
            "kind": "caging",
            "gimbals": ["9", "10"],
            "use": "LQG",
            "limits": {"disk_margin": 0.5, "damping": 0.2, "disk_margin_worst_case": 0.4, "damping_worst_case": 0.1},
            "design": [{"name": "LQG", "method": "lqg"}],
        }
    ],
}


@pytest.fixture(scope="module")
def loop():
    job = read_job(JOB)
    (spec,), plants = job.loops, loop_plants(job, ("9", "10"))
    return LoopProblem(job=job, spec=spec, design=spec.designs[0], model=linearise(job.platform), plant_set=plants)


def test_the_claimed_norm_is_the_rms_of_the_weighted_sampled_loop(loop):
    """Recomputed by integrating along the unit circle, from plant, controller and weights alone."""
    plants, channel, found = loop.plants, loop.channel, lqg_design(loop)
    controller, options, claims = found.controller, found.options, found.claims
    assert claims["gamma"] == pytest.approx(claims["gamma_optimal"], rel=1e-6)
    T = plants.period
    # Half steps keep clear of the integrator at z = 1; the sum of a periodic function converges fast.
    angle = 2 * np.pi * (np.arange(20_000) + 0.5) / 20_000
    z = np.exp(1j * angle)
    s = 2 / T * (z - 1) / (z + 1)

    def at(A, B, C, D):
        return C @ np.linalg.solve(z[:, None, None] * np.eye(len(A)) - A, np.broadcast_to(B, (len(z), *B.shape))) + D

    P, K = at(plants.A[0], plants.B[0], plants.C[0], plants.D[0]), at(*controller[:4])
    unit = channel.momenta[0] * plants.nutation
    We = (1 / options["sensitivity_peak"] + 2 * np.pi * options["bandwidth_hz"] / s)[:, None, None]
    S = np.linalg.inv(np.eye(2) - P @ K)
    d = options["disturbance"] * unit
    seen = np.concatenate([S, S @ P * d], axis=2)  # y + n
    rest = np.concatenate([S - np.eye(2), S @ P * d], axis=2)
    out = np.concatenate([We * seen, options["complementary"] * rest, options["torque"] * K @ seen / unit], axis=1)
    assert np.sqrt(np.mean(np.sum(np.abs(out) ** 2, axis=(1, 2)))) == pytest.approx(claims["gamma"], rel=1e-6)


def test_it_needs_less_torque_noise_than_the_loop_that_bounds_the_peak(loop):
    rms, peak = (measure(loop.plants, found.controller) for found in (lqg_design(loop), hinf_design(loop, "riccati")))
    assert rms.torque_noise.max() < 0.5 * peak.torque_noise.max()
    assert rms.damping.min() > 0.1


def test_a_job_may_ask_for_it_and_its_loop_meets_the_limits_over_the_spread():
    (outcome,) = loops(JOB)
    assert outcome.closed.method == "lqg"
    assert outcome.closed.passed
    assert set(outcome.closed.claims) >= {"gamma", "gamma_optimal"}


def test_an_option_of_another_method_is_refused(loop):
    other = dataclasses.replace(loop.design, options={"backoff": 0.1})
    with pytest.raises(DesignError, match="lqg: option 'backoff' has no meaning"):
        lqg_design(dataclasses.replace(loop, design=other))


def test_a_design_that_fails_is_named_by_loop_and_design():
    (spec,) = read_job(JOB).loops
    slow = {**JOB["loop"][0]["design"][0], "bandwidth_hz": 1e-9}
    with pytest.raises(DesignError, match=rf"^{spec.name}, {slow['name']}: h2: the plant is not detectable") as caught:
        loops({**JOB, "loop": [{**JOB["loop"][0], "design": [slow]}]})
    assert caught.value.problem is not None
