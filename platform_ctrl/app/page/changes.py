"""Changes of the settings that a page requests: chosen from its lists, and worked off in a thread."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Generic, TypeVar

from platform_ctrl.common.arguments import known_name, known_names, whole
from platform_ctrl.common.signatures import short
from platform_ctrl.errors import InputError

if TYPE_CHECKING:
    from platform_ctrl.app.backend import Backend
    from platform_ctrl.app.settings import Settings

NAMES = ("mode", "loop", "design", "channel", "plant", "axis", "band", "overlays")


def chosen(backend: Backend, settings: Settings, name: str, given: object, plants: tuple[str, ...]) -> Settings:
    """Return the settings with something else chosen."""
    choices = backend.choices()
    known_name("choice", name, NAMES)
    if name == "axis":
        return settings.but(axis=whole("axis", given, 1, 3))
    if name == "band":
        if not isinstance(given, bool):
            raise InputError(f"band: given {short(given)}; expected true or false")
        return settings.but(band=given)
    if name == "overlays":
        others = [one for one in choices.designs[settings.loop] if one != settings.design]
        if not isinstance(given, list):
            raise InputError(f"overlays: given {short(given)}; expected a list of designs")
        return settings.but(overlays=tuple(others[k] for k in known_names("overlays", given, others)))
    text = _text(name, given)
    if name == "loop":
        return backend.chosen(settings, loop=text)
    if name == "design":
        return backend.chosen(settings, design=text)
    if name == "channel":
        known_name("channel", text, choices.channels[settings.loop])
        return settings.but(channel=text)
    if name == "plant":
        known_name("plant", text, plants)
        return settings.but(plant=text)
    if text == settings.mode:
        return settings
    for loop in choices.loops:
        other = backend.chosen(settings, loop=loop)
        if other.mode == text:
            return other
    raise InputError(f"mode: given {short(given)}; expected one that this job has a loop for")


def _text(name: str, given: object) -> str:
    if not isinstance(given, str):
        raise InputError(f"{name}: given {short(given)}; expected a text")
    return given


T = TypeVar("T")


class LatestTasks(Generic[T]):
    """Tasks that a thread works off; a newer task takes the place of one of the same key that still waits.

    The thread lives as long as there is something to do.
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
        threading.Thread(target=self._run, name="page", daemon=True).start()

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
