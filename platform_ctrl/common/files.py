"""Files are written whole or not at all, first under a random name that nobody can have put a link at.

What a killed process leaves goes with the next that writes there: a lock that ends with its process says what is left.
"""

from __future__ import annotations

import contextlib
import glob
import os
import secrets
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from platform_ctrl.errors import InputError

try:
    import fcntl
except ImportError:  # Windows, which removes nothing that is open
    fcntl = None  # type: ignore[assignment]

UNFINISHED = ".unfinished-"
# Neither is known to Windows; a pipe that somebody called so must not be waited for.
_NO_LINK = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)


def write_whole(path: str | os.PathLike[str], content: str | bytes) -> Path:
    """Write `content`, text as UTF-8, to `path` and return it: the old file stays until the new one is complete."""
    target = Path(path)
    if target.exists() and not target.is_file():
        # A device or a pipe would be gone.
        raise InputError(f"{target}: cannot be written: it is no regular file; name a file, or a new path")
    remove_unfinished(target.parent, _unfinished(glob.escape(target.name), "*"))
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
    unfinished = path.with_name(_unfinished(path.name, secrets.token_hex(8)))
    file = open(unfinished, "xb", opener=lambda name, flags: os.open(name, flags | _NO_LINK, 0o666))  # noqa: SIM115
    try:
        with file, _held(unfinished, at_work=True):
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


@contextmanager
def unfinished_folder(folder: Path) -> Iterator[Path]:
    """Yield a new folder inside `folder`, which is removed at the end."""
    remove_unfinished(folder)
    temporary = tempfile.TemporaryDirectory(prefix=UNFINISHED, dir=folder, ignore_cleanup_errors=True)
    with temporary as made, _held(Path(made), at_work=True):
        yield Path(made)


def _unfinished(name: str, word: str) -> str:
    return f".{name}.{word}.tmp"


def remove_unfinished(folder: Path, names: str = f"{UNFINISHED}*") -> None:
    """Remove what killed processes left unfinished in a folder, but nothing that a process is at work on."""
    for left in folder.glob(names):
        with contextlib.suppress(OSError), _held(left):
            if left.is_dir():
                shutil.rmtree(left)
            else:
                left.unlink()


@contextmanager
def _held(path: Path, at_work: bool = False) -> Iterator[None]:
    """Lock a file or a folder that is no link; an OSError where another process holds it, or none can.

    Who is at work on it goes on all the same where the file system has no locks: nobody removes anything there.
    """
    if fcntl is None:
        yield
        return
    handle = os.open(path, os.O_RDONLY | _NO_LINK)
    try:
        with contextlib.suppress(OSError) if at_work else contextlib.nullcontext():
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    finally:
        os.close(handle)
