"""Files are written whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from platform_ctrl.errors import InputError


def write_whole(path: str | os.PathLike[str], content: str | bytes) -> Path:
    """Write `content`, text as UTF-8, to `path` and return it: the old file stays until the new one is complete."""
    target = Path(path)
    if target.exists() and not target.is_file():
        # A device or a pipe would be gone.
        raise InputError(f"{target}: cannot be written: it is no regular file; name a file, or a new path")
    try:
        with replaced_file(target) as file:
            file.write(content.encode() if isinstance(content, str) else content)
    except OSError as error:
        raise InputError(
            f"{target}: cannot be written: {error.strerror or error}; name a path in a folder that exists and is "
            "writable"
        ) from None
    return target


@contextmanager
def replaced_file(path: Path, *, synced: bool = False) -> Iterator[BinaryIO]:
    """Yield a file that takes the place of `path` when it is complete; with `synced` also after a loss of power."""
    # In the same folder, so that putting it in place is one step of the file system.
    unfinished = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with open(unfinished, "wb") as file:
            yield file
            if synced:
                file.flush()
                os.fsync(file.fileno())
        os.replace(unfinished, path)
    finally:
        unfinished.unlink(missing_ok=True)
    if synced and os.name == "posix":
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)
