"""What must fit together in a plant file: names, the tree, alternatives, signals.

These checks read the plain data and pass over whatever the structure check refuses anyway, so that all
mistakes of a file are known at once and the first can be reported.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from platform_ctrl.common.values import FloatArray
from platform_ctrl.plant.fields import (
    ROUNDING,
    TURN,
    Unfit,
    axis,
    coulomb,
    default_angle,
    default_torquer,
    number,
    stops,
    stops_in_degrees,
    text,
)
from platform_ctrl.plant.mistakes import Mistake, Path, given, suggestion, tables, text_of
from platform_ctrl.plant.platform import OMEGA_NAMES, ROOT_TORQUE_NAMES, Platform
from platform_ctrl.plant.sensors import gimbal_rate
from platform_ctrl.plant.tables import Shape, either, references, shape

Data = dict[str, Any]

_SERVO_KEYS = ("speed_gain", "speed_integral", "torque_limit")


def _friction(data: Data) -> Iterator[Mistake]:
    for k, table in tables(data, "friction"):
        for key, other in (("breakaway", "stribeck_rate"), ("stribeck_rate", "breakaway")):
            if key in table and other not in table:
                yield Mistake.useless(table, ("friction", k), key, f'without "{other}"; give both')
        try:
            breakaway, dry = coulomb(table["breakaway"]), coulomb(table.get("coulomb", 0.0))
        except (KeyError, Unfit):
            continue
        if breakaway[0] < dry[0] or breakaway[1] < dry[1]:
            words = f"at least coulomb, {given(table.get('coulomb', 0.0))}, to either side"
            yield Mistake.wrong(table, ("friction", k), "breakaway", words)


def _servo(data: Data) -> Iterator[Mistake]:
    for k, table in tables(data, "rotor"):
        servo = table.get("control") == "servo"
        if servo and "speed_gain" not in table:
            yield Mistake(("rotor", k, "control"), 'control = "servo" needs "speed_gain", N m s')
        for key in _SERVO_KEYS:
            if key in table and not servo:
                yield Mistake.useless(table, ("rotor", k), key, 'without control = "servo"')


# Which signal of its own each table names.
_SIGNALS = {
    "gimbal": "angle",
    "torquer": "torque",
    "rate_sensor": "rate",
    "angle_sensor": "reading",
    "attitude_sensor": "reading",
}


def plant_mistakes(data: Data) -> list[Mistake]:
    """Return what does not fit together in a plant file."""
    return [
        *_names(data),
        *_references(data),
        *_circles(data),
        *_alternatives(data),
        *_rotor_inertias(data),
        *_servo(data),
        *_friction(data),
        *_one_sensor_about_an_axis(data),
        *_line_of_sight(data),
        *_signals(data),
    ]


def _root_name(data: Data) -> str | None:
    root = data.get("root")
    return text_of(root, "name") if isinstance(root, dict) else None


def _gimbal_names(data: Data) -> list[str] | None:
    """Return the gimbals' names, or None if one is refused: references to it are not to blame."""
    entries = data.get("gimbal", [])
    if not isinstance(entries, list):
        return None
    try:
        return [text(entry["name"] if isinstance(entry, dict) else None) for entry in entries]
    except (KeyError, Unfit):
        return None


def _names(data: Data) -> Iterator[Mistake]:
    root = _root_name(data)
    for kind in ("gimbal", "rotor"):
        taken = {root: "the root"} if kind == "gimbal" and root is not None else {}
        for k, table in tables(data, kind):
            name = text_of(table, "name")
            if name is None:
                continue
            if name in taken:
                yield Mistake(
                    (kind, k, "name"), f"name = {given(name)} is the name of {taken[name]} already; choose another"
                )
            else:
                taken[name] = f"[[{kind}]] {k + 1}"


def _references(data: Data) -> Iterator[Mistake]:
    """Walk the names of bodies that are not there, or have a part of that kind already."""
    root, gimbals = _root_name(data), _gimbal_names(data)
    if root is None or gimbals is None:
        return
    for kind, of in shape(Platform).keys.items():
        if of.array is None or not isinstance(of.holds, Shape) or not isinstance(of.holds.make, type):
            continue
        for key, refers in references(of.holds.make):
            known = [root, *gimbals] if refers.root else gimbals
            what = "the root or a gimbal" if refers.root else "a gimbal"
            seen: dict[str, int] = {}
            for k, table in tables(data, kind):
                name = text_of(table, key)
                if name is None:
                    continue
                if name not in known:
                    hint = f" ({refers.hint})" if refers.hint and name == root else ""
                    words, more = f"the name of {what}{hint}", f"; {suggestion(name, known)}"
                    yield Mistake.wrong(table, (kind, k), key, words, more)
                elif refers.once and name in seen:
                    words = f"{given(name)} has a {refers.once} already, [[{kind}]] {seen[name] + 1}"
                    yield Mistake((kind, k, key), f"{key}: {words}; leave one of them out")
                seen.setdefault(name, k)


