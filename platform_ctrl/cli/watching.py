"""A command that runs again in the same process whenever a file that it reads is saved: nothing is loaded twice."""

from __future__ import annotations

import hashlib
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import NoReturn

from platform_ctrl.cli.error_lines import noted, reported
from platform_ctrl.cli.job_arguments import files_read
from platform_ctrl.errors import PlatformCtrlError, began_with_interrupt

# Between two looks at the files, s; large files are looked at for a tenth of the time.
_PAUSE, _SHARE = 0.1, 0.1

# Hash of what a file holds, which times and sizes do not show; None while there is none.
_State = dict[Path, bytes | None]


def whenever_saved(job: Path, run: Callable[[], int], *, quiet: bool) -> NoReturn:
    """Run, and again whenever the job or a file that it names has changed, until Ctrl-C.

    A message about wrong input does not end it.
    """
    while True:
        files = files_read(job)
        seen = _state(files)
        try:
            run()
        except PlatformCtrlError as error:
            if began_with_interrupt(error):
                raise
            reported(error)
        sys.stdout.flush()
        if not quiet:
            noted(f"waiting until {job} or a file that it names is saved; Ctrl-C ends")
        while seen == (now := _after_a_pause(files)):
            pass
        while now != (later := _after_a_pause(files)):  # it is still being written
            now = later


def _after_a_pause(files: list[Path]) -> _State:
    begun = time.monotonic()
    out = _state(files)
    time.sleep(max(_PAUSE, (time.monotonic() - begun) * (1.0 / _SHARE - 1.0)))
    return out


def _state(files: list[Path]) -> _State:
    out: _State = dict.fromkeys(files)
    for file in files:
        with suppress(OSError, ValueError):  # it does not exist, or no file can be called so
            if file.is_file():
                with file.open("rb") as opened:
                    out[file] = hashlib.file_digest(opened, "sha256").digest()
    return out
