"""The server of the designer's page by raw sockets: who may ask, what leaves, and nonsense that leaves it running."""

from __future__ import annotations

import ast
import functools
import gc
import importlib
import inspect
import random
import re
import socket
import struct
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from browser import served
from plain_web import Socket, answer, asked, message, token
from platform_ctrl.app.server import AllowedHosts
from platform_ctrl.errors import InputError

pytest.importorskip("bokeh")

from bokeh.models.widgets import Div

from platform_ctrl.app import web
from platform_ctrl.app.server import PageServer


def a_slider(backend: object, document: Any) -> None:
    from bokeh.models.widgets import Slider

    document.add_root(Slider(start=0.0, end=1.0, value=0.5, step=0.1))
    document.title = "</script><script>alert(1)</script>"


@pytest.fixture(scope="module")
def server() -> Iterator[PageServer]:
    gc.freeze()  # as the command does it: a page that ends is looked for among what came since
    with served(make=a_slider) as running:
        yield running
    gc.unfreeze()


def answers(server: PageServer) -> bool:
    """Whether a page still comes, and its websocket too."""
    with Socket(server, f"bokeh, {token(server)}") as page:
        return page.message()[0] == "ACK"


def test_a_page_comes_with_headers_that_keep_it_to_itself(server: PageServer) -> None:
    status, headers, body = asked(server)
    assert status == 200
    policy = dict(one.split(" ", 1) for one in headers["Content-Security-Policy"].split("; "))
    assert policy["default-src"] == policy["frame-ancestors"] == policy["base-uri"] == policy["form-action"] == "'none'"
    nonce = re.fullmatch(r"'self' 'nonce-([\w-]{20,})'", policy["script-src"])
    assert nonce is not None
    assert headers["X-Content-Type-Options"] == "nosniff"
    assert headers["Referrer-Policy"] == "no-referrer"
    assert headers["Cross-Origin-Resource-Policy"] == "same-origin"
    assert headers["Cache-Control"] == "no-store"
    assert "Bokeh" not in headers["Server"]
    assert "Tornado" not in headers["Server"]
    # What is not Bokeh's own script does not run: it has no nonce.
    assert body.count(f'nonce="{nonce[1]}"') == 2
    assert "<script>alert" not in body
    addresses = re.findall(r'(?:src|href)="([^"]*)"', body)
    assert addresses
    assert all(one.startswith("/") and not one.startswith("//") for one in addresses)
    assert nonce[1] not in asked(server)[2]


@pytest.mark.parametrize(
    ("headers", "words"),
    [
        ({"Host": "evil.example:5006"}, "requested as evil.example:5006"),
        ({"Host": "127.0.0.1.evil.example"}, "requested as 127.0.0.1.evil.example"),
        ({"Host": "127.0.0.1:5006:80"}, "requested as 127.0.0.1:5006:80"),
        ({"Host": "0.0.0.0"}, "requested as 0.0.0.0"),
        ({"Origin": "http://evil.example"}, "requested by a page of http://evil.example"),
        ({"Origin": "null"}, "requested by a page of null"),
        ({"Origin": "http://localhost:1"}, "requested by a page of http://localhost:1"),
        ({"Sec-Fetch-Site": "cross-site"}, "requested by another page (cross-site)"),
        ({"Sec-Fetch-Site": "same-site", "Sec-Fetch-Mode": "no-cors"}, "requested by another page (same-site)"),
    ],
)
def test_other_pages_and_hosts_are_refused_in_one_line(headers: dict[str, str], words: str, server: PageServer) -> None:
    before = server.sessions
    for path in ("/", "/ws", "/static/js/bokeh.min.js", "/nothing"):
        status, answered, body = asked(server, path, **headers)
        assert status == 403
        assert answered["Content-Type"] == "text/plain; charset=utf-8"
        assert words in body
        assert body.count("\n") == 1
        assert "default-src 'none'" in answered["Content-Security-Policy"]
    assert server.sessions == before
    with Socket(server, "bokeh, x", **{name: item for name, item in headers.items()}) as refused:
        assert refused.status == 403
    assert answers(server)


