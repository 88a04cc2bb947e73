"""Statistics of a campaign: how often each requirement is violated, with exact bounds, quantiles and the worst runs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis.metrics import RUN_METRICS, over_limit
from platform_ctrl.campaign.store import (
    DIVERGED,
    ENDED,
    MANOEUVRE,
    PASSED,
    RUN,
    Array,
    Columns,
    was_simulated,
)
from platform_ctrl.common.arguments import whole
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError

CONFIDENCE = 0.95
# An input is called a driver or a cause if chance would look like it in fewer than this share of campaigns.
SIGNIFICANCE = 0.01
# So many of the worst runs are named for each requirement.
_WORST_RUNS = 10


@value
class Probability:
    """How often something happened: `events` of `runs`, with Clopper and Pearson's bounds (Biometrika 26, 1934).

    The share of all runs that could be drawn lies between `low` and `high` at least with probability `CONFIDENCE`.
    """

    events: int
    runs: int
    low: float
    high: float

    @property
    def estimate(self) -> float:
        """Share of the runs; NaN without runs."""
        return self.events / self.runs if self.runs else float("nan")


def clopper_pearson(events: int, runs: int) -> Probability:
    """Return the probability of an event seen `events` times in `runs` independent runs.

    With no event the upper bound is 1 − (α/2)^(1/runs), about 3.7/runs at 95 %: two-sided throughout, also where the
    lower bound can only be zero. Exact for independent runs. Points of a Sobol sequence or a Latin hypercube fill the
    space more evenly: the estimate scatters less, the bounds are too wide as a rule, without a guarantee.
    ArgumentError: more events than runs.
    """
    if whole("events", events, 0) > whole("runs", runs, 0):
        raise ArgumentError(f"events must be at most runs, got {events} of {runs}")
    low, high = 0.0, 1.0
    if runs:
        from scipy import stats

        tail = 0.5 * (1.0 - CONFIDENCE)
        low = float(stats.beta.ppf(tail, events, runs - events + 1)) if events else 0.0
        high = float(stats.beta.isf(tail, events + 1, runs - events)) if events < runs else 1.0
    return Probability(events=events, runs=runs, low=low, high=high)


def holm(p_values: Sequence[float]) -> FloatArray:
    """Return p-values of several tests, each as large as it has to be for all of them together."""
    p = np.asarray(p_values, dtype=np.float64)
    order = np.argsort(p)
    adjusted = np.maximum.accumulate(np.minimum((len(p) - np.arange(len(p))) * p[order], 1.0))
    out = np.empty_like(p)
    out[order] = adjusted
    return out


QUANTILES = (0.5, 0.9, 0.99, 0.999)
# Different endings that are counted separately; further ones are counted together.
_MOST_ENDINGS = 20

# Limits of each manoeuvre by metric, SI units.
Limits = Mapping[str, Mapping[str, float]]


@value
class WorstRun:
    """One run's metric compared with its limit; `platform-ctrl simulate JOB.toml --run RUN` simulates it again."""

    run: int
    manoeuvre: str
    requirement: str  # name of the limit
    value: float  # rad, rad, share; infinite where it diverged
    limit: float  # in the same unit
    ratio: float  # of the value to the limit; above 1: violated
    ended: str


@value
class RequirementStatistics:
    """Statistics of a requirement.

    Attributes
    ----------
    requirement
        Name of the limit: ``"angle"``, ``"attitude"``, ``"torque_share"``; or ``"passed"``: all of them.
    manoeuvre
        The manoeuvre, or None over all.
    limit
        In the metric's unit (rad, rad, share of the torque limit); None for ``"passed"``. Over all manoeuvres a metric
        counts relative to its manoeuvre's limit, and this is 1.
    violation
        How often it is violated, of the simulated runs with this limit. A run that diverged violates every limit.
    quantiles
        Metric, in the unit of `limit`, by share of the runs; empty for ``"passed"``. Infinite where fewer completed.
    largest
        Largest metric, in the unit of `limit`.
    values
        The metric of these runs, increasing, in the unit of `limit`; infinite where a run diverged; empty for
        ``"passed"``.
    worst
        The runs with the largest metrics over their limits, the worst first.
    """

    requirement: str
    manoeuvre: str | None
    limit: float | None
    violation: Probability
    quantiles: dict[float, float]
    largest: float
    values: FloatArray
    worst: tuple[WorstRun, ...]


