"""Compiled work that takes long: an interrupt takes effect at once, not when the work is done."""

from __future__ import annotations

import threading
from collections.abc import Callable


def heeding_interrupts(work: Callable[[], object]) -> None:
    """Do `work` beside the main thread, which waits for it and heeds signals; what it raises is raised here.

    After an interrupt nobody waits any more. Compiled code cannot be ended from outside: its thread goes on until it is
    done or the process ends, which does not wait for it.
    """
    if threading.current_thread() is not threading.main_thread():
        work()  # signals are the main thread's
        return
    raised: list[BaseException] = []

    def done() -> None:
        try:
            work()
        except BaseException as error:
            raised.append(error)

    thread = threading.Thread(target=done, daemon=True)
    thread.start()
    while thread.is_alive():
        thread.join(0.2)  # with a limit: where there is none, some systems do not wake up for a signal
    if raised:
        raise raised[0]
