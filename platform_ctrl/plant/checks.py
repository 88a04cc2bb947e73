"""What must fit together in a plant file: names, the tree, alternatives, signals.

These checks read the plain data and pass over whatever the structure check refuses anyway, so that all
mistakes of a file are known at once and the first can be reported.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from platform_ctrl.common.values import FloatArray
from platform_ctrl.plant.entry import Entry
from platform_ctrl.plant.fields import (
    ROUNDING,
    TURN,
    Unfit,
    axis,
    coulomb,
    default_angle,
    default_torquer,
    stops,
    stops_in_degrees,
    text,
)
from platform_ctrl.plant.mistakes import Mistake, Path, given, suggestion
from platform_ctrl.plant.platform import OMEGA_NAMES, ROOT_TORQUE_NAMES, Platform
from platform_ctrl.plant.sensors import gimbal_rate
from platform_ctrl.plant.tables import Shape, either, references, shape

_SERVO_KEYS = ("speed_gain", "speed_integral", "torque_limit")
# Which signal of its own each table names.
_SIGNALS = {
    "gimbal": "angle",
    "torquer": "torque",
    "rate_sensor": "rate",
    "angle_sensor": "reading",
    "attitude_sensor": "reading",
}
# Cosine below which two axes count as normal to each other, and sine below which they count as parallel.
_NORMAL = 1e-6


def plant_mistakes(data: dict[str, Any]) -> list[Mistake]:
    """Return what does not fit together in a plant file."""
    plant = Entry(data)
    return [
        *_names(plant),
        *_references(plant),
        *_circles(plant),
        *_gimbals(plant),
        *_torquers(plant),
        *_rate_sensors(plant),
        *_rotors(plant),
        *_friction(plant),
        *_line_of_sight(plant),
        *_signals(plant),
    ]


def _gimbal_names(plant: Entry) -> list[str] | None:
    """Return the gimbals' names, or None if one is refused: references to it are not to blame."""
    entries = plant.data.get("gimbal", [])
    if not isinstance(entries, list):
        return None
    try:
        return [text(entry["name"] if isinstance(entry, dict) else None) for entry in entries]
    except (KeyError, Unfit):
        return None


def _names(plant: Entry) -> Iterator[Mistake]:
    root = plant.table("root").text("name")
    for kind in ("gimbal", "rotor"):
        taken = {root: "the root"} if kind == "gimbal" and root is not None else {}
        for one in plant.tables(kind):
            name = one.text("name")
            if name in taken:
                words = f"name = {given(name)} is the name of {taken[name]} already; choose another"
                yield one.text_at("name", words)
            elif name is not None:
                taken[name] = f"[[{kind}]] {one.place}"


def _references(plant: Entry) -> Iterator[Mistake]:
    """Walk the names of bodies that are not there, or have a part of that kind already."""
    root, gimbals = plant.table("root").text("name"), _gimbal_names(plant)
    if root is None or gimbals is None:
        return
    for kind, of in shape(Platform).keys.items():
        if of.array is None or not isinstance(of.holds, Shape) or not isinstance(of.holds.make, type):
            continue
        for key, refers in references(of.holds.make):
            known = [root, *gimbals] if refers.root else gimbals
            what = "the root or a gimbal" if refers.root else "a gimbal"
            seen: dict[str, int] = {}
            for one in plant.tables(kind):
                name = one.text(key)
                if name is None:
                    continue
                if name not in known:
                    hint = f" ({refers.hint})" if refers.hint and name == root else ""
                    yield one.wrong(key, f"the name of {what}{hint}", f"; {suggestion(name, known)}")
                elif refers.once and name in seen:
                    words = f"{given(name)} has a {refers.once} already, [[{kind}]] {seen[name]}"
                    yield one.says(key, f"{words}; leave one of them out")
                seen.setdefault(name, one.place)


def _circles(plant: Entry) -> Iterator[Mistake]:
    root, gimbals = plant.table("root").text("name"), _gimbal_names(plant)
    if root is None or gimbals is None:
        return
    parent = {one.text("name"): one.text("parent") for one in reversed(plant.tables("gimbal"))}
    parent.pop(root, None)
    reported: set[str | None] = set()
    for one in plant.tables("gimbal"):
        chain = [one.text("name")]
        while (above := parent.get(chain[-1])) is not None and above not in chain:
            chain.append(above)
        # A gimbal that only hangs on a cycle is not part of it.
        if above is not None and above == chain[0] and above not in reported:
            reported.update(chain)
            cycle = " -> ".join(given(name) for name in [*chain, above])
            words = f"parent = {given(one.data['parent'])} closes a ring of parents, {cycle}"
            yield one.text_at("parent", f"{words}; let the chain end at the root")


