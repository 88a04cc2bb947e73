"""Reference tables, made of the records that read files, of methods, metrics, faults and commands.

A page asks for a table by ``<!-- table: keys of job manoeuvre.sine -->``. What a key means is said by the docstring of
the record, or in its place by lines ``key, key: text`` within the comment.
"""

from __future__ import annotations

import dataclasses
import inspect
import json
import math
import re
from collections.abc import Callable, Mapping
from functools import cache
from itertools import groupby
from typing import Any

import typer

from platform_ctrl.analysis.logs import G
from platform_ctrl.analysis.metrics import BUDGET_METRICS, COUPLED_METRICS, METRICS, RUN_METRICS, Metric
from platform_ctrl.cli.commands import app
from platform_ctrl.design.methods import METHODS
from platform_ctrl.job.budget import Source
from platform_ctrl.job.faults import FAULT_KINDS
from platform_ctrl.job.quantities import axis_text
from platform_ctrl.job.reading import JOB_FILE
from platform_ctrl.job.spectra import PROFILES, SPECTRA, ProfileSpectrum
from platform_ctrl.plant.reading import PLANT_FILE, read_platform
from platform_ctrl.plant.sensors import Sensor
from platform_ctrl.plant.tables import Key, Shape, shape

MARK = re.compile(r"^<!-- table: (?P<kind>\w+) of (?P<name>[^\n]+?)(?:\n(?P<notes>.*?))? *-->$", re.M | re.S)
# The head of a table, and its rows.
Table = tuple[tuple[str, ...], list[tuple[str, ...]]]
FILES = {"plant": PLANT_FILE, "job": JOB_FILE}
LIMITS = {"loop": METRICS, "coupled": COUPLED_METRICS, "budget": BUDGET_METRICS, "manoeuvre": RUN_METRICS}
# Messages say more of a value than a table has room for.
_SHORTER = (
    ("a line of text that is not empty", "text"),
    (", without full stops", ""),
    (", the format that this version reads", ""),
    ("three principal moments > 0 or a symmetric 3 x 3 matrix, kg m2", "[I1, I2, I3] or 3 × 3, kg m²"),
    ("a list of names", "names"),
    (" other than 0", " ≠ 0"),
    (">=", "≥"),
)
_ALWAYS = {"--json", "--quiet", "--help"}  # options of all commands


def shown(page: str) -> str:
    """Return a page with tables in place of their marks."""
    return MARK.sub(lambda found: made(found["kind"], found["name"], found["notes"] or ""), page)


def made(kind: str, name: str, notes: str) -> str:
    """Return a table; a note of what it has not is refused."""
    said = dict(line.split(": ", 1) for line in notes.splitlines() if line)
    each = {key: text for keys, text in said.items() for key in keys.split(", ")}
    head, rows = _MAKERS[kind](name, each)
    if unknown := [key for key in each if not any(f"`{key}`" in row[0] for row in rows)]:
        raise KeyError(f"{kind} of {name}: {', '.join(unknown)}")
    lines = ["| " + " | ".join(cell.replace("|", r"\|") for cell in row) + " |" for row in (head, *rows)]
    return "\n".join([lines[0], "|" + " --- |" * len(head), *lines[1:]])


def _keys(name: str, notes: Mapping[str, str]) -> Table:
    """Return the keys of a table of a file; those that are explained together share a row."""
    file, _, path = name.partition(" ")
    table, records = _table(file, tuple(path.split(".")) if path else ())
    common = set(shape(Sensor).keys) - {"name"} if path.endswith("_sensor") or path == "pickoff" else set()
    rows = [
        (f"`{key}`", _value(entry), _default(records, key, entry), notes.get(key) or _meaning(records, key, entry))
        for key, entry in table.keys.items()
        if key not in common
    ]
    together = [zip(*group, strict=True) for _, group in groupby(rows, key=lambda row: row[3])]
    joined = [tuple(", ".join(dict.fromkeys(filter(None, cells))) for cells in group) for group in together]
    return ("key", "value", "default", "meaning"), joined


def _table(file: str, path: tuple[str, ...]) -> tuple[Shape, list[type]]:
    """Return the shape of a table, and the records whose docstrings explain its keys."""
    if path == ("sensors",):
        return shape(Sensor), [Sensor]
    table: Any = FILES[file]
    for key in path:
        table = table.keys[key].holds
    if table.one_of is not None:
        return table, [Source, *SPECTRA.values()]
    make = table.make if inspect.isclass(table.make) else FILES[file].make
    return table, [make] if inspect.isclass(make) else []


