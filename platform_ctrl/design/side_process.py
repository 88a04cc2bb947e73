"""A Python process beside this one that can be ended: questions go in and answers come out through its pipes."""

from __future__ import annotations

import contextlib
import os
import pickle
import queue
import subprocess
import sys
import threading
import time
from typing import Any

# Longest time that a process may take to start, s; imports from a cold disk are slow.
START_LIMIT = 120.0
# An interrupt is noticed within this time, s, also where waiting for a lock does not notice it.
POLL = 0.1


class Ended(Exception):
    """The process died."""


class Late(Exception):
    """The process was killed: the time was over."""


class SideProcess:
    """A running process; one question at a time.

    Parameters
    ----------
    source
        Python source that it runs. It reads pickled objects from standard input, first `sys.path` of this process, and
        writes one pickled answer for each to its own standard output; it ends when its input ends.
    arguments
        Its command line.
    """

    def __init__(self, source: str, *arguments: str) -> None:
        single = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
        options: dict[str, Any] = {}
        if sys.platform == "win32":
            options["creationflags"] = subprocess.CREATE_NO_WINDOW
        self.process = subprocess.Popen(
            [sys.executable, "-P", "-W", "ignore", "-c", source, *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**single, **os.environ},
            **options,
        )
        self.answers: queue.SimpleQueue[Any] = queue.SimpleQueue()
        threading.Thread(target=self._read, daemon=True).start()
        self._send(sys.path)
        self._answer(START_LIMIT)

    def ask(self, question: object, time_limit: float) -> Any:
        """Return the answer."""
        self._send(question)
        return self._answer(time_limit)

    def end(self) -> None:
        """Kill the process, if it still runs, and close its pipes."""
        self.process.kill()
        self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout):
            # What was not written yet is lost on purpose.
            with contextlib.suppress(OSError, ValueError):
                if pipe is not None:
                    pipe.close()

    def _send(self, message: object) -> None:
        # In a thread: a pipe whose other end is not read blocks, and nothing here may wait beyond the limit.
        threading.Thread(target=self._write, args=(message,), daemon=True).start()

    def _write(self, message: object) -> None:
        assert self.process.stdin is not None
        with contextlib.suppress(OSError, ValueError):  # the reader sees that the process died
            self.process.stdin.write(pickle.dumps(message, pickle.HIGHEST_PROTOCOL))
            self.process.stdin.flush()

    def _read(self) -> None:
        assert self.process.stdout is not None
        try:
            while True:
                self.answers.put(pickle.load(self.process.stdout))
        except (OSError, EOFError, ValueError, pickle.UnpicklingError):
            self.answers.put(None)

    def _answer(self, limit: float) -> Any:
        end = time.monotonic() + limit
        answer = None
        try:
            while True:
                try:
                    answer = self.answers.get(timeout=max(0.0, min(POLL, end - time.monotonic())))
                    break
                except queue.Empty:
                    if time.monotonic() >= end:
                        raise Late from None
        finally:
            # An interrupt passes through here too.
            if answer is None:
                self.end()
        if answer is None:
            raise Ended
        return answer