def _gimbals(plant: Entry) -> Iterator[Mistake]:
    for one in plant.tables("gimbal"):
        if "restitution" in one and "stops" not in one and "stops_deg" not in one:
            yield one.useless("restitution", 'without "stops" or "stops_deg"')
        try:
            ends = stops(one.data["stops"])
        except (KeyError, Unfit):
            continue
        if max(map(abs, ends)) > TURN:
            words = f"{given(one.data['stops'])} rad is more than a turn; is it in degrees? then write stops_deg"
            degrees = ", ".join(f"{end:.10g}" for end in stops_in_degrees(ends))
            yield one.says("stops", f"{words}, else stops_deg = [{degrees}]")


def _torquers(plant: Entry) -> Iterator[Mistake]:
    for one in plant.tables("torquer"):
        if ("gimbal" in one) == ("root_axis" in one):
            yield Mistake(one.path, either("gimbal", "root_axis", "gimbal" in one))


def _rotors(plant: Entry) -> Iterator[Mistake]:
    for one in plant.tables("rotor"):
        axial, transverse = one.number("axial_inertia"), one.number("transverse_inertia")
        if axial is not None and transverse is not None and 0 < transverse < axial / 2 * (1 - ROUNDING):
            yield one.wrong("transverse_inertia", f"at least half of axial_inertia = {given(axial)}")
        servo = one.data.get("control") == "servo"
        if servo and "speed_gain" not in one:
            yield one.text_at("control", 'control = "servo" needs "speed_gain", N m s')
        yield from (one.useless(key, 'without control = "servo"') for key in _SERVO_KEYS if key in one and not servo)


def _friction(plant: Entry) -> Iterator[Mistake]:
    for one in plant.tables("friction"):
        for key, other in (("breakaway", "stribeck_rate"), ("stribeck_rate", "breakaway")):
            if key in one and other not in one:
                yield one.useless(key, f'without "{other}"; give both')
        dry = one.data.get("coulomb", 0.0)
        try:
            pairs = zip(coulomb(one.data["breakaway"]), coulomb(dry), strict=True)
        except (KeyError, Unfit):
            continue
        if any(low < high for low, high in pairs):
            yield one.wrong("breakaway", f"at least coulomb, {given(dry)}, to either side")


def _rate_sensors(plant: Entry) -> Iterator[Mistake]:
    """Walk rate sensors that do not say, or say twice, what they measure, or measure what another one does."""
    root, axes = plant.table("root").text("name"), dict[int, int]()
    for one in plant.tables("rate_sensor"):
        about = _root_axis(one)
        if about in axes:
            words = f"axis {about} has a rate sensor already, [[rate_sensor]] {axes[about]}; leave one of them out"
            yield one.says("root_axis", words)
        elif about is not None:
            axes[about] = one.place
        places = [key for key in ("gimbal", "root_axis", "body") if key in one]
        if len(places) != 1:
            which = "not " + " and ".join(f'"{key}"' for key in places) if places else "one of them is needed"
            yield Mistake(one.path, f'give one of "gimbal", "root_axis" and "body", {which}')
            continue
        if places != ["body"]:
            yield from (one.useless(key, 'without "body"') for key in ("axis", "frame", "misalignment") if key in one)
            continue
        if "axis" not in one:
            yield one.missing("axis", "it must be the sensing axis in the body's axes")
        if one.data.get("frame") != "parent":
            continue
        body = one.data["body"]
        gimbal = next((own.data for own in plant.tables("gimbal") if own.data.get("name") == body), None)
        if body == root:
            words = f'frame = "parent" needs a gimbal: {given(root)} is the root; leave it out, or measure a gimbal'
            yield one.text_at("frame", words)
        elif gimbal is not None and _normal(gimbal.get("axis"), one.data.get("axis")):
            words = (
                f"gimbal {given(body)} turns about {given(gimbal['axis'])} against its parent, and "
                f"{given(one.data['axis'])} is normal to that: the reading would be 0; measure along that axis"
            )
            yield one.says("axis", words)


def _root_axis(one: Entry) -> int | None:
    """Return the number of a root axis, or None where there is none or another number."""
    about = one.data.get("root_axis")
    return about if isinstance(about, int) and not isinstance(about, bool) and about in (1, 2, 3) else None


def _unit(given_axis: object) -> FloatArray | None:
    try:
        return axis(given_axis)
    except Unfit:
        return None


