"""A real Chromium without a window, the user's or Debian's, driven by Playwright; without one the test is skipped."""

from __future__ import annotations

import os
import shutil
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

import pytest

if TYPE_CHECKING:
    from playwright.sync_api import Browser, ConsoleMessage, Page

    from platform_ctrl.app.server import PageServer

VARIABLE = "PLATFORM_CTRL_CHROMIUM"
NAMES = ("chromium", "chromium-browser", "google-chrome")
FLAGS = (
    "--no-sandbox",  # as root in a container there is none
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
# Milliseconds that a page has for whatever is waited for: the machine may be busy.
PATIENCE = 120_000


def executable() -> str:
    """Return Chromium's path; skip the test, with a reason, where there is none."""
    named = os.environ.get(VARIABLE)
    if named:
        found = shutil.which(named)
        assert found is not None, f"{VARIABLE}={named}: expected Chromium's executable"
        return found
    for name in NAMES:
        found = shutil.which(name)
        if found is not None:
            return found
    pytest.skip(f"no Chromium: none of {', '.join(NAMES)} is on the PATH, and {VARIABLE} is not set")


def chromium() -> Iterator[Browser]:
    """Yield a browser with a profile of its own.

    A fixture of a test file: ``browser = pytest.fixture(scope="module")(chromium)``.
    """
    playwright = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed")
    path = executable()
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=path, args=list(FLAGS))
        yield browser
        browser.close()


@dataclass
class Screen:
    """A page, and what happened on it: addresses it asked for (whole, in order), and what it complained about."""

    page: Page
    requests: list[str] = field(default_factory=list)
    complaints: list[str] = field(default_factory=list)

    def hear(self, said: ConsoleMessage) -> None:
        """Note an error or a warning; a driver without a graphics card complains about the pictures of the screen."""
        if said.type in ("error", "warning") and "GL Driver Message" not in said.text:
            self.complaints.append(said.text)

    def hosts(self) -> set[str]:
        """Return HOST:PORT of everything that was loaded from, without what the page holds itself (data, blob)."""
        return {parts.netloc for parts in map(urlsplit, self.requests) if parts.scheme not in ("data", "blob")}


@contextmanager
def screen(
    browser: Browser, address: str | None = None, *, dark: bool = False, width: int = 1440, height: int = 900
) -> Iterator[Screen]:
    """Yield a page in a window of its own (no cookies of others), at an address if one is given; closed at the end."""
    context = browser.new_context(
        viewport={"width": width, "height": height}, color_scheme="dark" if dark else "light", reduced_motion="reduce"
    )
    context.set_default_timeout(PATIENCE)
    try:
        seen = Screen(context.new_page())
        seen.page.on("request", lambda request: seen.requests.append(request.url))
        seen.page.on("websocket", lambda socket: seen.requests.append(socket.url))
        seen.page.on("pageerror", lambda error: seen.complaints.append(str(error)))
        seen.page.on("console", seen.hear)
        if address is not None:
            seen.page.goto(address)
        yield seen
    finally:
        context.close()


@contextmanager
def served_job(job: Path, made: Callable[[Any], None]) -> Iterator[PageServer]:
    """Yield a server of the designer's page for a job; `made` gets every document that becomes one."""
    pytest.importorskip("bokeh", reason="Bokeh is not installed")
    from platform_ctrl.app.backend import Backend
    from platform_ctrl.app.session import Pages

    pages = Pages(Backend(job))

    def fill(document: Any) -> None:
        pages.fill(document)
        made(document)

    with served(fill) as server:
        yield server


@contextmanager
def served(fill: Callable[[Any], None], port: int = 0) -> Iterator[PageServer]:
    """Yield a server that answers, by default at a free port, of what `fill` puts into documents."""
    pytest.importorskip("bokeh", reason="Bokeh is not installed")
    from platform_ctrl.app.server import PageServer

    server = PageServer(fill, port=port)
    ready = threading.Event()
    running = threading.Thread(target=server.run, args=(ready.set,))
    running.start()
    try:
        assert ready.wait(120.0), "the server did not start"
        yield server
    finally:
        server.end()
        running.join(120.0)
        assert not running.is_alive(), "the server did not end"


def sessions(server: PageServer) -> int:
    """Return the number of pages that are open, or were a moment ago."""
    return 0 if server.application is None else len(server.application.get_sessions("/"))
