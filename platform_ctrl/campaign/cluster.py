"""Flying pieces of a campaign on a Dask cluster. What is left to its scheduler: who flies what, and lost workers."""

from __future__ import annotations

import logging
import pickle
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from platform_ctrl.campaign.identity import versions
from platform_ctrl.campaign.single_run import Columns, Fly, flown, not_flown
from platform_ctrl.campaign.workers import DIED, Pieces
from platform_ctrl.errors import InputError, SimulationError

if TYPE_CHECKING:
    from platform_ctrl.campaign.plan import Plan

# Pieces for each thread of the cluster: one that is flown, one that waits there already.
_AHEAD = 2
_TIMEOUT = 10.0
# How long a campaign waits for workers when there are none, s.
_PATIENCE = 300.0
# How often a piece is sent again because of the network or a scheduler's whim, not because a worker died.
_RETRIES = 3


def flown_by_cluster(
    plan: Plan, pieces: Pieces, fly: Fly, *, address: str, device: str = "cpu", say: Callable[[str], None] = print
) -> Iterator[tuple[range, Columns]]:
    """Fly all pieces on the workers of a Dask scheduler and yield them with their columns as they are done.

    The plan is sent once. A piece whose workers died more often than the scheduler allows is flown again in parts. The
    scheduler blames whatever a lost worker had, also what only waited there: a single run that is blamed is flown again
    when nothing else is under way, and if it is blamed then, it is recorded as not flown.
    """
    distributed = _distributed()
    client = _client(distributed, address)
    # That a scheduler has gone is told once, by the error.
    told = logging.getLogger("distributed.client")
    before = told.level
    told.setLevel(logging.CRITICAL)
    try:
        yield from _Cluster(distributed, client, plan, pieces, fly, device, address, say).flown()
    finally:
        with suppress(Exception), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            client.close(timeout=_TIMEOUT)
        told.setLevel(before)


class _Cluster:
    """The pieces that are under way."""

    def __init__(
        self,
        distributed: Any,
        client: Any,
        plan: Plan,
        pieces: Pieces,
        fly: Fly,
        device: str,
        address: str,
        say: Callable[[str], None],
    ) -> None:
        self._distributed, self._client, self._plan = distributed, client, plan
        self._pieces, self._fly, self._device = pieces, fly, device
        self._address, self._say = address, say
        self._under_way: dict[Any, range] = {}
        self._suspects: list[range] = []
        self._alone = False
        self._threads = 0
        self._looked = self._seen = float("-inf")

    def flown(self) -> Iterator[tuple[range, Columns]]:
        distributed = self._distributed
        self._look(first=True)
        # As the result of a task, so that the scheduler makes it anew when the workers that hold it are lost.
        plan = pickle.dumps(self._plan, pickle.HIGHEST_PROTOCOL)
        shared = self._client.submit(pickle.loads, plan, pure=False, retries=_RETRIES)
        while self._pieces.waiting or self._under_way or self._suspects:
            self._look()
            while (piece := self._next()) is not None:
                arguments = (shared, piece, self._fly, self._device, versions())
                future = self._client.submit(_piece_flown, *arguments, pure=False, retries=_RETRIES)
                self._under_way[future] = piece
            if not self._under_way:
                time.sleep(0.2)
                continue
            try:
                with self._client.as_current():
                    done = distributed.wait(list(self._under_way), timeout=1.0, return_when="FIRST_COMPLETED").done
            except distributed.TimeoutError:
                continue
            except distributed.CancelledError:
                raise self._gone() from None
            for future in done:
                yield from self._landed(future, self._under_way.pop(future))

    def _next(self) -> range | None:
        """Return the piece to be sent now, if any."""
        if self._pieces.waiting:
            self._alone = False
            return self._pieces.next() if len(self._under_way) < _AHEAD * self._threads else None
        if self._suspects and not self._under_way and self._threads:
            self._alone = True
            return self._suspects.pop()
        return None

    def _landed(self, future: Any, piece: range) -> Iterator[tuple[range, Columns]]:
        if future.status == "cancelled":
            raise self._gone()
        error = future.exception() if future.status == "error" else None
        if isinstance(error, self._distributed.scheduler.KilledWorker):
            if len(piece) > 1:
                self._pieces.died(piece)
            elif not self._alone:
                self._suspects.append(piece)
            else:
                yield piece, not_flown(self._plan, piece.start, DIED)
        elif isinstance(error, InputError):
            raise error
        elif error is not None:
            reason = " ".join(f"{type(error).__name__}: {error}".split())
            raise SimulationError(
                f"--scheduler {self._address}: a worker cannot fly: {reason}; the runs so far are kept, the same "
                "command goes on"
            )
        else:
            columns, seconds = future.result()
            self._pieces.finished(piece, seconds)
            yield piece, columns

    def _look(self, first: bool = False) -> None:
        """Count the threads of the cluster, now and then: workers come and go."""
        now = time.monotonic()
        if now - self._looked < 1.0:
            return
        self._looked = now
        try:
            # Rarely long, even where the scheduler has just lost its workers.
            self._threads = sum(self._client.nthreads().values())
        except (OSError, self._distributed.TimeoutError):
            raise self._gone() from None
        self._pieces.crew = max(self._threads, 1)
        if self._threads or first:
            self._seen = now
        if not self._threads:
            self._say(f"no worker at {self._address}: waiting for one")
        if now - self._seen > _PATIENCE:
            raise SimulationError(
                f"--scheduler {self._address}: no worker for {_PATIENCE:.0f} s; the runs so far are kept, the same "
                "command goes on"
            )

    def _gone(self) -> SimulationError:
        return SimulationError(
            f"--scheduler {self._address}: the scheduler has gone; the runs so far are kept, the same command goes on"
        )


def _piece_flown(plan: Plan, piece: range, fly: Fly, device: str, expected: dict[str, str]) -> tuple[Columns, float]:
    """Fly a piece on a worker."""
    there = versions()
    for name, version in expected.items():
        if there[name] != version:
            raise InputError(
                f"a worker of the cluster has {name} {there[name]}, here it is {version}; expected the same everywhere"
            )
    began = time.perf_counter()
    columns = flown(plan, piece, fly, 1, device)
    return columns, time.perf_counter() - began


def _distributed() -> Any:
    try:
        import distributed
        import distributed.scheduler
    except ImportError:
        raise InputError("--scheduler: distributed is not installed: pip install 'platform_ctrl[cluster]'") from None
    return distributed


def _client(distributed: Any, address: str) -> Any:
    try:
        with warnings.catch_warnings():
            # Versions are compared by name before anything is flown.
            warnings.simplefilter("ignore")
            # Judged first: a client that cannot make sense of its address leaves a traceback behind.
            distributed.comm.get_address_host_port(address)
            return distributed.Client(address, timeout=_TIMEOUT, set_as_default=False)
    except (OSError, OverflowError, ValueError, TimeoutError) as error:
        reason = " ".join(str(error).split()) or "no answer"
        raise InputError(
            f"--scheduler {address}: {reason}; expected the address of a Dask scheduler, such as tcp://host:8786"
        ) from None
