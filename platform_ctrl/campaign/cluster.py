"""Chunks of a campaign on a Dask cluster, whose scheduler distributes them and notices lost workers."""

from __future__ import annotations

import logging
import pickle
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from platform_ctrl.campaign.identity import versions
from platform_ctrl.campaign.single_run import SimulateRuns, columns_of, row_not_simulated
from platform_ctrl.campaign.table import Columns
from platform_ctrl.campaign.workers import DIED, Chunks
from platform_ctrl.errors import InputError, SimulationError

if TYPE_CHECKING:
    from platform_ctrl.campaign.planning import Plan

# Pieces for each thread of the cluster: one that is simulated, one that waits there already.
_AHEAD = 2
_TIMEOUT = 10.0
# How long a campaign waits for workers when there are none, s.
_PATIENCE = 300.0
# How often a chunk is sent again because of the network or a scheduler's whim, not because a worker died.
_RETRIES = 3


def columns_by_cluster(
    plan: Plan,
    chunks: Chunks,
    simulate: SimulateRuns,
    *,
    address: str,
    device: str = "cpu",
    say: Callable[[str], None] = print,
) -> Iterator[tuple[range, Columns]]:
    """Simulate all chunks on the workers of a Dask scheduler and yield them with their columns as they are done.

    The plan is sent once. A chunk whose workers died more often than the scheduler allows is divided and simulated
    again. The scheduler blames whatever a lost worker had, also what only waited there: a single run that is blamed is
    simulated again when nothing else is under way, and if it is blamed then, it is recorded as not simulated.
    """
    distributed = _distributed()
    client = _client(distributed, address)
    # That a scheduler has gone is told once, by the error.
    told = logging.getLogger("distributed.client")
    before = told.level
    told.setLevel(logging.CRITICAL)
    try:
        yield from _Cluster(distributed, client, plan, chunks, simulate, device, address, say).columns()
    finally:
        with suppress(Exception), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            client.close(timeout=_TIMEOUT)
        told.setLevel(before)


class _Cluster:
    """The chunks that are under way."""

    def __init__(
        self,
        distributed: Any,
        client: Any,
        plan: Plan,
        chunks: Chunks,
        simulate: SimulateRuns,
        device: str,
        address: str,
        say: Callable[[str], None],
    ) -> None:
        self._distributed, self._client, self._plan = distributed, client, plan
        self._chunks, self._simulate, self._device = chunks, simulate, device
        self._address, self._say = address, say
        self._under_way: dict[Any, range] = {}
        self._suspects: list[range] = []
        self._alone = False
        self._threads = 0
        self._looked = self._seen = float("-inf")

    def columns(self) -> Iterator[tuple[range, Columns]]:
        distributed = self._distributed
        self._look(first=True)
        # As the result of a task, so that the scheduler makes it anew when the workers that hold it are lost.
        plan = pickle.dumps(self._plan, pickle.HIGHEST_PROTOCOL)
        shared = self._client.submit(pickle.loads, plan, pure=False, retries=_RETRIES)
        while self._chunks.waiting or self._under_way or self._suspects:
            self._look()
            while (chunk := self._next()) is not None:
                arguments = (shared, chunk, self._simulate, self._device, versions())
                future = self._client.submit(_chunk_columns, *arguments, pure=False, retries=_RETRIES)
                self._under_way[future] = chunk
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
        """Return the chunk to be sent now, if any."""
        if self._chunks.waiting:
            self._alone = False
            return self._chunks.next() if len(self._under_way) < _AHEAD * self._threads else None
        if self._suspects and not self._under_way and self._threads:
            self._alone = True
            return self._suspects.pop()
        return None

    def _landed(self, future: Any, chunk: range) -> Iterator[tuple[range, Columns]]:
        if future.status == "cancelled":
            raise self._gone()
        error = future.exception() if future.status == "error" else None
        if isinstance(error, self._distributed.scheduler.KilledWorker):
            if len(chunk) > 1:
                self._chunks.died(chunk)
            elif not self._alone:
                self._suspects.append(chunk)
            else:
                yield chunk, row_not_simulated(self._plan, chunk.start, DIED)
        elif isinstance(error, InputError):
            raise error
        elif error is not None:
            reason = " ".join(f"{type(error).__name__}: {error}".split())
            raise SimulationError(
                f"--scheduler {self._address}: a worker cannot simulate: {reason}; the runs so far are kept, the same "
                "command goes on"
            )
        else:
            columns, seconds = future.result()
            self._chunks.finished(chunk, seconds)
            yield chunk, columns

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
        self._chunks.crew = max(self._threads, 1)
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


def _chunk_columns(
    plan: Plan, chunk: range, simulate: SimulateRuns, device: str, expected: dict[str, str]
) -> tuple[Columns, float]:
    """Simulate a chunk on a worker."""
    there = versions()
    for name, version in expected.items():
        if there[name] != version:
            raise InputError(
                f"a worker of the cluster has {name} {there[name]}, here it is {version}: install the same everywhere"
            )
    began = time.perf_counter()
    columns = columns_of(plan, chunk, simulate, 1, device)
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
            # Versions are compared by name before anything is simulated.
            warnings.simplefilter("ignore")
            # Judged first: a client that cannot make sense of its address leaves a traceback behind.
            distributed.comm.get_address_host_port(address)
            return distributed.Client(address, timeout=_TIMEOUT, set_as_default=False)
    except (OSError, OverflowError, ValueError, TimeoutError) as error:
        reason = " ".join(str(error).split()) or "no answer"
        raise InputError(
            f"--scheduler {address}: {reason}; give the address of a Dask scheduler, such as tcp://host:8786"
        ) from None
