"""A table of an input file where it stands: what it holds as far as that has the right type, and mistakes about it.

The structure check refuses what has another type; here it counts as not given.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from platform_ctrl.plant.fields import Unfit, number
from platform_ctrl.plant.mistakes import Mistake, Path, given, suggestion


class Entry:
    """The table `data` at `path`; empty where `data` is no table."""

    __slots__ = ("data", "path")

    def __init__(self, data: object, path: Path = ()) -> None:
        self.data: dict[str, Any] = data if isinstance(data, dict) else {}
        self.path = path

    def __contains__(self, key: str) -> bool:
        return key in self.data

    def number(self, key: str) -> float | None:
        """Return the number under a key."""
        try:
            return number(self.data.get(key))
        except Unfit:
            return None

    def text(self, key: str) -> str | None:
        """Return the text under a key."""
        item = self.data.get(key)
        return item if isinstance(item, str) else None

    def names(self, key: str) -> list[str]:
        """Return the names in the list under a key, as far as they are text."""
        names = self.data.get(key)
        return [name for name in names if isinstance(name, str)] if isinstance(names, list) else []

    def table(self, key: str) -> Entry:
        """Return the table under a key."""
        return Entry(self.data.get(key), (*self.path, key))

    def tables(self, key: str) -> list[Entry]:
        """Return the tables of the array of tables under a key."""
        entries = self.data.get(key)
        found = enumerate(entries) if isinstance(entries, list) else ()
        return [Entry(one, (*self.path, key, k)) for k, one in found if isinstance(one, dict)]

    def named(self, key: str) -> list[str]:
        """Return the names of the tables of the array of tables under a key."""
        return [name for one in self.tables(key) if (name := one.text("name")) is not None]

    @property
    def place(self) -> int:
        """The number of the table in its array, from 1."""
        return int(self.path[-1]) + 1

    def says(self, key: str, words: str) -> Mistake:
        """Return what is wrong with a key."""
        return Mistake((*self.path, key), f"{key}: {words}")

    def text_at(self, key: str, text: str) -> Mistake:
        """Return the mistake at a key with all of its text."""
        return Mistake((*self.path, key), text)

    def wrong(self, key: str, words: str, more: str = "") -> Mistake:
        """Return what a key must be."""
        return self.text_at(key, f"{key} must be {words}, got {given(self.data.get(key))}{more}")

    def missing(self, key: str, words: str) -> Mistake:
        """Return that a key is missing, and what needs it."""
        return self.text_at(key, f'the key "{key}" is missing; {words}')

    def useless(self, key: str, words: str) -> Mistake:
        """Return that a key has no effect, and with or without what."""
        return self.text_at(key, f"{key} = {given(self.data[key])} has no effect {words}")

    def unknown(self, key: str, name: str, what: str, known: Iterable[str]) -> Mistake:
        """Return that a name under a key is no `what`."""
        return self.says(key, f"{given(name)} is no {what}; {suggestion(name, known)}")

    def takes(self, of: str, needed: Iterable[str], others: Iterable[str], every: Iterable[str]) -> Iterator[Mistake]:
        """Judge that of `every` key those that are `needed` stand here, and no further one but `others`."""
        needed, allowed = list(needed), [*needed, *others]
        for key in needed:
            if key not in self:
                yield self.missing(key, f"{of} needs {', '.join(needed)}")
        for key in every:
            if key in self and key not in allowed:
                yield self.useless(key, f"with {of}, which takes {', '.join(allowed) or 'at alone'}")

    def unique(self, key: str) -> Iterator[Mistake]:
        """Walk the tables of an array whose name another one has."""
        taken: dict[str, int] = {}
        for one in self.tables(key):
            name = one.text("name")
            if name in taken:
                header = ".".join([*(step for step in self.path if isinstance(step, str)), key])
                words = f"name = {given(name)} is the name of [[{header}]] {taken[name]} already; choose another"
                yield one.text_at("name", words)
            elif name is not None:
                taken[name] = one.place

    def of_length(self, key: str, beside: str) -> Iterator[Mistake]:
        """Judge that two lists have as many elements."""
        one, other = self.data.get(key), self.data.get(beside)
        if isinstance(one, list) and isinstance(other, list) and len(one) != len(other):
            yield self.text_at(key, f"{key} must have as many elements as {beside}, {len(other)}, got {len(one)}")