def _circles(data: Data) -> Iterator[Mistake]:
    root, gimbals = _root_name(data), _gimbal_names(data)
    if root is None or gimbals is None:
        return
    parent = {text_of(table, "name"): text_of(table, "parent") for _, table in reversed([*tables(data, "gimbal")])}
    parent.pop(root, None)
    reported: set[str | None] = set()
    for k, table in tables(data, "gimbal"):
        chain = [text_of(table, "name")]
        while (above := parent.get(chain[-1])) is not None and above not in chain:
            chain.append(above)
        # A gimbal that only hangs on a cycle is not part of it.
        if above is not None and above == chain[0] and above not in reported:
            reported.update(chain)
            cycle = " -> ".join(given(name) for name in [*chain, above])
            words = (
                f"parent = {given(table['parent'])} closes a ring of parents, {cycle}; let the chain end at the root"
            )
            yield Mistake(("gimbal", k, "parent"), words)


def _alternatives(data: Data) -> Iterator[Mistake]:
    """Walk parts that act on both a gimbal and the root, or on neither, and what means nothing without stops."""
    for k, table in tables(data, "torquer"):
        if ("gimbal" in table) == ("root_axis" in table):
            yield Mistake(("torquer", k), either("gimbal", "root_axis", "gimbal" in table))
    yield from _rate_sensors(data)
    for k, table in tables(data, "gimbal"):
        if "restitution" in table and "stops" not in table and "stops_deg" not in table:
            yield Mistake.useless(table, ("gimbal", k), "restitution", 'without "stops" or "stops_deg"')
        try:
            ends = stops(table["stops"])
        except (KeyError, Unfit):
            continue
        if max(map(abs, ends)) > TURN:
            words = f"stops: {given(table['stops'])} rad is more than a turn; is it in degrees? then write stops_deg"
            degrees = ", ".join(f"{end:.10g}" for end in stops_in_degrees(ends))
            yield Mistake(("gimbal", k, "stops"), f"{words}, else stops_deg = [{degrees}]")


def _rate_sensors(data: Data) -> Iterator[Mistake]:
    """Walk rate sensors that do not say, or say twice, what they measure."""
    root = _root_name(data)
    for k, table in tables(data, "rate_sensor"):
        path: Path = ("rate_sensor", k)
        places = [key for key in ("gimbal", "root_axis", "body") if key in table]
        if len(places) != 1:
            which = "not " + " and ".join(f'"{key}"' for key in places) if places else "one of them is needed"
            yield Mistake(path, f'give one of "gimbal", "root_axis" and "body", {which}')
            continue
        if places == ["body"] and "axis" not in table:
            yield Mistake.missing(path, "axis", "it must be the sensing axis in the body's axes")
        for key in ("axis", "frame", "misalignment") if places != ["body"] else ():
            if key in table:
                yield Mistake.useless(table, path, key, 'without "body"')
        if places != ["body"] or table.get("frame") != "parent":
            continue
        gimbal = next((g for _, g in tables(data, "gimbal") if g.get("name") == table["body"]), None)
        if table["body"] == root:
            words = f'frame = "parent" needs a gimbal: {given(root)} is the root; leave it out, or measure a gimbal'
            yield Mistake((*path, "frame"), words)
        elif gimbal is not None and _normal(gimbal.get("axis"), table.get("axis")):
            words = (
                f"axis: gimbal {given(table['body'])} turns about {given(gimbal['axis'])} against its parent, and "
                f"{given(table['axis'])} is normal to that: the reading would be 0; measure along that axis"
            )
            yield Mistake((*path, "axis"), words)


# Cosine below which two axes count as normal to each other, and sine below which they count as parallel.
_NORMAL = 1e-6


def _unit(given_axis: object) -> FloatArray | None:
    try:
        return axis(given_axis)
    except Unfit:
        return None


def _normal(one: object, other: object) -> bool:
    first, second = _unit(one), _unit(other)
    return first is not None and second is not None and abs(float(first @ second)) < _NORMAL


def _line_of_sight(data: Data) -> Iterator[Mistake]:
    """Judge a line of sight: its body, and whether any gimbal can turn it."""
    table, root, gimbals = data.get("line_of_sight"), _root_name(data), _gimbal_names(data)
    if not isinstance(table, dict) or root is None or gimbals is None:
        return
    body = text_of(table, "body")
    if body is not None and body not in (root, *gimbals):
        more = f"; {suggestion(body, [root, *gimbals])}"
        yield Mistake.wrong(table, ("line_of_sight",), "body", "the name of the root or a gimbal", more)
        return
    by_name = {text_of(gimbal, "name"): gimbal for _, gimbal in reversed([*tables(data, "gimbal")])}
    direction, turning, seen = _unit(table.get("direction")), [], set()
    while body in by_name and body not in seen:
        seen.add(body)
        turning.append(by_name[body].get("axis"))
        body = text_of(by_name[body], "parent")
    axes = [one for one in map(_unit, turning) if one is not None]
    if direction is None or not axes or len(axes) < len(turning):
        return
    if all(np.linalg.norm(np.cross(one, direction)) < _NORMAL for one in axes):
        words = (
            f"direction = {given(table['direction'])} is parallel to the axis of every gimbal that carries it, so "
            "that none of them turns the line of sight; choose a direction normal to the axis of the inner gimbal"
        )
        yield Mistake(("line_of_sight", "direction"), words)


