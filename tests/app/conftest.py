"""One browser for all tests of the app."""

from __future__ import annotations

import pytest

from browser import chromium

browser = pytest.fixture(scope="session")(chromium)
