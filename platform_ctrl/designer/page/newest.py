"""Working things out beside the page: only what is newest, never a queue that lags behind the hand."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

T = TypeVar("T")


class Newest(Generic[T]):
    """Tasks that a thread works off; a newer task takes the place of one of the same key that still waits.

    The thread lives as long as there is something to do.

    Parameters
    ----------
    work
        Called in the thread with all that waits, oldest first.
    """

    def __init__(self, work: Callable[[list[T]], None]) -> None:
        self._work = work
        self._lock = threading.Lock()
        self._waiting: dict[str, T] = {}
        self._working = False
        self._closed = False

    def add(self, key: str, task: T) -> None:
        """Have a task done; the one of the same key that waits is dropped."""
        with self._lock:
            if self._closed:
                return
            self._waiting.pop(key, None)
            self._waiting[key] = task
            if self._working:
                return
            self._working = True
        threading.Thread(target=self._run, name="designer", daemon=True).start()

    def close(self) -> None:
        """Drop what waits; nothing more is taken."""
        with self._lock:
            self._closed = True
            self._waiting.clear()

    def _run(self) -> None:
        while True:
            with self._lock:
                if not self._waiting:
                    self._working = False
                    return
                tasks = list(self._waiting.values())
                self._waiting.clear()
            self._work(tasks)
