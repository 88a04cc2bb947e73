"""Undo and redo: the settings that a page was at, as many as there is room for."""

from __future__ import annotations

from collections import deque

from platform_ctrl.app.settings import Settings


class History:
    """Where a page was, and where it came back from."""

    def __init__(self, first: Settings, room: int = 200) -> None:
        self.now = first
        self._past: deque[Settings] = deque(maxlen=room)
        self._future: deque[Settings] = deque(maxlen=room)

    @property
    def can_undo(self) -> bool:
        """Whether there is something to go back to."""
        return bool(self._past)

    @property
    def can_redo(self) -> bool:
        """Whether something was taken back that can be done again."""
        return bool(self._future)

    def put(self, settings: Settings) -> None:
        """Go on to other settings; what was taken back before is forgotten. The same settings are no step."""
        if settings is self.now or settings.data() == self.now.data():
            return
        self._past.append(self.now)
        self._future.clear()
        self.now = settings

    def replace(self, settings: Settings) -> None:
        """Change where the page is without a step: while a slider is held, only its last place counts."""
        self.now = settings

    def undo(self) -> Settings:
        """Go one step back, or stay where there is none."""
        if self._past:
            self._future.append(self.now)
            self.now = self._past.pop()
        return self.now

    def redo(self) -> Settings:
        """Go forward again what was taken back, or stay."""
        if self._future:
            self._past.append(self.now)
            self.now = self._future.pop()
        return self.now
