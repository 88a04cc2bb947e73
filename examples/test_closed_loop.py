"""A regression test to keep beside a project: the caged gyro 9-10 must not get worse.

    pytest examples/test_closed_loop.py

The loop is designed from fixed numbers, or read from the result.json named in CONTROLLERS; bandwidth, margin, damping
and torque noise are computed anew from the closed loop and held against figures that were once accepted. Whoever
changes the plant, the controller or this package and makes the loop worse by more than the tolerance gets a red test
that says which figure, and by how much. When a change is wanted, `pytest -s` prints the new figures.
"""

from __future__ import annotations

import numpy as np
import pytest

import platform_ctrl as pc

CONTROLLERS = None  # or "out/result.json", as `platform-ctrl design` writes it
CONTROLLER = {
    "name": "PI across, lead along",
    "method": "classical",
    "crossover_hz": 70,
    "integral_hz": 2,
    "damping_hz": 78,
    "damping2_hz": 92,
    "lead_hz": 7,
    "rolloff_hz": 900,
    "notch_hz": 200,
    "notch_depth": 0.7,
    "notch_width": 0.15,
}
JOB = {
    "schema": 1,
    "name": "gyro 9-10",
    "plant": "three_gyro_platform",
    "operation": {"Omega": [0.0, 0.0, 0.0]},
    "sampling": {"rate_hz": 2000, "delay": 0.0005},
    "loop": [
        {
            "name": "caging 9-10",
            "kind": "caging",
            "gimbals": ["9", "10"],
            "use": CONTROLLER["name"],
            "design": [CONTROLLER],
        }
    ],
}

# Accepted figures, and the direction that is better.
BASELINE = {
    "bandwidth, Hz": (47.59, "more"),
    "disk margin": (0.5511, "more"),
    "damping": (0.1195, "more"),
    "torque noise, N m rms": (0.004493, "less"),
}
TOLERANCE = 0.02  # relative

TORQUES, ANGLES = ["Q9", "Q10"], ["alpha9", "beta10"]


def figures() -> dict[str, float]:
    """What the closed loop does, computed from its plant and its controller alone."""
    job = pc.read_job(JOB)
    platform, sampling = job.platform, job.sampling
    gyro = pc.state_space(pc.linearise(platform), gimbals=("9", "10"))[ANGLES, TORQUES]
    lag = [torquer.lag for torquer in platform.torquers if torquer.gimbal in ("9", "10")]
    plant = pc.analysis.sampled(gyro, sampling.period, sampling.delay, lag)
    if CONTROLLERS is None:
        controller = pc.design.loops(job)[0].closed.controller
    else:
        every = pc.check.read_controllers(CONTROLLERS, job)
        controller = next(K for K in every if set(K.output_labels) == set(TORQUES))

    closed = pc.analysis.closed_loop(plant, controller)
    noise = [pickoff.sampled_noise(sampling.period) for pickoff in platform.pickoffs if pickoff.gimbal in ("9", "10")]
    noise_to_torque = closed[TORQUES, [f"noise_{angle}" for angle in ANGLES]]
    nutation = np.abs(pc.analysis.poles(gyro)).max()
    poles = pc.analysis.poles(closed)
    return {
        "bandwidth, Hz": pc.analysis.bandwidth(plant, controller) / (2.0 * np.pi),
        "disk margin": pc.analysis.disk_margin(pc.analysis.loop_transfer(plant, controller)).lower,
        "damping": float(pc.analysis.minimum_damping(poles, above=0.1 * nutation, dt=sampling.period)),
        "torque noise, N m rms": float(pc.analysis.noise_rms(noise_to_torque, noise).max()),
    }


@pytest.fixture(scope="module")
def measured() -> dict[str, float]:
    """Measure once for all tests."""
    found = figures()
    print(*(f"{name}: {value:.5g}" for name, value in found.items()), sep="\n")
    return found


@pytest.mark.parametrize("name", BASELINE)
def test_is_not_worse_than_what_was_accepted(measured: dict[str, float], name: str) -> None:
    """Fail where a figure is worse than the accepted one by more than the tolerance."""
    accepted, better = BASELINE[name]
    if better == "more":
        assert measured[name] >= accepted * (1.0 - TOLERANCE)
    else:
        assert measured[name] <= accepted * (1.0 + TOLERANCE)