def test_a_request_without_a_host_or_with_two_or_with_none_such_is_refused(server: PageServer) -> None:
    for given in ("", "Host: 127.0.0.1\r\nHost: evil.example\r\n", "Host: 127.0.0.1@evil.example\r\n", "Host: <x>\r\n"):
        for version in ("1.0", "1.1"):
            got = answer(server, f"GET / HTTP/{version}\r\n{given}\r\n".encode())
            assert re.match(rb"HTTP/1.1 40[03] ", got)
            assert b"<" not in got


def test_own_names_links_and_tunnels_are_accepted(server: PageServer) -> None:
    for host in ("localhost", f"localhost:{server.port}", "LOCALHOST:9000", f"[::1]:{server.port}", "127.0.0.1"):
        assert asked(server, Host=host, Origin=f"http://{host.lower()}")[0] == 200
    # A link on a page elsewhere that was clicked on; not a picture or a frame there.
    led = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate", "Sec-Fetch-Dest": "document"}
    assert asked(server, **led)[0] == 200
    assert asked(server, **(led | {"Sec-Fetch-Dest": "iframe"}))[0] == 403
    assert asked(server, "/static/js/bokeh.min.js", **led)[0] == 403


def test_nothing_of_a_session_can_be_joined_or_embedded(server: PageServer) -> None:
    valid = token(server)
    for path in (f"/?bokeh-token={valid}", "/?bokeh-session-id=abc", "/?bokeh-token=!!"):
        assert asked(server, path)[0] == 403
    assert asked(server, Bokeh_Session_Id="abc")[0] == 403
    for path in ("/autoload.js", "/metadata", "/static/extensions/x.js", "/index.html"):
        assert asked(server, path)[0] == 404


@pytest.mark.parametrize(
    "path",
    [
        "/static/js/../../../../../../etc/passwd.js",
        "/static/js/%2e%2e/%2e%2e/server.py.js",
        "/static/js//etc/passwd.js",
        "/page/../server.py",
        "/page/%2e%2e%2fserver.js",
        "/page/nothing.js",
        "/page/..js",
        "//etc/passwd",
        "/\x7f",
        "/" + "a" * 12_000,
    ],
)
def test_no_other_file_is_sent(path: str, server: PageServer) -> None:
    status, _, body = asked(server, path)
    assert status in (400, 403, 404)
    assert "root:" not in body
    assert "import" not in body


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "OPTIONS", "TRACE", "PATCH", "QUERY", "HEAD"])
def test_pages_accept_get_requests_alone(method: str, server: PageServer) -> None:
    before = server.sessions
    assert asked(server, method=method)[0] == 405
    assert server.sessions == before


def test_nonsense_over_http_leaves_it_running(server: PageServer) -> None:
    noise = random.Random(1)
    host = f"Host: 127.0.0.1:{server.port}\r\n".encode()
    for sent in (
        b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03" + noise.randbytes(500),  # a TLS client
        noise.randbytes(5000) + b"\r\n\r\n",
        b"GET\r\n\r\n",
        b"GET / HTTP/9.9\r\n" + host + b"\r\n",
        b"GET / HTTP/1.1\r\n" + host + b"X: " + b"y" * 100_000 + b"\r\n\r\n",
        b"POST / HTTP/1.1\r\n" + host + b"Content-Length: 99999999999\r\n\r\n",
        b"POST / HTTP/1.1\r\n" + host + b"Content-Length: -5\r\n\r\n",
        b"POST / HTTP/1.1\r\n" + host + b"Transfer-Encoding: chunked\r\n\r\nFFFFFFFF\r\n",
        b"POST / HTTP/1.1\r\n" + host + b"Content-Type: multipart/form-data\r\nContent-Length: 3\r\n\r\n\xff\xfe\xfd",
        b"GET /?x=%ff%fe&y=\xff HTTP/1.1\r\n" + host + b"Connection: close\r\n\r\n",
        b"GET / HTTP/1.1\r\n" + host + b"Upgrade: websocket\r\nConnection: Upgrade\r\n\r\n",
        b"GET /ws HTTP/1.1\r\n" + host + b"Connection: close\r\n\r\n",
    ):
        answer(server, sent, patience=0.5)
    assert answers(server)


