"""Tables of an input file, read as the records that they become, and records written as these tables.

A record says itself how it is read: each field that is a key of the file is annotated with what is expected of it
(`fields.Positive`, ...) or with one of the marks below. A field without a mark is no key of the file.
"""

from __future__ import annotations

import dataclasses
import math
import types
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache, partial
from typing import Annotated, Any, TypeVar, Union, dataclass_transform, get_args, get_origin, get_type_hints

import numpy as np

from platform_ctrl.common.arguments import nearest
from platform_ctrl.common.values import input_value
from platform_ctrl.errors import ArgumentError
from platform_ctrl.plant.fields import BITS, Expected, Refers, Unfit, base_key, in_si, units_of
from platform_ctrl.plant.mistakes import Misfit, Mistake, Path, at, given, suggestion

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Array:
    """Mark of a field that holds records: they are under `key`, each in a table with the header ``[[key]]``."""

    key: str
    least: int = 0
    most: int = 1000
    unique: tuple[str, ...] = ()  # keys of which no two of the tables may have a value in common


@dataclass(frozen=True, eq=False)
class InTable:
    """Mark of a field that is read from `key` of another table: ``[table]``."""

    table: str
    key: str


@dataclass(frozen=True, eq=False)
class Instead:
    """Mark of a field that another key may replace: `value` makes it of that key's value and of the other fields.

    A field that is no key itself is written by `back`.
    """

    key: str
    expected: Expected
    value: Callable[[Any, Mapping[str, Any]], Any]
    back: Callable[[Any], Any] | None = None


@dataclass(frozen=True, eq=False)
class Collected:
    """Mark of a field that is a dictionary of the values of `keys`, or of any key that has no other meaning."""

    keys: Mapping[str, Expected] = field(default_factory=dict)
    others: Expected | None = None


@dataclass(frozen=True, eq=False)
class OneOf:
    """Mark of a field that is one of several records, whose keys are in the same table: exactly one is given.

    `records`: by the key that says which it is.
    """

    records: Mapping[str, type]


@dataclass(frozen=True, eq=False)
class Key:
    """What a key holds, and where it goes: to a field, or into a dictionary that the field is."""

    holds: Expected | Shape
    field: str
    collected: bool = False
    needed: bool = False
    array: Array | None = None
    instead: Instead | None = None


def no_misfits(table: Mapping[str, Any]) -> Iterator[Misfit]:
    """Find nothing wrong with a table."""
    return iter(())


@dataclass(frozen=True, eq=False)
class Shape:
    """Which keys a table has, and what it becomes: with no `make`, fields of the table around it.

    `back` returns the table of what it has become, where that is neither a record nor a dictionary.

    Of each pair of `alternatives` one may be given and, where it is needed (True), has to be.
    """

    make: Callable[..., Any] | None
    keys: Mapping[str, Key]
    alternatives: tuple[tuple[str, str, bool], ...] = ()
    # Of any other key: the field that is a dictionary of them ("": the table is one itself), and what is expected.
    others: tuple[str, Expected] | None = None
    one_of: OneOf | None = None
    back: Callable[[Any], dict[str, Any]] | None = None
    # What is wrong with a table whose keys are all right, the record's `_misfits`.
    misfits: Callable[[dict[str, Any]], Iterator[Misfit]] = no_misfits


@dataclass_transform(frozen_default=True, kw_only_default=True, eq_default=False)
def record_value(cls: type[T]) -> type[T]:
    """Make `cls` an `input_value` whose constructor refuses what no table of a file could say (`ArgumentError`)."""
    made = input_value(cls)
    settled = made.__post_init__  # type: ignore[attr-defined]

    def judged(self: Any) -> None:
        settled(self)
        # Fields that a record needs count as given even where they have their default.
        table = written(self) | {name: getattr(self, name) for name in getattr(self, "_needed", ())}
        _, mistakes = read_table(shape(type(self)), table)
        for mistake in mistakes or at((), shape(type(self)).misfits(table)):
            raise ArgumentError(f"{cls.__name__}: {mistake.words}")

    made.__post_init__ = judged  # type: ignore[attr-defined]
    return made


# Mark of a field that is a record, in a table of the field's name.
TABLE = object()


def shape(record: type) -> Shape:
    """Return the shape of the table that becomes a record."""
    return _shape(record)


