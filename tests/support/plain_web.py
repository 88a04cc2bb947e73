"""HTTP and websockets spoken by hand, by raw sockets: what a browser would not send can be sent."""

from __future__ import annotations

import base64
import json
import os
import re
import socket
import struct
from contextlib import suppress
from typing import Any, Protocol


class Served(Protocol):
    """What listens on this machine."""

    port: int


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


def asked(server: Served, path: str = "/", method: str = "GET", **headers: str) -> tuple[int, dict[str, str], str]:
    """Return status, headers and body of the answer to a request; `Host` is right unless another is given."""
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


def message(kind: str, content: object, **header: object) -> list[bytes]:
    return [json.dumps(one).encode() for one in ({"msgid": "1", "msgtype": kind} | header, {}, content)]


class Socket:
    """A websocket to the server, spoken by hand."""

    def __init__(self, server: Served, protocols: str, **headers: str) -> None:
        self.talk = socket.create_connection(("127.0.0.1", server.port), 10.0)
        self.got, self.late = b"", False
        host = f"127.0.0.1:{server.port}"
        given = {"Host": host, "Origin": f"http://{host}"} | headers
        key = base64.b64encode(os.urandom(16)).decode()
        lines = ["GET /ws HTTP/1.1", "Upgrade: websocket", "Connection: Upgrade", "Sec-WebSocket-Version: 13"]
        lines += [f"Sec-WebSocket-Key: {key}", f"Sec-WebSocket-Protocol: {protocols}"]
        lines += [f"{name}: {value}" for name, value in given.items()]
        self.talk.sendall("\r\n".join([*lines, "", ""]).encode())
        while b"\r\n\r\n" not in self.got and self._more():
            pass
        head, _, self.got = self.got.partition(b"\r\n\r\n")
        self.status = int(head.split()[1])
        self.head = head.decode()

    def _more(self) -> bool:
        try:
            more = self.talk.recv(1 << 16)
        except TimeoutError:
            self.late = True
            return False
        except (ConnectionResetError, BrokenPipeError):
            return False
        self.got += more
        return bool(more)

    def send(self, data: bytes, opcode: int = 1, length: int | None = None) -> Socket:
        said = len(data) if length is None else length
        head = bytes([0x80 | opcode])
        if said < 126:
            head += bytes([0x80 | said])
        elif said < 1 << 16:
            head += bytes([0x80 | 126]) + struct.pack(">H", said)
        else:
            head += bytes([0x80 | 127]) + struct.pack(">Q", said)
        return self.raw(head + bytes(4) + data)  # a mask of zeros leaves it as it is

    def send_message(self, kind: str, content: object) -> Socket:
        for fragment in message(kind, content):
            self.send(fragment)
        return self

    def raw(self, data: bytes) -> Socket:
        with suppress(BrokenPipeError, ConnectionResetError):  # ended already: that is what is tested
            self.talk.sendall(data)
        return self

    def part(self, opcode: int = 1) -> bytes:
        """Return what the next frame brings: a text, or bytes (2); pings are passed over."""
        while True:
            frame = self._frame()
            if frame is None:
                assert self._more(), "ended"
            elif frame[0] != 9:
                assert frame[0] == opcode, frame
                return frame[1]

    def message(self) -> tuple[str, Any]:
        """Return kind and content of the next message: three texts, and perhaps buffers."""
        header, _, content = (json.loads(self.part()) for _ in range(3))
        for _ in range(header.get("num_buffers", 0)):
            self.part(), self.part(2)
        return header["msgtype"], content

    def _frame(self) -> tuple[int, bytes] | None:
        if len(self.got) < 2:
            return None
        size, start = self.got[1] & 0x7F, 2
        if size > 125:
            start = 4 if size == 126 else 10
            size = int.from_bytes(self.got[2:start], "big")
        if len(self.got) < start + size:
            return None
        opcode, data = self.got[0] & 0xF, self.got[start : start + size]
        self.got = self.got[start + size :]
        return opcode, data

    def ends(self) -> bool:
        """Whether the other side ends it, or says that it does."""
        while True:
            frame = self._frame()
            if frame is not None and frame[0] == 8:
                return True
            if frame is None and not self._more():
                return not self.late

    def __enter__(self) -> Socket:
        return self

    def __exit__(self, *args: object) -> None:
        self.talk.close()
