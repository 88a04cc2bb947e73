"""The server's end of a page's connection: requests, responses, and callbacks on the loop of the server."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from bokeh.core.properties import Any as AnyProperty
from bokeh.core.properties import String
from bokeh.model import DataModel

if TYPE_CHECKING:
    from bokeh.document import Document


class MessageModel(DataModel):
    """The last request of the page, and the last response to it."""

    # Of any type: `parse_request` refuses what is not a request.
    request = AnyProperty(default="")
    response = String(default="")


class Connection:
    """The server's end of the connection to a page; all but `later` runs on the server's loop."""

    def __init__(self, document: Document) -> None:
        self.document: Document | None = document
        self.model = MessageModel(name="messages")
        self._answered = 0

    def close(self) -> None:
        """Release the document: nothing is sent any more."""
        self.document = None

    def later(self, act: Callable[[], None]) -> None:
        """Call `act` on the server's loop; from any thread."""
        document = self.document
        if document is not None:
            # Bokeh takes a document apart before it says that its page is gone.
            with suppress(AttributeError):
                document.add_next_tick_callback(lambda: None if self.document is None else act())

    def soon(self, act: Callable[[], None], wait: int) -> None:
        """Call `act` on the server's loop after `wait` milliseconds, unless the page is closed by then."""
        document = self.document
        if document is not None:
            document.add_timeout_callback(lambda: None if self.document is None else act(), wait)

    def say(self, text: str, kind: str = "quiet", count: int | None = None) -> None:
        """Write the page's line: ``"quiet"``, ``"good"`` or ``"error"``."""
        self.answer(count, line={"text": text, "kind": kind})

    def answer(self, count: int | None = None, **parts: Any) -> None:
        """Send parts of what the page shows; all its messages up to `count` are done."""
        self._answered = max(self._answered, count or 0)
        content = {"n": self._answered, **parts}
        self.model.update(response=json.dumps(content, allow_nan=False, separators=(",", ":")))
