"""Simulating runs of a plan: the columns that a campaign keeps of them, and one run again with all that it recorded."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from platform_ctrl.analysis.metrics import RUN_METRICS, over_limit, run_metrics
from platform_ctrl.analysis.system import StateSpace
from platform_ctrl.campaign import store
from platform_ctrl.common.values import value
from platform_ctrl.errors import PlatformCtrlError
from platform_ctrl.job.job import Job
from platform_ctrl.plant.mistakes import one_line
from platform_ctrl.simulation.batch import BatchResult, run_values, simulate_batch
from platform_ctrl.simulation.closed_loop import simulate

if TYPE_CHECKING:
    from platform_ctrl.campaign.planning import Plan
    from platform_ctrl.job.scenario import Scenario
    from platform_ctrl.verification.simulated import Run


def simulate_runs(plan: Plan, runs: Sequence[int]) -> dict[str, store.Array]:
    """Simulate runs of a plan and return their columns, each with one entry a run."""
    columns = inputs_of(plan, runs)
    scenarios = plan.scenarios_with(columns, runs)
    result = simulate_batch(scenarios, plan.controllers, period=plan.job.sampling.period, step=plan.step)
    return {**columns, **_outcomes(scenarios, result, metrics_of(plan))}


def inputs_of(plan: Plan, runs: Sequence[int]) -> dict[str, store.Array]:
    """Return the columns ``run`` and inputs of some runs."""
    numbers = np.asarray(runs, dtype=np.int64)
    first, last = (int(numbers.min()), int(numbers.max()) + 1) if len(numbers) else (0, 0)
    inputs = plan.inputs(first, last)
    return {store.RUN: numbers, **{name: np.asarray(column)[numbers - first] for name, column in inputs.items()}}


def metrics_of(plan: Plan) -> tuple[str, ...]:
    """Return the keys of the metrics that the table of a plan has."""
    return run_metrics(manoeuvre.limits for manoeuvre, _ in plan.job.campaign_manoeuvres)


def _outcomes(scenarios: Sequence[Scenario], result: BatchResult, names: Sequence[str]) -> dict[str, store.Array]:
    """Return the outcomes of runs, by the names of the columns."""
    metrics = {name: run_values(name, result, scenarios)[0] for name in names}
    passed = result.completed
    answers: dict[str, store.Array] = {}
    for name in names:
        limits = np.array([one.limits.get(name, np.nan) for one in scenarios])
        limited = ~np.isnan(limits)
        met = over_limit(metrics[name], limits, RUN_METRICS[name].sense) <= 1.0
        passed = passed & (met | ~limited)
        answers[f"{name}_passed"] = np.where(limited, met, np.array(None))
    return {
        **metrics,
        "stop_contacts": result.stop_contacts.sum(axis=1),
        "saturated": result.saturated.max(axis=1, initial=0) / np.maximum(result.samples, 1),
        **answers,
        store.PASSED: passed,
        store.ENDED: np.array(result.ended, dtype=object),
    }


# Simulates runs of a plan as `simulate_runs` does.
SimulateRuns = Callable[..., store.Columns]

_LONGEST = 200
# Arrow's names of types, by NumPy's kinds.
_TYPES = {"i": "int64", "u": "int64", "f": "float64", "b": "bool", "U": "string", "O": "string"}


def types_of(plan: Plan) -> dict[str, str]:
    """Return Arrow's names of the types of all columns by the columns' names, in the table's order."""
    inputs = {name: _TYPES[np.asarray(column).dtype.kind] for name, column in plan.inputs(0, 1).items()}
    metrics = dict.fromkeys(metrics_of(plan), "float64")
    answers = {f"{name}_passed": "bool" for name in metrics} | {store.PASSED: "bool"}
    outcomes = {**metrics, "stop_contacts": "int64", "saturated": "float64", **answers, store.ENDED: "string"}
    return {store.RUN: "int64", **inputs, **outcomes}


