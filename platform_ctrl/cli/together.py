"""Several files that appear together: all of them, whole, or none, whenever the work is interrupted."""

from __future__ import annotations

import os
import shutil
import signal
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from platform_ctrl.errors import InputError


@contextmanager
def together(folder: Path) -> Iterator[Path]:
    """Yield a folder inside `folder` to write into; at the end every file in it moves up, over what stood there.

    If the work ends by an error or by Ctrl-C, `folder` is as it was. A Ctrl-C while the files move takes effect when
    they have moved.

    Raises
    ------
    InputError
        A file cannot be written.
    """
    unfinished: Path | None = None
    try:
        with uninterrupted():
            try:
                # In the same folder, so that putting a file in place is one step of the file system.
                unfinished = Path(tempfile.mkdtemp(prefix=".unfinished-", dir=folder))
            except OSError as error:
                raise InputError(f"{folder}: cannot be written to: {error.strerror or error}") from None
        try:
            yield unfinished
        except InputError as error:  # a full disk: named as the file was to be
            raise InputError(str(error).replace(str(unfinished), str(folder))) from None
        except OSError as error:
            meant = str(error.filename or folder).replace(str(unfinished), str(folder))
            raise InputError(f"{meant}: cannot be written: {error.strerror or error}") from None
        with uninterrupted():
            for file in sorted(unfinished.iterdir()):
                try:
                    os.replace(file, folder / file.name)
                except OSError as error:
                    raise InputError(f"{folder / file.name}: cannot be written: {error.strerror or error}") from None
    finally:
        if unfinished is not None:
            with uninterrupted():
                shutil.rmtree(unfinished, ignore_errors=True)


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Let a Ctrl-C wait until the end."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    waiting = []
    before = signal.signal(signal.SIGINT, lambda number, frame: waiting.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if waiting:
        raise KeyboardInterrupt
