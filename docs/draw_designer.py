"""Draw the pictures of the app in its documentation: `python docs/draw_designer.py` from the root of the checkout."""

from __future__ import annotations

import io
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from PIL import Image

from platform_ctrl.app.backend import Backend

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests" / "support"))
from browser import chromium, screen, served  # noqa: E402  beside the tests that use it too

if TYPE_CHECKING:
    from playwright.sync_api import Page

# Colours of a picture: text on plain ground needs no more, and the file is a third of what it would be.
COLOURS = 256
# Seconds that the page has to work out everything that it shows.
PATIENCE = 120.0
# Whether the arrows are there that say which way to move a slider: they come last.
ARROWS = "[...document.querySelectorAll('#requirements td.cell')].some(cell => cell.textContent.trim())"
# The loop, and a crossover with which it meets all its requirements.
LOOP, CROSSOVER = "caging 9-10", "70"


def settled(page: Page, there: str = "true") -> None:
    """Wait until the page shows what its sliders say, and until `there` is true on it."""
    end = time.monotonic() + PATIENCE
    while not page.evaluate(f"window.page.settled() && {there}"):
        assert time.monotonic() < end, "the page does not come to rest"
        page.wait_for_timeout(100)


def main() -> None:
    """Write docs/assets/designer-light.png and designer-dark.png."""
    backend = Backend(ROOT / "examples" / "three_gyro_platform.toml")
    for browser in chromium():
        with served(backend) as server:
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
                    shot = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
                    assert seen.complaints == []
                shot.quantize(COLOURS).save(ROOT / "docs" / "assets" / f"designer-{name}.png", optimize=True)
    backend.close()


if __name__ == "__main__":
    main()
