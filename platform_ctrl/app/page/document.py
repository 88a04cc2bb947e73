"""A page as a Bokeh document: its template, its plots, and the session behind it."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

from platform_ctrl.app.page.session import Session

if TYPE_CHECKING:
    from bokeh.document import Document
    from jinja2 import Template

    from platform_ctrl.app.backend import Backend

# The plots in the order in which they stand, and what they are called to readers who do not see them.
PANELS = (
    ("bode", "Bode diagram"),
    ("nichols", "Nichols plot"),
    ("locus", "Root locus"),
    ("step", "Step response"),
    ("Omega", "Response to a disturbance"),
)


def page(backend: Backend, document: Document) -> None:
    """Make a page of a new document: with a state of its own, which is dropped with the document's session."""
    session = Session(backend, document, _state(document))
    with document.models.freeze():  # what belongs to the document is looked for once, not for every plot
        for root in session.roots():
            document.add_root(root)
    document.on_session_destroyed(session.close)
    document.title = session.title
    # A lost page says so itself, and is loaded again with its state: what the server knew of it may be gone.
    document.config.update(reconnect_session=False, notify_connection_status=False)
    document.template = _template()
    document.template_variables.update(panels=PANELS)


def _state(document: Document) -> str:
    """Return the state that the page's address asks for, empty where it asks for none."""
    context: Any = document.session_context
    request = None if context is None else context.request
    given: Any = {} if request is None else request.arguments
    texts = given.get("state") or [b""]
    return bytes(texts[0]).decode("utf-8", "replace")


@cache
def _template() -> Template:
    from jinja2 import Environment, PackageLoader

    loader = PackageLoader("platform_ctrl.app.page")
    return Environment(loader=loader, autoescape=True, trim_blocks=True).get_template("page.html")