@pytest.mark.parametrize(
    "protocols",
    ["", "bokeh", "bokeh, x", "bokeh, a.b", "chat, x", "bokeh, " + "A" * 3000, "bokeh, e30.e30", "bokeh, W10.x, y"],
)
def test_a_websocket_without_a_pages_token_is_ended(protocols: str, server: PageServer) -> None:
    before = server.sessions
    with Socket(server, protocols) as page:
        assert page.status >= 400 or page.ends()
    assert server.sessions == before
    assert answers(server)


HOSTILE: dict[str, list[bytes]] = {
    "no JSON": [b"nonsense"] * 3,
    "JSON of another kind": [b"[]", b"null", b"17"],
    "nested deeply": [b"[" * 100_000, b"{}", b"{}"],
    "an unknown message": message("EXEC", {"code": "1"}),
    "another document": message("PUSH-DOC", {"doc": {"roots": [], "title": "x", "version": "3"}}),
    "no events": message("PATCH-DOC", {}),
    "events of no kind": message("PATCH-DOC", {"events": [{"kind": "Nothing"}, 5, None]}),
    "a model that is not there": message(
        "PATCH-DOC", {"events": [{"kind": "ModelChanged", "model": {"id": "p1"}, "attr": "value", "new": 1}]}
    ),
    "more buffers than come": message("PATCH-DOC", {"events": []}, num_buffers=10**9),
    "a negative number of buffers": message("PATCH-DOC", {"events": []}, num_buffers=-1),
    "a large array": message(
        "PATCH-DOC",
        {
            "events": [
                {
                    "kind": "MessageSent",
                    "msg_type": "x",
                    "msg_data": {
                        "type": "ndarray",
                        "array": {"type": "bytes", "data": "AAAA"},
                        "dtype": "float64",
                        "shape": [10**6, 10**6],
                        "order": "little",
                    },
                }
            ]
        },
    ),
}


@pytest.mark.parametrize("kind", HOSTILE)
def test_a_hostile_message_ends_its_own_page_at_most(
    kind: str, server: PageServer, capfd: pytest.CaptureFixture[str]
) -> None:
    with Socket(server, f"bokeh, {token(server)}") as neighbour, Socket(server, f"bokeh, {token(server)}") as page:
        neighbour.message()
        page.message()
        for fragment in HOSTILE[kind]:
            page.send(fragment)
        for fragment in message("SERVER-INFO-REQ", {}):
            neighbour.send(fragment)
        assert neighbour.message()[0] == "SERVER-INFO-REPLY"
    assert answers(server)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    "value", ["a text", None, [1.0], {}, True, float("nan"), 1e400, {"type": "number", "value": "x"}]
)
def test_a_value_of_another_kind_does_not_reach_the_page(value: object, server: PageServer) -> None:
    with Socket(server, f"bokeh, {token(server)}") as page:
        page.message()
        for fragment in message("PULL-DOC-REQ", {}):
            page.send(fragment)
        (slider,) = page.message()[1]["doc"]["roots"]
        event = {"kind": "ModelChanged", "model": {"id": slider["id"]}, "attr": "value", "new": value}
        for fragment in message("PATCH-DOC", {"events": [event]}):
            page.send(fragment)
        assert page.message()[0] in ("OK", "ERROR")
    assert answers(server)


