"""The limits that a job states, which the page edits: where they are in the job, in its file, and in the table."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, MutableMapping
from typing import Any

from platform_ctrl.analysis.metrics import COUPLED_METRICS
from platform_ctrl.job.budget import BudgetSpec
from platform_ctrl.job.job import Job, LoopSpec
from platform_ctrl.job.requirements import SCOPES, limit_keys
from platform_ctrl.verification.budget_result import LINE_OF_SIGHT, budget_requirements
from platform_ctrl.verification.coupled import ALL_LOOPS

# Number, in the units of the job file, by the name of the limit: "LOOP.limits.bandwidth_hz", "coupled.disk_margin".
Limits = Mapping[str, float]


def _name(*parts: str) -> str:
    return ".".join(parts)


def of_loop(limits: Limits, loop: str) -> Limits:
    """Return the limits and goals of a loop."""
    return {name: x for name, x in limits.items() if name.startswith((_name(loop, "limits."), _name(loop, "soft.")))}


def stated_limits(job: Job) -> dict[str, float]:
    """Return all limits that a job states."""
    tables: dict[str, Any] = {_name(one.name, of): getattr(one, of) for one in job.loops for of in ("limits", "soft")}
    tables["coupled"] = _fields(job.coupled)
    if job.budget is not None:
        tables["budget.limits"] = _fields(job.budget.limits)
        tables |= {_name("budget", one.name): {"limit": one.limit} for one in job.budget.sources}
    return {_name(table, key): float(x) for table, keys in tables.items() for key, x in keys.items() if x is not None}


def _fields(record: Any) -> dict[str, Any]:
    return {one.name: getattr(record, one.name) for one in dataclasses.fields(record)}


def with_limits(job: Job, limits: Limits) -> Job:
    """Return the job with other numbers of limits that it states."""

    def put(record: Any, table: str) -> Any:
        changes = {key: limits[_name(table, key)] for key in _fields(record) if _name(table, key) in limits}
        return dataclasses.replace(record, **changes) if changes else record

    loops = tuple(_limited(spec, limits) for spec in job.loops)
    budget = job.budget
    if budget is not None:
        sources = tuple(put(one, _name("budget", one.name)) for one in budget.sources)
        budget = dataclasses.replace(budget, limits=put(budget.limits, "budget.limits"), sources=sources)
    return dataclasses.replace(job, loops=loops, coupled=put(job.coupled, "coupled"), budget=budget)


def _limited(spec: LoopSpec, limits: Limits) -> LoopSpec:
    own, soft = ({key: limits[_name(spec.name, of, key)] for key in getattr(spec, of)} for of in ("limits", "soft"))
    return dataclasses.replace(spec, limits=own, soft=soft)


def put_into(document: Any, limits: Limits) -> None:
    """Write limits into the data of a job file."""
    tables: dict[str, MutableMapping[str, Any]] = {}
    for loop in document["loop"]:
        tables |= {_name(str(loop["name"]), of): loop.get(of, {}) for of in ("limits", "soft")}
    budget = document.get("budget", {})
    tables |= {"coupled": document.get("coupled", {}), "budget.limits": budget.get("limits", {})}
    tables |= {_name("budget", str(one["name"])): one for one in budget.get("source", ())}
    for table, keys in tables.items():
        for key in list(keys):
            if _name(table, key) in limits:
                keys[key] = number(limits[_name(table, key)])


def number(x: float) -> float:
    """Return a number as a file has it: whole ones without a point."""
    return int(x) if float(x).is_integer() and abs(x) < 1e15 else x


def limits_of_rows(job: Job) -> dict[tuple[str, str], str]:
    """Return the names of the limits of results, by the results' subject and name.

    What is not among them no job file states: that a loop has to be stable.
    """
    stated = stated_limits(job)
    return {row: name for row, name in _rows(job) if name in stated}


def _rows(job: Job) -> Iterator[tuple[tuple[str, str], str]]:
    keys = {of: key for key, of in limit_keys().items()}
    scopes = {over: scope for scope, over in SCOPES.items()}
    for spec in job.loops:
        for one in spec.requests:
            key = keys.get((one.kind, scopes[one.over]))
            if key is not None:
                yield (spec.name, one.name), _name(spec.name, "limits" if one.hard else "soft", key)
    for metric in COUPLED_METRICS.values():
        yield (ALL_LOOPS, metric.name), _name("coupled", metric.key)
    yield from _budget_rows(job.budget)


def _budget_rows(budget: BudgetSpec | None) -> Iterator[tuple[tuple[str, str], str]]:
    for (key, source), one in () if budget is None else budget_requirements(budget):
        yield (LINE_OF_SIGHT, one.name), _name("budget", source or "limits", key)