@cache
def _shape(record: type) -> Shape:
    hints = get_type_hints(record, include_extras=True)
    keys: dict[str, Key] = {}
    elsewhere: dict[str, dict[str, Key]] = {}
    alternatives: list[tuple[str, str, bool]] = []
    others = one_of = None
    make: Callable[..., Any] = record
    for one in dataclasses.fields(record):
        kind, marks = _marks(hints[one.name])
        needed = one.default is dataclasses.MISSING and one.default_factory is dataclasses.MISSING
        at = next((mark for mark in marks if isinstance(mark, InTable)), None)
        instead = next((mark for mark in marks if isinstance(mark, Instead)), None)
        for mark in marks:
            if isinstance(mark, Collected):
                keys |= {key: Key(expected, one.name, collected=True) for key, expected in mark.keys.items()}
                others = others if mark.others is None else (one.name, mark.others)
            elif isinstance(mark, OneOf):
                one_of, make = mark, _made_of(record, one.name, mark)
                for part in mark.records.values():
                    keys |= {key: Key(inner.holds, one.name, collected=True) for key, inner in shape(part).keys.items()}
            elif mark is TABLE:
                keys[one.name] = Key(shape(kind), one.name, needed=needed)
            elif isinstance(mark, Array):
                keys[mark.key] = Key(shape(get_args(kind)[0]), one.name, needed=mark.least > 0, array=mark)
            elif isinstance(mark, Expected | Shape):
                key = Key(mark, one.name, needed=needed and instead is None)
                if at is None:
                    keys[one.name] = key
                else:
                    elsewhere.setdefault(at.table, {})[at.key] = key
        if instead is not None:
            alone = one.name not in keys
            keys[instead.key] = Key(instead.expected, one.name, needed=alone and needed, instead=instead)
            alternatives += [] if alone else [(one.name, instead.key, needed)]
    for table, inner in elsewhere.items():
        keys[table] = Key(Shape(None, inner), "", needed=any(key.needed for key in inner.values()))
    return Shape(make, keys, tuple(alternatives), others, one_of, misfits=getattr(record, "_misfits", no_misfits))


def _made_of(record: type, name: str, mark: OneOf) -> Callable[..., Any]:
    """Return what makes a record with the one of several that the keys in its field `name` are of."""

    def make(**arguments: Any) -> Any:
        own = arguments[name]
        kind = next(kind for key, kind in mark.records.items() if key in own)
        return record(**arguments | {name: kind(**own)})

    return make


@cache
def references(record: type) -> tuple[tuple[str, Refers], ...]:
    """Return the fields of a record that name a body, and what they may name."""
    hints = get_type_hints(record, include_extras=True)
    return tuple((name, mark) for name, hint in hints.items() for mark in _marks(hint)[1] if isinstance(mark, Refers))


def _marks(hint: Any) -> tuple[Any, list[Any]]:
    """Return the type of an annotation, which may be optional, and its marks."""
    marks: list[Any] = []
    while True:
        parts = [part for part in get_args(hint) if part is not types.NoneType]
        if get_origin(hint) is Annotated:
            hint, marks = hint.__origin__, [*marks, *hint.__metadata__]
        elif get_origin(hint) in (Union, types.UnionType) and len(parts) == 1:
            hint = parts[0]
        else:
            return hint, marks


def read_table(table: Shape, data: dict[str, Any]) -> tuple[dict[str, Any], list[Mistake]]:
    """Return the arguments of the record that a table becomes, for `made`, and what is wrong with keys and values."""
    mistakes: list[Mistake] = []
    return _read(table, data, (), mistakes), mistakes


@dataclass(frozen=True, eq=False)
class _Later:
    """What is made, of the fields before it, once nothing in the whole file is wrong: a record, or by another key."""

    make: Callable[[Mapping[str, Any]], Any]


def made(arguments: dict[str, Any]) -> dict[str, Any]:
    """Return the arguments with the records within made of theirs: once nothing is wrong with the file."""
    out = dict(arguments)
    for name, item in arguments.items():
        if isinstance(item, _Later):
            out[name] = item.make(out)
        elif isinstance(item, tuple):
            out[name] = tuple(one.make(out) if isinstance(one, _Later) else one for one in item)
    return out


def written(record: Any) -> dict[str, Any]:
    """Return the table that a record is read from, the needed keys first, without what it has by default."""
    table = shape(type(record))
    out = _written(table, record)
    collected = [key.field for key in table.keys.values() if key.collected]
    for name in dict.fromkeys([*collected, *(table.others or ())[:1]]):
        part = getattr(record, name)
        out |= _plain(part) if isinstance(part, Mapping) else written(part)
    return out


