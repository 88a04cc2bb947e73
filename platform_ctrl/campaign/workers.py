"""Simulating a campaign's runs in chunks: in processes of this machine that may die alone, or on a Dask cluster."""

from __future__ import annotations

import logging
import pickle
import time
import warnings
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any

from platform_ctrl.campaign.identity import versions
from platform_ctrl.campaign.single_run import SimulateRuns, columns_of, row_not_simulated
from platform_ctrl.campaign.table import Columns
from platform_ctrl.common.processes import Started, TaskProcess, next_result
from platform_ctrl.errors import InputError, SimulationError

if TYPE_CHECKING:
    from platform_ctrl.campaign.planning import Plan

# Runs that the kernel computes side by side, as in `platform_ctrl.common.simd`, which would load numba: a chunk of
# fewer costs as much.
LANES = 8
# Most runs of a chunk.
_LARGEST = 4096
# How long a chunk should take, s.
SECONDS = 1.0
# A chunk whose worker died is simulated again in so many parts, until the run that it died of is alone.
_PARTS = 8
# A run that was alone when its worker died may have been unlucky: memory was short, somebody stopped the machine.
_CHANCES = 2


class Chunks:
    """The runs that are still to be simulated, in chunks of a fitting size.

    Parameters
    ----------
    gaps
        Missing runs, in order.
    crew
        How many chunks are simulated at a time.
    """

    def __init__(self, gaps: Iterable[range], crew: int) -> None:
        self._gaps = deque(gap for gap in gaps if gap)
        self._again: deque[range] = deque()
        self._deaths: dict[int, int] = {}
        self._size = LANES
        self.crew = crew

    @property
    def waiting(self) -> bool:
        """Whether runs wait for a worker."""
        return bool(self._gaps or self._again)

    @property
    def most(self) -> int:
        """How many workers the waiting runs could occupy at most."""
        return len(self._again) + sum(-(-len(gap) // LANES) for gap in self._gaps)

    def next(self) -> range | None:
        """Return the next chunk, or None."""
        if self._again:
            return self._again.popleft()
        if not self._gaps:
            return None
        gap = self._gaps.popleft()
        # Toward the end smaller ones, so that no worker waits long for the last; lanes stay full.
        share = max(sum(map(len, (gap, *self._gaps))) // (2 * self.crew), self._size // _PARTS)
        size = max(LANES, min(self._size, -(-share // LANES) * LANES))
        stop = min(gap.stop, gap.start // LANES * LANES + size)
        if stop < gap.stop:
            self._gaps.appendleft(range(stop, gap.stop))
        return range(gap.start, stop)

    def finished(self, chunk: range, seconds: float) -> None:
        """Learn from a chunk that took so long how large the next ones should be."""
        wanted = SECONDS * len(chunk) / max(seconds, 1e-6)
        self._size = int(max(LANES, min(wanted // LANES * LANES, 2 * self._size, _LARGEST)))

    def died(self, chunk: range) -> int | None:
        """Take back the chunk of a worker that died; return the run that it died of once that is known."""
        if len(chunk) == 1:
            run = chunk.start
            self._deaths[run] = self._deaths.get(run, 0) + 1
            if self._deaths[run] >= _CHANCES:
                del self._deaths[run]
                return run
        length = -(-len(chunk) // _PARTS)
        self._again.extend(chunk[k : k + length] for k in range(0, len(chunk), length))
        return None


DIED = "worker died"
# Deaths without a run finished in between: not the runs' fault.
_MAX_DEATHS = 24


def columns_by_processes(
    plan: Plan, chunks: Chunks, simulate: SimulateRuns, *, workers: int
) -> Iterator[tuple[range, Columns]]:
    """Simulate all chunks in `workers` processes and yield them with their columns as they are done, in any order.

    The first chunk is simulated alone: a kernel that has to be compiled is compiled once. A worker that dies is
    replaced, its chunk is divided and simulated again; a run that workers die of is recorded as not simulated.
    """
    crew = _Crew(plan, chunks, simulate, workers)
    try:
        while crew.assign():
            process, result = next_result(crew.results)
            if result is None:
                yield from crew.replace(process)
            elif isinstance(result, Started):
                crew.starting.remove(process)
                crew.busy[process] = None
            else:
                yield crew.finish(process, *result)
    finally:
        for process in (*crew.starting, *crew.busy):
            process.end()


class _Crew:
    """Processes that are starting, and those that run with the chunk that each works on."""

    def __init__(self, plan: Plan, chunks: Chunks, simulate: SimulateRuns, workers: int) -> None:
        self.results: SimpleQueue[tuple[TaskProcess, Any]] = SimpleQueue()
        self.starting: list[TaskProcess] = []
        self.busy: dict[TaskProcess, range | None] = {}
        self._plan, self._chunks, self._workers = plan, chunks, workers
        self._arguments = (_timed_columns, plan, simulate)
        self._deaths, self._warm = 0, False

    def assign(self) -> bool:
        """Give idle processes chunks and start as many processes as there is work for; False when all is done."""
        for process, chunk in self.busy.items():
            if chunk is None:
                self._next(process)
        working = sum(chunk is not None for chunk in self.busy.values())
        if not self._chunks.waiting and not working:
            return False
        wanted = min(self._workers if self._warm else 1, working + self._chunks.most)
        while len(self.starting) + len(self.busy) < wanted:
            self.starting.append(TaskProcess(*self._arguments, results=self.results, stderr=None))
        return True

    def _next(self, process: TaskProcess) -> None:
        self.busy[process] = chunk = self._chunks.next()
        if chunk is not None:
            process.send(chunk)

    def finish(self, process: TaskProcess, columns: Columns, seconds: float) -> tuple[range, Columns]:
        """Return the chunk that a process has done; it works on the next one while its columns are written."""
        chunk = self.busy[process]
        assert chunk is not None
        if self._warm:
            self._chunks.finished(chunk, seconds)
        self._deaths, self._warm = 0, True
        self._next(process)
        return chunk, columns

    def replace(self, process: TaskProcess) -> Iterator[tuple[range, Columns]]:
        """Take the chunk of a process that died back; yield the row of a run that workers die of."""
        code = process.exit_code()
        started, chunk = process in self.busy, self.busy.pop(process, None)
        if not started:
            self.starting.remove(process)
        if not started and not self._warm and code >= 0:
            raise SimulationError(f"a worker process ended before it began (exit code {code})")
        self._deaths += 1
        if self._deaths >= _MAX_DEATHS:
            raise SimulationError(
                f"{self._deaths} worker processes died without a run finished in between (exit code {code}); is there "
                "memory enough? Fewer --workers need less. The runs so far are kept, the same command goes on"
            )
        run = None if chunk is None else self._chunks.died(chunk)
        if run is not None:
            yield range(run, run + 1), row_not_simulated(self._plan, run, DIED)


def _timed_columns(plan: Plan, simulate: SimulateRuns, chunk: range) -> tuple[Columns, float]:
    """Return the columns of a chunk and how long it took, s; in a worker."""
    began = time.perf_counter()
    return columns_of(plan, chunk, simulate), time.perf_counter() - began


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
    say: Callable[[str], None] = print,
) -> Iterator[tuple[range, Columns]]:
    """Simulate all chunks on the workers of a Dask scheduler and yield them with their columns as they are done.

    The plan is sent once. A chunk whose workers died more often than the scheduler allows is divided and simulated
    again. The scheduler blames whatever a lost worker had, also what only waited there: a single run that is blamed is
    simulated again when nothing else is under way, and if it is blamed then, it is recorded as not simulated.
    """
    distributed = _distributed()
    client = _client(distributed, address)
    # That a scheduler has gone is reported once, by the error.
    log = logging.getLogger("distributed.client")
    before = log.level
    log.setLevel(logging.CRITICAL)
    try:
        yield from _Cluster(distributed, client, plan, chunks, simulate, address, say).columns()
    finally:
        with suppress(Exception), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            client.close(timeout=_TIMEOUT)
        log.setLevel(before)


class _Cluster:
    """The chunks that are under way."""

    def __init__(
        self,
        distributed: Any,
        client: Any,
        plan: Plan,
        chunks: Chunks,
        simulate: SimulateRuns,
        address: str,
        say: Callable[[str], None],
    ) -> None:
        self._distributed, self._client, self._plan = distributed, client, plan
        self._chunks, self._simulate = chunks, simulate
        self._address, self._say = address, say
        self._under_way: dict[Any, range] = {}
        self._suspects: list[range] = []
        self._alone = False
        self._threads = 0
        self._looked = self._seen = float("-inf")

    def columns(self) -> Iterator[tuple[range, Columns]]:
        distributed = self._distributed
        self._look(first=True)
        # As the result of a task, so that the scheduler makes it again when its workers are lost.
        plan = pickle.dumps(self._plan, pickle.HIGHEST_PROTOCOL)
        shared = self._client.submit(pickle.loads, plan, pure=False, retries=_RETRIES)
        while self._chunks.waiting or self._under_way or self._suspects:
            self._look()
            while (chunk := self._next()) is not None:
                arguments = (shared, chunk, self._simulate, versions())
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


def _chunk_columns(plan: Plan, chunk: range, simulate: SimulateRuns, expected: dict[str, str]) -> tuple[Columns, float]:
    """Simulate a chunk on a worker."""
    there = versions()
    for name, version in expected.items():
        if there[name] != version:
            raise InputError(
                f"a worker of the cluster has {name} {there[name]}, here it is {version}: install the same everywhere"
            )
    began = time.perf_counter()
    columns = columns_of(plan, chunk, simulate)
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
            # Checked first: a client with an invalid address prints a traceback.
            distributed.comm.get_address_host_port(address)
            return distributed.Client(address, timeout=_TIMEOUT, set_as_default=False)
    except (OSError, OverflowError, ValueError, TimeoutError) as error:
        reason = " ".join(str(error).split()) or "no answer"
        raise InputError(
            f"--scheduler {address}: {reason}; give the address of a Dask scheduler, such as tcp://host:8786"
        ) from None
