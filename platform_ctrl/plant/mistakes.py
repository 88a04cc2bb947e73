"""Mistakes in an input, in the file's order, as one line."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from platform_ctrl.common.arguments import nearest
from platform_ctrl.errors import InputError

Path = tuple[str | int, ...]

LONGEST = 60
# Whole floats below this are shown without a decimal point.
_WHOLE = 1e15
# Known names that a message lists.
LISTED = 20
# Further mistakes whose place a message names.
NAMED = 3


@dataclass(frozen=True)
class Mistake:
    """A mistake (`text`), and where it is in the nested tables (`path`: keys, and indices of arrays).

    A text that takes long to find may be a function: of many mistakes one is reported.
    """

    path: Path
    text: str | Callable[[], str]

    @property
    def words(self) -> str:
        """The text, found."""
        return self.text if isinstance(self.text, str) else self.text()


# What is wrong with a table or its record: the key (keys that lead further in, () for the table itself), the sentence.
Misfit = tuple[str | Path, str]


def at(path: Path, misfits: Iterable[Misfit]) -> Iterator[Mistake]:
    """Yield what is wrong with the table at `path`."""
    for keys, text in within(path, misfits):
        yield Mistake(keys, one_line(text))


def within(path: Path, misfits: Iterable[Misfit]) -> Iterator[tuple[Path, str]]:
    """Yield what is wrong with the table at `path`, by the keys that lead there and further in."""
    for keys, text in misfits:
        yield (*path, *((keys,) if isinstance(keys, str) else keys)), text


def wrong(table: object, key: str, words: str, more: str = "") -> Misfit:
    """Return a mistake that says what a key must be."""
    return key, f"{key} must be {words}, got {_stands(table, key)}{more}"


def missing(key: str, words: str) -> Misfit:
    """Return that a key is missing, and what needs it."""
    return key, f'the key "{key}" is missing; {words}'


def useless(table: object, key: str, words: str) -> Misfit:
    """Return that a key has no effect, and with or without what."""
    return key, f"{key} = {_stands(table, key)} has no effect {words}"


def unknown(key: str, name: str, what: str, known: Iterable[str]) -> Misfit:
    """Return that a name under a key is no `what`."""
    return key, f"{key}: {given(name)} is no {what}; {suggestion(name, known)}"


def strange(key: str, names: Iterable[str | None], what: str, known: Collection[str]) -> Iterator[Misfit]:
    """Yield names under a key, those that are given, that are no `what`."""
    return (unknown(key, name, what, known) for name in names if name is not None and name not in known)


def takes(
    table: Mapping[str, Any], of: str, needed: Iterable[str], others: Iterable[str], every: Iterable[str]
) -> Iterator[Misfit]:
    """Yield keys that are `needed` and missing, and those of `every` that are neither needed nor among `others`."""
    needed, allowed = list(needed), [*needed, *others]
    yield from (missing(key, f"{of} needs {', '.join(needed)}") for key in needed if key not in table)
    for key in every:
        if key in table and key not in allowed:
            yield useless(table, key, f"with {of}, which takes {', '.join(allowed) or 'at alone'}")


def of_length(table: Mapping[str, Any], key: str, beside: str) -> Iterator[Misfit]:
    """Yield a list that has not as many elements as another one."""
    if key in table and beside in table and len(table[key]) != len(table[beside]):
        words = f"{key} must have as many elements as {beside}, {len(table[beside])}, got {len(table[key])}"
        yield key, words


def _stands(table: object, key: str) -> str:
    """Show the value of a key of a table, or of a record, whose numbers are floats."""
    item = table.get(key) if isinstance(table, Mapping) else getattr(table, key)
    return given(int(item) if isinstance(item, float) and item.is_integer() and abs(item) < _WHOLE else item)


def given(item: object, depth: int = 0) -> str:
    """Return a value as a TOML file would have it, shortened."""
    match item:
        case bool():
            text = "true" if item else "false"
        case str():
            text = f'"{item[:LONGEST]}"'
        case int() if item.bit_length() > 200:
            text = f"an integer of {item.bit_length()} bits"  # Python refuses to print very long integers
        case int() | float() | complex():
            text = repr(item)
        case Mapping():
            text = "a table"
        case list() | tuple() if any(isinstance(entry, Mapping) for entry in item):
            text = "an array of tables"
        case list() | tuple() if item and depth > 1:
            text = "[...]"
        case list() | tuple():
            text = "[" + ", ".join(given(entry, depth + 1) for entry in item[:10]) + "]"
        case None:
            text = "None"
        case _:
            text = f"an object of type {type(item).__name__}"
    text = one_line(text)
    return text if len(text) <= LONGEST or depth else text[: LONGEST - 4] + " ..."


def one_line(text: str) -> str:
    """Escape whatever would break the line or cannot be printed."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


_REPLACED = dict.fromkeys(
    ("secant_of", "secant_limit"), "resolve = true in the [[loop]] turns its readings to the axes of its gimbals"
)


