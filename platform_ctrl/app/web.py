"""HTTP and websocket: Bokeh's server behind a check of every request.

Every response has the headers that keep a page to what this server sends. Bokeh's handlers that embed its pages in
others are closed. This is the one module that uses private names of Bokeh and Tornado.
"""

from __future__ import annotations

import re
import secrets
from collections.abc import Awaitable, Callable
from importlib import resources
from typing import TYPE_CHECKING, Any

from bokeh.application import Application
from bokeh.application.handlers.function import FunctionHandler
from bokeh.core.serialization import Serializer
from bokeh.document import Document
from bokeh.embed.server import server_html_page_for_session
from bokeh.models.widgets.markups import Markup
from bokeh.protocol.exceptions import ProtocolError
from bokeh.protocol.messages.patch_doc import patch_doc
from bokeh.resources import Resources
from bokeh.server.connection import ServerConnection
from bokeh.server.tornado import BokehTornado
from bokeh.server.views.doc_handler import DocHandler
from bokeh.server.views.static_handler import StaticHandler
from bokeh.server.views.ws import WSHandler
from bokeh.settings import settings
from tornado import httputil, iostream
from tornado.httpserver import HTTPServer
from tornado.web import OutputTransform, RequestHandler

from platform_ctrl.common.palette import PALETTE, declarations

if TYPE_CHECKING:
    from platform_ctrl.app.server import AllowedHosts

# Largest sizes; a page sends numbers of sliders and settings only.
MESSAGE_BYTES = 1 << 20
BODY_BYTES = 1 << 12
HEADER_BYTES = 1 << 14
# Pages open at once, sockets of them, and connections; seconds for sending a request.
PAGES = 32
CONNECTIONS = 256
PATIENCE = 30.0
# Milliseconds that a session lasts whose page was lost without a word, and between looks for such.
LINGER = 15_000
LOOK = 2_000
# What a browser says when a page is closed or left.
_LEFT = (1000, 1001)
KINDS = {
    "css": "text/css; charset=utf-8",
    "js": "text/javascript; charset=utf-8",
    "svg": "image/svg+xml",
}
_FILE = re.compile(rf"/page/(?P<name>[\w-][\w.-]*\.(?P<kind>{'|'.join(KINDS)}))")
# The two scripts that Bokeh writes into a page. Any other, whoever managed to put it there, does not run.
_BOKEH_SCRIPT = re.compile(r"<script>(?=\s*(?:Bokeh\.set_log_level\(|\(function\(\) \{\s*const fn = function\(\) \{))")
# Among a document's variables: the line that says why it could not be filled.
FAILED = "failed"
_JOINING = ("bokeh-session-id", "bokeh-token")

_ICON = (
    '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 32 32" fill="none" stroke="#0072b2" stroke-width="2.5">'
    '<circle cx="16" cy="16" r="13"/><ellipse cx="16" cy="16" rx="13" ry="5"/><circle cx="16" cy="16" r="2.5"'
    ' fill="#d55e00" stroke="none"/></svg>'
)


