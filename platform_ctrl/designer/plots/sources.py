"""Where the data of all plots stand: sources by name, changed in place and only where something has changed."""

from __future__ import annotations

from typing import Any

import numpy as np
from bokeh.models import ColumnDataSource


class Sources:
    """The column data sources of a page's plots."""

    def __init__(self) -> None:
        self.by_name: dict[str, ColumnDataSource] = {}

    def new(self, name: str, *columns: str, lists: tuple[str, ...] = ()) -> ColumnDataSource:
        """Return a new source with empty columns: of numbers, and of texts or whole curves (`lists`)."""
        data: dict[str, Any] = {one: np.zeros(0, np.float32) for one in columns}
        out = ColumnDataSource(data=data | {one: [] for one in lists}, name=name)
        self.by_name[name] = out
        return out

    def put(self, name: str, /, **columns: Any) -> None:
        """Give a source all its columns; nothing is sent where they are as before."""
        source = self.by_name[name]
        if not _same(source.data, columns):
            source.data = columns


def _same(old: dict[str, Any], new: dict[str, Any]) -> bool:
    if old.keys() != new.keys():
        return False
    for name, one in new.items():
        before = old[name]
        if isinstance(one, np.ndarray):
            if not (isinstance(before, np.ndarray) and np.array_equal(before, one, equal_nan=True)):
                return False
        elif len(before) != len(one) or not all(map(_equal, before, one)):
            return False
    return True


def _equal(one: Any, other: Any) -> bool:
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        return np.array_equal(one, other, equal_nan=True)
    return bool(one == other)
