"""The full-order caging loop: two routes, the certificate, and what the disturbance input is for."""

import dataclasses

import numpy as np
import pytest

from platform_ctrl.analysis.loop_metrics import measure
from platform_ctrl.design.loop import LoopProblem, certified
from platform_ctrl.design.plants import loop_plants
from platform_ctrl.design.riccati.weighted_loop import hinf_design, hinf_options, weighted_plant
from platform_ctrl.errors import DesignError
from platform_ctrl.job.reading import read_job
from platform_ctrl.mechanics.linearisation import linearise


@pytest.fixture(scope="module")
def loop():
    job = read_job("examples/three_gyro_platform.toml")
    plants, spec = loop_plants(job, ("9", "10")).only([0, *range(1, 9)]), job.loops[1]
    return LoopProblem(job=job, spec=spec, design=spec.designs[1], model=linearise(job.platform), plant_set=plants)


def with_options(problem, options):
    return dataclasses.replace(problem, design=dataclasses.replace(problem.design, options=options))


@pytest.fixture(scope="module")
def by_route(loop):
    return {route: hinf_design(loop, route) for route in ("lmi", "riccati")}


def test_both_routes_find_the_same_bound(by_route):
    lmi, riccati = (by_route[route].claims for route in ("lmi", "riccati"))
    assert lmi["gamma_optimal"] == pytest.approx(riccati["gamma_optimal"], rel=5e-3)
    for claims in (lmi, riccati):
        assert claims["gamma_optimal"] <= claims["gamma"] <= 1.11 * claims["gamma_optimal"]


def test_a_job_s_loop_takes_the_riccati_route_by_default(loop, by_route):
    assert hinf_design(loop).claims == by_route["riccati"].claims


@pytest.mark.parametrize("route", ["lmi", "riccati"])
def test_the_sampled_controller_meets_what_the_job_asks(loop, by_route, route):
    design = certified(loop.spec, loop.design, by_route[route], loop.plants)
    assert [r.name for r in design.results if not r.passed] == []
    assert {"bandwidth", "disk margin, worst case", "damping, worst case"} < {r.name for r in design.results}


def test_the_claimed_norm_is_that_of_the_weighted_sampled_loop(loop, by_route):
    """Recomputed along the unit circle from plant, controller and weights alone."""
    plants, channel, found = loop.plants, loop.channel, by_route["lmi"]
    controller, options, claims = found.controller, found.options, found.claims
    T = plants.period
    w = np.concatenate([np.geomspace(0.1, 6200.0, 1500), np.linspace(200, 600, 800)])
    z = np.exp(1j * w * T)
    s = 2 / T * (z - 1) / (z + 1)

    def at(A, B, C, D):
        return C @ np.linalg.solve(z[:, None, None] * np.eye(len(A)) - A, np.broadcast_to(B, (len(z), *B.shape))) + D

    P, K = at(plants.A[0], plants.B[0], plants.C[0], plants.D[0]), at(*controller[:4])
    unit = channel.momenta[0] * plants.nutation
    We = 1 / options["sensitivity_peak"] + 2 * np.pi * options["bandwidth_hz"] / s
    S = np.linalg.inv(np.eye(2) - P @ K)
    d = options["disturbance"] * unit
    seen = np.concatenate([S, S @ P * d], axis=2)  # y + n
    angle = np.concatenate([S - np.eye(2), S @ P * d], axis=2)
    torque = K @ seen / unit
    z_out = np.concatenate(
        [We[:, None, None] * seen, options["complementary"] * angle, options["torque"] * torque], axis=1
    )
    peak = np.linalg.norm(z_out, 2, axis=(1, 2)).max()
    assert peak == pytest.approx(claims["gamma"], rel=2e-3)


def test_without_the_torque_disturbance_nutation_is_left_undamped(loop, by_route):
    plants = loop.plants
    damped = measure(plants, by_route["riccati"].controller).damping[0]
    undisturbed = with_options(loop, loop.design.options | {"disturbance": 0.004})
    bare = measure(plants, hinf_design(undisturbed, "riccati").controller)
    assert bare.damping[0] < 0.1 * damped


def test_the_weighted_plant_has_the_delay_inside(loop):
    """Two channels: gimbal angles and momenta, two lags, two held torques, two integrators: ten states, no Padé."""
    plants, channel = loop.plants, loop.channel
    options = hinf_options(loop.design, channel, plants.nutation, plants.period)
    weighted = weighted_plant(options, channel, plants)
    assert weighted.arrays.A.shape == (10, 10)


def test_wrong_options_are_named(loop):
    with pytest.raises(DesignError, match="inertial_torque"):
        hinf_design(with_options(loop, {"inertial_torque": 1.0}))
    with pytest.raises(DesignError, match="must be > 0"):
        hinf_design(with_options(loop, {"torque": 0.0}))
