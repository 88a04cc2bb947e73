"""TOML files that nobody meant: what they begin as, how they are written, what is put in place of a value."""

from __future__ import annotations

import copy
import dataclasses
import datetime
import json
import math
import pickle
import random
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from platform_ctrl.plant.source import platform_source, shipped_models

Place = tuple[str | int, ...]

HERE = Path(__file__).parents[1] / "data" / "fuzz"
EXAMPLE = Path(__file__).parents[2] / "examples" / "three_gyro_platform.toml"


@dataclass(frozen=True)
class Seed:
    """A file that is right."""

    name: str
    text: str = field(repr=False)

    @cached_property
    def _read(self) -> bytes:
        return pickle.dumps(tomllib.loads(self.text))

    @property
    def data(self) -> dict[str, Any]:
        """What it says: a copy that may be changed."""
        found: dict[str, Any] = pickle.loads(self._read)
        return found


def _of(path: Path) -> Seed:
    return Seed(path.stem, path.read_text(encoding="utf-8"))


EVERY_PLANT_KEY = _of(HERE / "every_plant_key.toml")
EVERY_JOB_KEY = _of(HERE / "every_job_key.toml")
PLANTS = [EVERY_PLANT_KEY, *(Seed(name, platform_source(name)) for name in shipped_models())]
JOBS = [EVERY_JOB_KEY, _of(EXAMPLE)]

