"""Tasks for another process of the app, which has to be able to import them."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from typing import Any

from platform_ctrl.errors import ArgumentError

Say = Callable[[str], None]


def sleeping(*given: Any) -> None:
    """Never answer."""
    given[-1]("asleep")
    time.sleep(600.0)


def who(say: Say) -> int:
    """Return which process answers."""
    del say
    return os.getpid()


def refusing(say: Say) -> None:
    """Refuse."""
    del say
    raise ArgumentError("given nonsense; expected sense")


def dying(say: Say) -> None:
    """End the process that is asked."""
    del say
    os._exit(3)
