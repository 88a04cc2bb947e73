"""Two things worked out at the same time: most of the time goes by in numpy and compiled kernels, which run beside."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from typing import TypeVar

import numpy as np

T = TypeVar("T")
U = TypeVar("U")


def both(one: Callable[[], T], other: Callable[[], U]) -> tuple[T, U]:
    """Return what both return; `other` runs in a thread where one is free, with numpy's warnings off.

    An error of either is the caller's, of `one` first; the thread has ended by then.
    """
    running = _threads().submit(_silently, other)
    try:
        first = one()
    except BaseException:
        if not running.cancel():
            running.exception()
        raise
    # Pages enough may keep all threads: then it is done here.
    return first, other() if running.cancel() else running.result()


def _silently(work: Callable[[], T]) -> T:
    # What numpy warns of is set for a thread.
    with np.errstate(all="ignore"):
        return work()


@lru_cache(maxsize=1)
def _threads() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(max_workers=max(1, min(8, (os.cpu_count() or 2) - 1)), thread_name_prefix="beside")
