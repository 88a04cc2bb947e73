"""Plants, and input files in general, as TOML text: what the readers read back to the last bit."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from platform_ctrl.errors import ArgumentError
from platform_ctrl.plant.fields import stops_written
from platform_ctrl.plant.tables import written

if TYPE_CHECKING:
    from platform_ctrl.plant.platform import Platform

# Keys of a plant's parts that a file has beside another one alone: the table, that key, these.
_BESIDE = (
    ("gimbal", "stops", ("restitution",)),
    ("friction", "stribeck_rate", ("breakaway",)),
    ("rotor", "speed_gain", ("speed_integral", "torque_limit")),
)
_BARE = re.compile(r"[A-Za-z0-9_-]+")


def plant_data(platform: Platform) -> dict[str, Any]:
    """Return the plant as a dict of the plant file's structure, without default values."""
    for pickoff in platform.pickoffs:
        if pickoff.name != (angle := platform.angle_names[platform.gimbal(pickoff.gimbal)]):
            words = f"pick-off {pickoff.name!r} must be called {angle!r}, as its angle, to stand in a plant file"
            raise ArgumentError(f"{words}; leave its name out, or make it an AngleSensor")
    data = {"schema": 1} | written(platform)
    for gimbal in data.get("gimbal", ()):
        gimbal |= stops_written(gimbal.pop("stops")) if "stops" in gimbal else {}
    for table, beside, keys in _BESIDE:
        for own in data.get(table, ()):
            for key in keys if not {beside, f"{beside}_deg"} & own.keys() else ():
                own.pop(key, None)
    return data


def toml(data: Mapping[str, Any], header: str = "") -> str:
    """Return `data` as TOML: plain values first, then tables, then arrays of tables, every number exact."""
    lines, tables = [], []
    for key, item in data.items():
        name = key if _BARE.fullmatch(key) else _literal(key)
        path = f"{header}.{name}" if header else name
        if isinstance(item, Mapping):
            tables.append(f"\n[{path}]\n{toml(item, path)}" if item else "")
        elif isinstance(item, Sequence) and item and isinstance(item[0], Mapping):
            tables += [f"\n[[{path}]]\n{toml(one, path)}" for one in item]
        elif not (isinstance(item, Sequence) and not isinstance(item, str) and not item):
            lines.append(f"{name} = {_literal(item)}\n")
    return "".join(lines + tables)


def _literal(item: Any) -> str:
    if isinstance(item, bool):
        return "true" if item else "false"
    if isinstance(item, str):
        # JSON's escapes are TOML's, which wants DEL escaped, too.
        return json.dumps(item, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(item, Sequence):
        return f"[{', '.join(_literal(one) for one in item)}]"
    return repr(item.item() if isinstance(item, np.generic) else item)
