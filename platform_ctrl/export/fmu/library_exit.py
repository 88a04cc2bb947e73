"""PythonFMU3's library lets go of its thread twice when a process ends: told early enough, once.

Seen in 0.3.4 on Linux: at `exit` the library's shared pointer is destroyed first, and a function of the library that
runs after that sets it to nothing: what it counts with has been freed by then, and the process that had long been done
ends with "corrupted double-linked list". That function is exported, and once called does no harm later.
"""

from __future__ import annotations

import atexit
import ctypes
import os
import sys
from functools import cache
from pathlib import Path

_FUNCTION = "finalizePythonInterpreter"
# Program that the library says it is where it has started Python itself: there it ends Python too, in order.
_OWN_PROGRAM = "PythonFMU"


def let_go_once(resources: Path, identifier: str) -> None:
    """See to it that the library of a unit lets go before the process ends."""
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
