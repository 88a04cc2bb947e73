"""Running a campaign: runs that are there already are kept, the others are simulated, and the table is made.

Runs are simulated in parts, in processes of this machine or on the workers of a Dask cluster.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from contextlib import closing, contextmanager
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

from platform_ctrl.campaign import single_run
from platform_ctrl.campaign.single_run import SimulateRuns, columns_of, row_not_simulated, types_of
from platform_ctrl.campaign.store import DIVERGED, ENDED, NOT_SIMULATED, Columns, Record, Store, identity, run_versions
from platform_ctrl.common.processes import processes, processors
from platform_ctrl.common.progress import shown_runs
from platform_ctrl.common.values import value
from platform_ctrl.errors import ArgumentError, InputError, PlatformCtrlError, SimulationError

if TYPE_CHECKING:
    from platform_ctrl.campaign.planning import Plan

# Called with the number of runs that are kept, and of those that were not simulated or diverged since the start.
RunsProgress = Callable[[int, int], None]


@value
class CampaignResult:
    """The result of a campaign."""

    table: Path  # of the folder of Parquet files: one row a run, in their order
    record: Record  # content of campaign.json

    @property
    def counts(self) -> dict[str, int]:
        """Numbers of runs by outcome: ``completed``, ``diverged``, ``not simulated``, ``passed``, ``not passed``."""
        return dict(self.record["counts"])

    @property
    def reasons(self) -> dict[str, int]:
        """Why runs were not simulated, with how many each; the first twenty."""
        return dict(self.record["reasons"])

    @property
    def passed(self) -> bool:
        """Whether every run was simulated and met all its limits."""
        return bool(self.counts["passed"] == self.record["runs"])


def run_campaign(
    plan: Plan,
    folder: str | os.PathLike[str],
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    restart: bool = False,
    progress: RunsProgress | bool | None = None,
    simulate: SimulateRuns = single_run.simulate_runs,
) -> CampaignResult:
    """Simulate all runs of a plan that are not in `folder` yet.

    Killed at any moment and started again it goes on; the table is that of a campaign without interruption, whatever
    the number of workers. Runs that cannot be simulated have a row that says why.

    Parameters
    ----------
    plan
        What is simulated.
    folder
        Of ``campaign.parquet``, a folder with the parts of the table, and ``campaign.json``; made if needed.
    workers
        Processes on this machine; default: as many as there are processors.
    scheduler
        Address of a Dask scheduler, whose workers simulate instead.
    restart
        Forget what is in `folder`.
    progress
        Called after each part with the numbers of runs that are done and that failed; True shows a bar, in a notebook
        or on a terminal.
    simulate
        Simulates runs as `single_run.simulate_runs` does, its default; a function that worker processes can import.

    Returns
    -------
    CampaignResult
        Where the table is, and the counts.

    Raises
    ------
    InputError
        `folder` holds another campaign, a file cannot be written, a package is missing, no scheduler.
    SimulationError
        Workers die again and again; what was simulated is kept.
    ArgumentError
        `workers` is below one.
    """
    if workers is not None and workers < 1:
        raise ArgumentError(f"workers must be at least one, got {workers}")
    about = {"job": plan.job.name, "platform": plan.job.platform.name}
    store = Store(Path(folder), identity(plan), about, plan.runs, types_of(plan), restart)
    pool = partial(cluster, scheduler) if scheduler is not None else partial(processes_here, workers or processors())
    failed = 0
    with (
        shown_runs(progress, plan.runs) as tick,
        closing(simulated(plan, parts_of(store.gaps, plan.runs), simulate, pool)) as batches,
    ):
        tick(store.done, failed)
        for runs, columns in batches:
            store.write(runs, columns)
            failed += sum(str(one).startswith((NOT_SIMULATED, DIVERGED)) for one in columns[ENDED])
            tick(store.done, failed)
    store.finish()
    return CampaignResult(table=store.table, record=store.record)


# Runs of a part: at least as many as the kernel computes side by side, and what is lost when a campaign is stopped.
_FEWEST, _MOST = 8, 4096
# Parts of a campaign, unless they would be longer or shorter.
_PARTS = 256
# A part during which a worker died is repeated alone, and divided into so many where it dies again.
_DIVIDED = 8
# Parts for each worker: one that is simulated, one that waits there already.
_AHEAD = 2
# Workers that die without a part finished in between: their machine is the cause, not the runs.
_MOST_DEATHS = 24
DIED = "worker died"
_TIMEOUT = 10.0

# Makes an executor with its number of workers; it is called again where the one before is broken.
Pool = Callable[[], Any]


def parts_of(gaps: Iterable[range], runs: int) -> list[range]:
    """Return the missing runs of a campaign in parts; their ends are the same whichever are missing."""
    size = max(_FEWEST, min(_MOST, -(-runs // _PARTS // _FEWEST) * _FEWEST))
    out = []
    for gap in gaps:
        ends = [gap.start, *range((gap.start // size + 1) * size, gap.stop, size), gap.stop]
        out += [range(start, stop) for start, stop in pairwise(ends)]
    return out


def simulated(
    plan: Plan, parts: Iterable[range], simulate: SimulateRuns, pool: Pool
) -> Generator[tuple[range, Columns], None, None]:
    """Simulate all parts and yield them with their columns as they are done, in any order.

    The first part is simulated alone: a kernel that has to be compiled is compiled once. Where a worker dies the pool
    is made again; the parts that were open are repeated one by one, and divided until the run that workers die of is
    alone: it is recorded as not simulated.
    """
    waiting, suspects = deque(parts), deque[range]()
    expected, deaths, warm = run_versions(), 0, False
    while waiting or suspects:
        with pool() as (executor, workers, lost):
            under_way: dict[Future[Columns], range] = {}
            repeated = bool(suspects)
            try:
                while under_way or suspects or (waiting and not repeated):
                    most = _AHEAD * workers if warm and not repeated else 1
                    while len(under_way) < most and (source := suspects if repeated else waiting):
                        part = source.popleft()
                        under_way[executor.submit(_columns, plan, part, simulate, expected)] = part
                    for future in wait(under_way, return_when=FIRST_COMPLETED).done:
                        columns = future.result()
                        part, deaths, warm = under_way.pop(future), 0, True
                        yield part, columns
            except lost:
                deaths += 1
                if deaths >= _MOST_DEATHS:
                    raise SimulationError(
                        f"{deaths} workers died without a run finished in between; is there memory enough? Fewer "
                        "--workers need less. The runs so far are kept, the same command goes on"
                    ) from None
                part, *others = under_way.values()
                if repeated and len(part) == 1:
                    yield part, row_not_simulated(plan, part.start, DIED)
                elif repeated:
                    length = -(-len(part) // _DIVIDED)
                    suspects.extendleft(part[k : k + length] for k in range(0, len(part), length))
                else:
                    suspects.extend((part, *others))


def _columns(plan: Plan, part: range, simulate: SimulateRuns, expected: Mapping[str, str]) -> Columns:
    """Return the columns of a part; in a worker."""
    for name, version in run_versions().items():
        if expected[name] != version:
            raise InputError(
                f"a worker of the cluster has {name} {version}, here it is {expected[name]}: install the same "
                "everywhere"
            )
    return columns_of(plan, part, simulate)


@contextmanager
def processes_here(workers: int) -> Iterator[tuple[Executor, int, tuple[type[BaseException], ...]]]:
    """Yield an executor of processes on this machine."""
    with processes(workers) as executor:
        yield executor, workers, (BrokenExecutor,)


def client_of(address: str) -> Any:
    """Return a client of a Dask scheduler."""
    try:
        import distributed
    except ImportError:
        raise InputError("--scheduler: distributed is not installed: pip install 'platform_ctrl[cluster]'") from None
    try:
        # Checked first: a client with an invalid address prints a traceback.
        distributed.comm.get_address_host_port(address)
        return distributed.Client(address, timeout=_TIMEOUT, set_as_default=False)
    except (OSError, OverflowError, ValueError, TimeoutError) as error:
        reason = " ".join(str(error).split()) or "no answer"
        raise InputError(
            f"--scheduler {address}: {reason}; give the address of a Dask scheduler, such as tcp://host:8786"
        ) from None


@contextmanager
def cluster(address: str) -> Iterator[tuple[Executor, int, tuple[type[BaseException], ...]]]:
    """Yield an executor of the workers of a Dask scheduler."""
    with client_of(address) as client:
        import distributed
        import distributed.scheduler

        try:
            executor = client.get_executor(pure=False, retries=1)
            yield executor, max(sum(client.nthreads().values()), 1), (distributed.scheduler.KilledWorker,)
        except PlatformCtrlError:
            raise
        except (distributed.CancelledError, OSError):
            raise SimulationError(
                f"--scheduler {address}: the scheduler has gone; the runs so far are kept, the same command goes on"
            ) from None
        except Exception as error:
            reason = " ".join(f"{type(error).__name__}: {error}".split())
            raise SimulationError(f"--scheduler {address}: a worker cannot simulate: {reason}") from None
