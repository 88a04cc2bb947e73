"""What must fit together in a plant file: names, the tree, alternatives, signals.

These checks read the plain data and pass over whatever the structure check refuses anyway, so that all
mistakes of a file are known at once and the first can be reported.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from platform_ctrl.plant.fields import ROUNDING, Unfit, coulomb, number, text
from platform_ctrl.plant.mistakes import Mistake, Path, given, suggestion, tables, text_of
from platform_ctrl.plant.platform import OMEGA_NAMES, ROOT_TORQUE_NAMES, gimbal_rate

Data = dict[str, Any]

# Which body each table acts on or looks at: (table, key, whether the root will do, at most one on a body).
_REFERENCES = (
    ("spring", "gimbal", False, False),
    ("friction", "gimbal", False, True),
    ("cage", "gimbal", False, True),
    ("unbalance", "body", True, False),
    ("erection", "gimbal", False, False),
    ("erection", "senses", True, False),
)
_SERVO_KEYS = ("speed_gain", "speed_integral", "torque_limit")


def element_mistakes(data: Data, root: str | None, gimbals: list[str] | None) -> Iterator[Mistake]:
    """Walk what does not fit; `gimbals` is None where a name is refused already: references are not to blame then."""
    if gimbals is not None and root is not None:
        for kind, key, root_too, single in _REFERENCES:
            yield from _references(data, kind, key, [root, *gimbals] if root_too else gimbals, single)
    yield from _friction(data)
    yield from _servo(data)


def no_such(path: Path, name: str, what: str, known: list[str]) -> Mistake:
    """Return the mistake of a reference to something that is not there."""
    wrong = f"{path[-1]} = {given(name)}: does not exist"
    return Mistake(path, f"{wrong}; expected the name of {what}, {suggestion(name, known)}")


def _references(data: Data, kind: str, key: str, known: list[str], single: bool) -> Iterator[Mistake]:
    seen: dict[str, int] = {}
    for k, table in tables(data, kind):
        name = text_of(table, key)
        if name is None:
            continue
        path: Path = (kind, k, key)
        if name not in known:
            yield no_such(path, name, "a gimbal" if key == "gimbal" else "the root or a gimbal", known)
        elif single and name in seen:
            wrong = f"{key} = {given(name)}: has a {kind} already, [[{kind}]] {seen[name] + 1}"
            yield Mistake(path, f"{wrong}; expected one on a gimbal")
        seen.setdefault(name, k)


def _friction(data: Data) -> Iterator[Mistake]:
    for k, table in tables(data, "friction"):
        for key, other in (("breakaway", "stribeck_rate"), ("stribeck_rate", "breakaway")):
            if key in table and other not in table:
                wrong = f"{key} = {given(table[key])}: means nothing alone"
                yield Mistake(("friction", k, key), f'{wrong}; expected "{other}" with it, or none')
        try:
            breakaway, dry = coulomb(table["breakaway"]), coulomb(table.get("coulomb", 0.0))
        except (KeyError, Unfit):
            continue
        if breakaway[0] < dry[0] or breakaway[1] < dry[1]:
            wrong = f"breakaway = {given(table['breakaway'])}: is less than coulomb, {given(table.get('coulomb', 0.0))}"
            yield Mistake(("friction", k, "breakaway"), f"{wrong}; expected at least that, on either side")


def _servo(data: Data) -> Iterator[Mistake]:
    for k, table in tables(data, "rotor"):
        servo = table.get("control") == "servo"
        if servo and "speed_gain" not in table:
            yield Mistake(("rotor", k, "control"), 'control = "servo": has no speed loop; expected "speed_gain", N m s')
        for key in _SERVO_KEYS:
            if key in table and not servo:
                wrong = f"{key} = {given(table[key])}: belongs to a speed loop"
                yield Mistake(("rotor", k, key), f'{wrong}; expected control = "servo" with it, or none')


# Which signal of its own each table names.
_SIGNALS = {"gimbal": "angle", "torquer": "torque", "rate_sensor": "rate"}


def default_angle(gimbal: str) -> str:
    """Return the name of a gimbal's angle where the file gives none."""
    return f"q_{gimbal}"


def default_torquer(gimbal: str | None, root_axis: object) -> str:
    """Return the name of a torquer where the file gives none."""
    return f"Q{gimbal}" if gimbal is not None else f"M{root_axis}"


def measured_rate(angle: str | None, root_axis: object) -> str:
    """Return the signal name of a rate sensor: of the gimbal with this angle, or about this root axis."""
    return gimbal_rate(angle) if angle is not None else f"Omega{root_axis}"


