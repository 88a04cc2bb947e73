"""A two-axis gimbal with a camera: gyros on the payload, an encoder, a tracker and a line of sight; skew on demand."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import control
import numpy as np

from oracle_trees import turn
from platform_ctrl import Platform, read_platform

PLANT: dict[str, Any] = {
    "schema": 1,
    "name": "gimbal with a line of sight",
    "source": "assumed",
    "root": {"name": "base", "inertia": [0.3, 0.4, 0.5], "specific_force": [0.0, 0.0, 9.81]},
    "gimbal": [
        {"name": "yaw", "parent": "base", "axis": [0, 0, 1], "inertia": [3e-3, 3e-3, 4e-3]},
        {"name": "pitch", "parent": "yaw", "axis": [0, 1, 0], "inertia": [1e-3, 2e-3, 2e-3]},
    ],
    "torquer": [{"gimbal": "yaw", "limit": 0.5}, {"gimbal": "pitch", "limit": 0.5}],
    "pickoff": [{"gimbal": "yaw"}, {"gimbal": "pitch"}],
    "rate_sensor": [
        {"name": "gyro2", "body": "pitch", "axis": [0, 1, 0]},
        {"name": "gyro3", "body": "pitch", "axis": [0, 0, 1], "misalignment": [0.01, -0.02, 0.03]},
    ],
    "angle_sensor": [{"name": "encoder", "gimbal": "pitch", "quantisation": 1e-6}],
    "attitude_sensor": [{"name": "tracker", "body": "pitch", "axis": [0, 1, 0]}],
    "line_of_sight": {"body": "pitch", "direction": [1, 0, 0]},
}


def sighted(**tables: Any) -> Platform:
    """Return the plant, with other tables."""
    return read_platform({**PLANT, **tables})


def skewed(platform: Platform) -> Platform:
    """Return it with gimbals, sensors and line of sight about axes that are along none of the bodies'."""
    skew = turn(np.array([2.0, -1.0, 2.0]) / 3.0, 0.7)
    sight = platform.line_of_sight
    assert sight is not None
    return replace(
        platform,
        gimbals=tuple(replace(g, axis=skew @ g.axis) for g in platform.gimbals),
        rate_sensors=tuple(replace(s, axis=skew @ s.axis) for s in platform.rate_sensors if s.axis is not None),
        attitude_sensors=tuple(replace(s, axis=skew @ s.axis) for s in platform.attitude_sensors),
        line_of_sight=replace(sight, direction=skew @ sight.direction),
    )


# A sine of HZ Hz moves the base; viscous friction carries it over, a rate loop holds the payload against it.
FRICTION, GAIN, HZ = 0.01, 0.5, 4.0
JOB: dict[str, Any] = {
    "schema": 2,
    "name": "steady",
    "plant": {**PLANT, "friction": [{"gimbal": "pitch", "viscous": FRICTION}]},
    "operation": {"Omega": [0.1, 0.1, 0.1]},
    "sampling": {"rate_hz": 5000, "delay": 0.0},
    "loop": [
        {
            "name": "pitch rate",
            "kind": "rate",
            "gimbals": ["pitch"],
            "sensors": ["gyro2"],
            "use": "pi",
            "design": [{"name": "pi", "method": "pi"}],
        }
    ],
    "manoeuvre": [
        {
            "name": "sine",
            "mode": "caged",
            "duration": 1.25,
            "settle": 0.25,
            "sine": [{"kind": "rate", "axis": 2, "frequency_hz": HZ, "amplitude": 0.2}],
            "limits": {"attenuation_db": 30.0, "los_rate_rms": 1e-2, "los_angle_rms": 1e-3, "gimbal_rate": 1.0},
        }
    ],
}


def damped() -> control.StateSpace:
    """Return a controller that makes a damper of the payload's gyro."""
    return control.ss([], [], [], [[-GAIN]], 2e-4, inputs=["gyro2"], outputs=["Qpitch"], name="damper")
