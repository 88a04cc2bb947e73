"""Modes from a table of a finite-element run: a CSV file beside the plant file, a line a mode."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from platform_ctrl.common.arguments import nearest
from platform_ctrl.errors import InputError
from platform_ctrl.plant.mistakes import given, one_line
from platform_ctrl.plant.source import read_text

# Columns that are no participation: of what a mode needs, one of each line.
_NEEDED = (("name",), ("frequency_hz", "frequency"), ("damping",))
_VECTORS = ("base", "base_force")
_JOINT = "joint."


def with_mode_table(data: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Return a plant whose ``modes`` are a file with the modes of that file as ``mode`` tables behind its own."""
    out = dict(data)
    name = out.get("modes")
    if not isinstance(name, str):
        return out
    del out["modes"]
    own = out.get("mode", [])
    return out | ({"mode": [*own, *_modes(folder / name)]} if isinstance(own, list) else {})


def _modes(path: Path) -> list[dict[str, Any]]:
    """Return the tables of the modes in a file."""
    label = one_line(str(path))
    text = read_text(path, "a CSV table of modes").splitlines()
    lines = [(k, line) for k, line in enumerate(text, 1) if line.strip() and not line.lstrip().startswith("#")]
    cells = [[cell.strip() for cell in row] for row in csv.reader(line for _, line in lines)]
    header = cells[0] if cells else []
    for one in _NEEDED:
        if not set(one) & set(header):
            close = nearest(one[0], header)
            hint = "" if close is None else f"; is {given(close)} meant?"
            raise InputError(f"{label}: there is no column {given(one[0])}{hint}")
    if twice := next((name for name in header if header.count(name) > 1), None):
        raise InputError(f"{label}: column {given(twice)} is there twice; leave one of them out")
    return [_mode(f"{label}, line {k}", header, row) for (k, _), row in zip(lines[1:], cells[1:], strict=True)]


def _mode(label: str, header: list[str], row: list[str]) -> dict[str, Any]:
    """Return the table of the mode in a line; cells without a number are left out."""
    if len(row) != len(header):
        raise InputError(f"{label}: has {len(row)} cells, and the header {len(header)} columns")
    out: dict[str, Any] = {"name": row[header.index("name")], "participation": {}, "joints": {}}
    for column, cell in zip(header, row, strict=True):
        if column == "name" or not cell:
            continue
        try:
            number = float(cell)
        except ValueError:
            raise InputError(f"{label}: {column} must be a number, got {given(cell)}") from None
        key, axis = column[:-1], column[-1:]
        if column.startswith(_JOINT):
            out["joints"][column.removeprefix(_JOINT)] = number
        elif key in _VECTORS and axis in ("1", "2", "3"):
            out.setdefault(key, [0.0, 0.0, 0.0])[int(axis) - 1] = number
        elif any(column in one for one in _NEEDED):
            out[column] = number
        elif number:
            out["participation"][column] = number
    fixed = any(column.startswith(_JOINT) for column in header)
    left = ("participation", "joints") if fixed else ("joints",)
    return {key: one for key, one in out.items() if one or key not in left} | ({"interface": "fixed"} if fixed else {})
