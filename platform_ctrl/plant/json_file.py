"""JSON that people may have edited: read, or refused in one line."""

from __future__ import annotations

import json
import os
from pathlib import Path

from platform_ctrl.errors import InputError
from platform_ctrl.plant import fields
from platform_ctrl.plant.mistakes import one_line
from platform_ctrl.plant.source import read_text


def read_json(path: str | os.PathLike[str], expected: str) -> tuple[str, object]:
    """Return a file's name for messages, and what it holds.

    Parameters
    ----------
    path
        The file.
    expected
        What it should be, for messages.
    """
    file = Path(path)
    label, text = one_line(str(file)), read_text(file, expected)
    try:
        return label, json.loads(text)
    except json.JSONDecodeError as error:
        where = f"(line {error.lineno}, column {error.colno})"
        raise InputError(f"{label}: is not JSON: {error.msg} {where}; expected {expected}") from None
    except RecursionError:
        raise InputError(f"{label}: is not JSON that can be read: nested too deeply") from None
    except ValueError as error:  # more digits than Python reads
        raise InputError(f"{label}: cannot be read: {one_line(str(error))}") from None


def finite(item: object) -> float | None:
    """Return `item` as a finite number; None where it is none."""
    try:
        return fields.finite(item)
    except fields.Unfit:
        return None
