"""The server behind `platform-ctrl serve`: Bokeh's with one page, and which requests it accepts.

A page elsewhere can make its visitor's browser request 127.0.0.1, and under a name that resolves to it (DNS rebinding)
it could even read the responses. The browser reports this in the headers Host, Origin and Sec-Fetch-Site. Other users
of this machine reach 127.0.0.1 as well: only the printed link has the token without which no page is made.
"""

from __future__ import annotations

import asyncio
import errno
import ipaddress
import logging
import re
import secrets
import socket
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from bokeh.application import Application
from bokeh.application.handlers.function import FunctionHandler
from bokeh.document import Document
from bokeh.resources import Resources
from bokeh.server.auth_provider import AuthProvider
from bokeh.server.server import BaseServer
from bokeh.server.tornado import BokehTornado
from bokeh.server.views.static_handler import StaticHandler
from bokeh.settings import settings
from jinja2 import Template
from tornado.httpserver import HTTPServer
from tornado.ioloop import IOLoop
from tornado.web import StaticFileHandler

from platform_ctrl.common.values import value
from platform_ctrl.errors import InputError, PlatformCtrlError

# The port that is tried first, and how many after it before any free one is taken.
PORT = 5006
_TRIED = 16
# Seconds between checks whether the server is to end.
_LOOK = 0.2
_LIBRARIES = ("asyncio", "bokeh", "tornado")
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
_JOINING = ("bokeh-session-id", "bokeh-token")
# Headers of every response; the page's template says which scripts run in it.
HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-store",
}


class PageServer:
    """A server that is bound to its port; it responds once it runs.

    Parameters
    ----------
    fill
        Fills a new document with a page.
    host, port
        Address to listen on; port None: the first free one from `PORT` on; 0: any.
    allow
        Names under which browsers may reach it, besides this machine's own ones if it listens to itself alone.

    Attributes
    ----------
    token
        Without it in the address no page is made.
    """

    def __init__(
        self,
        fill: Callable[[Document], None],
        *,
        host: str = "127.0.0.1",
        port: int | None = None,
        allow: Sequence[str] = (),
    ) -> None:
        self.hosts = AllowedHosts.of(host, allow)
        self.token = secrets.token_urlsafe(24)
        self._socket = _bound(host, port)
        self.port: int = self._socket.getsockname()[1]
        self.application: PageApplication | None = None
        self._fill = fill
        self._ended = threading.Event()

    @property
    def address(self) -> str:
        """Address of the page with its token: what is opened in a browser."""
        listening = self.hosts.listening
        name = _bracketed(listening) if is_loopback(listening) else sorted(self.hosts.names)[0]
        return f"http://{name}:{self.port}/?token={self.token}"

    def run(self, ready: Callable[[], None] | None = None, check: Callable[[], None] | None = None) -> None:
        """Respond to requests until `end` is called or `check` raises."""
        # What the libraries say about invalid requests is not for the terminal.
        for name in _LIBRARIES:
            logging.getLogger(name).setLevel(logging.CRITICAL)
        with self._socket:
            asyncio.run(self._answer(ready, check))

    def end(self) -> None:
        """Let `run` return; from any thread."""
        self._ended.set()

    async def _answer(self, ready: Callable[[], None] | None, check: Callable[[], None] | None) -> None:
        self.application = PageApplication(self._filled, Guard(self.hosts, self.token))
        listening = HTTPServer(
            self.application,
            max_body_size=BODY_BYTES,
            max_header_size=HEADER_BYTES,
            max_buffer_size=HEADER_BYTES + (1 << 20),
            idle_connection_timeout=PATIENCE,
            body_timeout=PATIENCE,
        )
        server = BaseServer(IOLoop.current(), self.application, listening)
        listening.add_socket(self._socket)
        server.start()
        try:
            if ready is not None:
                ready()
            while not self._ended.is_set():
                if check is not None:
                    check()
                await asyncio.sleep(_LOOK)
        finally:
            server.stop()
            await listening.close_all_connections()

    def _filled(self, document: Document) -> None:
        """Fill a new document; an error is shown on the page and in the terminal."""
        try:
            self._fill(document)
        except Exception as error:
            words = str(error) if isinstance(error, PlatformCtrlError) else f"{type(error).__name__}: {error}"
            line = " ".join(words.split())[:400]
            print(f"platform-ctrl: a page could not be made: {line}", file=sys.stderr, flush=True)
            document.clear()
            # No scripts: the server may end before it could send them.
            document.template = Template("This page could not be made: {{ words }}", autoescape=True)
            document.template_variables["words"] = line


class Guard(AuthProvider):
    """Accepts requests of the page itself and of its printed link; others get one plain line."""

    def __init__(self, hosts: AllowedHosts, token: str) -> None:
        self._hosts, self._token = hosts, token
        super().__init__()

    @property
    def get_user_async(self) -> Any:
        """The check that Bokeh calls before it makes a page or its websocket."""
        return self._user

    @property
    def get_login_url(self) -> Any:
        """No login page: a refused request is answered at once."""
        return lambda handler: "/"

    async def _user(self, handler: Any) -> str:
        for name, item in HEADERS.items():
            handler.set_header(name, item)
        found = self._refusal(handler)
        if found is not None:
            status, words = found
            handler.set_status(status)
            handler.set_header("Content-Type", "text/plain; charset=utf-8")
            handler.finish(f"{words}\n")
        return "this machine"

    def _refusal(self, handler: Any) -> tuple[int, str] | None:
        request = handler.request
        words = self._hosts.refusal(request.headers, page=request.path == "/")
        if words is not None:
            return 403, words
        if any(name in request.arguments for name in _JOINING) or "Bokeh-Session-Id" in request.headers:
            return 403, "refused: every page has a state of its own; none can be joined"
        if request.path == "/ws":
            return None  # its token is that of a page, signed
        if request.path != "/":
            return 404, "there is nothing here"
        if not secrets.compare_digest(handler.get_argument("token", "").encode(), self._token.encode()):
            return (403, "refused: not the link of this server; open the one that platform-ctrl serve prints")
        if len(handler.application.get_sessions("/")) >= PAGES:
            return 503, f"{PAGES} pages are open already; close one and try again"
        return None


