"""Simulating runs of a plan: the columns that a campaign keeps of them, and one run again with all that it recorded."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from platform_ctrl.analysis.metrics import RUN_METRICS
from platform_ctrl.campaign.table import ENDED, NOT_SIMULATED, PASSED, RUN, Array, arrow
from platform_ctrl.errors import PlatformCtrlError
from platform_ctrl.plant.mistakes import one_line

if TYPE_CHECKING:
    from platform_ctrl.campaign.planning import Plan
    from platform_ctrl.job.scenario import Scenario
    from platform_ctrl.simulation.batch import BatchResult


def simulate_runs(plan: Plan, runs: Sequence[int], *, threads: int = 1, device: str = "cpu") -> dict[str, Array]:
    """Simulate runs of a plan and return their columns, each with one entry a run."""
    from platform_ctrl import simulation

    columns = inputs_of(plan, runs)
    scenarios = plan.scenarios_with(columns, runs)
    result = simulation.simulate_batch(
        scenarios, plan.controllers, period=plan.job.sampling.period, step=plan.step, threads=threads, device=device
    )
    return {**columns, **_outcomes(scenarios, result)}


def inputs_of(plan: Plan, runs: Sequence[int]) -> dict[str, Array]:
    """Return the columns ``run`` and inputs of some runs."""
    numbers = np.asarray(runs, dtype=np.int64)
    first, last = (int(numbers.min()), int(numbers.max()) + 1) if len(numbers) else (0, 0)
    inputs = plan.inputs(first, last)
    return {RUN: numbers, **{name: np.asarray(column)[numbers - first] for name, column in inputs.items()}}


def _outcomes(scenarios: Sequence[Scenario], result: BatchResult) -> dict[str, Array]:
    """What the runs came to, by the names of the columns."""
    done = result.completed
    largest = {name: getattr(result, name).max(axis=1, initial=0.0) for name in RUN_METRICS}
    metrics = {name: np.where(done, values, np.inf) for name, values in largest.items()}
    passed = done.copy()
    answers: dict[str, Array] = {}
    for name in RUN_METRICS:
        limits = np.array([one.limits.get(name, np.nan) for one in scenarios])
        asked = ~np.isnan(limits)
        met = metrics[name] <= np.where(asked, limits, np.inf)
        passed &= met | ~asked
        told = [bool(one) if wanted else None for one, wanted in zip(met, asked, strict=True)]
        answers[f"{name}_passed"] = np.array(told, dtype=object)
    return {
        **metrics,
        "stop_contacts": result.stop_contacts.sum(axis=1),
        "saturated": result.saturated.max(axis=1, initial=0) / np.maximum(result.samples, 1),
        **answers,
        PASSED: passed,
        ENDED: np.array(result.ended, dtype=object),
    }


Columns = dict[str, Array]
Kind = Literal["whole", "number", "answer", "word"]
# Simulates runs of a plan as `simulate_runs` does.
SimulateRuns = Callable[..., Columns]

_LONGEST = 200
_KINDS: dict[str, Kind] = {"i": "whole", "u": "whole", "f": "number", "b": "answer", "U": "word", "O": "word"}


def kinds_of(plan: Plan) -> dict[str, Kind]:
    """Return the kinds of all columns by their names, in the table's order."""
    inputs = {name: _KINDS[np.asarray(column).dtype.kind] for name, column in plan.inputs(0, 1).items()}
    metrics: dict[str, Kind] = dict.fromkeys(RUN_METRICS, "number")
    answers: dict[str, Kind] = {f"{name}_passed": "answer" for name in RUN_METRICS}
    rest: dict[str, Kind] = {"stop_contacts": "whole", "saturated": "number", **answers, PASSED: "answer"}
    return {RUN: "whole", **inputs, **metrics, **rest, ENDED: "word"}


def columns_of(
    plan: Plan, runs: Sequence[int], simulate: SimulateRuns, threads: int = 1, device: str = "cpu"
) -> Columns:
    """Return the columns of runs; a run that cannot be simulated has a row that says why."""
    try:
        return simulate(plan, runs, threads=threads, device=device)
    except Exception as error:
        if len(runs) > 1:
            middle = len(runs) // 2
            halves = [columns_of(plan, part, simulate, threads, device) for part in (runs[:middle], runs[middle:])]
            return {name: np.concatenate([half[name] for half in halves]) for name in halves[0]}
        return row_not_simulated(plan, runs[0], _reason(error))


def row_not_simulated(plan: Plan, run: int, why: str) -> Columns:
    """Return the row of a run that has its inputs, as far as they are known, and no outcome."""
    nothing = np.array([None], dtype=object)
    columns = dict.fromkeys(kinds_of(plan), nothing) | {RUN: np.array([run], dtype=np.int64)}
    with suppress(PlatformCtrlError):  # where the draws themselves are what cannot be made
        columns |= inputs_of(plan, [run])
    return columns | {ENDED: np.array([f"{NOT_SIMULATED}: {why}"], dtype=object)}


def _reason(error: Exception) -> str:
    text = one_line(" ".join(str(error).split()))
    title = "" if isinstance(error, PlatformCtrlError) else type(error).__name__ + (": " if text else "")
    return (title + text)[:_LONGEST]


def schema_of(kinds: Mapping[str, Kind], metadata: Mapping[str, str]) -> Any:
    """Return the Arrow schema; every column may hold nulls."""
    pa = arrow()
    types = {"whole": pa.int64(), "number": pa.float64(), "answer": pa.bool_(), "word": pa.string()}
    return pa.schema([(name, types[kind]) for name, kind in kinds.items()], metadata=dict(metadata))


def table_of(columns: Columns, schema: Any) -> Any:
    """Return columns as an Arrow table; a number that is no number is null."""
    pa = arrow()
    arrays = [pa.array(columns[field.name], type=field.type, from_pandas=True) for field in schema]
    return pa.Table.from_arrays(arrays, schema=schema)
