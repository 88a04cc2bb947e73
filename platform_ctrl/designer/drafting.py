"""Designs that take seconds, made beside the page: the latest wish for each, one at a time; who waits is told."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Hashable

from platform_ctrl.errors import PlatformCtrlError

Make = Callable[[Callable[[], bool]], None]

# A wish that is followed by another within this time is not begun, s: a slider is still moving.
_PAUSE = 0.6


class Drafting:
    """What is being designed, and what is wanted next.

    Parameters
    ----------
    pause
        How long a wish has to stand before it is begun, s.
    """

    def __init__(self, pause: float = _PAUSE) -> None:
        self._pause = pause
        self._lock = threading.Condition()
        self._wanted: dict[tuple[str, str], tuple[Hashable, Make]] = {}
        self._failed: dict[tuple[str, str], tuple[Hashable, str]] = {}
        self._listeners: list[Callable[[], None]] = []
        self._worker: threading.Thread | None = None
        self._ended = False

    def want(self, loop: str, design: str, key: Hashable, make: Make) -> str:
        """Ask for a design and return a line about it; the same wish again changes nothing.

        `make` is called in a thread with what tells it that it is not wanted any more.
        """
        name = (loop, design)
        with self._lock:
            failed = self._failed.get(name)
            if failed is not None and failed[0] == key:
                return failed[1]
            if not self._ended and self._wanted.get(name, (None,))[0] != key:
                self._wanted[name] = (key, make)
                self._lock.notify_all()
                if self._worker is None:
                    self._worker = threading.Thread(target=self._work, daemon=True)
                    self._worker.start()
        return f"{design}: is being designed; it is shown as soon as it is there"

    def wants(self, loop: str, design: str) -> bool:
        """Whether a design is being made, or will be."""
        with self._lock:
            return (loop, design) in self._wanted

    def listen(self, listener: Callable[[], None]) -> Callable[[], None]:
        """Have `listener` called in a thread after each design, and return what ends that."""
        with self._lock:
            self._listeners.append(listener)

        def end() -> None:
            with self._lock, contextlib.suppress(ValueError):
                self._listeners.remove(listener)

        return end

    def end(self) -> None:
        """Give up what is going on and what is wanted."""
        with self._lock:
            self._ended = True
            self._wanted.clear()
            self._lock.notify_all()

    def _work(self) -> None:
        while True:
            with self._lock:
                if self._ended or not self._wanted:
                    # Nobody waits: the next wish starts another thread.
                    self._worker = None
                    return
                name, wish = next(iter(self._wanted.items()))
                if self._lock.wait(self._pause) and self._wanted.get(name) is not wish:
                    continue
                if self._wanted.get(name) is not wish:
                    continue
            self._make(name, *wish)

    def _make(self, name: tuple[str, str], key: Hashable, make: Make) -> None:
        def unwanted() -> bool:
            return self._ended or self._wanted.get(name, (None,))[0] != key

        line = ""
        try:
            make(unwanted)
        except PlatformCtrlError as error:
            line = str(error)
        with self._lock:
            if self._wanted.get(name, (None,))[0] == key:
                del self._wanted[name]
                if line:
                    self._failed[name] = (key, line)
            listeners = list(self._listeners)
        for listener in listeners:
            listener()
