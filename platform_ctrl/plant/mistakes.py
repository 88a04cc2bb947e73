"""Mistakes in an input, in the file's order, as one line."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from platform_ctrl.common.arguments import nearest
from platform_ctrl.errors import InputError

Path = tuple[str | int, ...]

LONGEST = 60
# Known names that a message lists.
LISTED = 20
# Further mistakes whose place a message names.
NAMED = 3


@dataclass(frozen=True)
class Mistake:
    """What is wrong (`text`), and where in the nested tables (`path`: keys, and indices of arrays).

    A text that takes long to find may be a function: of many mistakes one is reported.
    """

    path: Path
    text: str | Callable[[], str]

    @property
    def words(self) -> str:
        """The text, found."""
        return self.text if isinstance(self.text, str) else self.text()


def given(item: object, depth: int = 0) -> str:
    """Show a value as it would stand in a TOML file, shortened."""
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


def suggestion(word: str, known: Iterable[str]) -> str:
    """Return ``did you mean "..."?``, or the list of what is known."""
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

    `places` keeps where the keys of each table stand, for the next mistake.
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
    if isinstance(entry, dict):
        for key, form in (
            ("name", " {}"),
            ("gimbal", " (gimbal {})"),
            ("body", " (body {})"),
            ("root_axis", " (root_axis {})"),
            ("parameter", " {}"),
            ("fault", " {}"),
        ):
            if isinstance(entry.get(key), str | int):
                return form.format(given(entry[key]))
    return ""


# A job with an inline plant needs six. What contains itself would never end.
DEEPEST = 8
_PLAIN_ALREADY = frozenset({bool, int, float, str})


def plain(source: Mapping[Any, Any]) -> tuple[dict[str, Any], list[Mistake]]:
    """Return a copy of `source` in dicts, lists and plain scalars, and what cannot be one.

    Mappings become dicts, tuples and arrays lists, NumPy scalars Python ones. Anything else stays what it
    is: the judge of the key refuses it. None is refused here, because further on it means "not given".
    """
    mistakes: list[Mistake] = []
    return _table(source, (), (id(source),), mistakes), mistakes


def _table(source: Mapping[Any, Any], path: Path, inside: tuple[int, ...], mistakes: list[Mistake]) -> dict[str, Any]:
    table: dict[str, Any] = {}
    for key, item in source.items():
        if not isinstance(key, str) or not key.isprintable():
            mistakes.append(Mistake((*path, ""), f"the key {given(key)} is not a line of printable text"))
        elif item is None:
            mistakes.append(Mistake((*path, key), f"{key} must not be None; leave the key out instead"))
            table[str(key)] = None
        else:
            table[str(key)] = _plain(item, (*path, str(key)), inside, mistakes)
    return table


def _plain(item: object, path: Path, inside: tuple[int, ...], mistakes: list[Mistake]) -> Any:
    if id(item) in inside or len(inside) > DEEPEST:
        while isinstance(path[-1], int):
            path = path[:-1]
        mistakes.append(Mistake(path, f"{path[-1]} is nested deeper than {DEEPEST} levels"))
        return None
    inside = (*inside, id(item))
    if isinstance(item, Mapping):
        return _table(item, path, inside, mistakes)
    if isinstance(item, np.ndarray):
        item = item.tolist()
    if isinstance(item, list | tuple):
        return [
            entry if type(entry) in _PLAIN_ALREADY else _plain(entry, (*path, k), inside, mistakes)
            for k, entry in enumerate(item)
        ]
    if isinstance(item, np.floating):
        return float(item)
    if isinstance(item, np.integer):
        return int(item)
    if isinstance(item, str):
        return str(item)
    return item