def _written(table: Shape, record: Any) -> dict[str, Any]:
    out: dict[str, Any] = {}
    fields = {one.name: one for one in dataclasses.fields(record)}
    double = {other for _, other, _ in table.alternatives}
    for name, key in sorted(table.keys.items(), key=lambda pair: not pair[1].needed):
        if name in double or key.collected:
            continue
        if isinstance(key.holds, Shape) and key.holds.make is None:
            item: Any = _written(key.holds, record)
            default: Any = {}
        else:
            one = fields[key.field]
            default = one.default if one.default_factory is dataclasses.MISSING else one.default_factory()
            item, default = (_item_of(key, item) for item in (getattr(record, key.field), default))
        no_limit = default is None and item == math.inf  # which files say by leaving the key out
        if item != default and not no_limit:
            out[name] = item
    return out


def _item_of(key: Key, item: Any) -> Any:
    """Return the content of a key for a field's value."""
    if item is None or item is dataclasses.MISSING:
        return item
    if key.instead is not None and key.instead.back is not None:
        return key.instead.back(item)
    if not isinstance(key.holds, Shape) or isinstance(item, Mapping):
        return _plain(item)
    if key.array is not None:
        return [written(one) for one in item]
    return written(item) if key.holds.back is None else key.holds.back(item)


def _plain(item: Any) -> Any:
    if isinstance(item, np.ndarray | np.generic):
        return item.tolist()
    if isinstance(item, Mapping):
        return {name: _plain(one) for name, one in item.items()}
    return [_plain(one) for one in item] if isinstance(item, tuple | list) else item


def _read(table: Shape, data: dict[str, Any], path: Path, mistakes: list[Mistake]) -> dict[str, Any]:
    """Return the arguments of a record; what is wrong goes to `mistakes`."""
    arguments: dict[str, Any] = {}
    known = list(table.keys)
    missing = {name for name, key in table.keys.items() if key.needed and name not in data}
    unknown = [name for name in data if name not in table.keys] if table.others is None else []
    for name in unknown:
        # A misspelt key is one mistake, not an unknown one and a missing one.
        if len(unknown) <= len(known):
            missing.discard(nearest(name, known) or "")
        mistakes.append(unknown_key((*path, name), data[name], known))
    mistakes += [Mistake((*path, name), _missing((*path, name), table.keys[name])) for name in known if name in missing]
    for one, other, needed in table.alternatives:
        if (one in data) == (other in data) and (one in data or (needed and not unknown)):
            mistakes.append(Mistake(path, either(one, other, one in data)))
    if table.one_of is not None and not unknown:
        mistakes += _choice(table.one_of, data, path)
    keys = {name: key for name, key in table.keys.items() if name in data}
    if table.others is not None:
        field, expected = table.others
        others = (name for name in data if name not in table.keys)
        keys |= {name: Key(expected, field or name, collected=bool(field)) for name in others}
    for name, key in keys.items():
        found = _item(key, data[name], (*path, name), mistakes)
        if key.collected:
            arguments.setdefault(key.field, {})[name] = found
        elif isinstance(key.holds, Shape) and key.holds.make is None:
            arguments |= found
        else:
            arguments[key.field] = found if key.instead is None else _Later(partial(key.instead.value, found))
    return arguments


def _converted(
    table: Shape, data: dict[str, Any], path: Path, mistakes: list[Mistake]
) -> tuple[dict[str, Any], dict[str, str]]:
    """Return a table whose numbers are all in SI, and the keys of the file with other units, each with what it is."""
    if table.others is not None:
        return data, {}
    out, units = {}, dict[str, str]()
    for name, item in data.items():
        found = None if name in table.keys else base_key(name, table.keys, getattr(table.make, "unit", ""))
        if found is None:
            out[name] = item
            continue
        base, suffix = found
        first = base if base in data else next((one for one, key in units.items() if key == base), None)
        if first is not None:
            mistakes.append(Mistake((*path, name), either(first, name, True)))
        if suffix == "bits" and not (type(item) in (int, float) and item in BITS):
            mistakes.append(
                Mistake((*path, name), f"{name} must be a whole number from 1 to {BITS[-1]}, got {given(item)}")
            )
            continue
        units[name] = base
        out[base] = in_si(item, suffix)
    return out, units


