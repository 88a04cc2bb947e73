"""Flying a whole campaign: what is there already is kept, the rest is flown, and the table is made."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

from platform_ctrl.campaign import single_run
from platform_ctrl.campaign.identity import identity, versions
from platform_ctrl.campaign.single_run import Fly, kinds_of
from platform_ctrl.campaign.store import Record, opened
from platform_ctrl.campaign.table import DIVERGED, ENDED, NOT_FLOWN, arrow
from platform_ctrl.campaign.workers import Pieces, flown_by_processes
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.values import value
from platform_ctrl.errors import ArgumentError
from platform_ctrl.simulation.device import expect_device, processors

if TYPE_CHECKING:
    from platform_ctrl.campaign.plan import Plan

# Called with the number of runs that are kept, and of those that were not flown or diverged since the start.
Progress = Callable[[int, int], None]


@value
class Campaigned:
    """What a campaign came to.

    Attributes
    ----------
    table
        Path of the Parquet file: one row a run, in their order.
    record
        What ``campaign.json`` holds.
    """

    table: Path
    record: Record

    @property
    def counts(self) -> dict[str, int]:
        """Runs that ``completed``, ``diverged``, were ``not flown``; that ``passed``, and flown ones that did not."""
        return dict(self.record["counts"])

    @property
    def reasons(self) -> dict[str, int]:
        """Why runs were not flown, with how many each; the first twenty."""
        return dict(self.record["reasons"])

    @property
    def passed(self) -> bool:
        """Whether every run was flown and met all its limits."""
        return bool(self.counts["passed"] == self.record["runs"])


@check_arguments
def run_campaign(
    plan: Plan,
    folder: str | os.PathLike[str],
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    device: str = "cpu",
    restart: bool = False,
    progress: Progress | None = None,
    say: Callable[[str], None] = lambda line: None,
    fly: Fly = single_run.fly,
) -> Campaigned:
    """Fly all runs of a plan that are not in `folder` yet, and make the table of all.

    Killed at any moment and started again it goes on; the table is that of a campaign that nobody disturbed, whatever
    the number of workers. Runs that cannot be flown have a row that says why.

    Parameters
    ----------
    plan
        What is flown.
    folder
        Of ``campaign.parquet`` and ``campaign.json``; made if needed.
    workers
        Processes on this machine; default: as many as there are processors, one for a GPU.
    scheduler
        Address of a Dask scheduler, whose workers fly instead.
    device
        ``"cpu"`` or ``"cuda"``.
    restart
        Forget what is in `folder`.
    progress, say
        Called after each piece of runs, and with a line where something should be known.
    fly
        Flies runs as `flight.fly` does, its default; a function that worker processes can import.

    Returns
    -------
    Campaigned
        Where the table is, and the counts.

    Raises
    ------
    InputError
        `folder` holds another campaign or is in use, a file cannot be written, a package is missing, no scheduler.
    SimulationError
        Workers die again and again; what was flown is kept.
    ArgumentError
        `workers` or `device` make no sense.
    """
    if workers is not None and workers < 1:
        raise ArgumentError(f"workers: given {workers}; expected at least one")
    arrow()
    expect_device(device)
    crew = workers or (processors() if device == "cpu" else 1)
    about = {"job": plan.job.name, "platform": plan.job.platform.name}
    kinds = kinds_of(plan)
    with opened(Path(folder), identity(plan, device), about, plan.runs, versions(), kinds, restart) as store:
        pieces = Pieces(store.gaps, crew, device)
        amiss = 0
        if progress is not None:
            progress(store.done, amiss)
        if pieces.waiting:
            if scheduler is None:
                flying = flown_by_processes(plan, pieces, fly, workers=crew, device=device)
            else:
                from platform_ctrl.campaign.cluster import flown_by_cluster

                flying = flown_by_cluster(plan, pieces, fly, address=scheduler, device=device, say=say)
            with closing(flying):  # type: ignore[type-var]
                for runs, columns in flying:
                    store.write(runs, columns)
                    amiss += sum(str(one).startswith((NOT_FLOWN, DIVERGED)) for one in columns[ENDED])
                    if progress is not None:
                        progress(store.done, amiss)
        say("putting the runs in order")
        store.finish()
        return Campaigned(table=store.table, record=store.record)