class PageApplication(BokehTornado):
    """Bokeh's server with one page, behind the check of requests."""

    def __init__(self, make: Callable[[Document], None], hosts: AllowedHosts) -> None:
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
            transforms=[Guarding],
            log_function=lambda handler: None,
        )
        # Columns go to a browser on this machine, as a rule: packing them takes longer than sending them.
        settings.compression_level = 0
        self.hosts = hosts
        self.files = {"palette.css": _palette_sheet()}

    @property
    def sessions(self) -> list[Any]:
        """The sessions of all pages that are open, or were a moment ago."""
        return list(self.get_sessions("/"))

    def find_handler(self, request: httputil.HTTPServerRequest, **kwargs: Any) -> Any:
        """Return the handler of a request; a refused one gets one line."""

        def by(handler: type[RequestHandler], **more: Any) -> Any:
            return self.get_handler_delegate(request, handler, more)

        path = request.path or "/"
        refused = self.hosts.refusal(request.headers, page=path == "/")
        if refused is not None:
            return by(Line, status=403, words=refused)
        context = {"application_context": self.applications["/"], "bokeh_websocket_path": "/ws"}
        if path == "/":
            if any(name in request.arguments for name in _JOINING) or "Bokeh-Session-Id" in request.headers:
                return by(Line, status=403, words="refused: every page has a state of its own; none can be joined")
            if not self._room():
                return by(Line, status=503, words=f"{PAGES} pages are open already; close one and try again")
            return by(PageHandler, **context)
        if path == "/ws":
            if len(self._clients) >= PAGES:
                return by(Line, status=503, words=f"{PAGES} pages are open already; close one and try again")
            return by(SocketHandler, compression_level=None, mem_level=None, **context)
        if path == "/favicon.ico":
            return by(Piece, kind="svg", data=_ICON.encode())
        file = _FILE.fullmatch(path)
        if file is not None:
            data = self._file(file["name"])
            return by(Line) if data is None else by(Piece, kind=file["kind"], data=data)
        if path.startswith("/static/js/") and path.endswith(".js"):
            return self.get_handler_delegate(request, StaticHandler, {}, path_args=[path[len("/static/") :].encode()])
        return by(Line)

    def new_connection(self, protocol: Any, socket: Any, application_context: Any, session: Any) -> ServerConnection:
        """Open a page's websocket, which sends simultaneous changes together."""
        connection = Together(protocol, socket, application_context, session)
        self._clients.add(connection)
        return connection

    def client_lost(self, connection: ServerConnection) -> None:
        """Drop a closed page: at once if the browser closed it, else after some seconds."""
        session, left = connection.session, connection._socket.close_code in _LEFT
        super().client_lost(connection)
        if left and session.connection_count == 0:
            session.request_expiration()
            self.io_loop.add_callback(self._cleanup_sessions)

    def close_pages(self) -> None:
        """Close all websockets as going away."""
        for connection in list(self._clients):
            connection._socket.close(1001)

    def _room(self) -> bool:
        """Return whether one more page fits; the oldest without a connection is dropped.

        If its browser is only slow, its websocket creates the session again.
        """
        if len(self.sessions) < PAGES:
            return True
        idle = [session for session in self.sessions if session.connection_count == 0]
        if not idle:
            return False
        max(idle, key=lambda session: session.milliseconds_since_last_unsubscribe).request_expiration()
        self.io_loop.add_callback(self._cleanup_sessions)
        return True

    def _file(self, name: str) -> bytes | None:
        if name not in self.files:
            try:
                self.files[name] = (resources.files("platform_ctrl.app.page") / "assets" / name).read_bytes()
            except OSError:
                return None
        return self.files[name]


def _palette_sheet() -> bytes:
    light, dark = declarations(PALETTE["light"]), declarations(PALETTE["dark"])
    return f':root{{{light}}}\n:root[data-theme="dark"]{{{dark}}}\n'.encode()


class Together(ServerConnection):
    """Sends all changes of a document during one lock as one message instead of some fifty."""

    _changes: tuple[Any, ...] = ()

    def send_patch_document(self, event: Any) -> Awaitable[None]:
        """Queue a change; the returned awaitable sends all queued ones."""
        self._changes = (*self._changes, event)
        return self._sent()

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


class Guarding(OutputTransform):
    """Adds the headers that isolate a page to every response."""

    def transform_first_chunk(
        self, status_code: int, headers: httputil.HTTPHeaders, chunk: bytes, finishing: bool
    ) -> tuple[int, httputil.HTTPHeaders, bytes]:
        """Add the headers; the page itself has set its own policy already."""
        if "Content-Security-Policy" not in headers:
            headers["Content-Security-Policy"] = _policy("'none'", "'none'")
        headers["X-Content-Type-Options"] = "nosniff"
        headers["Referrer-Policy"] = "no-referrer"
        headers["Cross-Origin-Resource-Policy"] = "same-origin"
        headers["Cross-Origin-Opener-Policy"] = "same-origin"
        headers["Server"] = "platform-ctrl"
        return status_code, headers, chunk


