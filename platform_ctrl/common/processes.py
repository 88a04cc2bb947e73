"""A Python process beside this one that works on tasks: they go in and results come out through its pipes.

Unlike `multiprocessing` it needs no ``if __name__ == "__main__"`` in scripts, and a process may die or be ended alone.
"""

from __future__ import annotations

import atexit
import contextlib
import gc
import importlib
import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

# Longest time that a process may take to start, s; imports from a cold disk are slow.
START_LIMIT = 120.0
# An interrupt is noticed within this time, s, also where waiting for a lock does not notice it.
POLL = 0.1
# How long a process may take from closing its pipe to its end, s.
_END_LIMIT = 5.0
# A process takes the paths of this one first: what it runs may be found on them alone.
_SOURCE = f"import pickle, sys; sys.path[:] = pickle.load(sys.stdin.buffer); from {__name__} import serve; serve()"
# Of the environment: how many processes a command may use.
PROCESSES = "PLATFORM_CTRL_PROCESSES"
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

    def exit_code(self) -> int:
        """Return the exit code of a process that has closed its pipe, which is ended if it lingers."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.wait(_END_LIMIT)
        return self.end()

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


Task = tuple[Callable[..., Any], tuple[Any, ...]]


class _Module:
    """A module that is loaded where this is unpickled."""

    def __init__(self, name: str) -> None:
        self.name = name

    def __reduce__(self) -> tuple[Callable[[str], Any], tuple[str]]:
        return importlib.import_module, (self.name,)


class Begun:
    """Tasks of which those at the front of the list may be done by another process."""

    def __init__(self, tasks: Sequence[Task], long: Sequence[int] = ()) -> None:
        self.tasks = tasks
        short = [k for k in range(len(tasks)) if k not in long]
        # Long ones at both ends, where the processes begin: one of them at the end of all would be waited for.
        self.left = deque([*long[1::2], *short, *long[::2][::-1]])
        self.done: dict[int, tuple[bool, Any]] = {}
        self.feeding: threading.Thread | None = None


class SecondProcess:
    """A process that takes tasks from the front of a list while this one works from its end.

    What goes wrong in it, whatever it is, is done again here: results and errors are those of one process.

    Parameters
    ----------
    modules
        Names of what it loads at once, before there is a task.
    """

    def __init__(self, *modules: str) -> None:
        self._process: TaskProcess | None = None
        self._last: threading.Thread | None = None
        # Without another core the two would only wait for each other.
        if _cores() > 1:
            # A system that starts no process works with this one.
            with contextlib.suppress(OSError):
                self._process = TaskProcess(_attempted, tuple(map(_Module, modules)))

    def __enter__(self) -> SecondProcess:
        return self

    def __exit__(self, *error: object) -> None:
        self.end()

    def end(self) -> None:
        """Kill the process, if it still runs."""
        process, self._process = self._process, None
        if process is not None:
            process.end()

    def results(
        self, tasks: Sequence[Task], begun: Callable[[int], None] = lambda k: None, long: Sequence[int] = ()
    ) -> list[Any]:
        """Return what the functions of `tasks` return for their arguments, in their order.

        `begun` is called with the number of each task that this process begins; the numbers in `long` are those of
        tasks to begin with. Of several errors the first in the order of the tasks is raised.
        """
        # A single one is done here at once.
        return self.finished(self.begin(tasks, long) if len(tasks) > 1 else Begun(tasks), begun)

    def begin(self, tasks: Sequence[Task], long: Sequence[int] = ()) -> Begun:
        """Let the process work on `tasks`, after those begun before, while this one goes on; for `finished`."""
        out = Begun(tasks, long)
        if self._process is not None and tasks:
            self._last = out.feeding = threading.Thread(target=self._feed, args=(out, self._last), daemon=True)
            out.feeding.start()
        return out

    def finished(self, work: Begun, begun: Callable[[int], None] = lambda k: None) -> list[Any]:
        """Return the results of tasks; this process does those that the other has not come to, as in `results`."""
        tasks, done = work.tasks, work.done
        errors: dict[int, Exception] = {}
        while (k := _popped(work.left.pop)) is not None:
            begun(k)
            function, arguments = tasks[k]
            try:
                done[k] = True, function(*arguments)
            except Exception as error:
                errors[k] = error
        while work.feeding is not None and work.feeding.is_alive():
            work.feeding.join(POLL)  # with a limit: an interrupt is noticed
        for k, (function, arguments) in enumerate(tasks):
            if k in errors:
                raise errors[k]
            if not done.get(k, (False, None))[0]:
                begun(k)
                done[k] = True, function(*arguments)
        return [done[k][1] for k in range(len(tasks))]

    def _feed(self, work: Begun, before: threading.Thread | None) -> None:
        if before is not None:
            before.join()
        while self._process is not None and (k := _popped(work.left.popleft)) is not None:
            try:
                work.done[k] = self._process.ask(work.tasks[k], float("inf"))
            except Exception:
                # A task that cannot be pickled, or a process that has died: this process does the rest.
                self.end()


def _popped(pop: Callable[[], int]) -> int | None:
    """Return what is taken from a list, None where it is empty: both processes take."""
    with contextlib.suppress(IndexError):
        return pop()
    return None


def _cores() -> int:
    """Return how many processes may be used: the environment may say so, else as many as there are cores."""
    given = os.environ.get(PROCESSES, "")
    if given.isdecimal():
        return int(given)
    return processors()


def processors() -> int:
    """Return the number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _attempted(modules: object, task: Task) -> tuple[bool, Any]:
    function, arguments = task
    try:
        return True, function(*arguments)
    except Exception:
        return False, None


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


# Inside a process: writes a result.
_write_result: Callable[[object], None] | None = None


def send_early(result: object) -> None:
    """Send a result before the task is done; called by a function that a `TaskProcess` runs."""
    assert _write_result is not None
    _write_result(result)


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

    global _write_result
    _write_result = write
    threading.Thread(target=read, daemon=True).start()
    write(Started())
    while True:
        write(function(*arguments, tasks.get()))
