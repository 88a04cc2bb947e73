"""The server of the designer's page by raw sockets: who may ask, what leaves, and nonsense that leaves it running."""

from __future__ import annotations

import gc
import random
import re
import time
from collections.abc import Iterator
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
    for path in ("/", "/ws", "/autoload.js", "/metadata"):
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


def test_own_names_links_and_tunnels_are_accepted(server: PageServer) -> None:
    for host in ("localhost", f"localhost:{server.port}", "LOCALHOST:9000", f"[::1]:{server.port}", "127.0.0.1"):
        assert asked(server, Host=host, Origin=f"http://{host.lower()}")[0] == 200
    # A link on a page elsewhere that was clicked on; not a picture or a frame there.
    led = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate", "Sec-Fetch-Dest": "document"}
    assert asked(server, **led)[0] == 200
    assert asked(server, **(led | {"Sec-Fetch-Dest": "iframe"}))[0] == 403


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
    "nested deeply": [b"[" * 100_000, b"{}", b"{}"],
    "an unknown message": message("EXEC", {"code": "1"}),
    "another document": message("PUSH-DOC", {"doc": {"roots": [], "title": "x", "version": "3"}}),
    "no events": message("PATCH-DOC", {}),
    "a model that is not there": message(
        "PATCH-DOC", {"events": [{"kind": "ModelChanged", "model": {"id": "p1"}, "attr": "value", "new": 1}]}
    ),
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


def test_messages_too_large_end_their_page(server: PageServer) -> None:
    with Socket(server, f"bokeh, {token(server)}") as page:
        page.message()
        page.send(b"", length=1 << 40)
        assert page.ends()
    assert answers(server)


def test_too_many_pages_are_refused_until_there_is_room(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(web, "PAGES", 3)
    monkeypatch.setattr(web, "LINGER", 500)
    monkeypatch.setattr(web, "LOOK", 100)
    with served(make=a_slider) as server:
        pages = [Socket(server, f"bokeh, {token(server)}") for _ in range(3)]
        for page in pages:
            page.message()
        status, _, body = asked(server)
        assert (status, body) == (503, "3 pages are open already; close one and try again\n")
        assert server.sessions == 3
        for page in pages:
            page.talk.close()
        late = time.monotonic() + 10.0
        while server.sessions:
            assert time.monotonic() < late
            time.sleep(0.02)
        assert asked(server)[0] == 200


def test_a_page_that_cannot_be_made_says_so_in_a_plain_line(capfd: pytest.CaptureFixture[str]) -> None:
    def failing(backend: object, document: Any) -> None:
        document.add_root(Div(text="half"))
        raise InputError("job.toml: is no job\nany more, <b>")

    with served(make=failing) as server:
        assert asked(server)[2] == "This page could not be made: job.toml: is no job any more, &lt;b&gt;"
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


def test_a_port_in_use_and_an_invalid_host_are_errors_of_one_line(server: PageServer) -> None:
    with pytest.raises(InputError, match=f"--port {server.port}: is used by another program; give a free port"):
        PageServer(None, port=server.port, make=a_slider)
    with pytest.raises(InputError, match=r"--host 192\.0\.2\.7: cannot be listened on"):
        PageServer(None, host="192.0.2.7", port=0, allow=["x"], make=a_slider)
    with pytest.raises(InputError, match="--host no such host: cannot be listened on"):
        PageServer(None, host="no such host", port=0, allow=["x"], make=a_slider)


# Private names of Bokeh and Tornado that `web` uses, by the class that has them.
