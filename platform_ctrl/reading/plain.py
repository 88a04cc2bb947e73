"""From whatever Python objects a dict holds to the types that TOML knows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from platform_ctrl.reading.mistakes import Mistake, Path, given

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
            mistakes.append(Mistake((*path, key), f"{key} = None: leave the key out where nothing is meant"))
            table[str(key)] = None
        else:
            table[str(key)] = _plain(item, (*path, str(key)), inside, mistakes)
    return table


def _plain(item: object, path: Path, inside: tuple[int, ...], mistakes: list[Mistake]) -> Any:
    if id(item) in inside or len(inside) > DEEPEST:
        while isinstance(path[-1], int):
            path = path[:-1]
        mistakes.append(Mistake(path, f"{path[-1]}: nested deeper than {DEEPEST} levels"))
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
