"""What a job needs is compiled once an installation: this takes a while, beside other work in its own process."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

# By the paths of this process, for there may be another checkout in the working directory; it ends without clearing up.
_SOURCE = """
import os, sys
sys.path[:] = {paths!r}
from platform_ctrl.common.processes import collect_seldom
collect_seldom()
from platform_ctrl.simulation.batch import compile_ahead
compile_ahead()
os._exit(0)
"""
_compiling: list[subprocess.Popen[bytes]] = []


def start_compilation() -> None:
    """Begin to compile what designs, runs and the coupled check need, unless the kernel has been or is being compiled.

    The other process keeps what it has compiled where this one will look for it. If it fails, nothing is lost but time.
    """
    if _compiling or is_compiled():
        return
    command = [sys.executable, "-P", "-c", _SOURCE.format(paths=sys.path)]
    quiet = subprocess.DEVNULL
    try:
        _compiling.append(subprocess.Popen(command, stdin=quiet, stdout=quiet, stderr=quiet))
    except OSError:
        return


def is_compiled() -> bool:
    """Return whether the kernel has been compiled in this installation.

    By the name that numba gives its index files, which is not documented: loading numba to ask would take longer than
    what this is for. A test fails when the name changes.
    """
    return any((Path(__file__).parent / "kernel" / "__pycache__").glob("loop.simulate_groups*.nbi"))


def wait_for_compilation() -> None:
    """Wait until the other process has compiled the kernel, if there is one."""
    while _compiling:
        _compiling.pop().wait()


def run_interruptibly(work: Callable[[], object]) -> None:
    """Do `work` beside the main thread, which waits for it and handles signals; what it raises is raised here.

    After an interrupt nobody waits any more. Compiled code cannot be ended from outside: its thread goes on until it is
    done or the process ends, which does not wait for it.
    """
    if threading.current_thread() is not threading.main_thread():
        work()  # signals are the main thread's
        return
    raised: list[BaseException] = []

    def done() -> None:
        try:
            work()
        except BaseException as error:
            raised.append(error)

    thread = threading.Thread(target=done, daemon=True)
    thread.start()
    while thread.is_alive():
        thread.join(0.2)  # with a limit: where there is none, some systems do not wake up for a signal
    if raised:
        raise raised[0]