def _choice(one_of: OneOf, data: dict[str, Any], path: Path) -> Iterator[Mistake]:
    """Judge which of several records a table has: none, two, or one with keys of another."""
    given_keys = [key for key in one_of.records if key in data]
    if len(given_keys) != 1:
        found = f"got {' and '.join(given_keys)}; leave one out" if given_keys else "one of them is needed"
        yield Mistake(path, f"give exactly one of {', '.join(one_of.records)}; {found}")
        return
    [kind] = given_keys
    own = shape(one_of.records[kind]).keys
    for name, key in own.items():
        if key.needed and name not in data:
            yield Mistake((*path, name), _missing((*path, name), key))
    for part in one_of.records.values():
        for name in [name for name in shape(part).keys if name in data and name not in own]:
            words = f"{name} = {given(data[name])} has no effect with {kind}, which takes {', '.join(own)}"
            yield Mistake((*path, name), words)


def _item(key: Key, item: Any, path: Path, mistakes: list[Mistake]) -> Any:
    if key.array is None:
        return _value(key.holds, item, path, mistakes)
    if not isinstance(item, list):
        mistakes.append(_wrong(path, item, f"must be an array of tables, each headed [[{_header(path)}]]"))
        return ()
    if len(item) > key.array.most:
        words = f"{_header(path)} has {len(item)} elements; at most {key.array.most} are allowed"
        mistakes.append(Mistake(path, words))
        return ()
    if len(item) < key.array.least:
        mistakes.append(_wrong(path, item, f"must have at least one [[{_header(path)}]]"))
    mistakes += (mistake for name in key.array.unique for mistake in _twice(name, item, path))
    return tuple([_value(key.holds, entry, (*path, k), mistakes) for k, entry in enumerate(item)])


def _twice(key: str, tables: list[Any], path: Path) -> Iterator[Mistake]:
    """Yield tables of an array that have the value of `key` in common with an earlier one."""
    taken: dict[str | int, int] = {}
    for k, table in enumerate(tables):
        name = table.get(key) if isinstance(table, dict) else None
        if isinstance(name, str | int) and taken.setdefault(name, k) != k:
            words = f"{key} = {given(name)} is the {key} of [[{_header(path)}]] {taken[name] + 1} already"
            yield Mistake((*path, k, key), f"{words}; choose another, or leave one of them out")


def _value(holds: Expected | Shape, item: Any, path: Path, mistakes: list[Mistake]) -> Any:
    if isinstance(holds, Expected):
        try:
            return holds.judge(item)
        except Unfit as error:
            mistakes.append(_wrong(path, item, f"must be {holds.words}", str(error)))
            return None
    if not isinstance(item, dict):
        mistakes.append(_wrong(path, item, "must be a table"))
        return {}
    before, (in_units, units) = len(mistakes), _converted(holds, item, path, mistakes)
    arguments = _read(holds, in_units, path, mistakes)
    if len(mistakes) == before:
        mistakes += at(path, holds.misfits(in_units))
    for name, base in units.items():
        for k, one in enumerate(mistakes[before:], before):
            if one.path == (*path, base):
                mistakes[k] = _as_in_file(one, name, item[name])
    make = holds.make
    return arguments if make is None else _Later(lambda before: make(**made(arguments)))


def _as_in_file(one: Mistake, name: str, item: object) -> Mistake:
    """Return a mistake about a number in SI with the key and the number that the file has."""
    return Mistake((*one.path[:-1], name), lambda: f"{one.words}; the file has {name} = {given(item)}")


def _wrong(path: Path, item: object, words: str, reason: str = "") -> Mistake:
    key = next(step for step in reversed(path) if isinstance(step, str))
    return Mistake(path, lambda: f"{key} {words}, got {given(item)}{f' ({reason})' if reason else ''}")


def _missing(path: Path, key: Key) -> str:
    if isinstance(key.holds, Expected):
        return f'the key "{path[-1]}" is missing; it must be {key.holds.words}'
    return f"the table {f'[{_header(path)}]' if key.array is None else f'[[{_header(path)}]]'} is missing"


def _header(path: Path) -> str:
    return ".".join(step for step in path if isinstance(step, str))


def either(one: str, other: str, both: bool) -> str:
    """Return the mistake of giving both of two keys, or neither."""
    return f'give either "{one}" or "{other}", {"not both" if both else "one of them is needed"}'


def unknown_key(path: Path, item: object, known: list[str]) -> Mistake:
    """Return the mistake of an unknown key or table."""

    def words() -> str:
        is_table = isinstance(item, Mapping) or (isinstance(item, list) and any(isinstance(x, Mapping) for x in item))
        what = "table" if is_table else "key"
        units = units_of(str(path[-1]), known)
        hint = f"it may be {' or '.join(map(given, units))}" if units else suggestion(str(path[-1]), known)
        return f"unknown {what} {given(path[-1])}; {hint}"

    return Mistake(path, words)
