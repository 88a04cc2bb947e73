"""Parts of a `Platform` as records: each is read out of a plant that has no more than what it is fixed to."""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import Any

import platform_ctrl as pc

_BODIES = ("gimbal", "parent", "carrier", "body", "senses")
# What a file has to say of a part beside words, before its own numbers take these places.
_NEEDED: dict[str, dict[str, Any]] = {
    "gimbal": {"axis": [1, 0, 0], "inertia": [1, 1, 1]},
    "rotor": {"axis": [1, 0, 0], "axial_inertia": 1, "transverse_inertia": 1, "angular_momentum": 1, "speed_gain": 1},
    "spring": {"stiffness": 1},
    "friction": {"viscous": 1},
    "cage": {"stiffness": 1},
    "unbalance": {"moment": [1, 0, 0]},
    "erection": {"axis": [1, 0, 0], "gain": 1},
}


def part(table: str, **fields: Any) -> Any:
    """Return the record of a part by the table that it has in a plant file, with exactly these fields."""
    numbers = {key: item for key, item in fields.items() if item is not None and not isinstance(item, str)}
    words = {key: item for key, item in fields.items() if isinstance(item, str) or key == "root_axis"}
    plain = words | _NEEDED.get(table, {})
    if table == "rotor" and words.get("control") != "servo":
        del plain["speed_gain"]
    bodies = dict.fromkeys(fields[key] for key in _BODIES if fields.get(key) is not None)
    base: dict[str, Any] = {"parent": "what carries it", "axis": [1, 0, 0], "inertia": [1, 1, 1]}
    tables: dict[str, Any] = {"gimbal": [base | {"name": body, "angle": f"angle of {body}"} for body in bodies]}
    if table == "pickoff":  # which is called as its angle
        tables["gimbal"][0]["angle"] = plain.pop("name")
    tables[table] = [*tables.get(table, []), plain]
    root = {"name": "what carries it", "inertia": [1, 1, 1], "specific_force": [0, 0, 9.81]}
    made = getattr(pc.read_platform({"schema": 1, "name": "a part", "root": root, **tables}), f"{table}s")[-1]
    left_out = {one.name: one.default for one in dataclasses.fields(made) if one.name in _NEEDED.get(table, {})}
    return dataclasses.replace(made, **left_out | numbers)


Cage, Erection, Friction, Gimbal = (partial(part, table) for table in ("cage", "erection", "friction", "gimbal"))
PickOff, RateSensor, Rotor = (partial(part, table) for table in ("pickoff", "rate_sensor", "rotor"))
Spring, Torquer, Unbalance = (partial(part, table) for table in ("spring", "torquer", "unbalance"))
