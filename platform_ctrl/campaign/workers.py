"""Flying pieces of a campaign on processes of this machine: each has a pipe of its own, so that it may die alone."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import threading
import time
from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection, wait
from typing import TYPE_CHECKING

from platform_ctrl.campaign.single_run import Columns, Fly, flown, not_flown
from platform_ctrl.errors import SimulationError
from platform_ctrl.simulation.device import processors

if TYPE_CHECKING:
    from platform_ctrl.campaign.plan import Plan

# Runs that the kernel computes side by side, as in `platform_ctrl.common.simd`, which would load numba: a piece of
# fewer costs as much.
LANES = 8
# Smallest and largest piece by device: a GPU wants many runs at once.
SIZES = {"cpu": (LANES, 4096), "cuda": (1 << 12, 1 << 17)}
SECONDS = 1.0
# A piece whose worker died is flown again in so many parts, until the run that it died of is alone.
_PARTS = 8
# A run that was alone when its worker died may have been unlucky: memory was short, somebody stopped the machine.
_CHANCES = 2


class Pieces:
    """The runs that are still to be flown, cut to size.

    Parameters
    ----------
    gaps
        Runs to be flown, in order.
    crew
        How many pieces are flown at a time.
    device
        ``"cpu"`` or ``"cuda"``.
    """

    def __init__(self, gaps: Iterable[range], crew: int, device: str = "cpu") -> None:
        self._gaps = deque(gap for gap in gaps if gap)
        self._again: deque[range] = deque()
        self._deaths: dict[int, int] = {}
        self._smallest, self._largest = SIZES[device]
        self._size = self._smallest
        self.crew = crew

    @property
    def waiting(self) -> bool:
        """Whether runs wait for a worker."""
        return bool(self._gaps or self._again)

    @property
    def most(self) -> int:
        """How many workers the waiting runs could occupy at most."""
        return len(self._again) + sum(-(-len(gap) // self._smallest) for gap in self._gaps)

    def next(self) -> range | None:
        """Return the next piece, or None."""
        if self._again:
            return self._again.popleft()
        if not self._gaps:
            return None
        gap = self._gaps.popleft()
        # Toward the end smaller ones, so that no worker waits long for the last; lanes stay full.
        share = max(sum(map(len, (gap, *self._gaps))) // (2 * self.crew), self._size // _PARTS)
        size = max(self._smallest, min(self._size, -(-share // LANES) * LANES))
        stop = min(gap.stop, gap.start // LANES * LANES + size)
        if stop < gap.stop:
            self._gaps.appendleft(range(stop, gap.stop))
        return range(gap.start, stop)

    def finished(self, piece: range, seconds: float) -> None:
        """Learn from a piece that took so long how large the next ones should be."""
        wanted = SECONDS * len(piece) / max(seconds, 1e-6)
        self._size = int(max(self._smallest, min(wanted // LANES * LANES, 2 * self._size, self._largest)))

    def died(self, piece: range) -> int | None:
        """Take back the piece of a worker that died; return the run that it died of once that is known."""
        if len(piece) == 1:
            run = piece.start
            self._deaths[run] = self._deaths.get(run, 0) + 1
            if self._deaths[run] >= _CHANCES:
                del self._deaths[run]
                return run
        length = -(-len(piece) // _PARTS)
        self._again.extend(piece[k : k + length] for k in range(0, len(piece), length))
        return None


DIED = "worker died"
# Deaths without a run finished in between: not the runs' fault.
_DEATHS = 24
# How long a process may take from closing its pipe to its end, s.
_FAREWELL = 5.0


def flown_by_processes(
    plan: Plan, pieces: Pieces, fly: Fly, *, workers: int, device: str = "cpu"
) -> Iterator[tuple[range, Columns]]:
    """Fly all pieces on `workers` processes and yield them with their columns as they are done, in any order.

    The first piece is flown alone: a kernel that has to be compiled is compiled once. A worker that dies is replaced,
    its piece is flown again in parts; a run that workers die of is given up and recorded as not flown.
    """
    parcel = pickle.dumps(plan, pickle.HIGHEST_PROTOCOL)
    context = multiprocessing.get_context("spawn")
    crew: dict[Connection, _Worker] = {}
    deaths, warm = 0, False
    threads = processors() if device == "cuda" else 1

    try:
        while True:
            for worker in crew.values():
                piece = pieces.next() if worker.idle else None
                if piece is not None:
                    worker.send(piece)
            busy = sum(worker.piece is not None for worker in crew.values())
            if not pieces.waiting and not busy:
                return
            while len(crew) < min(workers if warm else 1, busy + pieces.most):
                worker = _Worker(context, parcel, fly, threads, device)
                crew[worker.connection] = worker
            for connection in wait(list(crew)):
                worker = crew[connection]  # type: ignore[index]
                try:
                    message = worker.connection.recv()
                except (EOFError, OSError):
                    del crew[worker.connection]
                    worker.process.join(_FAREWELL)
                    worker.kill()
                    killed = (worker.process.exitcode or 0) < 0
                    if not worker.ready and not warm and not killed:
                        raise SimulationError(
                            f"a worker process ended before it began (exit code {worker.process.exitcode}); a script "
                            'that starts a campaign must do so under if __name__ == "__main__"'
                        ) from None
                    deaths += 1
                    if deaths >= _DEATHS:
                        raise SimulationError(
                            f"{deaths} worker processes died without a run finished in between (exit code "
                            f"{worker.process.exitcode}); is there memory enough? Fewer --workers need less. The runs "
                            "so far are kept, the same command goes on"
                        ) from None
                    if worker.piece is not None:
                        run = pieces.died(worker.piece)
                        if run is not None:
                            yield range(run, run + 1), not_flown(plan, run, DIED)
                    continue
                if message is None:
                    worker.ready = True
                    continue
                piece, worker.piece = worker.piece, None
                if piece is None:
                    continue
                columns, seconds = message
                if warm:
                    pieces.finished(piece, seconds)
                deaths, warm = 0, True
                following = pieces.next()
                if following is not None:
                    worker.send(following)  # it flies while what it brought is written
                yield piece, columns
    finally:
        for worker in crew.values():
            worker.kill()


class _Worker:
    """A process, the pipe to it, and the piece that it flies."""

    def __init__(
        self, context: multiprocessing.context.SpawnContext, parcel: bytes, fly: Fly, threads: int, device: str
    ) -> None:
        self.connection, its = context.Pipe()
        self.process = context.Process(target=_work, args=(its, parcel, fly, threads, device), daemon=True)
        with _no_interrupt():
            self.process.start()
        its.close()
        self.ready = False
        self.piece: range | None = None

    @property
    def idle(self) -> bool:
        return self.ready and self.piece is None

    def send(self, piece: range) -> None:
        self.piece = piece
        with suppress(OSError):  # that it has gone is seen when it is listened to
            self.connection.send(piece)

    def kill(self) -> None:
        self.process.kill()
        self.process.join()
        self.connection.close()


@contextmanager
def _no_interrupt() -> Iterator[None]:
    """Start a process that never sees a Ctrl-C, meant for this one: the mask of signals is inherited."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _work(connection: Connection, parcel: bytes, fly: Fly, threads: int, device: str) -> None:
    """Fly pieces until the campaign's process has gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    plan = pickle.loads(parcel)
    with suppress(EOFError, OSError):
        connection.send(None)
        while True:
            piece = connection.recv()
            began = time.perf_counter()
            columns = flown(plan, piece, fly, threads, device)
            connection.send((columns, time.perf_counter() - began))


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
