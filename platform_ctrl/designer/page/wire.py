"""The model through which a page and its session talk: JSON texts both ways."""

from __future__ import annotations

import json
from typing import Any

from bokeh.core.properties import Any as AnyProperty
from bokeh.core.properties import String
from bokeh.model import DataModel


class Wire(DataModel):
    """What was asked last by the page, and told last by the session.

    References
    ----------
    See docs/designer.md.
    """

    # Of any type: what is nonsense is refused by `asking.ask_of`, with a line.
    asked = AnyProperty(default="")
    told = String(default="")

    def tell(self, **parts: Any) -> None:
        """Tell the page parts of what it shows, each under its name.

        Parameters
        ----------
        **parts
            JSON-able; numbers finite.

        References
        ----------
        RFC 8259.
        """
        self.update(told=json.dumps(parts, allow_nan=False, separators=(",", ":")))