@value
class CampaignStatistics:
    """Statistics of all runs of a campaign.

    Attributes
    ----------
    runs, simulated, diverged
        Rows of the table; those that were simulated; those of them that diverged.
    endings
        How many runs ended how: ``"completed"``, ``"diverged"``, ``"not simulated: ..."``.
    violation
        How often a run violates any of its requirements.
    requirements
        Each over all manoeuvres, then by manoeuvre.
    worst
        The runs with the largest metrics over any of their limits.
    confidence
        Of all bounds, a probability.
    """

    runs: int
    simulated: int
    diverged: int
    endings: dict[str, int]
    violation: Probability
    requirements: tuple[RequirementStatistics, ...]
    worst: tuple[WorstRun, ...]
    confidence: float

    @property
    def not_simulated(self) -> int:
        """Number of runs that were not simulated."""
        return self.runs - self.simulated

    @property
    def passed(self) -> bool:
        """Whether every run was simulated and met all its limits."""
        return self.not_simulated == 0 and self.violation.events == 0

    def of(self, requirement: str, manoeuvre: str | None = None) -> RequirementStatistics:
        """Return the statistics of a requirement, by default over all manoeuvres; ArgumentError if there are none."""
        for one in self.requirements:
            if (one.requirement, one.manoeuvre) == (requirement, manoeuvre):
                return one
        known = ", ".join(sorted({repr(one.requirement) for one in self.requirements}))
        raise ArgumentError(
            f"requirement of {manoeuvre or 'all manoeuvres'!r} must be one of {known}, got {requirement!r}"
        )


def statistics(columns: Columns, limits: Limits) -> CampaignStatistics:
    """Return the statistics of each requirement from the columns of a campaign's table.

    Parameters
    ----------
    columns
        As of `store.read_columns`: `run`, `manoeuvre`, the metrics `angle`, `attitude`, `torque_share`, for
        each its `..._passed` (null where the manoeuvre has no such limit), `passed` and `ended`.
    limits
        Limits of each manoeuvre by metric: `Manoeuvre.limits` by name, SI units.
    """
    answers = answer_columns(columns)
    metrics = tuple(name for name in RUN_METRICS if name in columns)
    runs, rows = len(columns[RUN]), was_simulated(columns)
    endings: dict[str, int] = {}
    for text, number in zip(*np.unique(columns[ENDED].astype(str), return_counts=True), strict=True):
        kind = DIVERGED if text.startswith(DIVERGED) else str(text)
        kind = kind if kind in endings or len(endings) < _MOST_ENDINGS else "other reasons"
        endings[kind] = endings.get(kind, 0) + int(number)
    data = {name: column[rows] for name, column in columns.items()}
    compared = over_limits(data, metrics, limits)
    found: list[RequirementStatistics] = []
    for manoeuvre in (None, *in_order(np.unique(data[MANOEUVRE].astype(str)).tolist(), limits)):
        here = np.ones(len(data[RUN]), dtype=bool) if manoeuvre is None else data[MANOEUVRE] == manoeuvre
        for requirement in (*RUN_METRICS, PASSED):
            answer = data[answers[requirement]][here] if requirement in answers else np.zeros(0)
            if not (answer >= 0).any():
                continue
            violation = clopper_pearson(int((answer == 0).sum()), int((answer >= 0).sum()))
            limit, values = None, np.zeros(0)
            if requirement in metrics:
                # Over all manoeuvres relative to each limit: without one a metric means something else, as the
                # attitude of a platform that is turned on purpose.
                limit = 1.0 if manoeuvre is None else limits.get(manoeuvre, {}).get(requirement)
                metric, bound, ratio = compared[metrics.index(requirement)]
                values = np.sort(ratio[here & ~np.isnan(bound)] if manoeuvre is None else metric[here])
            one = RequirementStatistics(
                requirement=requirement,
                manoeuvre=manoeuvre,
                limit=limit,
                violation=violation,
                quantiles={share: quantile(values, share) for share in QUANTILES} if values.size else {},
                largest=float(values[-1]) if values.size else float("nan"),
                values=values,
                worst=_worst(data, metrics, compared, here, requirement),
            )
            found.append(one)
    whole = next((one for one in found if (one.requirement, one.manoeuvre) == (PASSED, None)), None)
    return CampaignStatistics(
        runs=runs,
        simulated=int(rows.sum()),
        diverged=endings.get(DIVERGED, 0),
        endings=dict(sorted(endings.items(), key=lambda item: -item[1])),
        violation=clopper_pearson(0, 0) if whole is None else whole.violation,
        requirements=tuple(found),
        worst=() if whole is None else whole.worst,
        confidence=CONFIDENCE,
    )


