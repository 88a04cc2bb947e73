"""Files are written whole or not at all."""

from __future__ import annotations

import os
from pathlib import Path

from platform_ctrl.errors import InputError


def write_whole(path: str | os.PathLike[str], content: str | bytes) -> Path:
    """Write `content`, text as UTF-8, to `path` and return it: the old file stays until the new one is complete."""
    target = Path(path)
    if target.exists() and not target.is_file():
        # A device or a pipe would be gone.
        raise InputError(f"{target}: cannot be written: is no regular file; expected a file, or nothing there")
    # In the same folder, so that putting it in place is one step of the file system.
    unfinished = target.with_name(f".{target.name}.{os.getpid()}.tmp")
    try:
        try:
            unfinished.write_bytes(content.encode() if isinstance(content, str) else content)
            os.replace(unfinished, target)
        finally:
            unfinished.unlink(missing_ok=True)
    except OSError as error:
        raise InputError(
            f"{target}: cannot be written: {error.strerror or error}; expected a path in a folder that exists and may "
            "be written to"
        ) from None
    return target
