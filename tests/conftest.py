"""Shared by all tests."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

# Before numpy is loaded: on small matrices BLAS threads spend their time waiting for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

if TYPE_CHECKING:
    from platform_ctrl.check import JobResult


@pytest.fixture(scope="session")
def shipped_job() -> Callable[[Path], tuple[JobResult, list[str]]]:
    """A shipped job designed and checked as it stands, once for all tests; and what was said while it worked."""
    from platform_ctrl import check, design
    from platform_ctrl.reading import read_job

    @cache
    def done(path: Path) -> tuple[JobResult, list[str]]:
        said: list[str] = []
        job = read_job(path)
        return check.checked(job, design.loops(job, said.append), said.append), said

    return done
