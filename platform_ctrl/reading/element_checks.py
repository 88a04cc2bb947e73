"""What must fit together about force elements and servo rotors of a plant file."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from platform_ctrl.reading.fields import Unfit, coulomb
from platform_ctrl.reading.mistakes import Mistake, Path, given, suggestion, tables, text_of

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
