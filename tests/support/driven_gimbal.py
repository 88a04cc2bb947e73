"""Gimbals with dry friction, gyros on the payload and on the base, and the drives of their torquers."""

from __future__ import annotations

import copy
from typing import Any

INERTIA, COULOMB, COULOMB_RATE, VISCOUS, RATE_HZ = 0.02, 0.02, 0.01, 0.003, 1000.0
FRICTION = {"torquer": "Qouter", "friction": COULOMB, "friction_rate": 0.01, "sensors": ["base_yaw"]}
_SPHERE = [INERTIA, INERTIA, INERTIA]
_PLANT: dict[str, Any] = {
    "schema": 1,
    "name": "two axes",
    "root": {"name": "base", "inertia": [1.0, 1.0, 1.0]},
    "gimbal": [
        {"name": "outer", "angle": "yaw", "parent": "base", "axis": [0, 0, 1], "inertia": _SPHERE},
        {"name": "inner", "angle": "pitch", "parent": "outer", "axis": [0, 1, 0], "inertia": _SPHERE},
    ],
    "torquer": [{"gimbal": "outer"}, {"gimbal": "inner"}],
    "pickoff": [{"gimbal": "outer"}, {"gimbal": "inner"}],
    "rate_sensor": [
        {"name": "gyro", "body": "inner", "axis": [0, 0, 1]},
        {"name": "pitch_gyro", "body": "inner", "axis": [0, 1, 0]},
        {"name": "base_yaw", "body": "base", "axis": [0, 0, 1]},
        {"name": "base_oblique", "body": "base", "axis": [0, 0.6, 0.8]},
        {"name": "base_pitch", "body": "base", "axis": [0, 1, 0]},
        {"name": "tacho", "gimbal": "outer"},
    ],
    "friction": [{"gimbal": "outer", "coulomb": COULOMB, "coulomb_rate": COULOMB_RATE, "viscous": VISCOUS}],
    "line_of_sight": {"body": "inner", "direction": [1, 0, 0]},
}
_JOB: dict[str, Any] = {
    "schema": 2,
    "name": "driven",
    "operation": {"Omega": [0.1, 0.1, 0.1]},
    "sampling": {"rate_hz": RATE_HZ, "delay": 0.0},
    "loop": [
        {
            "name": "loop",
            "kind": "rate",
            "gimbals": ["outer", "inner"],
            "sensors": ["gyro", "pitch_gyro"],
            "use": "own",
            "design": [{"name": "own", "method": "pi"}],
        }
    ],
    "manoeuvre": [
        {
            "name": "yaw",
            "mode": "caged",
            "duration": 1.0,
            "sine": [{"kind": "rate", "axis": 3, "frequency_hz": 2.0, "amplitude": 0.1}],
        }
    ],
}


def resolved_job(*drives: dict[str, Any], **changed: Any) -> dict[str, Any]:
    """Return the same with readings that are turned to the axes of the gimbals."""
    data = driven_job(*drives, **changed)
    data["loop"][0]["resolve"] = True
    return data


def skew_job() -> dict[str, Any]:
    """Return a job of three gimbals about oblique axes, with turned readings of gyros on two of them."""
    axes = {"a": [0.48, 0.6, 0.64], "b": [0.6, -0.8, 0], "c": [0, 0.28, 0.96]}
    parents = {"a": "base", "b": "a", "c": "b"}
    data = driven_job()
    plant, loop = data["plant"], data["loop"][0]
    plant["gimbal"] = [{"name": n, "parent": parents[n], "axis": axes[n], "inertia": _SPHERE} for n in axes]
    plant["torquer"] = plant["pickoff"] = [{"gimbal": name} for name in axes]
    sensing = [("c", [1, 0, 0]), ("b", [0, 0.8, 0.6]), ("c", [0, 0, 1])]
    plant["rate_sensor"] = [
        {"name": f"gyro{k}", "body": body, "axis": axis, "noise_rms": 1e-3} for k, (body, axis) in enumerate(sensing)
    ]
    del plant["friction"], plant["line_of_sight"]
    loop |= {"gimbals": ["b", "a", "c"], "sensors": ["gyro0", "gyro1", "gyro2"], "resolve": True}
    return data


def less_base(data: dict[str, Any], **more: Any) -> dict[str, Any]:
    """Return a job whose turned readings are those less the base's motion, from gyros about oblique axes on it."""
    axes = ([0.6, 0.8, 0], [0, 0.6, 0.8], [0.8, 0, -0.6])
    gyros = [{"name": f"root{k}", "body": "base", "axis": axis} | more for k, axis in enumerate(axes)]
    data["plant"]["rate_sensor"] += gyros
    data["loop"][0]["resolve_base"] = [one["name"] for one in gyros]
    return data


def driven_job(*drives: dict[str, Any], **changed: Any) -> dict[str, Any]:
    """Return a job of a rate loop on both gimbals with these drives."""
    return copy.deepcopy(_JOB | {"plant": _PLANT} | ({"drive": list(drives)} if drives else {}) | changed)
