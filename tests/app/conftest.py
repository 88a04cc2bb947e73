"""A browser for the tests of a file, no longer since its driver keeps an event loop running; gyros behind a page."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest

from browser import chromium

if TYPE_CHECKING:
    from platform_ctrl.app.backend import Backend

browser = pytest.fixture(scope="module")(chromium)


@pytest.fixture(scope="module")
def backend(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Backend]:
    from app.test_page import JOB
    from platform_ctrl.app.backend import Backend

    path = tmp_path_factory.mktemp("page") / "gyros.toml"
    path.write_text(JOB, encoding="utf-8")
    made = Backend(path)
    yield made
    made.close()
