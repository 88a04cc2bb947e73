"""Tasks for another process of the app, which has to be able to import them."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass

from platform_ctrl.errors import ArgumentError

Say = Callable[[str], None]


@dataclass(frozen=True)
class Sleeping:
    """An answer that never comes."""

    def run(self, say: Say) -> None:
        say("asleep")
        time.sleep(600.0)


@dataclass(frozen=True)
class Who:
    """Which process answers; with `wrong` it refuses."""

    wrong: bool = False

    def run(self, say: Say) -> int:
        if self.wrong:
            raise ArgumentError("given nonsense; expected sense")
        return os.getpid()


@dataclass(frozen=True)
class Dying:
    """The process that is asked dies."""

    def run(self, say: Say) -> None:
        os._exit(3)
