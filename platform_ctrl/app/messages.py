"""The messages between page and server: requests of the page, and the parts of it that an answer replaces."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from bokeh.core.properties import Any as AnyProperty
from bokeh.core.properties import String
from bokeh.model import DataModel

from platform_ctrl.common.arguments import short
from platform_ctrl.common.values import value
from platform_ctrl.errors import InputError

if TYPE_CHECKING:
    from bokeh.document import Document

# Every request, and what belongs to it besides its count.
REQUESTS: Mapping[str, tuple[str, ...]] = {
    "ready": (),
    "dark": ("dark",),
    "move": ("moves", "gesture"),
    "fix": ("slider", "fixed"),
    "part": ("part", "on"),
    "reset": ("slider",),
    "overlay": ("design", "on"),
    "set": ("name", "value"),
    "limit": ("key", "number"),
    "view": ("view",),
    "undo": (),
    "redo": (),
    "tune": (),
    "cancel": (),
    "save": ("name", "overwrite"),
    "simulate": ("manoeuvre",),
}


@value
class Request:
    """A message of a page: its `count`, which the response names, its kind `what`, and its content."""

    count: int
    what: str
    more: dict[str, Any]


def parse_request(message: Any) -> Request:
    """Return a message of a page; what its content may be is seen where it is used."""
    try:
        read = json.loads(message)
        more = {name: read[name] for name in REQUESTS[read["what"]]}
        return Request(count=int(read["n"]), what=read["what"], more=more)
    except (TypeError, ValueError, KeyError, RecursionError):
        raise InputError(
            f"a message must be one of the requests {', '.join(REQUESTS)} as JSON, the page sent {short(message)}"
        ) from None


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

    def say(self, text: str, kind: str = "quiet", count: int | None = None) -> None:
        """Write the page's line: ``"quiet"``, ``"good"`` or ``"error"``."""
        self.answer(count, line={"text": text, "kind": kind})

    def answer(self, count: int | None = None, **parts: Any) -> None:
        """Send parts of what the page shows; all its messages up to `count` are done.

        ``html`` has the content of elements by their ids.
        """
        self._answered = max(self._answered, count or 0)
        self.model.update(response=json.dumps({"n": self._answered, **parts}, allow_nan=False))
