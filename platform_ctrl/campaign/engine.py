"""Running a campaign: runs that are there already are kept, the others are simulated, and the table is made."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from platform_ctrl.campaign import single_run
from platform_ctrl.campaign.identity import identity
from platform_ctrl.campaign.single_run import SimulateRuns, kinds_of
from platform_ctrl.campaign.store import Record, Store
from platform_ctrl.campaign.table import DIVERGED, ENDED, NOT_SIMULATED
from platform_ctrl.campaign.workers import cluster, parts_of, processes_here, simulated
from platform_ctrl.common.processes import processors
from platform_ctrl.common.progress import shown_runs
from platform_ctrl.common.values import value
from platform_ctrl.errors import ArgumentError

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

    Killed at any moment and started again it goes on; the table is that of a campaign that nobody disturbed, whatever
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
    store = Store(Path(folder), identity(plan), about, plan.runs, kinds_of(plan), restart)
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