def over_limits(data: Mapping[str, Array], metrics: Sequence[str], limits: Limits) -> FloatArray:
    """Return each metric, its limit (NaN where the manoeuvre has none) and their ratio (−∞ there), (metrics, 3, N)."""
    names, place = np.unique(data[MANOEUVRE].astype(str), return_inverse=True)
    out = np.empty((len(metrics), 3, len(place)))
    for name, row in zip(metrics, out, strict=True):
        bound = np.array([limits.get(one, {}).get(name, np.nan) for one in names])[place]
        metric = RUN_METRICS[name]
        value = np.where(np.isfinite(data[name]), data[name], metric.worst)
        ratio = over_limit(value, bound, metric.sense)
        row[:] = value, bound, np.where(np.isnan(bound), -np.inf, ratio)
    return out


def quantile(values: FloatArray, share: float) -> float:
    """Return the least of increasing values that a share (0 to 1) of them does not exceed."""
    return float(values[max(int(np.ceil(share * len(values) - 1e-9)), 1) - 1])


def _worst(
    data: Mapping[str, Array], metrics: Sequence[str], compared: FloatArray, here: NDArray[np.bool_], requirement: str
) -> tuple[WorstRun, ...]:
    """Return the runs with the largest ratios of a metric, or of any; ties go to the lower run."""
    if not metrics:
        return ()
    which = compared[:, 2].argmax(axis=0) if requirement == PASSED else np.full(len(here), metrics.index(requirement))
    value, limit, ratio = compared[which, :, np.arange(len(which))].T
    rows = np.flatnonzero(here & (ratio > -np.inf))
    rows = rows[np.lexsort((data[RUN][rows], -ratio[rows]))[:_WORST_RUNS]]
    return tuple(
        WorstRun(
            run=int(data[RUN][k]),
            manoeuvre=str(data[MANOEUVRE][k]),
            requirement=metrics[which[k]],
            value=float(value[k]),
            limit=float(limit[k]),
            ratio=float(ratio[k]),
            ended=str(data[ENDED][k]),
        )
        for k in rows
    )


def in_order(names: Iterable[str], limits: Limits) -> list[str]:
    """Return names of manoeuvres in the order of the job file, whatever was drawn first."""
    return sorted(names, key=lambda name: list(limits).index(name) if name in limits else len(limits))


def answer_columns(columns: Columns) -> dict[str, str]:
    """Return the columns that say whether requirements are met."""
    return {name: f"{name}_passed" for name in RUN_METRICS if f"{name}_passed" in columns} | {PASSED: PASSED}
