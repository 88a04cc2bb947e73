"""Bokeh's server with one page: which requests it accepts, and the headers that keep a page to what it sends."""

from __future__ import annotations

import re
import secrets
from collections.abc import Awaitable, Callable, Generator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bokeh.application import Application
from bokeh.application.handlers.function import FunctionHandler
from bokeh.core.serialization import Serializer
from bokeh.document import Document
from bokeh.models.widgets.markups import Markup
from bokeh.protocol.messages.patch_doc import patch_doc
from bokeh.resources import Resources
from bokeh.server.auth_provider import AuthProvider
from bokeh.server.connection import ServerConnection
from bokeh.server.tornado import BokehTornado
from bokeh.server.views.static_handler import StaticHandler
from bokeh.settings import settings
from tornado import httputil
from tornado.web import OutputTransform, RequestHandler, StaticFileHandler

if TYPE_CHECKING:
    from platform_ctrl.app.server import AllowedHosts

# Largest sizes; a page sends numbers of sliders and settings only.
MESSAGE_BYTES = 1 << 20
BODY_BYTES = 1 << 12
HEADER_BYTES = 1 << 14
# Pages open at once; seconds for sending a request.
PAGES = 32
PATIENCE = 30.0
# Milliseconds that a session lasts whose page was closed or lost, and between looks for such.
LINGER = 5_000
LOOK = 1_000
# The two scripts that Bokeh writes into a page. Any other, whoever managed to put it there, does not run.
_BOKEH_SCRIPT = re.compile(rb"<script>(?=\s*(?:Bokeh\.set_log_level\(|\(function\(\) \{\s*const fn = function\(\) \{))")
_JOINING = ("bokeh-session-id", "bokeh-token")


class Guard(AuthProvider):
    """Accepts requests of the page itself; others get one plain line."""

    def __init__(self, hosts: AllowedHosts) -> None:
        self._hosts = hosts
        super().__init__()

    @property
    def get_user_async(self) -> Any:
        """What Bokeh calls before a page or its websocket is made."""
        return self._user

    @property
    def get_login_url(self) -> Any:
        """Where nobody is sent: a refused request is answered at once."""
        return lambda handler: "/"

    async def _user(self, handler: Any) -> str:
        request, status = handler.request, 403
        words = self._hosts.refusal(request.headers, page=request.path == "/")
        if words is None and (
            any(name in request.arguments for name in _JOINING) or "Bokeh-Session-Id" in request.headers
        ):
            words = "refused: every page has a state of its own; none can be joined"
        if words is None and request.path not in ("/", "/ws"):
            status, words = 404, "there is nothing here"
        if words is None and request.path == "/" and handler.application.pages >= PAGES:
            status, words = 503, f"{PAGES} pages are open already; close one and try again"
        if words is not None:
            handler.set_status(status)
            handler.set_header("Content-Type", "text/plain; charset=utf-8")
            handler.finish(f"{words}\n")
        return "this machine"


class Guarding(OutputTransform):
    """Adds the headers that isolate a page to every response, and lets no script run in it but Bokeh's own."""

    def __init__(self, request: httputil.HTTPServerRequest) -> None:
        super().__init__(request)
        self._host = request.host

    def transform_first_chunk(
        self, status_code: int, headers: httputil.HTTPHeaders, chunk: bytes, finishing: bool
    ) -> tuple[int, httputil.HTTPHeaders, bytes]:
        """Add the headers."""
        scripts = sockets = "'none'"
        is_page = status_code == 200 and headers.get("Content-Type", "").startswith("text/html")
        if is_page:
            nonce = secrets.token_urlsafe(16)
            chunk = _BOKEH_SCRIPT.sub(f'<script nonce="{nonce}">'.encode(), chunk)
            headers["Content-Length"] = str(len(chunk))
            # The websocket by name too: older browsers do not count it as 'self'.
            scripts, sockets = f"'self' 'nonce-{nonce}'", f"'self' ws://{self._host} wss://{self._host}"
        headers["Content-Security-Policy"] = (
            f"default-src 'none'; script-src {scripts}; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; "
            f"font-src 'self' data:; connect-src {sockets}; base-uri 'none'; form-action 'none'; "
            "frame-ancestors 'none'"
        )
        headers["X-Content-Type-Options"] = "nosniff"
        headers["Referrer-Policy"] = "no-referrer"
        headers["Cross-Origin-Resource-Policy"] = "same-origin"
        headers["Cross-Origin-Opener-Policy"] = "same-origin"
        headers["Cache-Control"] = "no-store" if is_page else "no-cache"
        headers["Server"] = "platform-ctrl"
        return status_code, headers, chunk


