"""The server behind `platform-ctrl serve`, and which requests it accepts. Bokeh is loaded when it starts.

A page elsewhere can make its visitor's browser request 127.0.0.1, and under a name that resolves to it (DNS rebinding)
it could even read the responses. The browser reports this in the headers Host, Origin and Sec-Fetch-Site.
"""

from __future__ import annotations

import asyncio
import errno
import ipaddress
import logging
import re
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from platform_ctrl.common.values import value
from platform_ctrl.errors import InputError, PlatformCtrlError

if TYPE_CHECKING:
    import socket

    from platform_ctrl.app.web import PageApplication

# The port that is tried first, and how many after it before any free one is taken.
PORT = 5006
_TRIED = 16
# Seconds between checks whether the server is to end.
_LOOK = 0.2
_LIBRARIES = ("asyncio", "bokeh", "tornado")

Make = Callable[[Any, Any], None]


class PageServer:
    """A server that is bound to its port; it responds once it runs.

    Parameters
    ----------
    backend
        `Backend` that all pages share; passed to `make`.
    host, port
        Address to listen on; port None: the first free one from `PORT` on; 0: any.
    allow
        Names under which browsers may reach it, besides this machine's own ones if it listens to itself alone.
    make
        Fills a new document, called with the backend and the document; default: `page.session.page`.
    """

    def __init__(
        self,
        backend: object,
        *,
        host: str = "127.0.0.1",
        port: int | None = None,
        allow: Sequence[str] = (),
        make: Make | None = None,
    ) -> None:
        self.hosts = AllowedHosts.of(host, allow)
        require_bokeh()
        self._socket = _bound(host, port)
        self.port: int = self._socket.getsockname()[1]
        self.application: PageApplication | None = None
        self._backend, self._make = backend, make
        self._ended = threading.Event()

    @property
    def address(self) -> str:
        """Address of the page: what is opened in a browser."""
        name = self.hosts.listening
        if not is_loopback(name):
            name = sorted(self.hosts.names)[0]
        elif ":" in name:
            name = f"[{name.strip('[]')}]"
        return f"http://{name}:{self.port}/"

    @property
    def sessions(self) -> int:
        """Number of sessions: pages that are open, or were a moment ago."""
        return 0 if self.application is None else len(self.application.sessions)

    def run(self, ready: Callable[[], None] | None = None, check: Callable[[], None] | None = None) -> None:
        """Respond to requests until `end` is called or `check` raises."""
        # Not asyncio.run, which would wait for the pages' threads at the end.
        loop = asyncio.new_event_loop()
        asyncio.set_event_loop(loop)
        with _quiet(), self._socket:
            try:
                loop.run_until_complete(self._answer(ready, check))
            finally:
                for task in asyncio.all_tasks(loop):
                    task.cancel()
                loop.run_until_complete(asyncio.sleep(0))
                asyncio.set_event_loop(None)
                loop.close()

    def end(self) -> None:
        """Let `run` return; from any thread."""
        self._ended.set()

    async def _answer(self, ready: Callable[[], None] | None, check: Callable[[], None] | None) -> None:
        from bokeh.server.server import BaseServer
        from tornado.httpserver import HTTPServer
        from tornado.ioloop import IOLoop

        from platform_ctrl.app.web import BODY_BYTES, HEADER_BYTES, PATIENCE, PageApplication

        self.application = PageApplication(self._filled, self.hosts)
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
            self.application.close_pages()
            await listening.close_all_connections()

    def _filled(self, document: Any) -> None:
        """Fill a new document; an error is shown on the page and in the terminal."""
        from jinja2 import Template

        try:
            (self._make or _page())(self._backend, document)
        except Exception as error:
            words = str(error) if isinstance(error, PlatformCtrlError) else f"{type(error).__name__}: {error}"
            _say(f"a page could not be made: {words}")
            document.clear()
            # No scripts: the server may end before it could send them.
            document.template = Template("This page could not be made: {{ words }}", autoescape=True)
            document.template_variables["words"] = _line(words)


def require_bokeh() -> None:
    """Raise `InputError` if the libraries of the page are not installed."""
    try:
        import bokeh.server.tornado  # noqa: F401
        import tomlkit  # noqa: F401
    except ModuleNotFoundError as error:
        raise InputError(
            f"the page needs {error.name}, which is not installed: pip install 'platform_ctrl[designer]'"
        ) from None


def _page() -> Make:
    from platform_ctrl.app.page.session import page

    made: Make = page
    return made


def _bound(host: str, port: int | None) -> socket.socket:
    """Return the socket, bound to the given port or to a free one."""
    ports = [*range(PORT, PORT + _TRIED), 0] if port is None else [port]
    for tried in ports:
        try:
            return _listening(host, tried)
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


def _listening(host: str, port: int) -> socket.socket:
    import socket

    bare = host.strip("[]")
    try:
        made = socket.create_server((bare, port), family=socket.AF_INET6 if ":" in bare else socket.AF_INET)
    except UnicodeError:
        raise OSError(errno.EINVAL, "not a host's name or address") from None
    made.setblocking(False)
    return made


def _say(words: str) -> None:
    print(f"platform-ctrl: {_line(words)}", file=sys.stderr, flush=True)


def _line(words: str) -> str:
    return " ".join(words.split())[:400]


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep what the libraries say about invalid requests off the terminal."""
    loggers = [logging.getLogger(name) for name in _LIBRARIES]
    before = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for logger, level in zip(loggers, before, strict=True):
            logger.setLevel(level)


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

    @property
    def local_only(self) -> bool:
        """Whether only this machine reaches what listens."""
        return is_loopback(self.listening)

    def refusal(self, headers: Mapping[str, str], page: bool = False) -> str | None:
        """Return why a request is refused, or None.

        Parameters
        ----------
        headers
            Those of the request; their names in the usual spelling, or of a mapping that does not mind.
        page
            Whether the page itself is requested: then a link elsewhere may lead here.

        Returns
        -------
        str or None
            One line.

        References
        ----------
        RFC 6454 (Origin); W3C, Fetch Metadata Request Headers (Sec-Fetch-Site).
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
