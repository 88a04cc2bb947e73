"""The result of a campaign in one value, from which its page, its terminal tables and campaign.json are made.

With causes that violating runs have in common and drivers of each requirement, from the runs that exist.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.campaign import statistics as counted
from platform_ctrl.campaign import store
from platform_ctrl.campaign.planning import Plan
from platform_ctrl.common.files import plain_types
from platform_ctrl.common.values import FloatArray, value

# A number with more values than this, or with about one for each run, is divided into thirds.
_MOST_LEVELS = 12
# Ranks of so many runs, the first ones of the table, are correlated: more show nothing else.
_RANKED = 1 << 16

Level = bool | float | str


@value
class Influence:
    """The influence of an input on a requirement.

    Attributes
    ----------
    requirement
        Name of the limit, or ``"passed"``: whether a run violates anything at all.
    manoeuvre
        Within this manoeuvre alone; None: over all.
    parameter
        Name of the input.
    correlation, correlation_p
        Spearman's rank correlation of the input with the metric over its limit, of ``"passed"`` with the largest such
        ratio, and its p-value; NaN where the input is a word, or the metric is the same in every run.
    level, present, absent, p_value
        The value of the input with which runs violate most tellingly: True for a fault that happens, a manoeuvre's
        name, one of a few numbers, or a third of the runs, such as ``"above 1.02"``; violations among the runs with it
        and among the others; the p-value of Fisher's exact test, two-sided.

    Notes
    -----
    All p-values of a requirement and manoeuvre are corrected together (Holm, Scandinavian Journal of Statistics 6,
    1979).
    """

    requirement: str
    manoeuvre: str | None
    parameter: str
    correlation: float
    correlation_p: float
    level: Level
    present: counted.Probability
    absent: counted.Probability
    p_value: float

    @property
    def driver(self) -> bool:
        """Whether the metric follows the input, and chance alone is no explanation."""
        return bool(self.correlation_p < counted.SIGNIFICANCE)

    @property
    def cause(self) -> bool:
        """Whether the counts show that the value sets violating runs apart: of one run nothing does."""
        return bool(self.p_value < counted.SIGNIFICANCE) and self.present.events + self.absent.events > 1

    @property
    def in_every_violation(self) -> bool:
        """Whether there are violations, and none without this value."""
        return self.present.events > 0 and self.absent.events == 0


def influences(columns: store.Columns, limits: counted.Limits, inputs: Sequence[str]) -> tuple[Influence, ...]:
    """Return the influence of every input on every requirement, the largest first.

    Every requirement over all manoeuvres comes first, then within each manoeuvre. An input that is the same in all runs
    is left out. `columns` and `limits` are those of `statistics`, `inputs` the names of the columns of inputs.
    """
    answers = counted.answer_columns(columns)
    metrics = [name for name in answers if name != store.PASSED]
    data = {name: column[store.was_simulated(columns)] for name, column in columns.items()}
    manoeuvres = np.unique(data[store.MANOEUVRE].astype(str)).tolist()
    ratios = dict(zip(metrics, counted.over_limits(data, metrics, limits)[:, 2], strict=True))
    ratios[store.PASSED] = np.max([*ratios.values()], axis=0) if ratios else np.zeros(len(data[store.MANOEUVRE]))
    out: list[Influence] = []
    for manoeuvre in (None, *(counted.in_order(manoeuvres, limits) if len(manoeuvres) > 1 else ())):
        here = (
            np.ones(len(data[store.MANOEUVRE]), dtype=bool) if manoeuvre is None else data[store.MANOEUVRE] == manoeuvre
        )
        for requirement, column in answers.items():
            rows = here & (data[column] >= 0)
            given = {name: data[name][rows] for name in inputs if _varies(data[name][rows])}
            violated = data[column][rows] == 0
            out += _of_one((requirement, manoeuvre), given, violated, ratios[requirement][rows])
    return tuple(out)


def _varies(column: store.Array) -> bool:
    return bool((column != column[:1]).any())


def _of_one(
    of: tuple[str, str | None], inputs: Mapping[str, store.Array], violated: NDArray[np.bool_], ratio: FloatArray
) -> list[Influence]:
    """Return the influences on one requirement, within one manoeuvre or over all."""
    from scipy import stats

    whole = np.array([violated.sum(), len(violated)])
    tests: list[tuple[str, Level, Sequence[counted.Probability], float]] = []
    ranked: dict[str, tuple[float, float]] = {}
    for name, column in inputs.items():
        for level, rows in _levels(column):
            own = np.array([violated[rows].sum(), rows.sum()])
            sides = [counted.clopper_pearson(int(events), int(runs)) for events, runs in (own, whole - own)]
            p = float(stats.fisher_exact([(side.events, side.runs - side.events) for side in sides])[1])
            tests.append((name, level, sides, p))
        x, y = column[:_RANKED], ratio[:_RANKED]
        if column.dtype.kind in "if" and _varies(x) and _varies(y):
            correlation, p = stats.spearmanr(x, y)
            ranked[name] = (float(correlation), float(p))
    corrected = counted.holm([*(p for *_, p in tests), *(p for _, p in ranked.values())])
    correlated = zip(ranked.items(), corrected[len(tests) :].tolist(), strict=True)
    correlations = {name: (r, p) for (name, (r, _)), p in correlated}
    found: dict[str, Influence] = {}
    for (name, level, (present, absent), _), p in zip(tests, corrected.tolist(), strict=False):
        correlation, correlation_p = correlations.get(name, (float("nan"), 1.0))
        one = Influence(
            requirement=of[0],
            manoeuvre=of[1],
            parameter=name,
            correlation=correlation,
            correlation_p=correlation_p,
            level=level,
            present=present,
            absent=absent,
            p_value=p,
        )
        if name not in found or _telling(one) < _telling(found[name]):
            found[name] = one
    return sorted(found.values(), key=lambda one: min(one.p_value, one.correlation_p))


def _telling(one: Influence) -> tuple[bool, float]:
    # Of a value with which runs violate seldom, its complement is what violating runs have in common.
    return one.present.estimate < one.absent.estimate, one.p_value


def _levels(column: store.Array) -> Iterator[tuple[Level, NDArray[np.bool_]]]:
    """Yield the values of an input with the runs that have them; thirds of the runs where there are many values."""
    if column.dtype == np.int8:  # that a fault does not happen is the other side of that it does
        yield True, column == 1
        return
    levels = np.unique(column if column.dtype.kind == "f" else column.astype(str))
    if column.dtype.kind != "f" or len(levels) <= min(_MOST_LEVELS, len(column) // 2):
        for level in levels.tolist():
            yield level, column == level
        return
    low, high = np.quantile(column, [1.0 / 3.0, 2.0 / 3.0])
    yield f"below {low:.4g}", column < low
    yield f"{low:.4g} to {high:.4g}", (column >= low) & (column <= high)
    yield f"above {high:.4g}", column > high


Record = dict[str, Any]


@value
class Summary:
    """The result of a campaign.

    Attributes
    ----------
    plan
        What was simulated.
    statistics
        How often each requirement is violated.
    influences
        What violating runs have in common, and what drives each requirement.
    """

    plan: Plan
    statistics: counted.CampaignStatistics
    influences: tuple[Influence, ...]

    @property
    def passed(self) -> bool:
        """Whether every run was simulated and met all its limits."""
        return self.statistics.passed

    def inputs_of(self, run: int) -> dict[str, float | bool | str]:
        """Return the inputs of one run by their names, in plain types: SI units, names and truth values."""
        return {name: column[0].item() for name, column in self.plan.inputs(run, run + 1).items()}


def summarise(plan: Plan, table: str | os.PathLike[str]) -> Summary:
    """Return the statistics and influences of a campaign's table.

    Parameters
    ----------
    plan
        What was simulated.
    table
        The folder of Parquet files with the runs.

    Returns
    -------
    Summary
        What the page, the terminal and campaign.json show.

    Raises
    ------
    InputError
        The files cannot be read, or are not those of a campaign.
    """
    columns = store.read_columns(table)
    limits = {manoeuvre.name: manoeuvre.limits for manoeuvre, _ in plan.job.campaign_manoeuvres}
    return Summary(
        plan=plan,
        statistics=counted.statistics(columns, limits),
        influences=influences(columns, limits, plan.input_names),
    )


def summary_record(summary: Summary) -> Record:
    """Return the record of a summary for campaign.json; None where a number is not finite."""
    found = summary.statistics
    record = {
        "statistics": {
            "runs": found.runs,
            "simulated": found.simulated,
            "diverged": found.diverged,
            "endings": found.endings,
            "passed": found.passed,
            "confidence": found.confidence,
            "violation": _probability(found.violation),
            "requirements": [_requirement(one) for one in found.requirements],
            "worst": [dataclasses.asdict(one) for one in found.worst],
        },
        "influences": [_influence(one) for one in summary.influences],
    }
    out: Record = plain_types(record)
    return out


def _requirement(one: counted.RequirementStatistics) -> Record:
    return {
        "requirement": one.requirement,
        "manoeuvre": one.manoeuvre,
        "limit": one.limit,
        **_probability(one.violation),
        "quantiles": {f"{share:g}": requirement for share, requirement in one.quantiles.items()},
        "largest": one.largest,
        "worst": [dataclasses.asdict(single) for single in one.worst],
    }


def _influence(one: Influence) -> Record:
    return {
        "requirement": one.requirement,
        "manoeuvre": one.manoeuvre,
        "parameter": one.parameter,
        "rank_correlation": one.correlation,
        "rank_correlation_p_value": one.correlation_p,
        "driver": one.driver,
        "value": one.level,
        "with": _probability(one.present),
        "without": _probability(one.absent),
        "p_value": one.p_value,
        "cause": one.cause,
        "in_every_violation": one.in_every_violation,
    }


def _probability(one: counted.Probability) -> Record:
    return {"violations": one.events, "runs": one.runs, "probability": one.estimate, "low": one.low, "high": one.high}