class PageApplication(BokehTornado):
    """Bokeh's server with one page, behind the check of requests."""

    def __init__(self, make: Callable[[Document], None], hosts: AllowedHosts) -> None:
        files: tuple[str, type[RequestHandler], dict[str, Any]]
        files = (r"/page/(.*)", StaticFileHandler, {"path": str(Path(__file__).parent / "page" / "assets")})
        super().__init__(
            Application(FunctionHandler(make)),
            secret_key=secrets.token_bytes(32),
            sign_sessions=True,
            include_headers=[],
            include_cookies=[],
            ico_path="none",
            check_unused_sessions_milliseconds=LOOK,
            unused_session_lifetime_milliseconds=LINGER,
            websocket_max_message_size_bytes=MESSAGE_BYTES,
            extra_websocket_origins=["*"],  # the guard has compared Origin and Host
            auth_provider=Guard(hosts),
            extra_patterns=[files],
            transforms=[Guarding],
            log_function=lambda handler: None,
        )
        # Columns go to a browser on this machine, as a rule: packing them takes longer than sending them.
        settings.compression_level = 0

    @property
    def sessions(self) -> list[Any]:
        """The sessions of all pages that are open, or were a moment ago."""
        return list(self.get_sessions("/"))

    @property
    def pages(self) -> int:
        """Number of pages that are open."""
        return sum(session.connection_count > 0 for session in self.sessions)

    def resources(self, absolute_url: str | bool | None = None) -> Resources:
        """Return the components of BokehJS that the page uses."""
        return Resources(
            mode="server",
            root_url="/",
            components=["bokeh", "bokeh-widgets"],
            path_versioner=StaticHandler.append_version,
            log_level="warn",
        )

    def new_connection(self, protocol: Any, socket: Any, application_context: Any, session: Any) -> ServerConnection:
        """Open a page's websocket, which sends simultaneous changes together."""
        connection = Together(protocol, socket, application_context, session)
        self._clients.add(connection)
        return connection

    def close_pages(self) -> None:
        """Close all websockets as going away."""
        for connection in list(self._clients):
            connection._socket.close(1001)


class Together(ServerConnection):
    """Sends all changes of a document during one lock as one message instead of some fifty."""

    _changes: tuple[Any, ...] = ()

    def send_patch_document(self, event: Any) -> Awaitable[None]:
        """Queue a change; the returned awaitable sends all queued ones."""
        self._changes = (*self._changes, event)
        return self

    def __await__(self) -> Generator[Any, None, None]:
        """Send the queued changes; no coroutine is left over when the page goes before they are sent."""
        return self._sent().__await__()

    async def _sent(self) -> None:
        changes, self._changes = self._changes, ()
        if changes:
            await self._socket.send_message(_patch(changes))


def _patch(changes: tuple[Any, ...]) -> patch_doc:
    """Return Bokeh's message of changes, the columns among its text: as pieces of their own they take longer."""
    models = changes[0].document.models
    serializer = Serializer(references=models.synced_references, deferred=False)
    # At new words the browser lays out and paints at once: not with half of the data.
    events = serializer.encode(sorted(changes, key=lambda one: not isinstance(getattr(one, "model", None), Markup)))
    models.flush_synced(lambda model: not serializer.has_ref(model))
    return patch_doc(patch_doc.create_header(), {}, {"events": events})
