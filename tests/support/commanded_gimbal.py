"""A balanced gimbal about one axis on a base at rest, with a gyro and an attitude sensor: a rate or a pointing loop."""

from __future__ import annotations

import copy
from typing import Any

INERTIA, RATE_HZ = 0.02, 1000.0
_PLANT: dict[str, Any] = {
    "schema": 1,
    "name": "one axis",
    "root": {"name": "base", "inertia": [1.0, 1.0, 1.0]},
    "gimbal": [{"name": "yaw", "parent": "base", "axis": [0, 0, 1], "inertia": [INERTIA, INERTIA, INERTIA]}],
    "torquer": [{"gimbal": "yaw", "limit": 5.0}],
    "pickoff": [{"gimbal": "yaw"}],
    "rate_sensor": [{"name": "gyro", "body": "yaw", "axis": [0, 0, 1]}],
    "attitude_sensor": [{"name": "heading", "body": "yaw", "axis": [0, 0, 1]}],
    "line_of_sight": {"body": "yaw", "direction": [1, 0, 0]},
}
_JOB: dict[str, Any] = {
    "schema": 2,
    "name": "commanded",
    "operation": {"Omega": [0.1, 0.1, 0.1]},
    "sampling": {"rate_hz": RATE_HZ, "delay": 0.0},
}


def commanded_job(
    commands: list[dict[str, Any]], kind: str = "rate", limits: dict[str, float] | None = None, **design: Any
) -> dict[str, Any]:
    """Return a job whose run has these commands: a rate loop by a PI, or a pointing loop by a classical controller."""
    rate = kind == "rate"
    given = {"name": "own", "method": "pi" if rate else "classical"} | design
    loop = {
        "name": "loop",
        "kind": kind,
        "gimbals": ["yaw"],
        "sensors": ["gyro" if rate else "heading"],
        "use": "own",
        "design": [given],
    }
    run = {"name": "slew", "mode": "caged", "duration": 1.0, "command": commands, "limits": limits or {}}
    return copy.deepcopy(_JOB | {"plant": _PLANT, "loop": [loop], "manoeuvre": [run]})