def _normal(one: object, other: object) -> bool:
    first, second = _unit(one), _unit(other)
    return first is not None and second is not None and abs(float(first @ second)) < _NORMAL


def _line_of_sight(plant: Entry) -> Iterator[Mistake]:
    """Judge a line of sight: its body, and whether any gimbal can turn it."""
    sight, root, gimbals = plant.table("line_of_sight"), plant.table("root").text("name"), _gimbal_names(plant)
    if root is None or gimbals is None:
        return
    body = sight.text("body")
    if body is not None and body not in (root, *gimbals):
        yield sight.wrong("body", "the name of the root or a gimbal", f"; {suggestion(body, [root, *gimbals])}")
        return
    by_name = {one.text("name"): one for one in reversed(plant.tables("gimbal"))}
    direction, turning, seen = _unit(sight.data.get("direction")), [], set()
    while body in by_name and body not in seen:
        seen.add(body)
        turning.append(by_name[body].data.get("axis"))
        body = by_name[body].text("parent")
    axes = [one for one in map(_unit, turning) if one is not None]
    if direction is None or not axes or len(axes) < len(turning):
        return
    if all(np.linalg.norm(np.cross(one, direction)) < _NORMAL for one in axes):
        words = (
            f"direction = {given(sight.data['direction'])} is parallel to the axis of every gimbal that carries it, so "
            "that none of them turns the line of sight; choose a direction normal to the axis of the inner gimbal"
        )
        yield sight.text_at("direction", words)


def _signals(plant: Entry) -> Iterator[Mistake]:
    """Angles, torques and rates are inputs and outputs of one system: no name twice."""
    of_root, rate = "a torque about a root axis", "a platform rate"
    taken = dict.fromkeys(OMEGA_NAMES, rate) | dict.fromkeys(ROOT_TORQUE_NAMES, of_root)
    for path, name, own in _signal_names(plant):
        what = f"{path[2]} = {given(name)}" if len(path) > 2 else f"the default name {given(name)}"
        if "." in name:
            yield Mistake(path, f"{what} has a full stop, which no signal may have; choose a name without one")
        elif name in taken and not (name == own and taken[name] in (of_root, rate)):
            yield Mistake(path, f"{what} is the name of {taken[name]} already; choose another")
        else:
            taken[name] = f"the {_SIGNALS[str(path[0])]} of [[{path[0]}]] {int(path[1]) + 1}"


def _signal_names(plant: Entry) -> Iterator[tuple[Path, str, str]]:
    """Walk the path, the name, and the reserved name that a root torquer may bear."""
    angles: dict[str | None, str] = {}
    for one in plant.tables("gimbal"):
        name, angle = one.text("name"), one.text("angle")
        if angle is not None:
            yield (*one.path, "angle"), angle, ""
        elif name is not None and "angle" not in one:
            angle = default_angle(name)
            yield one.path, angle, ""
        if name is not None and angle is not None:
            angles.setdefault(name, angle)
    for one in plant.tables("torquer"):
        name, gimbal, about = one.text("name"), one.text("gimbal"), _root_axis(one)
        own = "" if about is None else f"M{about}"
        if name is not None:
            yield (*one.path, "name"), name, own
        elif "name" not in one and (gimbal is not None or own):
            yield one.path, default_torquer(gimbal, one.data.get("root_axis")), own
    measured: set[str | None] = set()
    for kind in ("rate_sensor", "angle_sensor", "attitude_sensor"):
        for one in plant.tables(kind):
            name, gimbal, about = one.text("name"), one.text("gimbal"), _root_axis(one)
            if name is not None:
                yield (*one.path, "name"), name, "" if about is None else f"Omega{about}"
            elif "name" not in one and kind == "rate_sensor" and gimbal in angles and gimbal not in measured:
                yield one.path, gimbal_rate(angles[gimbal]), ""
            elif "name" not in one and (default := _default_reading(plant, kind, one)):
                yield one.path, default, ""
            measured.add(gimbal)


def _default_reading(plant: Entry, kind: str, one: Entry) -> str:
    """Return the name of a reading of a body where none is given; empty where it has another rule."""
    body, axes, root = one.text("body"), _unit(one.data.get("axis")), plant.table("root").text("name")
    if body is None or axes is None or (kind == "rate_sensor" and (body == root or one.data.get("frame") == "parent")):
        return ""
    signal = "Omega" if kind == "rate_sensor" else "theta"
    owner = "" if body == root else f"{body}_"
    return f"{owner}{signal}{int(np.abs(axes).argmax()) + 1}"