def suggestion(word: str, known: Iterable[str]) -> str:
    """Return ``did you mean "..."?``, the list of what is known, or what replaces a key that there was."""
    if word in _REPLACED:
        return _REPLACED[word]
    known = list(known)
    close = nearest(word, known)
    return listed(known) if close is None else f'did you mean "{close}"?'


def listed(known: Iterable[str]) -> str:
    """Return the list of what is known."""
    known = list(known)
    if not known:
        return "none is known"
    more = f" and {len(known) - LISTED} more" if len(known) > LISTED else ""
    return "known: " + ", ".join(given(name) for name in known[:LISTED]) + more


def report(label: str, data: dict[str, Any], mistakes: Iterable[Mistake]) -> InputError:
    """Return the error that names the first mistake in the file's order, and the places of the others."""
    first_at: dict[Path, Mistake] = {}
    for mistake in mistakes:
        first_at.setdefault(mistake.path, mistake)
    places: dict[int, dict[str, int]] = {}
    first, *others = sorted(first_at.values(), key=lambda mistake: _position(data, mistake.path, places))
    parts = [label, *_headers(data, first.path), first.words]
    named = [_place(data, one.path) for one in others[:NAMED]] + ["..."] * (len(others) > NAMED)
    more = f" (and {len(others)} more: {', '.join(named)})" if others else ""
    return InputError(one_line(": ".join(parts) + more))


def _place(data: Any, path: Path) -> str:
    """Return where a mistake is: headers and key."""
    return ": ".join([*_headers(data, path), *(step for step in path[-1:] if isinstance(step, str))])


def _position(data: Any, path: Path, places: dict[int, dict[str, int]]) -> tuple[int, ...]:
    """Return the position of `path` in the file; that of a missing key is the head of its table.

    `places` keeps the lines of the keys of each table, for the next mistake.
    """
    position = []
    for step in path:
        if isinstance(step, int):
            position.append(step)
        elif isinstance(data, dict) and step in data:
            if id(data) not in places:
                places[id(data)] = {key: number for number, key in enumerate(data)}
            position.append(places[id(data)][step])
        else:
            return (*position, -1)
        data = _entry(data, step)
    return tuple(position)


def _headers(data: Any, path: Path) -> list[str]:
    """Return the TOML headers on the way to `path`: ``[[loop]] 1 "caging"``, ``[loop.limits]``."""
    headers: list[str] = []
    names: list[str] = []
    table = ""
    for step, following in zip(path, (*path[1:], None), strict=True):
        data = _entry(data, step)
        if isinstance(step, int):
            headers.append(f"[[{'.'.join(names)}]] {step + 1}{_title(data)}")
            table = ""
        elif following is not None:
            names.append(step)
            table = f"[{'.'.join(names)}]"
    return [*headers, table] if table else headers


def _entry(data: Any, step: str | int) -> Any:
    if isinstance(data, dict):
        return data.get(step)
    return data[step] if isinstance(data, list) and isinstance(step, int) and step < len(data) else None


def _title(entry: Any) -> str:
    for key in ("name", "parameter", "fault", "gimbal", "body", "root_axis"):
        if isinstance(entry, dict) and isinstance(entry.get(key), str | int):
            shown = given(entry[key])
            return f" ({key} {shown})" if key in ("gimbal", "body", "root_axis") else f" {shown}"
    return ""


# A job with an inline plant needs six. What contains itself would never end.
DEEPEST = 8


def plain(source: Mapping[Any, Any]) -> tuple[dict[str, Any], list[Mistake]]:
    """Return a copy of `source` in dicts, lists and plain scalars, and what cannot be one.

    Mappings become dicts, tuples and arrays lists, NumPy scalars Python ones. Anything else stays what it
    is: the judge of the key refuses it. None is refused here, because further on it means "not given".
    """
    mistakes: list[Mistake] = []
    return _plain(source, (), (), mistakes), mistakes


def _plain(item: Any, path: Path, inside: tuple[int, ...], mistakes: list[Mistake]) -> Any:
    if isinstance(item, np.ndarray | np.generic):
        item = item.tolist()
    if not isinstance(item, Mapping | list | tuple):
        return str(item) if isinstance(item, str) else item
    if id(item) in inside or len(inside) > DEEPEST:
        key = next(step for step in reversed(path) if isinstance(step, str))
        mistakes.append(Mistake(path[: path.index(key) + 1], f"{key} is nested deeper than {DEEPEST} levels"))
        return None
    inside = (*inside, id(item))
    if not isinstance(item, Mapping):
        return [_plain(entry, (*path, k), inside, mistakes) for k, entry in enumerate(item)]
    table: dict[str, Any] = {}
    for key, entry in item.items():
        if not isinstance(key, str) or not key.isprintable():
            mistakes.append(Mistake((*path, ""), f"the key {given(key)} is not a line of printable text"))
            continue
        if entry is None:
            mistakes.append(Mistake((*path, key), f"{key} must not be None; leave the key out instead"))
        table[str(key)] = _plain(entry, (*path, str(key)), inside, mistakes)
    return table
