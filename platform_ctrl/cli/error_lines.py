"""What a command says on standard error: notes, and errors with the code that it ends with."""

from __future__ import annotations

import shutil
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path

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
