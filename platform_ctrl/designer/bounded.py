"""What was worked out lately, kept for as long as there is room: the oldest goes first."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

T = TypeVar("T")


class Bounded(Generic[T]):
    """A cache of at most `room` items; safe in several threads.

    Parameters
    ----------
    room
        Most items.
    """

    def __init__(self, room: int) -> None:
        self.room = room
        self._items: OrderedDict[Hashable, T] = OrderedDict()
        self._lock = threading.Lock()

    def __len__(self) -> int:
        """Return how many items are kept."""
        return len(self._items)

    def get(self, key: Hashable, make: Callable[[], T]) -> T:
        """Return the item of `key`, made when it is not there: two threads may both make it."""
        with self._lock:
            if key in self._items:
                self._items.move_to_end(key)
                return self._items[key]
        made = make()
        self.put(key, made)
        return made

    def put(self, key: Hashable, item: T) -> None:
        """Keep an item, and let the oldest go."""
        with self._lock:
            self._items[key] = item
            self._items.move_to_end(key)
            while len(self._items) > self.room:
                self._items.popitem(last=False)

    def found(self, key: Hashable) -> T | None:
        """Return the item of `key`, or None."""
        with self._lock:
            return self._items.get(key)
