"""A small camera gimbal, elevation over azimuth, with gyros on its payload and a rate loop: numbers invented."""

from __future__ import annotations

import copy
from typing import Any

J_AZIMUTH, J_ELEVATION = 0.03, 0.018
FRICTION = 0.01

_PLANT: dict[str, Any] = {
    "schema": 1,
    "name": "small camera gimbal",
    "root": {"name": "vehicle", "inertia": [5.0, 6.0, 7.0]},
    "gimbal": [
        {"name": "az", "parent": "vehicle", "axis": [0, 0, 1], "inertia": [0.011, 0.011, J_AZIMUTH - 0.019]},
        {"name": "el", "parent": "az", "axis": [0, 1, 0], "inertia": [0.02, J_ELEVATION, 0.019], "stops": [-0.9, 1.55]},
    ],
    "torquer": [{"gimbal": "az", "limit": 2.0, "lag": 2e-4}, {"gimbal": "el", "limit": 2.0, "lag": 2e-4}],
    "pickoff": [{"gimbal": "az"}, {"gimbal": "el"}],
    "friction": [{"gimbal": "az", "coulomb": FRICTION}, {"gimbal": "el", "coulomb": FRICTION}],
    "rate_sensor": [
        {"name": "pitch_gyro", "body": "el", "axis": [0, 1, 0], "noise_density": 1e-5},
        {"name": "yaw_gyro", "body": "el", "axis": [0, 0, 1], "noise_density": 1e-5},
    ],
    "attitude_sensor": [
        {"name": "pitch_error", "body": "el", "axis": [0, 1, 0], "noise_rms": 1e-6},
        {"name": "yaw_error", "body": "el", "axis": [0, 0, 1], "noise_rms": 1e-6},
    ],
    "line_of_sight": {"body": "el", "direction": [1, 0, 0]},
}
_JOB: dict[str, Any] = {
    "schema": 2,
    "name": "camera",
    "operation": {"Omega": [0.2, 0.2, 0.2]},
    "sampling": {"rate_hz": 2000, "delay": 0.0002},
    "loop": [
        {
            "name": "rate",
            "kind": "rate",
            "gimbals": ["az", "el"],
            "sensors": ["yaw_gyro", "pitch_gyro"],
            "use": "pi",
            "limits": {"disk_margin": 0.5},
            "design": [{"name": "pi", "method": "pi", "crossover_hz": 30, "integral_hz": 3}],
        }
    ],
    "coupled": {"disk_margin": 0.3},
}


def camera_plant(**changes: Any) -> dict[str, Any]:
    """Return the plant with other tables."""
    return copy.deepcopy(_PLANT | changes)


def camera_job(**changes: Any) -> dict[str, Any]:
    """Return the job with other tables; "plant" is the plant above unless it is given."""
    return copy.deepcopy(_JOB | {"plant": camera_plant()} | changes)


def camera_loop(kind: str = "rate", method: str = "pi", **changes: Any) -> list[dict[str, Any]]:
    """Return the job's loops: one, of another kind, method or with other keys."""
    loop = copy.deepcopy(_JOB["loop"][0]) | {"kind": kind, "design": [{"name": "pi", "method": method}]}
    if kind == "pointing":
        loop["sensors"] = ["yaw_error", "pitch_error"]
    return [loop | changes]


def tracking_loop(limits: dict[str, float], around: str = "rate", *sensors: str, **design: Any) -> dict[str, Any]:
    """Return a loop around a rate loop that it commands, by the trackers of the camera or by these sensors."""
    own, read = {"name": "pi", "method": "pi"} | design, [*(sensors or ("yaw_error", "pitch_error"))]
    loop = {"name": "track", "kind": "tracking", "around": around, "sensors": read, "use": own["name"]}
    return loop | {"limits": limits, "design": [own]}
