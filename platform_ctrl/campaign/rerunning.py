"""One run of a campaign again: with everything that it recorded, held against its row in the table."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from platform_ctrl.campaign import single_run
from platform_ctrl.campaign.identity import identity, versions
from platform_ctrl.campaign.store import TABLE, Record, differences
from platform_ctrl.campaign.table import MANOEUVRE, RUN, arrow
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.values import value
from platform_ctrl.errors import InputError
from platform_ctrl.job.job import Job
from platform_ctrl.simulation import simulate
from platform_ctrl.verification.simulated import Run, judged

if TYPE_CHECKING:
    from platform_ctrl.campaign.planning import Plan

# Metrics of another machine's processor or a GPU agree to rounding.
_ROUNDING = 1e-6

Row = dict[str, Any]


@value
class Rerun:
    """A run of a campaign that was simulated again.

    Attributes
    ----------
    number
        Of the run, from 0.
    job
        The campaign's, its plant with what was drawn for this run.
    inputs
        What was drawn, by the names of the table's columns.
    metrics
        What the run came to, likewise.
    run
        With its trajectory and limits.
    """

    number: int
    job: Job
    inputs: Row
    metrics: Row
    run: Run


@check_arguments
def rerun(plan: Plan, number: int) -> Rerun:
    """Simulate one run of a plan again.

    Parameters
    ----------
    plan
        Of the campaign.
    number
        Of the run, from 0.

    Returns
    -------
    Rerun
        With its trajectory, and the row that it has in the table.

    Raises
    ------
    ArgumentError
        The plan has no such run, or it cannot be simulated.
    """
    inputs = plan.inputs(number, number + 1)
    scenario = plan.scenario(number)
    row = {name: _plain(column[0]) for name, column in single_run.simulate_runs(plan, [number]).items()}
    trajectory = simulate(scenario, plan.controllers, period=plan.job.sampling.period, step=plan.step)
    base = next(one for one in plan.job.manoeuvres if one.name == inputs[MANOEUVRE][0])
    manoeuvre = dataclasses.replace(base, duration=scenario.duration, limits=dict(scenario.limits))
    job = dataclasses.replace(plan.job, platform=scenario.platform)
    return Rerun(
        number=number,
        job=job,
        inputs={name: row[name] for name in inputs},
        metrics={name: item for name, item in row.items() if name not in inputs and name != RUN},
        run=Run(manoeuvre=manoeuvre, trajectory=trajectory, results=judged(job, manoeuvre, trajectory)),
    )


def recorded_row(folder: Path, number: int) -> Row | None:
    """Return a run's row in the table of a campaign's folder; None where there is no table, or none such in it."""
    path = folder / TABLE
    if not path.is_file():
        return None
    pa = arrow()
    try:
        rows = pa.parquet.read_table(path, filters=[(RUN, "==", number)]).to_pylist()
    except (OSError, pa.ArrowException) as error:
        raise InputError(f"{path}: cannot be read as Parquet: {str(error).splitlines()[0]}") from None
    return rows[0] if rows else None


def unlike(found: Rerun, row: Row) -> list[str]:
    """Return in words what is not the same in a run's row, beyond rounding."""
    out = []
    for name, now in {**found.inputs, **found.metrics}.items():
        before = row.get(name)
        if isinstance(before, float) and isinstance(now, float):
            same = math.isclose(before, now, rel_tol=_ROUNDING)
        else:
            same = before == now
        if not same:
            out.append(f"{name} {_words(now)}, there {_words(before)}")
    return out


def settings_of(record: Record | None) -> dict[str, Any]:
    """Return seed, sampling and number of runs of the campaign that a record is of, as `plan` takes them."""
    if record is None:
        return {}
    return {name: record["identity"][name] for name in ("seed", "sampling")} | {"runs": record["runs"]}


def changed_settings(record: Record, plan: Plan) -> list[str]:
    """Return in words what a recorded campaign follows from and a plan does not."""
    return differences(record, {"identity": identity(plan, record["identity"]["device"]), "versions": versions()})


def _plain(item: Any) -> Any:
    return item.item() if hasattr(item, "item") else item


def _words(item: object) -> str:
    return f"{item:.9g}" if isinstance(item, float) else str(item)