class PageApplication(BokehTornado):
    """Bokeh's server with one page, behind the check of requests."""

    def __init__(self, make: Callable[[Document], None], guard: Guard) -> None:
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
            auth_provider=guard,
            extra_patterns=[files],
            log_function=lambda handler: None,
        )
        # Columns go to a browser on this machine, as a rule: packing them takes longer than sending them.
        settings.compression_level = 0
        settings.perform_document_validation = False

    def resources(self, absolute_url: str | bool | None = None) -> Resources:
        """Return the components of BokehJS that the page uses."""
        return Resources(
            mode="server",
            root_url="/",
            components=["bokeh"],
            path_versioner=StaticHandler.append_version,
            log_level="warn",
        )


def _bound(host: str, port: int | None) -> socket.socket:
    """Return the socket, bound to the given port or to a free one."""
    ports = [*range(PORT, PORT + _TRIED), 0] if port is None else [port]
    for tried in ports:
        try:
            bare = host.strip("[]")
            try:
                made = socket.create_server((bare, tried), family=socket.AF_INET6 if ":" in bare else socket.AF_INET)
            except UnicodeError:
                raise OSError(errno.EINVAL, "not a host's name or address") from None
            made.setblocking(False)
            return made
        except OSError as error:
            if error.errno == errno.EADDRINUSE and tried != ports[-1]:
                continue
            if error.errno == errno.EADDRINUSE:
                raise InputError(
                    f"--port {tried}: is used by another program; give a free port, or none to have one found"
                ) from None
            what = f"--port {tried}" if error.errno == errno.EACCES else f"--host {host}"
            raise InputError(f"{what}: cannot be listened on: {error.strerror or error}") from None
    raise AssertionError("the last port ends the loop")


LOOPBACK_NAMES = frozenset({"127.0.0.1", "localhost", "[::1]"})
# A name, an IPv4 address or an IPv6 one in brackets; then a port, perhaps.
_HOST = re.compile(r"(\[[0-9a-f:.]+\]|[a-z0-9_]([a-z0-9_.-]*[a-z0-9_])?\.?)(?::(\d{1,5}))?")


@value
class AllowedHosts:
    """The names under which the pages may be requested.

    Attributes
    ----------
    listening
        Address that is listened on.
    names
        Lower-case names and addresses, IPv6 ones in brackets, without ports: behind a tunnel the port is another.
    """

    listening: str
    names: frozenset[str]

    @classmethod
    def of(cls, host: str, allow: Sequence[str] = ()) -> AllowedHosts:
        """Return the names for an address that is listened on, and those that are allowed besides."""
        loopback = is_loopback(host)
        if not loopback and not allow:
            raise InputError(
                f"--host {host}: other machines could reach the page; give --allow NAME too, once for each name or "
                "address under which browsers reach this machine"
            )
        names = {_name(one) for one in allow}
        if loopback:
            names |= LOOPBACK_NAMES | ({_bracketed(host.lower())} - {""})
        return cls(listening=host, names=frozenset(names))

    def refusal(self, headers: Mapping[str, str], page: bool = False) -> str | None:
        """Return why a request is refused in one line, or None; to the `page` itself a link elsewhere may lead.

        By RFC 6454 (Origin) and W3C, Fetch Metadata Request Headers (Sec-Fetch-Site).
        """
        host = headers.get("Host", "")
        found = _HOST.fullmatch(host.lower())
        if found is None or found[1].rstrip(".") not in self.names:
            return f"refused: requested as {_shown(host)}, which is none of {', '.join(sorted(self.names))}"
        origin = headers.get("Origin")
        if origin is not None and origin.lower() not in (f"http://{host.lower()}", f"https://{host.lower()}"):
            return f"refused: requested by a page of {_shown(origin)}, not of {host.lower()}"
        site = headers.get("Sec-Fetch-Site", "none")
        led = page and headers.get("Sec-Fetch-Mode") == "navigate" and headers.get("Sec-Fetch-Dest") == "document"
        if site not in ("none", "same-origin") and not led:
            return f"refused: requested by another page ({_shown(site)})"
        return None


def is_loopback(host: str) -> bool:
    """Return whether an address is reached from this machine alone."""
    if host.lower().rstrip(".") == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def _bracketed(host: str) -> str:
    bare = host.strip("[]")
    return f"[{bare}]" if ":" in bare else bare


def _name(given: str) -> str:
    name = _bracketed(given.lower())
    found = _HOST.fullmatch(name)
    if found is None or found[3] is not None:
        raise InputError(
            f"--allow {given!r}: must be a name or an address as browsers show it, without http:// and without a port"
        )
    return found[1].rstrip(".")


def _shown(given: str) -> str:
    """Return a part of a request as short printable ASCII."""
    plain = "".join(letter if " " <= letter <= "~" and letter not in "<>&\"'" else "?" for letter in given[:80])
    return plain or "nothing"
