"""Shared by all tests."""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Iterator

import pytest
from hypothesis import settings

# Before numpy is loaded: on small matrices BLAS threads spend their time waiting for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# A change is judged by the same cases everywhere; new ones are sought by `pytest --hypothesis-profile=others`.
settings.register_profile("same", derandomize=True)
settings.register_profile("others", derandomize=False, print_blob=True)
settings.load_profile("same")


def pytest_collection_finish(session: pytest.Session) -> None:
    """What is loaded by now stays to the end: to look through it for garbage again and again takes time."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 20, 100)


@pytest.fixture(scope="module")
def untraced() -> Iterator[None]:
    """Long computations, of lines that other tests cover: coverage would take twice their time."""
    # pytest-cov's marker no_cover comes to nothing in the processes of pytest-xdist.
    tracer = sys.gettrace()
    sys.settrace(None)
    yield
    sys.settrace(tracer)