def test_messages_too_large_end_their_page(server: PageServer) -> None:
    half = b"x" * (web.MESSAGE_BYTES // 2)
    with Socket(server, f"bokeh, {token(server)}") as page:
        page.message()
        page.send(b"", length=1 << 40)
        assert page.ends()
    with Socket(server, f"bokeh, {token(server)}") as page:
        page.message()
        for fragment in (*message("PATCH-DOC", {"events": []}, num_buffers=10**6), b'{"id":"a"}'):
            page.send(fragment)
        page.send(half, opcode=2).send(b'{"id":"b"}').send(half, opcode=2).send(b'{"id":"c"}')
        assert page.ends()
    assert answers(server)


def test_invalid_frames_end_their_page(server: PageServer) -> None:
    noise = random.Random(2)
    for sent in (b"\xff" * 100, noise.randbytes(2000), b"\x01\x05hello", b"\x89\xff" + bytes(12)):
        with Socket(server, f"bokeh, {token(server)}") as page:
            page.message()
            page.raw(sent)
    with Socket(server, f"bokeh, {token(server)}") as page:
        page.message()
        page.send(b"\xff\xfe")  # no UTF-8
        assert page.ends()
    assert answers(server)


def test_too_many_pages_and_connections_are_refused_until_there_is_room(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(web, "PAGES", 3)
    monkeypatch.setattr(web, "CONNECTIONS", 20)
    monkeypatch.setattr(web, "LINGER", 1000)
    monkeypatch.setattr(web, "LOOK", 100)
    with served(make=a_slider) as server:
        pages = [Socket(server, f"bokeh, {token(server)}") for _ in range(3)]
        for page in pages:
            page.message()
        status, _, body = asked(server)
        assert (status, body) == (503, "3 pages are open already; close one and try again\n")
        assert server.sessions == 3
        pages[0].send(struct.pack(">H", 1001), opcode=8).ends()
        for _ in range(10):  # pages that are asked for and never looked at make way for others
            assert asked(server)[0] == 200
        assert server.sessions <= 4
        idle = [socket.create_connection(("127.0.0.1", server.port)) for _ in range(40)]
        refused = [one for one in idle if _ended(one)]
        assert len(refused) >= 20
        for one in (*idle, *(page.talk for page in pages)):
            one.close()
        late = time.monotonic() + 10.0
        while server.sessions:  # also that of the page that was asked for and never opened its websocket
            assert time.monotonic() < late
            time.sleep(0.02)
        assert asked(server)[0] == 200


def _ended(one: socket.socket) -> bool:
    one.settimeout(0.02)
    try:
        return one.recv(1) == b""
    except TimeoutError:
        return False
    except ConnectionResetError:
        return True


def test_a_page_that_cannot_be_made_says_so_in_a_plain_line(capfd: pytest.CaptureFixture[str]) -> None:
    def failing(backend: object, document: Any) -> None:
        document.add_root(Div(text="half"))
        raise InputError("job.toml: is no job\nany more, <b>")

    with served(make=failing) as server:
        status, headers, body = asked(server)
        assert status == 500
        assert headers["Content-Type"] == "text/plain; charset=utf-8"
        assert body == "This page could not be made: job.toml: is no job any more, <b>\n"
    assert capfd.readouterr().err == "platform-ctrl: a page could not be made: job.toml: is no job any more, <b>\n"


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.0.2.7", "lab-pc"])
def test_other_machines_are_accepted_only_by_name(host: str) -> None:
    with pytest.raises(InputError, match=f"--host {host}: other machines could reach the page; give --allow"):
        AllowedHosts.of(host)
    hosts = AllowedHosts.of(host, ["Lab-PC.local", "192.0.2.7", "2001:db8::1"])
    assert not hosts.local_only
    for named in ("lab-pc.local:5006", "192.0.2.7:5006", "[2001:db8::1]:5006", "LAB-PC.LOCAL."):
        assert hosts.refusal({"Host": named, "Origin": f"http://{named}"}) is None
    for named in ("127.0.0.1:5006", "localhost", "lab-pc", "", "lab-pc.local:", "lab-pc.local:5006:1"):
        assert hosts.refusal({"Host": named}) is not None


@pytest.mark.parametrize("name", ["http://lab-pc", "lab-pc:5006", "", "a b", "*", "<x>", "-x", "é"])
def test_an_invalid_name_to_allow_is_an_error_of_one_line(name: str) -> None:
    with pytest.raises(InputError, match=r"--allow .*: must be a name or an address as browsers show it"):
        AllowedHosts.of("0.0.0.0", [name])


def test_a_port_in_use_and_an_invalid_host_are_errors_of_one_line(server: PageServer) -> None:
    with pytest.raises(InputError, match=f"--port {server.port}: is used by another program; give a free port"):
        PageServer(None, port=server.port, make=a_slider)
    with pytest.raises(InputError, match=r"--host 192\.0\.2\.7: cannot be listened on"):
        PageServer(None, host="192.0.2.7", port=0, allow=["x"], make=a_slider)
    with pytest.raises(InputError, match="--host no such host: cannot be listened on"):
        PageServer(None, host="no such host", port=0, allow=["x"], make=a_slider)


def test_without_a_port_the_next_free_one_is_taken(monkeypatch: pytest.MonkeyPatch, server: PageServer) -> None:
    monkeypatch.setattr("platform_ctrl.app.server.PORT", server.port)
    with served(make=a_slider, port=None) as other:
        assert other.port != server.port
        assert other.address == f"http://127.0.0.1:{other.port}/"
        assert asked(other)[0] == 200


def test_a_missing_library_is_named_with_the_command_that_installs_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "tomlkit", None)
    with pytest.raises(InputError, match=r"needs tomlkit, .*: pip install 'platform_ctrl\[designer\]'"):
        PageServer(None, port=0)


# Private names of Bokeh and Tornado that `web` uses, by the class that has them.
PRIVATE = {
    "_clients": "bokeh.server.tornado:BokehTornado",
    "_cleanup_sessions": "bokeh.server.tornado:BokehTornado",
    "_socket": "bokeh.server.connection:ServerConnection",
    "_receive": "bokeh.server.views.ws:WSHandler",
    "_handle": "bokeh.server.views.ws:WSHandler",
    "_async_open": "bokeh.server.views.ws:WSHandler",
    "_protocol_error": "bokeh.server.views.ws:WSHandler",
    "_connections": "tornado.httpserver:HTTPServer",
}


def private_names(module: Path) -> set[str]:
    """The private attributes that a module uses and does not define."""
    tree = ast.parse(module.read_text(encoding="utf-8"))
    nodes = list(ast.walk(tree))
    used = {node.attr for node in nodes if isinstance(node, ast.Attribute) and re.match("_[a-z]", node.attr)}
    own = {node.name for node in nodes if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)}
    own |= {node.attr for node in nodes if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store)}
    own |= {node.target.id for node in nodes if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name)}
    own |= {t.id for node in nodes if isinstance(node, ast.Assign) for t in node.targets if isinstance(t, ast.Name)}
    supers = {
        node.attr
        for node in nodes
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Call) and "super" in ast.unparse(node.value)
    }
    return (used - own) | (used & supers)


def test_private_names_of_bokeh_are_used_in_one_module_and_are_there() -> None:
    assert private_names(Path(web.__file__)) == set(PRIVATE)
    for name, place in PRIVATE.items():
        module, _, path = place.partition(":")
        found = functools.reduce(getattr, path.split("."), importlib.import_module(module))
        assert hasattr(found, name) or f"self.{name}" in inspect.getsource(found), f"{place} has no {name} any more"
    for module in Path(web.__file__).parent.rglob("*.py"):
        if "bokeh" in module.read_text(encoding="utf-8") and module.name != "web.py":
            assert private_names(module) == set(), module
