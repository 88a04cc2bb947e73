"""``platform-ctrl serve`` as a process: its line, port, Ctrl-C, what is wrong in one line; its page in a browser."""

from __future__ import annotations

import gc
import json
import os
import signal
import socket
import subprocess
import sys
import time
import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest

import platform_ctrl as pc
from browser import chromium, screen, served_job, sessions
from plain_web import OpenPage
from platform_ctrl.cli import main
from refused_command import refused

pytest.importorskip("bokeh")


if TYPE_CHECKING:
    from playwright.sync_api import Browser

browser = pytest.fixture(scope="module")(chromium)


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("serve")
    assert main(["new", "gyro", "-o", str(folder)]) == 0
    return folder / "gyro.toml"


@contextmanager
def serving(*arguments: str | Path) -> Iterator[subprocess.Popen[str]]:
    with subprocess.Popen(
        [sys.executable, "-m", "platform_ctrl", "serve", *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": str(Path(pc.__file__).parents[1])},
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def until(holds: Callable[[], bool], seconds: float = 120.0) -> None:
    late = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < late
        time.sleep(0.02)


def first_line(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    return process.stdout.readline()


@pytest.mark.skipif(os.name != "posix", reason="Ctrl-C as POSIX sends it")
def test_what_json_says_can_be_asked_and_a_page_that_is_open_does_not_hold_it_up(job: Path) -> None:
    with serving(job, "--json", "--port", "0", "--host", "127.0.0.1") as process:
        told = json.loads(first_line(process))
        address, _, link = told["address"].partition("?token=")
        assert told == {"schema": 1, "job": "gyro", "address": told["address"], "port": told["port"]}
        assert address == f"http://127.0.0.1:{told['port']}/"
        there = SimpleNamespace(port=told["port"], token=link)
        with OpenPage(there) as opened:
            assert "ACK" in str(opened.part())
            process.send_signal(signal.SIGINT)
            _, err = process.communicate(timeout=120)
            assert (process.returncode, err) == (130, "platform-ctrl: interrupted\n")
            while opened.part() is not None:
                pass


def test_other_machines_need_names_and_are_told_of(job: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "give --allow NAME too" in refused(capsys, "serve", str(job), "--host", "0.0.0.0")
    with serving(
        job, "--quiet", "--port", "0", "--host", "0.0.0.0", "--allow", "lab-pc.local", "--no-browser"
    ) as process:
        assert first_line(process).startswith("gyro: http://lab-pc.local:")
        assert process.stderr is not None
        warned = process.stderr.readline()
        assert "listening on 0.0.0.0: anybody who has the link and reaches this machine on port" in warned
        assert "as lab-pc.local can see this job" in warned


def test_what_is_wrong_is_one_line(job: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "there is no such file" in refused(capsys, "serve", str(job.with_name("none.toml")))
    assert "none.json: there is no such file" in refused(capsys, "serve", str(job), "-q", "--controllers", "none.json")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert f"--port {port}: is used by another program" in refused(
            capsys, "serve", str(job), "-q", "--port", str(port)
        )
    assert "--port" in refused(capsys, "serve", str(job), "--port", "70000")


def test_pages_are_apart_load_nothing_from_elsewhere_and_leave_nothing(job: Path, browser: Browser) -> None:
    made: list[weakref.ref[Any]] = []

    with served_job(job, lambda document: made.append(weakref.ref(document))) as server:
        with screen(browser, server.address) as one, screen(browser, server.address, dark=True) as two:
            for shown in (one, two):
                shown.page.get_by_text("limits are met").first.wait_for()
                shown.page.locator("#panel-tree text").first.wait_for(state="attached")
            assert sessions(server) == 2
            for shown in (one, two):
                assert shown.hosts() == {f"127.0.0.1:{server.port}"}
                assert shown.complaints == []
        until(lambda: sessions(server) == 0)
        until(lambda: gc.collect() >= 0 and not any(document() for document in made))