def number_of(table: Data, key: str) -> float | None:
    """Return the number under `key`, or None where there is none."""
    try:
        return number(table.get(key))
    except Unfit:
        return None


def root_axis_of(table: Data) -> int | None:
    """Return the number of a root axis, or None where there is none or another number."""
    axis = table.get("root_axis")
    return axis if isinstance(axis, int) and not isinstance(axis, bool) and axis in (1, 2, 3) else None


def _rotor_inertias(data: Data) -> Iterator[Mistake]:
    for k, table in tables(data, "rotor"):
        axial, transverse = number_of(table, "axial_inertia"), number_of(table, "transverse_inertia")
        if axial is None or axial <= 0:
            continue
        if transverse is not None and 0 < transverse < axial / 2 * (1 - ROUNDING):
            words = f"at least half of axial_inertia = {given(axial)}"
            yield Mistake.wrong(table, ("rotor", k), "transverse_inertia", words)


def _one_sensor_about_an_axis(data: Data) -> Iterator[Mistake]:
    axes: dict[int, int] = {}
    for k, table in tables(data, "rate_sensor"):
        axis = root_axis_of(table)
        if axis in axes:
            words = f"root_axis: axis {axis} has a rate sensor already, [[rate_sensor]] {axes[axis] + 1}"
            yield Mistake(("rate_sensor", k, "root_axis"), f"{words}; leave one of them out")
        elif axis is not None:
            axes[axis] = k


def _signals(data: Data) -> Iterator[Mistake]:
    """Angles, torques and rates are inputs and outputs of one system: no name twice."""
    of_root = "a torque about a root axis"
    rate = "a platform rate"
    taken = dict.fromkeys(OMEGA_NAMES, rate) | dict.fromkeys(ROOT_TORQUE_NAMES, of_root)
    for path, name, own in _signal_names(data):
        if "." in name:
            what = f"{path[2]} = {given(name)}" if len(path) > 2 else f"the default name {given(name)}"
            yield Mistake(path, f"{what} has a full stop, which no signal may have; choose a name without one")
        elif name in taken and not (name == own and taken[name] in (of_root, rate)):
            what = f"{path[2]} = {given(name)}" if len(path) > 2 else f"the default name {given(name)}"
            yield Mistake(path, f"{what} is the name of {taken[name]} already; choose another")
        else:
            taken[name] = f"the {_SIGNALS[str(path[0])]} of [[{path[0]}]] {int(path[1]) + 1}"


def _signal_names(data: Data) -> Iterator[tuple[Path, str, str]]:
    """Walk the path, the name, and the reserved name that a root torquer may bear."""
    angles: dict[str | None, str] = {}
    for k, table in tables(data, "gimbal"):
        name, angle = text_of(table, "name"), text_of(table, "angle")
        if angle is not None:
            yield ("gimbal", k, "angle"), angle, ""
        elif name is not None and "angle" not in table:
            angle = default_angle(name)
            yield ("gimbal", k), angle, ""
        if name is not None and angle is not None:
            angles.setdefault(name, angle)
    for k, table in tables(data, "torquer"):
        name, gimbal, root_axis = text_of(table, "name"), text_of(table, "gimbal"), table.get("root_axis")
        own = f"M{root_axis}" if root_axis_of(table) is not None else ""
        if name is not None:
            yield ("torquer", k, "name"), name, own
        elif "name" not in table and (gimbal is not None or own):
            yield ("torquer", k), default_torquer(gimbal, root_axis), own
    measured: set[str | None] = set()
    for kind in ("rate_sensor", "angle_sensor", "attitude_sensor"):
        for k, table in tables(data, kind):
            name, gimbal = text_of(table, "name"), text_of(table, "gimbal")
            if name is not None:
                own = f"Omega{table.get('root_axis')}" if root_axis_of(table) is not None else ""
                yield (kind, k, "name"), name, own
            elif "name" not in table and kind == "rate_sensor" and gimbal in angles and gimbal not in measured:
                yield (kind, k), gimbal_rate(angles[gimbal]), ""
            elif "name" not in table and (default := _default_reading(data, kind, table)):
                yield (kind, k), default, ""
            measured.add(gimbal)


def _default_reading(data: Data, kind: str, table: Data) -> str:
    """Return the name of a reading of a body where none is given; empty where it has another rule."""
    body, axes = text_of(table, "body"), _unit(table.get("axis"))
    if body is None or axes is None or (body == _root_name(data) and kind == "rate_sensor"):
        return ""
    if kind == "rate_sensor" and table.get("frame") == "parent":
        return ""
    signal = "Omega" if kind == "rate_sensor" else "theta"
    owner = "" if body == _root_name(data) else f"{body}_"
    return f"{owner}{signal}{int(np.abs(axes).argmax()) + 1}"