# Values that no key of any file takes, whatever it is.
NEVER_RIGHT: list[Any] = [
    math.nan,
    math.inf,
    -math.inf,
    10**400,
    "",
    " \t",
    "\x00",
    "\x1b[31mred\x1b[0m",
    "one\nline more",
    "right to left \u202e",
    datetime.date(1976, 5, 1),
    datetime.time(1, 2, 3),
    datetime.datetime(1976, 5, 1, 12, tzinfo=datetime.UTC),
    [[[[]]]],
    [[1.0, 2.0], [3.0]],
    [math.nan, 0.0, 1.0],
    [True, False, True],
    [None],
]
# Values that some keys take and others do not.
SOMETIMES_RIGHT: list[Any] = [
    0,
    -1,
    1,
    2,
    3,
    4,
    10,
    2**31,
    2**63,
    10**30,
    -(10**30),
    0.0,
    -0.0,
    0.5,
    1.0,
    -1.5,
    5e-324,
    -5e-324,
    1e-308,
    1e-300,
    1e-30,
    1e30,
    1e150,
    1e300,
    1e308,
    -1e308,
    True,
    False,
    "x",
    "platform",
    "outer",
    "alpha",
    "Omega1",
    "M1",
    "\u00e9\U0001d11e",
    "../x",
    "/dev/zero",
    "a" * 5000,
    "[[gimbal]]",
    "{0} %s {{x}} [bold]red[/bold]",
    [],
    [0.0, 0.0, 0.0],
    [0, 0, 1],
    [1.0, 2.0, 3.0],
    [1e308, 1e308, 1e308],
    [1e-308, 1e-308, 1e-308],
    [1e-308, 1e308, 1.0],
    [-0.0, 0.0],
    [-1.0, 1.0],
    [1.0, -1.0],
    [1.0] * 50,
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
    [[1.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
    [[1e300, 0.0, 0.0], [0.0, 1e300, 0.0], [0.0, 0.0, 1e-300]],
    ["x"],
    ["outer", "outer"],
    {},
    {"x": 1},
    {"name": "x"},
    [{}],
    [{"name": "x"}],
    [{}, 1],
]


def places(data: Any, above: Place = ()) -> Iterator[Place]:
    """Walk the places of everything in a file: tables, arrays, values, and entries of arrays."""
    items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for step, item in items:
        yield (*above, step)
        yield from places(item, (*above, step))


def at(data: Any, place: Place) -> Any:
    """Return what stands at a place."""
    for step in place:
        data = data[step]
    return data


def put(data: dict[str, Any], place: Place, item: Any) -> dict[str, Any]:
    """Return a file with something else at a place."""
    changed = copy.deepcopy(data)
    at(changed, place[:-1])[place[-1]] = item
    return changed


MISHAPS = ("drop", "misspell", "other letters", "again", "inside")


def with_key(data: dict[str, Any], place: Place, mishap: str) -> str:
    """Return a file as TOML with a mishap to one key; a table does not stand twice: it is left as it is."""
    changed = copy.deepcopy(data)
    table, key = at(changed, place[:-1]), str(place[-1])
    match mishap:
        case "drop":
            del table[key]
        case "misspell":
            table[f"{key}s"] = table.pop(key)
        case "other letters":
            table[key.swapcase()] = table.pop(key)
        case "inside":
            table[key] = {key: table[key]}
        case "again":
            # Not within the line of a longer key.
            line = f"\n{key} = {value(table[key])}"
            return written(changed).replace(f"{line}\n", f"{line * 2}\n", 1)
    return written(changed)


def key_of(place: Place) -> str:
    """Return the key at a place, or of the array that it is in."""
    return next(step for step in reversed(place) if isinstance(step, str))


def meaning(item: Any) -> Any:
    """Return what was read in plain types, which can be compared."""
    if dataclasses.is_dataclass(item):
        return {field.name: meaning(getattr(item, field.name)) for field in dataclasses.fields(item)}
    if isinstance(item, np.ndarray):
        return item.tolist()
    if isinstance(item, tuple | list):
        return [meaning(entry) for entry in item]
    return {key: meaning(entry) for key, entry in item.items()} if isinstance(item, dict) else item


def written(data: dict[str, Any], style: random.Random | None = None) -> str:
    """Return a file as TOML; with `style` in one of the many ways that mean the same."""
    lines: list[str] = []
    _table(data, (), lines, style or _Plain())
    return "\n".join(lines) + "\n"


class _Plain(random.Random):
    """No choice at all: the first of everything, nothing shuffled."""

    def random(self) -> float:
        return 1.0

    def shuffle(self, x: Any) -> None:
        pass


def _table(data: dict[str, Any], header: tuple[str, ...], lines: list[str], style: random.Random) -> None:
    plain, below = [], []
    for key, item in data.items():
        nested = isinstance(item, dict) or (isinstance(item, list) and item and all(isinstance(x, dict) for x in item))
        (below if nested and style.random() > 0.2 else plain).append(key)
    style.shuffle(plain)
    style.shuffle(below)
    for key in plain:
        _decorated(f"{_key(key, style)} = {value(data[key], style)}", lines, style)
    for key in below:
        name = (*header, key)
        title = ".".join(_key(step, style) for step in name)
        if isinstance(data[key], dict):
            _decorated(f"[{title}]", lines, style)
            _table(data[key], name, lines, style)
        else:
            for entry in data[key]:
                _decorated(f"[[{title}]]", lines, style)
                _table(entry, name, lines, style)


def _decorated(line: str, lines: list[str], style: random.Random) -> None:
    if style.random() < 0.1:
        lines.append("  # nothing = [is meant]")
    if style.random() < 0.1:
        line = f" \t {line}\t # \u00e9"
    lines.append(line)


def _key(key: str, style: random.Random) -> str:
    bare = key.isascii() and key.replace("_", "").replace("-", "").isalnum()
    return key if bare and style.random() > 0.1 else json.dumps(key)


def value(item: Any, style: random.Random | None = None) -> str:
    """Return a value as TOML."""
    style = style or _Plain()
    match item:
        case None:
            return "nothing"  # which is no TOML
        case bool():
            return "true" if item else "false"
        case str():
            if style.random() < 0.2 and item.isprintable() and "'" not in item:
                return f"'{item}'"
            return json.dumps(item).replace("\x7f", "\\u007f") if item.isascii() else _escaped(item)
        case int():
            return f"0x{item:x}" if 0 <= item < 2**62 and style.random() < 0.1 else str(_digits(item))
        case float():
            shown = repr(item)
            return f"+{shown}" if style.random() < 0.1 and math.isfinite(item) and not shown.startswith("-") else shown
        case dict():
            return "{" + ", ".join(f"{_key(key, style)} = {value(x, style)}" for key, x in item.items()) + "}"
        case list():
            space = "\n  # in between\n  " if style.random() < 0.1 else ""
            return "[" + space + ", ".join(value(x, style) for x in item) + space + "]"
        case _:
            return item.isoformat()


def _digits(item: int) -> str:
    return f"1{'0' * 400}" if item == 10**400 else str(item)


def _escaped(text: str) -> str:
    return '"' + "".join(c if c.isprintable() and c not in '"\\' else f"\\U{ord(c):08x}" for c in text) + '"'
