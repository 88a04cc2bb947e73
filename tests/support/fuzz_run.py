"""A command run in this process as a user runs it, with everything judged that has to hold whatever it was given."""

from __future__ import annotations

import contextlib
import faulthandler
import functools
import io
import os
import random
import signal
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from unittest import mock

import typer.main
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st

from platform_ctrl.cli import main

# Seconds of work that a command on a mutated file may take, and of waiting: a busy machine is no hang. Compiled code
# that never returns to Python heeds no signal: then the process ends with a traceback.
LONGEST = 5.0
WAITING = 60.0

# A night's run: so many times the cases, each time others. Without it a fifth of them, the same everywhere.
TIMES = int(os.environ.get("FUZZ_TIMES", "0"))

PREFIX = "platform-ctrl: error: "


# What chance makes of a file: a number that stands for all choices is quicker than a choice at a time.
chances = st.integers(0, 2**32 - 1).map(random.Random)


class HangError(BaseException):
    """A case took longer than it may: no handler of ordinary errors keeps it."""


@dataclass(frozen=True)
class Ended:
    """How a command ended."""

    code: int
    out: str
    err: str

    @property
    def error(self) -> str:
        """The one line that says what is wrong with the input, without its begin."""
        assert self.code == 2, self
        assert self.out == "", self
        assert self.err.startswith(PREFIX), self
        assert self.err.count("\n") == 1, self
        return self.err.removeprefix(PREFIX).removesuffix("\n")


def cases(number: int) -> settings:
    """Return the settings of a fuzz test of so many cases."""
    return settings(
        max_examples=number * TIMES if TIMES else number // 5,
        derandomize=not TIMES,
        database=None,
        deadline=None,
        phases=(Phase.explicit, Phase.generate, Phase.shrink),
        suppress_health_check=list(HealthCheck),
    )


def ended(*arguments: str | Path, folder: Path | None = None, seconds: float = LONGEST) -> Ended:
    """Run a command; `folder`, its current one and its input's, has the same files as before if the input is wrong."""
    before = None if folder is None else contents(folder)
    out, err = (io.TextIOWrapper(io.BytesIO(), encoding="utf-8", newline="", write_through=True) for _ in range(2))
    # The commands are the same every time: to gather them takes longer than to read a small file.
    gathered = mock.patch.object(typer.main, "get_command", _get_command)
    with _watched(arguments, seconds), gathered, contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main([str(argument) for argument in arguments])
    found = Ended(code, *(stream.buffer.getvalue().decode("utf-8") for stream in (out, err)))  # type: ignore[attr-defined]
    assert found.code in (0, 1, 2), found
    for stream in (found.out, found.err):
        assert all(line.isprintable() for line in stream.split("\n")), found
    if found.code == 2:
        assert found.error
        assert before is None or folder is None or contents(folder) == before, found
    elif found.code == 1 and not found.out:
        assert found.err.splitlines()[-1].startswith(PREFIX), found
    return found


def contents(folder: Path) -> dict[str, int]:
    """Return the files below a folder with their sizes."""
    return {str(path): path.stat().st_size for path in folder.rglob("*") if path.is_file()}


@contextlib.contextmanager
def _watched(arguments: tuple[str | Path, ...], seconds: float) -> Iterator[None]:
    def hung(number: int, frame: FrameType | None) -> None:
        raise HangError(f"{' '.join(map(str, arguments))}: more than {seconds} s")

    if not hasattr(signal, "setitimer"):
        yield
        return
    timers = ((signal.ITIMER_PROF, signal.SIGPROF, seconds), (signal.ITIMER_REAL, signal.SIGALRM, WAITING))
    heeded = [signal.signal(number, hung) for _, number, _ in timers]
    faulthandler.dump_traceback_later(2.0 * WAITING, exit=True, file=sys.__stderr__)
    for timer, _, after in timers:
        signal.setitimer(timer, after)
    try:
        yield
    finally:
        for (timer, number, _), before in zip(timers, heeded, strict=True):
            signal.setitimer(timer, 0.0)
            signal.signal(number, before)
        faulthandler.cancel_dump_traceback_later()


_get_command = functools.cache(typer.main.get_command)
