"""Judging the tables of a baseline: each mistake is one line that names the file, the entry and the key."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from platform_ctrl.errors import InputError
from platform_ctrl.frozen import FloatArray
from platform_ctrl.reading.json_file import finite
from platform_ctrl.reading.mistakes import given, one_line, suggestion


class Table:
    """A table of the file, and where it stands."""

    def __init__(self, where: str, data: object, known: Sequence[str]) -> None:
        if not isinstance(data, Mapping):
            raise InputError(f"{where}: given {given(data)}; expected a table")
        self.where, self.data = where, data
        for key in data:
            if key not in known:
                raise self.mistake(f"unknown key {given(key)}; {suggestion(str(key), known)}")

    def mistake(self, text: str) -> InputError:
        """Return the error that says `text` of this table."""
        return InputError(one_line(f"{self.where}: {text}"))

    def item(self, key: str, expected: str) -> Any:
        """Return what stands under `key`."""
        if key not in self.data:
            raise self.mistake(f'missing key "{key}"; expected {expected}')
        return self.data[key]

    def text(self, key: str, expected: str, *, empty: bool = False) -> str:
        """Return a printable text."""
        item = self.item(key, expected)
        if not isinstance(item, str) or not item.isprintable() or not (item.strip() or empty):
            raise self.mistake(f"{key}: given {given(item)}; expected {expected}")
        return item

    def one_of(self, key: str, options: Sequence[str]) -> str:
        """Return one of a few words."""
        expected = " or ".join(f'"{option}"' for option in options)
        item = self.text(key, expected)
        if item not in options:
            raise self.mistake(f"{key}: given {given(item)}; expected {expected}")
        return item

    def number(self, key: str, expected: str) -> float:
        """Return a finite number."""
        out = finite(self.item(key, expected))
        if out is None:
            raise self.mistake(f"{key}: given {given(self.data[key])}; expected {expected}")
        return out

    def positive(self, key: str, expected: str) -> float:
        """Return a number >= 0."""
        out = self.number(key, expected)
        if out < 0.0:
            raise self.mistake(f"{key}: given {given(self.data[key])}; expected {expected}")
        return out

    def names(self, key: str) -> tuple[str, ...]:
        """Return signal names, each once."""
        item = self.item(key, "a list of signal names")
        if (
            not isinstance(item, list)
            or not item
            or not all(isinstance(name, str) and name for name in item)
            or len(set(item)) < len(item)
        ):
            raise self.mistake(f"{key}: given {given(item)}; expected a list of signal names, each once")
        return tuple(item)

    def matrix(self, key: str, rows: int, columns: int) -> FloatArray:
        """Return a matrix of a known size."""
        item = self.item(key, "a matrix as a list of rows")
        out = np.zeros((rows, columns))
        if rows * columns == 0 and isinstance(item, list) and all(row == [] for row in item):
            return out
        if not isinstance(item, list) or len(item) != rows:
            raise self.mistake(f"{key}: given {given(item)}; expected a matrix of {rows} x {columns} as a list of rows")
        for i, row in enumerate(item):
            numbers = [finite(entry) for entry in row] if isinstance(row, list) else []
            if len(numbers) != columns or any(number is None for number in numbers):
                raise self.mistake(f"{key}: row {i + 1} is {given(row)}; expected {columns} finite numbers")
            out[i] = np.array(numbers, dtype=np.float64)
        return out

    def tables(self, key: str, expected: str, known: Sequence[str]) -> Iterator[Table]:
        """Walk a list of tables."""
        item = self.item(key, expected)
        if not isinstance(item, list):
            raise self.mistake(f"{key}: given {given(item)}; expected {expected}")
        for number, entry in enumerate(item, 1):
            name = entry.get("name", entry.get("loop")) if isinstance(entry, Mapping) else None
            title = f" {given(name)}" if isinstance(name, str) else ""
            yield Table(f"{self.where}: {key} {number}{title}", entry, known)
