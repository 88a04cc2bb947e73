"""Where a page saves: into the job's own folder, under a plain name, and never over a file unasked."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

from platform_ctrl.errors import InputError
from platform_ctrl.signatures import short

# A name and no path; nothing that a system keeps to itself.
_NAME = re.compile(r"[\w .,()+=@-]+(?<![ .])")
_LONGEST = 80
_RESERVED = re.compile(r"(?i)(con|prn|aux|nul|com\d|lpt\d)(\..*)?")


def target(folder: Path, name: str) -> Path:
    """Return the path of the job file that a page wants to save.

    Parameters
    ----------
    folder
        That of the job which is open.
    name
        What was typed, with or without ``.toml``.

    Returns
    -------
    Path
        In that folder.

    Raises
    ------
    InputError
        It is no plain name of a file.

    References
    ----------
    See docs/designer.md.
    """
    stem = name.strip().removesuffix(".toml")
    if len(stem) > _LONGEST:
        raise InputError(f"name: {len(stem)} characters; expected at most {_LONGEST}")
    if _RESERVED.fullmatch(stem) is not None:
        raise InputError(f"name: given {short(name)}; expected another: Windows keeps it for a device")
    if _NAME.fullmatch(stem) is None:
        raise InputError(f"name: given {short(name)}; expected letters, digits, blanks, . , ( ) + = @ - or _")
    if stem.startswith("."):
        raise InputError(f"name: given {short(name)}; expected no dot at its beginning: such files are hidden")
    return folder / f"{stem}.toml"


def check_line(path: Path) -> str:
    """Return the command that checks a saved job.

    Parameters
    ----------
    path
        Of the job file.

    Returns
    -------
    str
        A line for a shell.

    References
    ----------
    See docs/command-line.md.
    """
    return f"platform-ctrl check {shlex.quote(str(path))}"
