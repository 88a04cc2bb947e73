"""A command that runs again in the same process whenever a file that it reads is saved: nothing is loaded twice."""

from __future__ import annotations

import stat
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import NoReturn

from platform_ctrl.cli.error_lines import noted, reported
from platform_ctrl.cli.job_arguments import files_read
from platform_ctrl.errors import PlatformCtrlError, began_with_interrupt

# Between two looks at the files, s.
_PAUSE = 0.1

# When a file was written last, and its size; None while there is none.
_State = dict[Path, tuple[int, int] | None]


def whenever_saved(job: Path, run: Callable[[bool], int], first: bool, *, quiet: bool) -> NoReturn:
    """Run with `first`, then with False whenever the job or a file that it names has changed, until Ctrl-C.

    A message about wrong input does not end it.
    """
    while True:
        files = files_read(job)
        seen = _state(files)
        try:
            run(first)
        except PlatformCtrlError as error:
            if began_with_interrupt(error):
                raise
            reported(error)
        first = False
        sys.stdout.flush()
        if not quiet:
            noted(f"waiting until {job} or a file that it names is saved; Ctrl-C ends")
        while seen == (now := _state(files)):
            time.sleep(_PAUSE)
        while now != (later := _state(files)):  # it is still being written
            now = later
            time.sleep(_PAUSE)


def _state(files: list[Path]) -> _State:
    out: _State = dict.fromkeys(files)
    for file in files:
        with suppress(OSError, ValueError):  # it does not exist, or no file can be called so
            status = file.stat()
            if stat.S_ISREG(status.st_mode):
                out[file] = status.st_mtime_ns, status.st_size
    return out
