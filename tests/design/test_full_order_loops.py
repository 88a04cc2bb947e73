"""The full-order H-infinity caging loop: its claims recomputed, the two routes, their place in a job."""

import dataclasses

import numpy as np
import pytest

from platform_ctrl.analysis.loop_metrics import measure
from platform_ctrl.analysis.system import System
from platform_ctrl.design.loop import measured
from platform_ctrl.design.method import LoopProblem
from platform_ctrl.design.methods import read_job
from platform_ctrl.design.methods.hinf import hinf_controller, hinf_options, weighted_plant
from platform_ctrl.design.plants import loop_plants
from platform_ctrl.mechanics.linearisation import linearise


@pytest.fixture(scope="module")
def loop():
    """The loop 9-10 of the example with its H-infinity design, with nine of its plants."""
    job = read_job("examples/three_gyro_platform.toml")
    plants, spec = loop_plants(job, ("9", "10")).only(range(9)), job.loops[1]
    return LoopProblem(job=job, spec=spec, design=spec.designs[1], model=linearise(job.platform), plant_set=plants)


def with_options(problem, options):
    return dataclasses.replace(problem, design=dataclasses.replace(problem.design, options=options))


@pytest.fixture(scope="module")
def by_route(loop):
    return {route: loop.made(*hinf_controller(loop, route)) for route in ("lmi", "riccati")}


def test_both_routes_find_the_same_bound(loop, by_route):
    lmi, riccati = (by_route[route].claims for route in ("lmi", "riccati"))
    assert lmi["gamma_optimal"] == pytest.approx(riccati["gamma_optimal"], rel=5e-3)
    for claims in (lmi, riccati):
        assert claims["gamma_optimal"] <= claims["gamma"] <= 1.11 * claims["gamma_optimal"]
    assert hinf_controller(loop)[2] == riccati


@pytest.mark.parametrize("route", ["lmi", "riccati"])
def test_the_sampled_controller_meets_the_limits_of_the_job(loop, by_route, route):
    design = measured(loop.spec, loop.design.name, "hinf", by_route[route].controller, loop.plants)
    assert [r.name for r in design.results if not r.passed] == []
    assert {"bandwidth", "disk margin, worst case", "damping, worst case"} < {r.name for r in design.results}


def weighted_response(problem, found, z):
    """From noise and torque disturbance to the weighted outputs at points z, from plant, controller and weights."""
    plants, options = problem.plants, found.options

    def at(A, B, C, D):
        return C @ np.linalg.solve(z[:, None, None] * np.eye(len(A)) - A, np.broadcast_to(B, (len(z), *B.shape))) + D

    P, K = at(plants.A[0], plants.B[0], plants.C[0], plants.D[0]), at(*System.of(found.controller, "K")[:4])
    s = 2 / plants.period * (z - 1) / (z + 1)
    unit = problem.channel.momenta[0] * plants.nutation
    We = (1 / options["sensitivity_peak"] + 2 * np.pi * options["bandwidth_hz"] / s)[:, None, None]
    S = np.linalg.inv(np.eye(2) - P @ K)
    disturbed = S @ P * (options["disturbance"] * unit)
    measured = np.concatenate([S, disturbed], axis=2)
    angle = np.concatenate([S - np.eye(2), disturbed], axis=2)
    outputs = [We * measured, options["complementary"] * angle, options["torque"] * K @ measured / unit]
    return np.concatenate(outputs, axis=1)


def test_the_claimed_h_infinity_norm_is_the_peak_along_the_unit_circle(loop, by_route):
    w = np.concatenate([np.geomspace(0.1, 6200.0, 1500), np.linspace(200, 600, 800)])
    response = weighted_response(loop, by_route["lmi"], np.exp(1j * w * loop.plants.period))
    peak = np.linalg.norm(response, 2, axis=(1, 2)).max()
    assert peak == pytest.approx(by_route["lmi"].claims["gamma"], rel=2e-3)


def test_without_the_torque_disturbance_nutation_is_left_undamped(loop, by_route):
    damped = measure(loop.plants, System.of(by_route["riccati"].controller, "K")).damping[0]
    undisturbed = with_options(loop, loop.design.options | {"disturbance": 0.004})
    bare = measure(loop.plants, hinf_controller(undisturbed, "riccati")[0])
    assert bare.damping[0] < 0.1 * damped


def test_the_weighted_plant_contains_the_delay(loop):
    """Two channels: gimbal angles and momenta, two lags, two held torques, two integrators: ten states, no Padé."""
    options = hinf_options(loop.design.options, loop.channel, loop.plants.nutation, loop.plants.period)
    assert weighted_plant(options, loop.channel, loop.plants).arrays.A.shape == (10, 10)