def plant_mistakes(data: Data) -> list[Mistake]:
    """Return what does not fit together in a plant file."""
    return [
        *_names(data),
        *_tree(data),
        *_alternatives(data),
        *_rotor_inertias(data),
        *_actuators_and_sensors(data),
        *_signals(data),
        *element_mistakes(data, _root_name(data), _gimbal_names(data)),
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
                    (kind, k, "name"), f"name = {given(name)}: is the name of {taken[name]} already; expected another"
                )
            else:
                taken[name] = f"[[{kind}]] {k + 1}"


def _tree(data: Data) -> Iterator[Mistake]:
    root, gimbals = _root_name(data), _gimbal_names(data)
    if root is None or gimbals is None:
        return
    bodies = [root, *gimbals]
    for kind, key in (("gimbal", "parent"), ("rotor", "carrier")):
        for k, table in tables(data, kind):
            body = text_of(table, key)
            if body is not None and body not in bodies:
                yield no_such((kind, k, key), body, "the root or a gimbal", bodies)
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
            wrong = f"parent = {given(table['parent'])}: the parents run in a circle, {cycle}"
            yield Mistake(("gimbal", k, "parent"), f"{wrong}; expected a chain that ends at the root")


def _alternatives(data: Data) -> Iterator[Mistake]:
    for kind, one, other in (
        ("rotor", "spin", "angular_momentum"),
        ("torquer", "gimbal", "root_axis"),
        ("rate_sensor", "gimbal", "root_axis"),
    ):
        for k, table in tables(data, kind):
            if (one in table) == (other in table):
                have = "both are given" if one in table else "neither is given"
                yield Mistake((kind, k), f'{have}; expected either "{one}" or "{other}"')
    for k, table in tables(data, "gimbal"):
        if "stops" in table and "stops_deg" in table:
            yield Mistake(("gimbal", k), 'both are given; expected either "stops" or "stops_deg"')
        if "restitution" in table and "stops" not in table and "stops_deg" not in table:
            wrong = f"restitution = {given(table['restitution'])}: the gimbal has no stops to bounce off"
            yield Mistake(("gimbal", k, "restitution"), f'{wrong}; expected "stops" or "stops_deg" with it, or none')


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
            yield Mistake(
                ("rotor", k, "transverse_inertia"),
                f"transverse_inertia = {given(transverse)}: no body has it with axial_inertia = {given(axial)}; "
                f"expected at least half the axial inertia",
            )


def _actuators_and_sensors(data: Data) -> Iterator[Mistake]:
    gimbals = _gimbal_names(data)
    if gimbals is None:
        return
    for kind, single, of_root in (
        ("torquer", "", "root_axis turns the root"),
        ("pickoff", "pick-off", ""),
        ("rate_sensor", "rate sensor", "root_axis measures the root"),
    ):
        seen: dict[str, int] = {}
        for k, table in tables(data, kind):
            gimbal = text_of(table, "gimbal")
            if gimbal is None:
                continue
            path: Path = (kind, k, "gimbal")
            if gimbal not in gimbals:
                what = f"a gimbal ({of_root})" if of_root and gimbal == _root_name(data) else "a gimbal"
                yield no_such(path, gimbal, what, gimbals)
            elif single and gimbal in seen:
                wrong = f"gimbal = {given(gimbal)}: has a {single} already, [[{kind}]] {seen[gimbal] + 1}"
                yield Mistake(path, f"{wrong}; expected one on a gimbal")
            seen.setdefault(gimbal, k)
    axes: dict[int, int] = {}
    for k, table in tables(data, "rate_sensor"):
        axis = root_axis_of(table)
        if axis in axes:
            wrong = f"root_axis = {axis}: has a rate sensor already, [[rate_sensor]] {axes[axis] + 1}"
            yield Mistake(("rate_sensor", k, "root_axis"), f"{wrong}; expected one about an axis")
        elif axis is not None:
            axes[axis] = k


def _signals(data: Data) -> Iterator[Mistake]:
    """Angles, torques and rates are inputs and outputs of one system: no name twice."""
    of_root = "a torque about a root axis"
    taken = dict.fromkeys(OMEGA_NAMES, "a platform rate") | dict.fromkeys(ROOT_TORQUE_NAMES, of_root)
    for path, name, own in _signal_names(data):
        if "." in name:
            what = f"{path[2]} = {given(name)}:" if len(path) > 2 else f"the default name {given(name)}"
            yield Mistake(path, f"{what} has a full stop, which no signal may have; expected a signal name without one")
        elif name in taken and not (name == own and taken[name] == of_root):
            what = f"{path[2]} = {given(name)}:" if len(path) > 2 else f"the default name {given(name)}"
            wrong = f"{what} names {taken[name]} already"
            yield Mistake(path, f"{wrong}; expected a signal name of its own")
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
    for k, table in tables(data, "rate_sensor"):
        gimbal = text_of(table, "gimbal")
        if gimbal in angles and gimbal not in measured:
            yield ("rate_sensor", k), measured_rate(angles[gimbal], None), ""
        measured.add(gimbal)
