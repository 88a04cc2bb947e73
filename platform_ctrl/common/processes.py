"""A Python process beside this one that works on tasks: they go in and results come out through its pipes.

Unlike `multiprocessing` it needs no ``if __name__ == "__main__"`` in scripts, and a process may die or be ended alone.
"""

from __future__ import annotations

import atexit
import contextlib
import gc
import multiprocessing
import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from typing import Any

# Longest time that a process may take to start, s; imports from a cold disk are slow.
START_LIMIT = 120.0
# An interrupt is noticed within this time, s, also where waiting for a lock does not notice it.
POLL = 0.1
# How long a process may take from closing its pipe to its end, s.
_END_LIMIT = 5.0
# A process takes the paths of this one first: what it runs may be found on them alone.
_SOURCE = f"import pickle, sys; sys.path[:] = pickle.load(sys.stdin.buffer); from {__name__} import serve; serve()"
_ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


class ProcessDied(Exception):
    """The process died."""


class ProcessTimeout(Exception):
    """The process was killed because the time was over."""


class Started:
    """The first result of a process: it has loaded its function."""


class TaskProcess:
    """A running process that calls a function for each task, one at a time.

    Parameters
    ----------
    function, arguments
        Called as ``function(*arguments, task)``, returns anything but None; all of it is pickled. What it raises ends
        the process.
    results
        Takes (process, result) for each task, after (process, `Started`), and (process, None) when the process has
        ended; several processes may share it.
    stderr
        Where the process writes its errors, as of `subprocess.Popen`.
    """

    def __init__(
        self,
        function: Callable[..., Any],
        *arguments: object,
        results: queue.SimpleQueue[tuple[TaskProcess, Any]] | None = None,
        stderr: int | None = subprocess.DEVNULL,
    ) -> None:
        # In a session of its own: an interrupt at the terminal is meant for this process alone.
        options: dict[str, Any] = {"start_new_session": True}
        if sys.platform == "win32":
            options = {"creationflags": subprocess.CREATE_NO_WINDOW}
        self.process = subprocess.Popen(
            [sys.executable, "-P", "-W", "ignore", "-c", _SOURCE],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=stderr,
            env={**_ONE_THREAD, **os.environ},
            **options,
        )
        self._asked = False
        self._results: queue.SimpleQueue[tuple[TaskProcess, Any]] = results or queue.SimpleQueue()
        threading.Thread(target=self._read, daemon=True).start()
        self._send(pickle.dumps(sys.path) + pickle.dumps((function, arguments), pickle.HIGHEST_PROTOCOL))

    def send(self, task: object) -> None:
        """Give the process a task; the one before must be done."""
        self._send(pickle.dumps(task, pickle.HIGHEST_PROTOCOL))

    def ask(self, task: object, time_limit: float) -> Any:
        """Return the result of a task within a time, s; for a process whose `results` nobody else reads.

        Raises
        ------
        ProcessDied
            It died, or could not start.
        ProcessTimeout
            The time was over; the process is killed.
        """
        if not self._asked:
            self._wait(START_LIMIT)
            self._asked = True
        self.send(task)
        return self._wait(time_limit)

    def end(self) -> int:
        """Kill the process, if it still runs, and close its pipes; return its exit code."""
        self.process.kill()
        code = self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout):
            # What was not written yet is lost on purpose.
            with contextlib.suppress(OSError, ValueError):
                if pipe is not None:
                    pipe.close()
        return code

    def _send(self, message: bytes) -> None:
        # In a thread: a pipe whose other end is not read blocks, and nothing here may wait beyond the limit.
        threading.Thread(target=self._write, args=(message,), daemon=True).start()

    def _write(self, message: bytes) -> None:
        assert self.process.stdin is not None
        with contextlib.suppress(OSError, ValueError):  # the reader sees that the process died
            self.process.stdin.write(message)
            self.process.stdin.flush()

    def _read(self) -> None:
        assert self.process.stdout is not None
        try:
            while True:
                self._results.put((self, pickle.load(self.process.stdout)))
        except Exception:  # whatever a broken pickle raises: the waiting side has to know
            self._results.put((self, None))

    def _wait(self, limit: float) -> Any:
        result = None
        try:
            _, result = next_result(self._results, limit)
        finally:
            # An interrupt passes through here too.
            if result is None:
                self.end()
        if result is None:
            raise ProcessDied
        return result


def processors() -> int:
    """Return the number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def next_result(
    results: queue.SimpleQueue[tuple[TaskProcess, Any]], limit: float = float("inf")
) -> tuple[TaskProcess, Any]:
    """Return the next process with its result, None where it has ended; `ProcessTimeout` after `limit`, s."""
    end = time.monotonic() + limit
    while True:
        try:
            return results.get(timeout=max(0.0, min(POLL, end - time.monotonic())))
        except queue.Empty:
            if time.monotonic() >= end:
                raise ProcessTimeout from None


@contextmanager
def processes(
    workers: int, method: str = "spawn", prepare: Callable[..., None] | None = None, *given: object
) -> Iterator[Executor]:
    """Yield an executor of processes, which end with it and with this process; each calls ``prepare(*given)`` first.

    `method` is a way of `multiprocessing` to start them; "fork" hands `given` over as they are.
    """
    before = set(multiprocessing.active_children())
    executor = ProcessPoolExecutor(workers, multiprocessing.get_context(method), _begin, (prepare, given))
    try:
        yield executor
    finally:
        for child in {*multiprocessing.active_children()} - before:
            child.terminate()
        executor.shutdown(cancel_futures=True)


def _begin(prepare: Callable[..., None] | None, given: tuple[object, ...]) -> None:
    """Prepare a process: an interrupt at the terminal is meant for its parent, with which it ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    assert parent is not None

    def follow() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=follow, daemon=True).start()
    if prepare is not None:
        prepare(*given)


def collect_seldom() -> None:
    """Look for garbage seldom, and not again at the end: said first in a process that ends with its command.

    What is loaded stays, and to look through it again and again takes a quarter of the time of loading it.
    """
    gc.set_threshold(50_000, 20, 100)
    atexit.register(gc.freeze)


def serve() -> None:
    """Work on the tasks of standard input until it ends, which it also does when the other process is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    collect_seldom()
    results = os.fdopen(os.dup(1), "wb")
    # Nothing that a library prints may come between the results.
    os.dup2(2, 1)
    function, arguments = pickle.load(sys.stdin.buffer)
    tasks: queue.SimpleQueue[Any] = queue.SimpleQueue()

    def read() -> None:
        try:
            while True:
                tasks.put(pickle.load(sys.stdin.buffer))
        except BaseException:
            os._exit(1)

    def write(result: object) -> None:
        pickle.dump(result, results, pickle.HIGHEST_PROTOCOL)
        results.flush()

    threading.Thread(target=read, daemon=True).start()
    write(Started())
    while True:
        write(function(*arguments, tasks.get()))
