"""Tasks that take seconds, in other processes: they report progress and end when they are cancelled."""

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
    "from platform_ctrl.app.processes import serve; serve()"
)
# How soon a cancelled task notices, s.
_POLL = 0.1
# Tasks at a time; others wait.
_AT_A_TIME = threading.BoundedSemaphore(2)


class TaskCancelled(PlatformCtrlError):
    """The task was cancelled."""


def run_in_process(task: object, progress: Progress, cancelled: IsCancelled) -> Any:
    """Return the result of a task, one of `process_tasks`, run in a process of its own."""
    while not _AT_A_TIME.acquire(timeout=_POLL):
        if cancelled():
            raise TaskCancelled("cancelled")
    process = None
    try:
        process = _Process()
        return process.run(task, progress, cancelled)
    finally:
        _AT_A_TIME.release()
        if process is not None:
            process.end()


class PersistentProcess:
    """A process that stays for the next task: what it has loaded and compiled is there; one at a time."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._held: list[_Process] = []
        self._ended = False
        weakref.finalize(self, _drop, self._held)

    @property
    def started(self) -> bool:
        """Whether the process was started already."""
        return bool(self._held)

    def run(self, task: object, progress: Progress, cancelled: IsCancelled) -> Any:
        """Return the result of a task, as `run_in_process` does; the process ends if it is cancelled."""

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
                return self._held[0].run(task, progress, unwanted)
            except TaskCancelled:
                _drop(self._held)
                raise
        finally:
            self._lock.release()

    def end(self) -> None:
        """End the process; no task is accepted any more."""
        self._ended = True
        with self._lock:  # who waits for a result leaves at the next look
            _drop(self._held)


def _drop(held: list[_Process]) -> None:
    while held:
        held.pop().end()


class _Process:
    """A process that runs tasks, one after another."""

    def __init__(self) -> None:
        self._process = _started()
        self._messages: queue.SimpleQueue[tuple[str, Any]] = queue.SimpleQueue()
        self._died = False
        self._write(pickle.dumps(sys.path))
        threading.Thread(target=_listen, args=(self._process, self._messages), daemon=True).start()

    @property
    def gone(self) -> bool:
        # One that closed its pipe may not have ended yet, and reports that it died only once.
        return self._died or self._process.poll() is not None

    def run(self, task: object, progress: Progress, cancelled: IsCancelled) -> Any:
        # Pickled here: the caller sees what cannot be.
        threading.Thread(target=self._write, args=(pickle.dumps(task),), daemon=True).start()
        while True:
            if cancelled():
                raise TaskCancelled("cancelled")
            try:
                kind, content = self._messages.get(timeout=_POLL)
            except queue.Empty:
                continue
            if kind == "progress":
                progress(content)
            elif kind == "done":
                return content
            elif kind == "failed":
                raise content
            else:
                self._died = True
                raise DesignError("the process that ran the task died; try again")

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


def _listen(process: subprocess.Popen[bytes], messages: queue.SimpleQueue[tuple[str, Any]]) -> None:
    assert process.stdout is not None
    try:
        while True:
            messages.put(pickle.load(process.stdout))
    except Exception:  # whatever a broken pickle raises: who waits is to know
        messages.put(("died", None))


def serve() -> None:
    """Run tasks from standard input, one after another; write progress and results to standard output."""
    # Solvers may print: that is no part of the result.
    pipe = os.fdopen(os.dup(1), "wb")
    silent = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silent, 1)

    def send(kind: str, content: object) -> None:
        pipe.write(pickle.dumps((kind, content)))
        pipe.flush()

    tasks: queue.SimpleQueue[Any] = queue.SimpleQueue()
    threading.Thread(target=_read, args=(tasks,), daemon=True).start()
    try:
        while True:
            task = tasks.get()
            try:
                send("done", task.run(lambda line: send("progress", line)))
            except PlatformCtrlError as error:
                # What was being solved may not be for a pipe.
                plain = DesignError(str(error)) if isinstance(error, DesignError) else error
                send("failed", plain)
    finally:
        os._exit(1)  # at once: the thread that reads holds the lock of what it reads from


def _read(tasks: queue.SimpleQueue[Any]) -> None:
    """Take tasks, and end this process when the other end of its input is gone: nobody waits for a result."""
    try:
        while True:
            tasks.put(pickle.load(sys.stdin.buffer))
    finally:
        os._exit(0)
