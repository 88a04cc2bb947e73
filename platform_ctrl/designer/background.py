"""Work that takes seconds, in a process beside this one: it tells how far it is, and ends when it is not wanted."""

from __future__ import annotations

import contextlib
import os
import pickle
import queue
import subprocess
import sys
import threading
from collections.abc import Callable
from typing import Any

from platform_ctrl.errors import DesignError, PlatformCtrlError

Progress = Callable[[str], None]
Cancelled = Callable[[], bool]

_SOURCE = (
    "import pickle, sys; sys.path[:] = pickle.load(sys.stdin.buffer); "
    "from platform_ctrl.designer.tasks import answer; answer()"
)
# How soon a cancelled task notices, s.
_POLL = 0.1
# Tasks at a time; others wait.
_AT_A_TIME = threading.BoundedSemaphore(2)


class Abandoned(PlatformCtrlError):
    """The task was cancelled."""


def worked_out(question: object, progress: Progress, cancelled: Cancelled) -> Any:
    """Return what `platform_ctrl.designer.tasks` answers to a question.

    Parameters
    ----------
    question
        What can be pickled.
    progress
        Called with a line now and then.
    cancelled
        Asked ten times a second: the process is ended as soon as it says yes.

    Raises
    ------
    Abandoned
        It was cancelled.
    PlatformCtrlError
        What the task raised.
    """
    while not _AT_A_TIME.acquire(timeout=_POLL):
        if cancelled():
            raise Abandoned("cancelled")
    process = None
    try:
        process = _started()
        return _answer(process, question, progress, cancelled)
    finally:
        _AT_A_TIME.release()
        if process is not None:
            _end(process)


def _started() -> subprocess.Popen[bytes]:
    single = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
    options: dict[str, Any] = {}
    if sys.platform == "win32":
        options["creationflags"] = subprocess.CREATE_NO_WINDOW
    return subprocess.Popen(
        [sys.executable, "-P", "-W", "ignore", "-c", _SOURCE],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env={**single, **os.environ},
        **options,
    )


def _answer(process: subprocess.Popen[bytes], question: object, progress: Progress, cancelled: Cancelled) -> Any:
    told: queue.SimpleQueue[tuple[str, Any]] = queue.SimpleQueue()
    threading.Thread(target=_ask, args=(process, question), daemon=True).start()
    threading.Thread(target=_listen, args=(process, told), daemon=True).start()
    while True:
        if cancelled():
            raise Abandoned("cancelled")
        try:
            kind, content = told.get(timeout=_POLL)
        except queue.Empty:
            continue
        if kind == "told":
            progress(content)
        elif kind == "done":
            return content
        elif kind == "failed":
            raise content
        else:
            raise DesignError("the process that worked it out died; expected an answer, try again")


def _ask(process: subprocess.Popen[bytes], question: object) -> None:
    assert process.stdin is not None
    with contextlib.suppress(OSError, ValueError):  # the listener sees that the process died
        process.stdin.write(pickle.dumps(sys.path) + pickle.dumps(question))
        process.stdin.flush()


def _listen(process: subprocess.Popen[bytes], told: queue.SimpleQueue[tuple[str, Any]]) -> None:
    assert process.stdout is not None
    try:
        while True:
            told.put(pickle.load(process.stdout))
    except (OSError, EOFError, ValueError, pickle.UnpicklingError):
        told.put(("died", None))


def _end(process: subprocess.Popen[bytes]) -> None:
    process.kill()
    process.wait()
    for pipe in (process.stdin, process.stdout):
        with contextlib.suppress(OSError, ValueError):
            if pipe is not None:
                pipe.close()
