"""A platform with gimbals locked: what they carry becomes a part of what carries them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from platform_ctrl.common.arguments import known_name
from platform_ctrl.common.values import FloatArray, replaced
from platform_ctrl.plant.flexible import Compliance
from platform_ctrl.plant.force_elements import Friction, Spring
from platform_ctrl.plant.gimbals import Body, Gimbal, Rotor
from platform_ctrl.plant.platform import Platform
from platform_ctrl.plant.sensors import Sensor
from platform_ctrl.plant.tables import shape

# Where a part on a body is fixed, by the fields of its class.
_BODIES = ("parent", "carrier", "body", "senses")


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
    drives = {one.gimbal: one.motor_side for one in platform.compliances}
    # A motor side goes with its load.
    gone = {drives[name] for name in names if name in drives}
    for name in names:
        if name in gone:
            continue
        held = next((one for one in platform.compliances if one.motor_side == name), None)
        platform = _with_one(platform if held is None else _on_its_drive(platform, held), name)
        if drives.get(name) in platform.gimbal_names:
            platform = _with_one(platform, drives[name])
    return platform


def _on_its_drive(platform: Platform, drive: Compliance) -> Platform:
    """Return the platform with a load that its drive holds at rest, as a spring does."""
    others = tuple(one for one in platform.compliances if one is not drive)
    springs, frictions = [*platform.springs, Spring(gimbal=drive.gimbal, stiffness=drive.strength)], platform.frictions
    own = next((one for one in frictions if one.gimbal == drive.gimbal), Friction(gimbal=drive.gimbal))
    damped = replaced(own, {"viscous": own.viscous + drive.damping})
    kept = [one for one in frictions if one is not own]
    changes = {"compliances": others, "springs": tuple(springs), "frictions": (*kept, damped)}
    return replaced(platform, changes)


def with_cogging(platform: Platform, held: FloatArray) -> list[tuple[str, Platform]]:
    """Return the platform in words where cogging is steepest, a spring that pushes or holds, and ripple largest.

    `held`: torques of the gimbals at rest (n,), N m; the ripple of a current that holds one is as steep as cogging.
    """
    names = platform.gimbal_names
    cogging, ripple = (dict.fromkeys(names, 0.0) for _ in range(2))
    for k, (order, torque, _) in platform.cogging:
        cogging[names[k]] += abs(order * torque)
    for k, _, (order, share, _) in platform.ripples:
        ripple[names[k]] += abs(order * share * held[k])

    def steepest(one: Platform, sign: float) -> Platform:
        sizes = {name: cogging[name] + ripple[name] for name in names}
        springs = (Spring(gimbal=name, stiffness=sign * size) for name, size in sizes.items() if size)
        return replaced(one, {"springs": (*one.springs, *springs)})

    def rippled(one: Platform, sign: float) -> Platform:
        motors = (
            m if m.ripple is None else replaced(m, {"swell": 1.0 + sign * min(m.ripple[:, 1].sum(), 1.0)})
            for m in one.motors
        )
        return replaced(one, {"motors": tuple(motors)})

    what = " with ".join(
        word for word, sizes in (("cogging", cogging), ("ripple under load", ripple)) if any(sizes.values())
    )
    steep = {f"{what} pushes away": -1.0, f"{what} holds": 1.0} if what else {}
    swollen = {"ripple takes torque away": -1.0, "ripple adds torque": 1.0} if platform.ripples else {}
    cases = [(words, steepest(platform, sign)) for words, sign in steep.items()] or [("", platform)]
    if not swollen:
        return cases if what else []
    return [
        (", ".join(filter(None, (first, second))), rippled(one, sign))
        for first, one in cases
        for second, sign in swollen.items()
    ]


def with_stuck_bristles(platform: Platform) -> Platform:
    """Return the platform about rest where bristles of bearings stick: they are springs with damping there."""
    stuck = [one for one in platform.frictions if one.bristle_stiffness]
    if not stuck:
        return platform
    frictions = [one.linear(one.bristle_damping) if one in stuck else one for one in platform.frictions]
    springs = (*platform.springs, *(Spring(gimbal=one.gimbal, stiffness=one.bristle_stiffness) for one in stuck))
    return replaced(platform, {"frictions": tuple(frictions), "springs": springs})


def with_rigid_drives(platform: Platform) -> Platform:
    """Return the platform with drives that do not give way: what is on their motor sides is on their loads."""
    sides = {one.motor_side: one for one in platform.compliances}
    if not sides:
        return platform
    changes: dict[str, Any] = {"compliances": ()}
    for kind in (key.field for key in shape(Platform).keys.values() if key.array is not None):
        moved = ((part, sides.get(getattr(part, "gimbal", None) or "")) for part in getattr(platform, kind))
        parts = tuple(part if side is None else replaced(part, {"gimbal": side.gimbal}) for part, side in moved)
        changes.setdefault(kind, parts)
    added = {one.gimbal: one.inertia for one in sides.values()}
    changes["gimbals"] = tuple(
        replaced(one, {"inertia": one.inertia + added.get(one.name, 0.0) * np.outer(one.axis, one.axis)})
        for one in platform.gimbals
        if one.name not in sides
    )
    return replaced(platform, changes)


def carried_inertia(platform: Platform, name: str) -> float:
    """Return the inertia about the axis of a gimbal of all that it carries at zero angles, kg m²."""
    carried: list[str] = []
    for _ in platform.gimbals:
        carried = [one.name for one in platform.gimbals if one.parent in (name, *carried)]
    rigid = with_locked(platform, carried)
    own = rigid.gimbals[rigid.gimbal(name)]
    whole = own.body
    for rotor in rigid.rotors:
        if rotor.carrier == name:
            axial = rotor.axial_inertia * np.outer(rotor.axis, rotor.axis)
            whole |= rotor.body._replace(inertia=rotor.body.inertia + axial)
    arm = np.cross(own.axis, whole.centre)
    return float(own.axis @ whole.inertia @ own.axis + whole.mass * (arm @ arm))


def _with_one(platform: Platform, name: str) -> Platform:
    own = platform.gimbals[known_name("locked", name, platform.gimbal_names)]

    def fixed(part: Any) -> Any:
        moved: dict[str, Any] = {key: own.parent for key in _BODIES if getattr(part, key, None) == name}
        if moved and (isinstance(part, Gimbal) or (isinstance(part, Rotor) and part.mass)):
            moved["origin"] = part.origin + own.origin
        return replaced(part, moved) if moved else part

    changes: dict[str, Any] = {}
    for kind in (key.field for key in shape(Platform).keys.values() if key.array is not None):
        kept = [part for part in getattr(platform, kind) if not _between(part, name)]
        changes[kind] = tuple(fixed(part) for part in kept)
    # With the gimbal a geared motor's rotor stands still, too, but turns with the parent.
    rotors = sum((one.rotor_inertia for one in platform.motors if one.gimbal == name), 0.0)
    turning = own.inertia + rotors * np.outer(own.axis, own.axis)
    carried = Body(own.mass, own.centre, turning).moved(own.origin)
    whole = (platform.bodies[platform.body(own.parent)] | carried)._asdict()
    changes["gimbals"] = tuple(replaced(g, whole) if g.name == own.parent else g for g in changes["gimbals"])
    if own.parent == platform.root_name:
        changes |= {f"root_{key}": item for key, item in whole.items()}
    if platform.line_of_sight is not None:
        changes["line_of_sight"] = fixed(platform.line_of_sight)
    return replaced(platform, changes)


def _between(part: Any, name: str) -> bool:
    """Return whether a part is the gimbal itself, or acts or measures between it and its parent."""
    if getattr(part, "gimbal", None) == name or (hasattr(part, "parent") and part.name == name):
        return True
    return isinstance(part, Sensor) and getattr(part, "body", None) == name and getattr(part, "frame", "") == "parent"
