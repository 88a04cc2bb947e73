"""The server of the designer's page: who may ask, what leaves, and how many pages it has."""

from __future__ import annotations

import gc
import re
import time
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import pytest

from browser import served, sessions
from plain_web import OpenPage, asked, token
from platform_ctrl.app.server import AllowedHosts
from platform_ctrl.errors import InputError

pytest.importorskip("bokeh")

from bokeh.models.widgets import Div
from tornado.httpclient import HTTPClientError
from tornado.websocket import WebSocketError

from platform_ctrl.app import server as served_by
from platform_ctrl.app.server import PageServer


def a_slider(document: Any) -> None:
    from bokeh.models.widgets import Slider

    document.add_root(Slider(start=0.0, end=1.0, value=0.5, step=0.1))
    document.title = "</script><script>alert(1)</script>"


@pytest.fixture(scope="module")
def server() -> Iterator[PageServer]:
    gc.freeze()  # as the command does it: a page that ends is looked for among what came since
    with served(a_slider) as running:
        yield running
    gc.unfreeze()


def answers(server: PageServer) -> bool:
    """Whether a page still comes, and its websocket too."""
    with OpenPage(server) as page:
        return "ACK" in str(page.part())


def test_a_page_comes_with_its_token_alone_and_headers_that_keep_it_to_itself(server: PageServer) -> None:
    status, headers, body = asked(server)
    assert status == 200
    assert headers["X-Content-Type-Options"] == "nosniff"
    assert headers["X-Frame-Options"] == "DENY"
    assert headers["Referrer-Policy"] == "no-referrer"
    assert headers["Cross-Origin-Resource-Policy"] == "same-origin"
    assert headers["Cache-Control"] == "no-store"
    assert "<script>alert" not in body
    addresses = re.findall(r'(?:src|href)="([^"]*)"', body)
    assert addresses
    assert all(one.startswith("/") and not one.startswith("//") for one in addresses)
    # Another user of this machine does not know the printed link.
    before = sessions(server)
    for path in ("/", "/?token=", f"/?token={server.token}x", f"/?token={server.token[:-1]}", "/?token=%C3%A9"):
        status, _, body = asked(server, path)
        assert status == 403
        assert body == "refused: not the link of this server; open the one that platform-ctrl serve prints\n"
    assert sessions(server) == before


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
    before = sessions(server)
    for path in ("", "/ws", "/autoload.js", "/metadata"):
        status, answered, body = asked(server, path, **headers)
        assert status == 403
        assert answered["Content-Type"] == "text/plain; charset=utf-8"
        assert words in body
        assert body.count("\n") == 1
        assert answered["X-Content-Type-Options"] == "nosniff"
    assert sessions(server) == before
    with pytest.raises(HTTPClientError, match="403"), OpenPage(server, "x", **headers):
        pass
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
    for more in (f"bokeh-token={valid}", "bokeh-session-id=abc", "bokeh-token=!!"):
        assert asked(server, f"/?token={server.token}&{more}")[0] == 403
    assert asked(server, Bokeh_Session_Id="abc")[0] == 403
    for path in ("/autoload.js", "/metadata", "/static/extensions/x.js", "/index.html"):
        assert asked(server, path)[0] == 404


@pytest.mark.parametrize(
    "path",
    [
        "/static/js/../../../../../../etc/passwd.js",
        "/page/../server.py",
        "/page/%2e%2e%2fserver.js",
        "//etc/passwd",
    ],
)
def test_no_other_file_is_sent(path: str, server: PageServer) -> None:
    status, _, body = asked(server, path)
    assert status in (400, 403, 404)
    assert "root:" not in body
    assert "import" not in body


@pytest.mark.parametrize("given", ["x", "a.b", "A" * 3000, "e30.e30"])
def test_a_websocket_without_a_pages_token_is_ended(given: str, server: PageServer) -> None:
    before = sessions(server)
    try:
        with OpenPage(server, given) as page:
            assert page.part() is None
    except (HTTPClientError, WebSocketError):
        pass
    assert sessions(server) == before
    assert answers(server)


def test_too_many_pages_are_refused_until_there_is_room(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(served_by, "PAGES", 3)
    monkeypatch.setattr(served_by, "LINGER", 500)
    monkeypatch.setattr(served_by, "LOOK", 100)
    with served(a_slider) as server:
        with ExitStack() as stack:
            for _ in range(3):
                stack.enter_context(OpenPage(server)).part()
            status, _, body = asked(server)
            assert (status, body) == (503, "3 pages are open already; close one and try again\n")
            assert sessions(server) == 3
        late = time.monotonic() + 60.0
        while sessions(server):
            assert time.monotonic() < late
            time.sleep(0.02)
        assert asked(server)[0] == 200


def test_a_page_that_cannot_be_made_says_so_in_a_plain_line(capfd: pytest.CaptureFixture[str]) -> None:
    def failing(document: Any) -> None:
        document.add_root(Div(text="half"))
        raise InputError("job.toml: is no job\nany more, <b>")

    with served(failing) as server:
        assert asked(server)[2] == "This page could not be made: job.toml: is no job any more, &lt;b&gt;"
    assert capfd.readouterr().err == "platform-ctrl: a page could not be made: job.toml: is no job any more, <b>\n"


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.0.2.7", "lab-pc"])
def test_other_machines_are_accepted_only_by_name(host: str) -> None:
    with pytest.raises(InputError, match=f"--host {host}: other machines could reach the page; give --allow"):
        AllowedHosts.of(host)
    hosts = AllowedHosts.of(host, ["Lab-PC.local", "192.0.2.7", "2001:db8::1"])
    assert hosts.listening == host
    for named in ("lab-pc.local:5006", "192.0.2.7:5006", "[2001:db8::1]:5006", "LAB-PC.LOCAL."):
        assert hosts.refusal({"Host": named, "Origin": f"http://{named}"}) is None
    for named in ("127.0.0.1:5006", "localhost", "lab-pc", "", "lab-pc.local:", "lab-pc.local:5006:1"):
        assert hosts.refusal({"Host": named}) is not None


def test_a_port_in_use_and_an_invalid_host_are_errors_of_one_line(server: PageServer) -> None:
    with pytest.raises(InputError, match=f"--port {server.port}: is used by another program; give a free port"):
        PageServer(a_slider, port=server.port)
    with pytest.raises(InputError, match=r"--host 192\.0\.2\.7: cannot be listened on"):
        PageServer(a_slider, host="192.0.2.7", port=0, allow=["x"])
    with pytest.raises(InputError, match="--host no such host: cannot be listened on"):
        PageServer(a_slider, host="no such host", port=0, allow=["x"])
