"""A camera with a rate loop on a yoke without torquer, on a spring of 85 Hz and coupled by a product of inertia."""

from __future__ import annotations

import math
from typing import Any

from camera_job import camera_job

J_YOKE, J_CAMERA, PRODUCT = 0.01, 0.02, 0.004  # kg m²


def passive_job() -> dict[str, Any]:
    """Return the job; its loop turns the camera alone."""
    camera = [[J_CAMERA, PRODUCT, 0.0], [PRODUCT, J_CAMERA, 0.0], [0.0, 0.0, J_CAMERA]]
    plant = {
        "schema": 1,
        "name": "camera on a flexible yoke",
        "root": {"name": "vehicle", "inertia": [5.0, 6.0, 7.0]},
        "gimbal": [
            {"name": "yoke", "parent": "vehicle", "axis": [1, 0, 0], "inertia": [J_YOKE] * 3},
            {"name": "camera", "parent": "yoke", "axis": [0, 1, 0], "inertia": camera},
        ],
        "spring": [{"gimbal": "yoke", "stiffness": (math.tau * 85.0) ** 2 * J_YOKE}],
        "friction": [{"gimbal": "yoke", "viscous": 0.2}],
        "torquer": [{"gimbal": "camera", "limit": 2.0}],
        "pickoff": [{"gimbal": "camera"}],
        "rate_sensor": [{"name": "gyro", "body": "camera", "axis": [0, 1, 0], "noise_density": 1e-5}],
        "line_of_sight": {"body": "camera", "direction": [1, 0, 0]},
    }
    loop = {
        "name": "rate",
        "kind": "rate",
        "gimbals": ["camera"],
        "sensors": ["gyro"],
        "use": "pi",
        "limits": {"disk_margin": 0.2},
        "design": [{"name": "pi", "method": "pi", "crossover_hz": 15, "integral_hz": 1.5}],
    }
    return camera_job(plant=plant, loop=[loop])
