"""Shared by all tests."""

from __future__ import annotations

import contextlib
import gc
import io
import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from filelock import FileLock
from hypothesis import settings

# Hundreds of processes load what these load: byte code is kept, whatever the environment says.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
# Until all is loaded there is no garbage worth the time to look for it.
gc.disable()
# Before numpy is loaded: on small matrices BLAS threads spend their time waiting for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# No window, whichever test loads pyplot first.
os.environ["MPLBACKEND"] = "Agg"

# A shell lets what it starts in the background ignore Ctrl-C, and children inherit that.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# A change is judged by the same cases everywhere; new ones are sought by `pytest --hypothesis-profile=others`.
settings.register_profile("same", derandomize=True)
settings.register_profile("others", derandomize=False, print_blob=True)
settings.load_profile("same")


def pytest_collection_finish(session: pytest.Session) -> None:
    """What is loaded by now stays to the end: to look through it for garbage again and again takes time."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 20, 100)
    gc.enable()


@pytest.fixture(autouse=True)
def no_figures_of_other_tests() -> Iterator[None]:
    """Pyplot keeps the figures of scripts until they are closed, and warns at the twenty-first."""
    yield
    if pyplot := sys.modules.get("matplotlib.pyplot"):
        pyplot.close("all")


def _compile_kernel() -> None:
    from platform_ctrl.cli import main

    with contextlib.redirect_stdout(io.StringIO()):
        assert main(["warm-up", "--quiet"]) == 0


def _compile_kernel_of_masses() -> None:
    """Compile what masses off the axes need besides, in another order: one of both at a time writes an index."""
    from platform_ctrl import read_platform
    from platform_ctrl.simulation import Scenario, rollout, simulate_batch

    drone = read_platform("drone_gimbal")
    rollout(drone, q=[[0.0] * 3], velocity=[[0.0] * 6], step=1e-5, steps=1)
    simulate_batch([Scenario(platform=drone, mode="caged", duration=0.0, delay=0.0)], [], period=1e-3)


def pytest_xdist_auto_num_workers() -> int:
    """One process more than there are processors: some tests wait, for a browser or another process."""
    return (os.cpu_count() or 1) + 1


@pytest.hookimpl(wrapper=True)
def pytest_collection(session: pytest.Session) -> Iterator[None]:
    """Let one worker of a fresh checkout compile what all of them load; two others compile the kernel meanwhile."""
    worker = getattr(session.config, "workerinput", None)
    if worker is None:
        return (yield)
    number = int(worker["workerid"].removeprefix("gw"))
    first = FileLock(Path(session.config.getoption("basetemp")).parent / "collection.lock")
    if number == 0:
        with first:
            return (yield)
    if number in (1, 2):
        (_compile_kernel, _compile_kernel_of_masses)[number - 1]()
    with first:
        pass
    return (yield)