def _policy(scripts: str, sockets: str) -> str:
    return (
        f"default-src 'none'; script-src {scripts}; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; "
        f"font-src 'self' data:; connect-src {sockets}; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )


class PageHandler(DocHandler):
    """The page, with a new session for every request."""

    async def get(self, *args: Any, **kwargs: Any) -> None:
        """Send the page with the components of BokehJS that it uses."""
        session: Any = await super().get_session()  # type: ignore[misc]  # hidden by Tornado's decorator
        document = session.document
        failed = document.template_variables.get(FAILED)
        if failed is not None:
            # Plain text: the server may end before it could send scripts.
            session.request_expiration()
            self.set_status(500)
            self.set_header("Content-Type", "text/plain; charset=utf-8")
            self.set_header("Cache-Control", "no-store")
            self.finish(f"{failed}\n")
            return
        page = server_html_page_for_session(
            session,
            resources=Resources(
                mode="server",
                root_url="/",
                components=["bokeh", "bokeh-widgets"],
                path_versioner=StaticHandler.append_version,
                log_level="warn",
            ),
            title=document.title,
            template=document.template,
            template_variables=document.template_variables,
        )
        nonce = secrets.token_urlsafe(16)
        host = self.request.host
        # The websocket by name too: older browsers do not count it as 'self'.
        policy = _policy(f"'self' 'nonce-{nonce}'", f"'self' ws://{host} wss://{host}")
        self.set_header("Content-Security-Policy", policy)
        self.set_header("Content-Type", "text/html; charset=utf-8")
        self.set_header("Cache-Control", "no-store")
        self.write(_BOKEH_SCRIPT.sub(f'<script nonce="{nonce}">', page))


class SocketHandler(WSHandler):
    """The page's websocket: only messages of a page, of limited size."""

    _received = 0

    def check_origin(self, origin: str) -> bool:
        """Accept it: `find_handler` has checked it already."""
        return True

    async def _receive(self, fragment: str | bytes) -> Any:
        # A message comes in as many pieces as it announces itself.
        self._received += len(fragment)
        if self._received > MESSAGE_BYTES:
            self._protocol_error("message too large")
            return None
        message = await super()._receive(fragment)
        if message is not None:
            self._received = 0
        return message

    async def _handle(self, message: Any) -> Any:
        if message.msgtype == "PUSH-DOC":  # another document in the place of the page: no page sends it
            self._protocol_error("not a message of a page")
            return None
        return await super()._handle(message)

    async def _async_open(self, token: str) -> None:
        # A message is many small pieces: each would wait for the browser's word about the one before.
        self.set_nodelay(True)
        try:
            await super()._async_open(token)
        except ProtocolError:
            self.close()


class Line(RequestHandler):
    """One plain line: refused, or not found."""

    def initialize(self, status: int = 404, words: str = "there is nothing here") -> None:
        """Store the status and the words."""
        self._status, self._words = status, words

    def prepare(self) -> None:
        """Respond to any method."""
        self.set_status(self._status)
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.set_header("Connection", "close")
        self.finish(f"{self._words}\n")


class Piece(RequestHandler):
    """A file of the page."""

    def initialize(self, kind: str, data: bytes) -> None:
        """Store the file's kind and bytes."""
        self._kind, self._data = kind, data

    def get(self) -> None:
        """Send the file; Tornado adds its hash for the browser's cache."""
        self.set_header("Content-Type", KINDS[self._kind])
        self.set_header("Cache-Control", "no-cache")
        self.write(self._data)


class Listening(HTTPServer):
    """Tornado's server with a limited number of connections."""

    def handle_stream(self, stream: iostream.IOStream, address: tuple[Any, ...]) -> None:
        """Accept a connection, or close it beyond the limit."""
        if len(self._connections) >= CONNECTIONS:
            stream.close()
            return
        super().handle_stream(stream, address)