def columns_of(plan: Plan, runs: Sequence[int], simulate: SimulateRuns) -> store.Columns:
    """Return the columns of runs; a run that cannot be simulated has a row that says why."""
    try:
        return simulate(plan, runs)
    except Exception as error:
        if len(runs) > 1:
            middle = len(runs) // 2
            halves = [columns_of(plan, part, simulate) for part in (runs[:middle], runs[middle:])]
            return {name: np.concatenate([half[name] for half in halves]) for name in halves[0]}
        text = one_line(" ".join(str(error).split()))
        title = "" if isinstance(error, PlatformCtrlError) else type(error).__name__ + (": " if text else "")
        return row_not_simulated(plan, runs[0], (title + text)[:_LONGEST])


def row_not_simulated(plan: Plan, run: int, why: str) -> store.Columns:
    """Return the row of a run that has its inputs, as far as they are known, and no outcome."""
    nothing = np.array([None], dtype=object)
    columns = dict.fromkeys(types_of(plan), nothing) | {store.RUN: np.array([run], dtype=np.int64)}
    with suppress(PlatformCtrlError):  # where the draws themselves are what cannot be made
        columns |= inputs_of(plan, [run])
    return columns | {store.ENDED: np.array([f"{store.NOT_SIMULATED}: {why}"], dtype=object)}


# Metrics of another machine's processor agree to rounding.
ROUNDING = 1e-6

Row = dict[str, Any]


@value
class Rerun:
    """A run of a campaign that was simulated again."""

    number: int  # from 0
    job: Job  # the campaign's, its plant with what was drawn for this run
    inputs: Row  # what was drawn, by the names of the table's columns
    metrics: Row  # the other columns
    run: Run  # with its trajectory and limits


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
    from platform_ctrl.verification.simulated import run_of

    scenario, inputs = plan.scenario(number), plan.inputs(number, number + 1)
    trajectory = simulate(scenario, plan.controllers, period=plan.job.sampling.period, step=plan.step)
    outcomes = _outcomes([scenario], trajectory.metrics, metrics_of(plan))
    base = next(one for one in plan.job.manoeuvres if one.name == inputs[store.MANOEUVRE][0])
    manoeuvre = dataclasses.replace(base, duration=scenario.duration, limits=dict(scenario.limits))
    job = dataclasses.replace(plan.job, platform=scenario.platform)
    inputs, metrics = ({name: _plain(column[0]) for name, column in part.items()} for part in (inputs, outcomes))
    return Rerun(number=number, job=job, inputs=inputs, metrics=metrics, run=run_of(job, manoeuvre, trajectory))


def recorded_row(folder: Path, number: int) -> Row | None:
    """Return a run's row in the table of a campaign's folder; None where there is no table, or none such in it."""
    path = folder / store.TABLE
    if not path.exists():
        return None
    rows: list[Row] = store.read_rows(path, number).to_pylist()
    return rows[0] if rows else None


def unlike(found: Rerun, row: Row) -> list[str]:
    """Return in words what is not the same in a run's row, beyond rounding."""
    out = []
    for name, now in {**found.inputs, **found.metrics}.items():
        before = row.get(name)
        if isinstance(before, float) and isinstance(now, float):
            same = math.isclose(before, now, rel_tol=ROUNDING)
        else:
            same = before == now
        if not same:
            out.append(f"{name} {_words(now)}, there {_words(before)}")
    return out


def recorded_plan(job: Job, controllers: Sequence[StateSpace], record: store.Record | None) -> tuple[Plan, list[str]]:
    """Return the plan of a recorded campaign for the present job, and in words what has changed since."""
    from platform_ctrl.campaign.planning import plan

    if record is None:
        return plan(job, controllers), []
    before = record["identity"]
    made = plan(job, controllers, runs=record["runs"], seed=before["seed"], sampling=before["sampling"])
    return made, store.differences(before, store.identity(made))


def _plain(item: Any) -> Any:
    return item.item() if hasattr(item, "item") else item


def _words(item: object) -> str:
    return f"{item:.9g}" if isinstance(item, float) else str(item)
