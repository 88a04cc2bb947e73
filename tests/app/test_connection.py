from __future__ import annotations

import time
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from browser import chromium, screen, served
from one_gyro_job import JOB

pytest.importorskip("bokeh")
pytest.importorskip("tomlkit")

from platform_ctrl.app.backend import Backend
from platform_ctrl.app.page.tasks import target
from platform_ctrl.errors import DesignError, InputError

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

browser = pytest.fixture(scope="module")(chromium)


def until(page: Page, what: str) -> None:
    end = time.monotonic() + 30.0
    while not page.evaluate(what):
        assert time.monotonic() < end, what
        page.wait_for_timeout(30)


def test_a_page_whose_server_ends_says_so_and_comes_back_as_it_stood_with_the_server(
    browser: Browser, tmp_path: Path
) -> None:
    job = tmp_path / "gyro.toml"
    job.write_text(JOB, encoding="utf-8")
    backend = Backend(job)
    with ExitStack() as stack:
        with served(backend) as server:
            port = server.port
            page = stack.enter_context(screen(browser, server.address)).page
            page.wait_for_selector("body:not(.starting)", state="attached")
            number = page.locator('#sliders [data-slider="crossover_hz"] input[type="text"]')
            other = f"{1.1 * float(number.input_value()):.4g}"
            number.fill(other)
            number.press("Enter")
            until(page, "window.page.settled() && location.search.includes('state=')")
        until(page, "document.querySelector('#line').textContent.includes('connection to the server is lost')")
        with page.expect_event("load"):
            stack.enter_context(served(backend, port=port))
        until(page, "!document.body.matches('.starting, .lost') && window.page.settled()")
        assert number.input_value() == other
        page.close()


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("x" * 81, "this one has 81"),
        (".hidden", "must not begin with a dot"),
        ("Con.old", "for a device"),
        ("../out", "only letters"),
        ("..", "only letters"),
    ],
)
def test_a_name_that_is_refused_is_told_why(tmp_path: Path, name: str, why: str) -> None:
    with pytest.raises(InputError, match=why):
        target(tmp_path, name)


def test_a_sample_rate_that_another_loop_does_not_bear_is_refused_in_its_name(tmp_path: Path) -> None:
    job = tmp_path / "gyros.toml"
    other = '[[loop]]\nname = "other"\nkind = "caging"\ngimbals = ["4", "5", "7"]\nuse = "classical"\n'
    other += 'design = [{ name = "classical", method = "classical", notch_hz = 200 }]\n'
    job.write_text(JOB + other, encoding="utf-8")
    backend = Backend(job)
    with pytest.raises(DesignError, match="other, classical: notch_hz = 200"):
        backend.picture(backend.moved(backend.start(), "rate_hz", 300.0))
