"""Handles on the plots that the mouse drags: the crossover and poles."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Generic, TypeVar

from bokeh.events import PanEnd, PanStart
from bokeh.models import Model

Place = TypeVar("Place")

# Milliseconds between two places that are handed on, of rest after which a drag is over that nobody ends, and for what
# the browser has sent while the server was busy.
EVERY, REST, LATE = 40, 400, 150


class Drag(Generic[Place]):
    """Hands on where a handle is dragged, at most every `EVERY` ms, and always the last place.

    A drag lasts from the mouse going down to the mouse going up, however long it is held still. Where the browser does
    not say when it goes up, a drag ends when it has rested for `REST` ms.

    Parameters
    ----------
    anchor
        The figure with the handle: it tells of the mouse, and its document has the clock; without a document everything
        is handed on at once.
    dragged
        Called with the place.
    ended
        Called when the drag is over.
    """

    def __init__(self, anchor: Model, dragged: Callable[[Place], None], ended: Callable[[], None]) -> None:
        self._anchor, self._dragged, self._ended = anchor, dragged, ended
        self._held = False
        anchor.on_event(PanStart, self._gripped)
        anchor.on_event(PanEnd, self._let_go)
        self._place: Place | None = None
        self._waiting: Any = None
        self._resting: Any = None
        self.active = False
        # Drags so far.
        self.begun = 0

    def move(self, place: Place) -> None:
        """Take a new place."""
        self.begun += not self.active
        self.active = True
        self._place = place
        document = self._anchor.document
        if document is None or document.session_context is None:
            self._hand_on()
            return
        if self._waiting is None:
            self._waiting = document.add_timeout_callback(self._hand_on, EVERY)
        self._rest_no_more()
        if not self._held:
            self._resting = document.add_timeout_callback(self._rested, REST)

    def _gripped(self, event: object) -> None:
        if self.active:
            self.end()
        self._held = True

    def _let_go(self, event: object) -> None:
        self._held = False
        if self.active:
            self.end()

    def _rest_no_more(self) -> None:
        document = self._anchor.document
        if document is not None and self._resting is not None:
            document.remove_timeout_callback(self._resting)
        self._resting = None

    def end(self) -> None:
        """End the drag now: what was not handed on yet is."""
        document = self._anchor.document
        if document is not None:
            for waiting in (self._waiting, self._resting):
                if waiting is not None and waiting in document.session_callbacks:
                    document.remove_timeout_callback(waiting)
        self._waiting = self._resting = None
        self._hand_on()
        self.active = False
        self._ended()

    def _rested(self) -> None:
        document = self._anchor.document
        if document is not None:
            self._resting = document.add_timeout_callback(self.end, LATE)

    def _hand_on(self) -> None:
        self._waiting = None
        place, self._place = self._place, None
        if place is not None:
            self._dragged(place)
