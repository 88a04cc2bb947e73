"""One process at a time in a campaign's folder: a lock of the operating system, gone when the process is."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from platform_ctrl.errors import InputError

LOCK = ".campaign.lock"


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold the folder.

    Raises
    ------
    InputError
        Another process holds it, or it cannot be written to.
    """
    try:
        handle = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o666)
    except OSError as error:
        raise InputError(f"{folder}: cannot be written to: {error.strerror or error}") from None
    try:
        if not _taken(handle):
            raise InputError(
                f"{folder}: another process is at work on the campaign there; wait for it, or name another folder "
                "with -o"
            )
        yield
    finally:
        os.close(handle)


def _taken(handle: int) -> bool:
    try:
        if sys.platform == "win32":
            import msvcrt

            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True
