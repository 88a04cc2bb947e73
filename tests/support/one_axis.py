"""Plants of one gimbal about axis 3, and jobs of one loop, in a few lines."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any


def one_axis(inertia: Any, root: dict[str, Any] | None = None, **tables: Any) -> dict[str, Any]:
    """Return the plant of gimbal g with the angle q on a base, with these tables; `root` are other keys of the base."""
    gimbal = {"name": "g", "parent": "base", "axis": [0, 0, 1], "inertia": inertia, "angle": "q"}
    base = {"name": "base", "inertia": [1.0, 1.0, 1.0]} | (root or {})
    return {"schema": 1, "name": "one axis", "root": base, "gimbal": [gimbal]} | tables


def loop_of(gimbals: Sequence[str], sensors: Sequence[str] = (), method: str = "classical", **keys: Any) -> Any:
    """Return a pointing loop, or one with other keys, of one design; the keys of `design` are further options."""
    design = {"name": "d", "method": method} | keys.pop("design", {})
    loop = {"name": "L", "kind": "pointing", "gimbals": list(gimbals), "use": design["name"], "design": [design]}
    return loop | ({"sensors": list(sensors)} if sensors else {}) | keys


def job_of(plant: Any, *loops: Any, rate_hz: float = 1000.0, delay: float = 0.0, **tables: Any) -> dict[str, Any]:
    """Return a job of these loops with these tables."""
    sampling, operation = {"rate_hz": rate_hz, "delay": delay}, {"Omega": [0.1, 0.1, 0.1]}
    data = {"schema": 2, "name": "one axis", "plant": plant, "operation": operation, "sampling": sampling}
    return data | {"loop": list(loops)} | tables