def _value(key: Key) -> str:
    if isinstance(key.holds, Shape):
        return "table" if key.array is None else "tables"
    words = key.holds.words
    for long, short in _SHORTER:
        words = words.replace(long, short)
    return re.sub(r'"[^"]+"', r"`\g<0>`", words.replace('" or "', '", "'))


def _default(records: list[type], name: str, key: Key) -> str:
    dataclass = [record for record in records if dataclasses.is_dataclass(record)]
    fields = {one.name: one.default for record in dataclass for one in dataclasses.fields(record)}
    item = fields.get(name, fields.get(key.field))
    if key.needed or not isinstance(item, bool | int | float | str) or item in ("", math.inf):
        return "required" if key.needed else ""
    return f"`{json.dumps(item)}`" if isinstance(item, str | bool) else f"{item:g}"


def _meaning(records: list[type], name: str, key: Key) -> str:
    texts = [_explained(record).get(one) for one in (name, key.field) for record in records]
    text = next(filter(None, texts))
    text = text[0].lower() + text[1:] if text[1:2].islower() else text
    return text.replace("``", "`").replace(", or None", "").replace("None:", "left out:").removesuffix(".")


@cache
def _explained(record: type) -> dict[str, str]:
    """Return what the docstring of a record says of its fields."""
    section = (inspect.getdoc(record) or "").partition("\nAttributes\n----------\n")[2]
    found = re.findall(r"^(\w[\w, ]*)(?: : .*)?\n((?:    .*\n?)+)", section, re.M)
    return {name: " ".join(text.split()) for names, text in found for name in names.strip().split(", ")}


def _limits(name: str, notes: Mapping[str, str]) -> Table:
    rows = []
    for one in LIMITS[name].values():
        keys, best = [one.key], ""
        if isinstance(one, Metric):
            keys = [f"{one.key}_{scope}" if scope else one.key for scope in one.scopes]
            keys += filter(None, [one.lowest_key, one.frequency_key])
            best = f"; no loop has more than {one.best:g}" if one.best else ""
        if one.key and one.key != "limit":  # the key of a source
            rows.append((", ".join(f"`{key}`" for key in keys), one.unit, f"{one.sense}: {one.meaning}{best}"))
    return ("key", "unit", "requirement"), rows


def _options(name: str, notes: Mapping[str, str]) -> Table:
    """Return the options of a method; the notes are their defaults."""
    method = METHODS[name]
    tuned = method.tunable if method.tunes else ()
    return ("option", "unit", "default", "meaning"), [
        (f"`{key}`", one.unit, notes[key], f"{one.tip}{'; tuned' if key in tuned else ''}")
        for key, one in method.options.items()
    ]


def _kinds(name: str, notes: Mapping[str, str]) -> Table:
    return ("kind", "part", "needs", "may have", "what happens"), [
        (f'`"{kind.name}"`', kind.part or "", ", ".join(kind.needed), ", ".join(kind.optional), kind.effect)
        for kind in FAULT_KINDS.values()
    ]


def _profiles(name: str, notes: Mapping[str, str]) -> Table:
    rows = []
    for one in PROFILES.values():
        rms = math.sqrt(ProfileSpectrum(profile=one.name).mean_square(0.0, 1e4))
        size = f"{rms / G:.3g} g" if one.kind == "specific-force" else f"{rms:.3g} rad/s"
        band = f"{one.points[0, 0]:g} to {one.points[-1, 0]:g}"
        rows.append((f"`{one.name}`", one.kind, band, size, one.title, one.source))
    return ("profile", "kind", "Hz", "rms", "what it is", "source"), rows


def _bodies(name: str, notes: Mapping[str, str]) -> Table:
    plant = read_platform(name)
    gimbals = [(one.name, one.parent, axis_text(one.axis), f"`{one.angle}`") for one in plant.gimbals]
    rotors = [(one.name, one.carrier, axis_text(one.axis), f"rotor, {one.control}") for one in plant.rotors]
    return ("body", "carried by", "axis", "angle"), gimbals + rotors


def _command(name: str, notes: Mapping[str, str]) -> Table:
    command: Any = typer.main.get_command(app).commands[name]  # type: ignore[attr-defined]
    spelt = [
        (one.opts + one.secondary_opts if one.opts[0][0] == "-" else [one.metavar], one.help) for one in command.params
    ]
    return ("option", "meaning"), [
        (", ".join(f"`{one}`" for one in names), text) for names, text in spelt if not _ALWAYS & set(names)
    ]


_MAKERS: dict[str, Callable[[str, Mapping[str, str]], Table]] = {
    "keys": _keys,
    "limits": _limits,
    "options": _options,
    "kinds": _kinds,
    "profiles": _profiles,
    "command": _command,
    "bodies": _bodies,
}
