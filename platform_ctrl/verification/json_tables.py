"""Tables of the JSON files that this package writes, read with errors that name the file, the entry and the key."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.common.values import FloatArray
from platform_ctrl.errors import InputError
from platform_ctrl.plant.fields import finite_number
from platform_ctrl.plant.mistakes import given, one_line, suggestion

SCHEMA = 1
# States of a controller: what is checked of it takes time by their number's cube.
MOST_STATES = 1000


class JSONTable:
    """A table of a file, with its place for messages; with `known` no other keys are allowed."""

    def __init__(self, where: str, data: object, known: Sequence[str] | None = None) -> None:
        if not isinstance(data, Mapping):
            raise InputError(f"{where} must be a table, got {given(data)}")
        self.where, self.data = where, data
        for key in data if known is not None else ():
            if key not in known:  # type: ignore[operator]
                raise self.mistake(f"unknown key {given(key)}; {suggestion(str(key), known)}")  # type: ignore[arg-type]

    def mistake(self, text: str) -> InputError:
        """Return the error with `text` about this table."""
        return InputError(one_line(f"{self.where}: {text}"))

    def must_be(self, key: str, expected: str, item: object) -> InputError:
        """Return the error for an item that is not as expected."""
        return self.mistake(f"{key} must be {expected}, got {given(item)}")

    def item(self, key: str, expected: str) -> Any:
        """Return what is under `key`."""
        if key not in self.data:
            raise self.mistake(f'the key "{key}" is missing; it must be {expected}')
        return self.data[key]

    def expect_schema(self) -> None:
        """Refuse another format."""
        expected = f"{SCHEMA}, the format that this version reads"
        schema = self.item("schema", expected)
        if isinstance(schema, bool) or schema != SCHEMA:
            raise self.must_be("schema", expected, schema)

    def text(self, key: str, expected: str, *, empty: bool = False) -> str:
        """Return a printable text."""
        item = self.item(key, expected)
        if not isinstance(item, str) or not item.isprintable() or not (item.strip() or empty):
            raise self.must_be(key, expected, item)
        return item

    def one_of(self, key: str, options: Sequence[str]) -> str:
        """Return one of a few words."""
        expected = " or ".join(f'"{option}"' for option in options)
        item = self.text(key, expected)
        if item not in options:
            raise self.must_be(key, expected, item)
        return item

    def number(self, key: str, expected: str, *, least: float = -np.inf) -> float:
        """Return a finite number of at least `least`."""
        out = finite_number(self.item(key, expected))
        if out is None or out < least:
            raise self.must_be(key, expected, self.data[key])
        return out

    def names(self, key: str) -> tuple[str, ...]:
        """Return signal names, each once."""
        expected = "a list of signal names"
        item = self.item(key, expected)
        if not isinstance(item, list) or not item or not all(isinstance(name, str) and name for name in item):
            raise self.must_be(key, expected, item)
        for k, name in enumerate(item):
            if name in item[:k]:
                raise self.mistake(f"{key}: {given(name)} is listed twice; leave one of them out")
        return tuple(item)

    def arrays(self, inputs: int, outputs: int, dt: float) -> StateArrays:
        """Return the matrices A to D of a system with so many signals."""
        rows = self._rows("A")
        order = 0 if rows == [[]] else len(rows)
        if order > MOST_STATES:
            raise self.mistake(f"A: has {order} rows; at most {MOST_STATES} states are allowed")
        return StateArrays(
            A=self._matrix("A", order, order),
            B=self._matrix("B", order, inputs),
            C=self._matrix("C", outputs, order),
            D=self._matrix("D", outputs, inputs),
            dt=dt,
        )

    def _rows(self, key: str) -> list[Any]:
        expected = "a matrix as a list of rows"
        item = self.item(key, expected)
        if not isinstance(item, list):
            raise self.must_be(key, expected, item)
        return item

    def _matrix(self, key: str, rows: int, columns: int) -> FloatArray:
        item = self._rows(key)
        expected = f"{key} must be {rows} x {columns}" + (" (square)" if key == "A" else " (by inputs, outputs and A)")
        if rows * columns == 0 and all(row == [] for row in item):
            return np.zeros((rows, columns))
        if len(item) != rows:
            raise self.mistake(f"{expected}, has {len(item)} row{'' if len(item) == 1 else 's'}")
        out = np.zeros((rows, columns))
        for i, row in enumerate(item):
            if not isinstance(row, list):
                raise self.mistake(f"{expected}, row {i + 1} is {given(row)}")
            if len(row) != columns:
                raise self.mistake(f"{expected}, row {i + 1} has {len(row)} element{'' if len(row) == 1 else 's'}")
            for j, entry in enumerate(row):
                number = finite_number(entry)
                if number is None:
                    raise self.must_be(f"{key}: element ({i + 1}, {j + 1})", "a finite number", entry)
                out[i, j] = number
        return out

    def tables(self, key: str, expected: str, known: Sequence[str] | None = None) -> Iterator[JSONTable]:
        """Walk a list of tables."""
        item = self.item(key, expected)
        if not isinstance(item, list):
            raise self.must_be(key, expected, item)
        for number, entry in enumerate(item, 1):
            name = entry.get("name", entry.get("loop")) if isinstance(entry, Mapping) else None
            title = f" {given(name)}" if isinstance(name, str) else ""
            yield JSONTable(f"{self.where}: {key} {number}{title}", entry, known)
