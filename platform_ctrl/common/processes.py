"""Processes beside this one, which end with it, and work that Ctrl-C interrupts."""

from __future__ import annotations

import atexit
import gc
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager


def processors() -> int:
    """Return the number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def processes(
    workers: int, method: str = "spawn", prepare: Callable[..., None] | None = None, *given: object
) -> Iterator[Executor]:
    """Yield an executor of processes, which end with it and with this process; each calls ``prepare(*given)`` first.

    `method` is a way of `multiprocessing` to start them; "fork" hands `given` over as they are.
    """
    before = set(multiprocessing.active_children())
    executor = ProcessPoolExecutor(workers, multiprocessing.get_context(method), _begin, (prepare, given))
    try:
        if method == "fork":
            # Python prints an exception of what it runs beside a fork, and forgets it.
            with interrupts_deferred():
                executor.submit(os.getpid)
        yield executor
    finally:
        for child in {*multiprocessing.active_children()} - before:
            child.terminate()
        executor.shutdown(cancel_futures=True)


def _begin(prepare: Callable[..., None] | None, given: tuple[object, ...]) -> None:
    """Prepare a process: an interrupt at the terminal is meant for its parent, with which it ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    assert parent is not None

    def follow() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=follow, daemon=True).start()
    if prepare is not None:
        prepare(*given)


@contextmanager
def interrupts_deferred() -> Iterator[None]:
    """Heed a Ctrl-C only at the end of the block."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    pressed: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, frame: pressed.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if pressed:
        signal.raise_signal(signal.SIGINT)


def collect_seldom() -> None:
    """Look for garbage seldom, and not again at the end: said first in a process that ends with its command.

    Loaded modules stay: to search them again and again takes a quarter of the time of loading them.
    """
    gc.set_threshold(50_000, 20, 100)
    atexit.register(gc.freeze)


def collect_often() -> None:
    """Look for garbage often, but not in what is loaded by now: said by a process that goes on for hours."""
    gc.freeze()
    gc.set_threshold(5_000, 10, 5)


def run_interruptibly(work: Callable[[], object]) -> None:
    """Do `work` beside the main thread, which waits for it and handles signals; what it raises is raised here.

    After an interrupt no caller waits. Compiled code cannot be ended from outside: its thread goes on until it is
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
