"""How a command ends: what it says on standard error, with which exit code, and that of a Ctrl-C at any moment.

A Ctrl-C gives 130 from the first line of the command to the end of the process, and leaves no half-written files.
"""

from __future__ import annotations

import atexit
import os
import shutil
import signal
import sys
import textwrap
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import NoReturn

from platform_ctrl.common.files import json_text
from platform_ctrl.errors import DesignError, PlatformCtrlError, SimulationError, began_with_interrupt, reason


def not_drawn(path: Path, draw: Callable[[Path], object]) -> str:
    """Write a picture or a page; where that fails return a line that says why, for the result does not depend on it."""
    try:
        draw(path)
    except Exception as error:
        if began_with_interrupt(error):
            raise
        there = "; the file there is of an earlier run" if path.exists() else ""
        return f"{path}: not written: {reason(error)}{there}"
    return ""


def reported(error: PlatformCtrlError) -> int:
    """Print an error; return the exit code."""
    return failed(str(error), 1 if isinstance(error, DesignError | SimulationError) else 2)


def print_json(record: object) -> None:
    """Print data as JSON on standard output."""
    print(json_text(record))


def failed(message: str, code: int) -> int:
    """Print a message as one line; return the exit code."""
    noted(f"platform-ctrl: error: {' '.join(message.split())}")
    return code


def noted(line: str) -> None:
    """Print a line on standard error, unless it is empty; a terminal would break it within words."""
    if not line:
        return
    if sys.stderr.isatty():
        width = shutil.get_terminal_size().columns
        line = textwrap.fill(line, width, break_long_words=False, break_on_hyphens=False)
    print(line, file=sys.stderr, flush=True)


INTERRUPTED = 130
INTERRUPTED_LINE = "platform-ctrl: interrupted"


class _Note:
    """A handler of SIGINT that counts the signals and raises `KeyboardInterrupt` from the one after `deferred` on."""

    def __init__(self, deferred: int) -> None:
        self.deferred, self.count = deferred, 0

    def __call__(self, number: int, frame: FrameType | None) -> None:
        self.count += 1
        if self.count > self.deferred:
            raise KeyboardInterrupt

    def check(self) -> None:
        if self.count:
            raise KeyboardInterrupt


@contextmanager
def interruptible(deferred: int = 0) -> Iterator[Callable[[], None]]:
    """Yield a function that raises `KeyboardInterrupt` if Ctrl-C was pressed: libraries may swallow the exception.

    The first `deferred` ones are raised by that function only, not inside a library. An error of the block after a
    Ctrl-C is an interrupt. An `interruptible` around this one counts what is pressed here.
    """
    note, before = _Note(deferred), signal.getsignal(signal.SIGINT)
    ours = before is signal.default_int_handler or isinstance(before, _Note)
    if not ours or threading.current_thread() is not threading.main_thread():
        yield note.check  # the signal is ignored, handled by the caller, or belongs to another thread
        return
    signal.signal(signal.SIGINT, note)
    try:
        yield note.check
    except Exception:
        note.check()
        raise
    finally:
        signal.signal(signal.SIGINT, before)
        if isinstance(before, _Note):
            before.count += note.count


def exit_interrupted(*signal_and_frame: object) -> NoReturn:
    """End the process at once; a library that was interrupted while it was loaded may crash an orderly end."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    print(INTERRUPTED_LINE, file=sys.stderr, flush=True)
    os._exit(INTERRUPTED)


def end_of_process() -> Callable[[int], None]:
    """Return a function that lets the process end with a code, of a Ctrl-C from then on with 130.

    Python restores the system's own handler of SIGINT before it clears its modules and would die of a Ctrl-C there
    (exit status -2). Therefore the process ends as soon as all that is registered with `atexit` after this call has
    run.
    """
    given: list[int] = []

    def leave() -> None:
        if given:
            with suppress(OSError, ValueError):  # the reader has ended
                sys.stdout.flush()
                sys.stderr.flush()
            os._exit(given[0])

    def begin(code: int) -> None:
        if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
            signal.signal(signal.SIGINT, exit_interrupted)
        given.append(code)

    atexit.register(leave)
    return begin
