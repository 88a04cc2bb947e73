"""Work that takes seconds, in a process beside this one: it tells how far it is, and ends when it is not wanted."""

from __future__ import annotations

import contextlib
import os
import pickle
import queue
import subprocess
import sys
import threading
import weakref
from collections.abc import Callable
from typing import Any

from platform_ctrl.errors import DesignError, PlatformCtrlError

Progress = Callable[[str], None]
IsCancelled = Callable[[], bool]

_SOURCE = (
    "import pickle, sys; sys.path[:] = pickle.load(sys.stdin.buffer); "
    "from platform_ctrl.app.process_tasks import answer; answer()"
)
# How soon a cancelled task notices, s.
_POLL = 0.1
# Tasks at a time; others wait.
_AT_A_TIME = threading.BoundedSemaphore(2)


class TaskCancelled(PlatformCtrlError):
    """The task was cancelled."""


def run_in_process(question: object, progress: Progress, cancelled: IsCancelled) -> Any:
    """Return what `platform_ctrl.app.process_tasks` answers to a question."""
    while not _AT_A_TIME.acquire(timeout=_POLL):
        if cancelled():
            raise TaskCancelled("cancelled")
    process = None
    try:
        process = _Process()
        return process.run(question, progress, cancelled)
    finally:
        _AT_A_TIME.release()
        if process is not None:
            process.end()


class PersistentProcess:
    """A process that stays for the next question: what it has loaded and compiled is there. One question at a time."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._held: list[_Process] = []
        self._ended = False
        weakref.finalize(self, _drop, self._held)

    @property
    def started(self) -> bool:
        """Whether the process was started already."""
        return bool(self._held)

    def run(self, question: object, progress: Progress, cancelled: IsCancelled) -> Any:
        """Return the answer to a question, as the function `run` does; the process ends if it is cancelled."""

        def unwanted() -> bool:
            return self._ended or cancelled()

        while not self._lock.acquire(timeout=_POLL):
            if unwanted():
                raise TaskCancelled("cancelled")
        try:
            if self._held and self._held[0].gone:
                _drop(self._held)
            if unwanted():
                raise TaskCancelled("cancelled")
            if not self._held:
                self._held.append(_Process())
            try:
                return self._held[0].run(question, progress, unwanted)
            except TaskCancelled:
                _drop(self._held)
                raise
        finally:
            self._lock.release()

    def end(self) -> None:
        """End the process; nobody asks any more."""
        self._ended = True
        with self._lock:  # who asks leaves at the next look
            _drop(self._held)


def _drop(held: list[_Process]) -> None:
    while held:
        held.pop().end()


class _Process:
    """A process that answers questions, one after another."""

    def __init__(self) -> None:
        self._process = _started()
        self._told: queue.SimpleQueue[tuple[str, Any]] = queue.SimpleQueue()
        self._died = False
        self._write(pickle.dumps(sys.path))
        threading.Thread(target=_listen, args=(self._process, self._told), daemon=True).start()

    @property
    def gone(self) -> bool:
        # One that closed its pipe may not have ended yet, and tells that it died only once.
        return self._died or self._process.poll() is not None

    def run(self, question: object, progress: Progress, cancelled: IsCancelled) -> Any:
        # Pickled here: what cannot be is told to who asks.
        threading.Thread(target=self._write, args=(pickle.dumps(question),), daemon=True).start()
        while True:
            if cancelled():
                raise TaskCancelled("cancelled")
            try:
                kind, content = self._told.get(timeout=_POLL)
            except queue.Empty:
                continue
            if kind == "told":
                progress(content)
            elif kind == "done":
                return content
            elif kind == "failed":
                raise content
            else:
                self._died = True
                raise DesignError("the process that worked it out died; expected an answer, try again")

    def end(self) -> None:
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            with contextlib.suppress(OSError, ValueError):
                if pipe is not None:
                    pipe.close()

    def _write(self, content: bytes) -> None:
        assert self._process.stdin is not None
        with contextlib.suppress(OSError, ValueError):  # the listener sees that the process died
            self._process.stdin.write(content)
            self._process.stdin.flush()


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


def _listen(process: subprocess.Popen[bytes], told: queue.SimpleQueue[tuple[str, Any]]) -> None:
    assert process.stdout is not None
    try:
        while True:
            told.put(pickle.load(process.stdout))
    except Exception:  # whatever a broken pickle raises: who waits is to know
        told.put(("died", None))
