"""A browser for the tests of a file; no longer, since its driver keeps an event loop running."""

from __future__ import annotations

import pytest

from browser import chromium

browser = pytest.fixture(scope="module")(chromium)
