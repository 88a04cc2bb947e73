"""Requests by raw sockets, of which a browser would not send some, and the websocket of a page."""

from __future__ import annotations

import asyncio
import re
import socket
import threading
from collections.abc import Coroutine
from typing import Any, Protocol

from tornado.httpclient import HTTPRequest
from tornado.websocket import WebSocketClientConnection, websocket_connect


class Served(Protocol):
    """What listens on this machine, and the token of its link."""

    port: int
    token: str


def answer(server: Served, sent: bytes, patience: float = 60.0) -> bytes:
    """Send bytes and return what comes back until the other side ends, or nothing comes."""
    with socket.create_connection(("127.0.0.1", server.port), patience) as talk:
        talk.sendall(sent)
        got = b""
        try:
            while more := talk.recv(1 << 16):
                got += more
        except (TimeoutError, ConnectionResetError):
            pass
        return got


def asked(server: Served, path: str = "", method: str = "GET", **headers: str) -> tuple[int, dict[str, str], str]:
    """Return status, headers and body of the answer to a request, of the page itself with its token by default.

    `Host` is right unless another is given.
    """
    path = path or f"/?token={server.token}"
    given = {"Host": f"127.0.0.1:{server.port}", "Connection": "close"}
    given |= {name.replace("_", "-"): value for name, value in headers.items()}
    lines = [f"{method} {path} HTTP/1.1", *(f"{name}: {value}" for name, value in given.items() if value), "", ""]
    return parts(answer(server, "\r\n".join(lines).encode()))


def parts(got: bytes) -> tuple[int, dict[str, str], str]:
    head, _, body = got.decode("utf-8", "replace").partition("\r\n\r\n")
    first, *lines = head.split("\r\n")
    headers = dict(line.split(": ", 1) for line in lines)
    return int(first.split()[1]), headers, body


def token(server: Served) -> str:
    found = re.search(r'"token":"([^"]+)"', asked(server)[2])
    assert found is not None
    return found[1]


class OpenPage:
    """A page that is open: its websocket, on the loop of a thread of its own, for a browser's driver has this one's."""

    def __init__(self, server: Served, given: str | None = None, **headers: str) -> None:
        self._loop = asyncio.new_event_loop()
        self._running = threading.Thread(target=self._loop.run_forever)
        self._running.start()
        where = HTTPRequest(
            f"ws://127.0.0.1:{server.port}/ws", headers={"Origin": f"http://127.0.0.1:{server.port}"} | headers
        )

        async def connected() -> WebSocketClientConnection:
            return await websocket_connect(where, subprotocols=["bokeh", given or token(server)])

        try:
            self._socket = self._run(connected())
        except BaseException:
            self._end()
            raise

    def _run(self, work: Coroutine[Any, Any, Any]) -> Any:
        return asyncio.run_coroutine_threadsafe(work, self._loop).result()

    def _end(self) -> None:
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._running.join()
        self._loop.close()

    def part(self) -> str | bytes | None:
        """Return the next part of a message, None at the end."""

        async def read() -> str | bytes | None:
            return await self._socket.read_message()

        part: str | bytes | None = self._run(asyncio.wait_for(read(), 120.0))
        return part

    def __enter__(self) -> OpenPage:
        return self

    def __exit__(self, *args: object) -> None:
        self._loop.call_soon_threadsafe(self._socket.close)
        self._run(asyncio.sleep(0.05))
        self._end()
