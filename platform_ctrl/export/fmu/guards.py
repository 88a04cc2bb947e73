"""FMI's getters and setters without exceptions: one that left would take the instance from under the importer."""

from __future__ import annotations

import atexit
import ctypes
import math
import os
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from pythonfmu3 import Fmi3Slave

from platform_ctrl.errors import PlatformCtrlError

# What a getter that fails returns in place of each number.
_NOTHING: dict[str, Any] = {
    "float64": math.nan,
    "int32": 0,
    "int64": 0,
    "uint64": 0,
    "boolean": False,
    "string": "",
}


def error_line(error: BaseException) -> str:
    """Return a line about an error."""
    return str(error) if isinstance(error, PlatformCtrlError) else f"{type(error).__name__}: {error}"


def guarded_setter(kind: str) -> Callable[[Any, list[int], list[Any]], None]:
    """Return the library's setter of a kind; what it raises goes to the instance's `fail`."""

    def put(self: Any, references: list[int], numbers: list[Any]) -> None:
        try:
            getattr(Fmi3Slave, f"set_{kind}")(self, references, numbers)
        except (Exception, KeyboardInterrupt) as error:
            self.fail(f"values that cannot be set: {error_line(error)}")

    return put


def guarded_getter(kind: str) -> Callable[[Any, list[int]], list[Any]]:
    """Return the library's getter of a kind; where it raises, numbers that say nothing."""

    def get(self: Any, references: list[int]) -> list[Any]:
        try:
            return list(getattr(Fmi3Slave, f"get_{kind}")(self, references))
        except (Exception, KeyboardInterrupt) as error:
            self.fail(f"values that cannot be read: {error_line(error)}")
            return [_NOTHING[kind]] * len(references)

    return get


_FUNCTION = "finalizePythonInterpreter"
# Program name that the library sets where it has started Python itself; there it also ends Python.
_OWN_PROGRAM = "PythonFMU"


def finalize_before_exit(resources: Path, identifier: str) -> None:
    """Register the end of the unit's library before that of the process."""
    if os.name == "posix" and Path(sys.executable or _OWN_PROGRAM).name != _OWN_PROGRAM:
        for library in sorted(resources.parent.glob(f"binaries/*/{identifier}.so")):
            _at_exit(library)


@cache
def _at_exit(library: Path) -> None:
    try:
        # Not loaded anew: the handle of the one that is there, or none.
        loaded = ctypes.CDLL(str(library), mode=os.RTLD_NOLOAD | os.RTLD_LAZY)
        atexit.register(getattr(loaded, _FUNCTION))
    except (OSError, AttributeError):
        return
