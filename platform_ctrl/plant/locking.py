"""Gimbals that are locked: one body with what carries them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from platform_ctrl.common.arguments import known_name
from platform_ctrl.common.values import replaced
from platform_ctrl.plant.platform import Platform
from platform_ctrl.plant.sensors import Sensor

# What a part on a body is fixed to, by the fields of its class; what acts between a gimbal and its parent.
_BODIES = ("parent", "carrier", "body", "senses")
_PARTS = (
    *("gimbals", "rotors", "torquers", "pickoffs", "rate_sensors", "angle_sensors", "attitude_sensors"),
    *("springs", "frictions", "cages", "unbalances", "erections"),
)


def with_locked(platform: Platform, names: Sequence[str]) -> Platform:
    """Return the platform with gimbals locked at the angle zero.

    Their bodies, rotors, sensors and unbalance are then those of what carries them; what acts or measures between the
    two is gone.

    Parameters
    ----------
    platform
        The platform.
    names
        Of gimbals.

    Returns
    -------
    Platform
        Without these gimbals.

    Raises
    ------
    ArgumentError
        The platform has no such gimbal.
    """
    for name in names:
        platform = _with_one(platform, name)
    return platform


def _with_one(platform: Platform, name: str) -> Platform:
    own = platform.gimbals[known_name("locked", name, platform.gimbal_names)]

    def fixed(part: Any) -> Any:
        moved = {field: own.parent for field in _BODIES if getattr(part, field, None) == name}
        return replaced(part, moved) if moved else part

    changes: dict[str, Any] = {}
    for field in _PARTS:
        kept = [part for part in getattr(platform, field) if not _between(part, name)]
        changes[field] = tuple(fixed(part) for part in kept)
    changes["gimbals"] = tuple(
        replaced(g, {"inertia": g.inertia + own.inertia}) if g.name == own.parent else g for g in changes["gimbals"]
    )
    if own.parent == platform.root_name:
        changes["root_inertia"] = platform.root_inertia + own.inertia
    if platform.line_of_sight is not None:
        changes["line_of_sight"] = fixed(platform.line_of_sight)
    return replaced(platform, changes)


def _between(part: Any, name: str) -> bool:
    """Return whether a part is the gimbal itself, or acts or measures between it and its parent."""
    if getattr(part, "gimbal", None) == name or (hasattr(part, "parent") and part.name == name):
        return True
    return isinstance(part, Sensor) and getattr(part, "body", None) == name and getattr(part, "frame", "") == "parent"
