"""Draw the pictures of the app and of the report: `python docs/draw_designer.py` from the root of the checkout.

They are drawn by hand, since a browser is needed. `pictures.json` beside them has a digest of the files that decide how
they look; a test compares it, and says when they are old.
"""

from __future__ import annotations

import hashlib
import io
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

from PIL import Image

from platform_ctrl.app.backend import Backend
from platform_ctrl.app.session import Pages

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests" / "support"))
from browser import chromium, screen, served  # noqa: E402  beside the tests that use it too

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

ASSETS = ROOT / "docs" / "assets"
JOB = ROOT / "examples" / "three_gyro_platform.toml"
# What decides how a picture looks, below the root of the checkout.
SOURCES = {
    "designer": (
        *("page/page.html", "page/fragments.html", "page/assets/page.css", "fragments.py", "plots/painter.py"),
        *("plots/loop.py", "plots/responses.py"),
    ),
    "report": ("templates/page.html", "templates/blocks.html", "templates/report.css", "first_screen.py"),
}
PACKAGES = {"designer": "platform_ctrl/app", "report": "platform_ctrl/report"}

# Colours of a picture: text on plain ground needs no more, and the file is a third of what it would be.
COLOURS = 256
# Seconds that the page has to work out everything that it shows.
PATIENCE = 120.0
# Whether the arrows are there that say which way to move a slider: they come last.
ARROWS = "document.querySelector('#requirements table:not(.stale)') !== null"
# The loop, and a crossover with which it meets all its requirements.
LOOP, CROSSOVER = "caging 9-10", "70"


def settled(page: Page, there: str = "true") -> None:
    """Wait until the page shows what its sliders say, and until `there` is true on it."""
    end = time.monotonic() + PATIENCE
    while not page.evaluate(f"window.page.settled() && {there}"):
        assert time.monotonic() < end, "the page does not come to rest"
        page.wait_for_timeout(100)


def digests() -> dict[str, str]:
    """Return a digest of the sources of each picture, whatever their line ends."""
    out = {}
    for name, files in SOURCES.items():
        found = hashlib.sha256(JOB.read_text(encoding="utf-8").encode())
        for file in files:
            found.update((ROOT / PACKAGES[name] / file).read_text(encoding="utf-8").encode())
        out[name] = found.hexdigest()
    return out


def write(shot: bytes, name: str) -> None:
    """Write a screenshot with few colours."""
    Image.open(io.BytesIO(shot)).convert("RGB").quantize(COLOURS).save(ASSETS / f"{name}.png", optimize=True)


def draw_app(browser: Browser, backend: Backend) -> None:
    """Write designer-light.png and designer-dark.png."""
    with served(Pages(backend).fill) as server:
        for name in ("light", "dark"):
            with screen(browser, server.address, dark=name == "dark") as seen:
                page = seen.page
                page.wait_for_selector("body:not(.starting)", state="attached")
                settled(page)
                page.locator("#loop").select_option(label=LOOP)
                settled(page)
                number = page.locator('#sliders [data-slider="crossover_hz"] input[type="text"]')
                for text in (number.input_value(), CROSSOVER):
                    number.fill(text)
                    number.press("Enter")
                    settled(page)
                page.locator("h1").click()
                settled(page, ARROWS)
                write(page.screenshot(), f"designer-{name}")
                assert seen.complaints == []


def draw_report(browser: Browser, page: Path) -> None:
    """Write report-light.png and report-dark.png."""
    for name in ("light", "dark"):
        with screen(browser, page.as_uri(), dark=name == "dark", width=1400, height=920) as seen:
            seen.page.wait_for_load_state()
            write(seen.page.screenshot(), f"report-{name}")
            assert seen.complaints == []


def main() -> None:
    """Write the pictures in docs/assets and their digests."""
    from platform_ctrl.cli import main as command

    backend = Backend(JOB)
    with tempfile.TemporaryDirectory() as folder:
        assert command(["design", str(JOB), "-o", folder, "-q"]) == 0
        for browser in chromium():
            draw_report(browser, Path(folder) / "report.html")
            draw_app(browser, backend)
    backend.close()
    (ASSETS / "pictures.json").write_text(json.dumps(digests(), indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
