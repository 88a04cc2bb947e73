"""What a campaign says: how often each requirement is violated, with bounds, quantiles and the worst runs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis.run_metrics import RUN_METRICS, over_limit, worst_value
from platform_ctrl.campaign.probability import (
    CONFIDENCE,
    Distribution,
    Probability,
    clopper_pearson,
)
from platform_ctrl.campaign.table import (
    DIVERGED,
    ENDED,
    MANOEUVRE,
    PASSED,
    RUN,
    Array,
    Table,
    batches,
    codes,
    column_names,
    was_simulated,
)
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError

QUANTILES = (0.5, 0.9, 0.99, 0.999)
# Different endings that are counted separately; further ones are counted together.
_MOST_ENDINGS = 20

# What each manoeuvre allows each metric at most, SI units.
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
    """What the campaign says about one requirement.

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
    distribution
        Of the metric over these runs; None for ``"passed"``.
    worst
        The runs with the largest metrics over their limits, the worst first.
    """

    requirement: str
    manoeuvre: str | None
    limit: float | None
    violation: Probability
    quantiles: dict[float, float]
    largest: float
    distribution: Distribution | None
    worst: tuple[WorstRun, ...]


@value
class CampaignStatistics:
    """What the runs of a campaign say together.

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

    @check_arguments
    def of(self, requirement: str, manoeuvre: str | None = None) -> RequirementStatistics:
        """Return the statistics of a requirement, by default over all manoeuvres; ArgumentError if there are none."""
        for one in self.requirements:
            if (one.requirement, one.manoeuvre) == (requirement, manoeuvre):
                return one
        known = ", ".join(sorted({repr(one.requirement) for one in self.requirements}))
        raise ArgumentError(
            f"requirement of {manoeuvre or 'all manoeuvres'!r} must be one of {known}, got {requirement!r}"
        )


@check_arguments
def statistics(table: Table, limits: Limits, *, confidence: float = CONFIDENCE, worst: int = 10) -> CampaignStatistics:
    """Return what a campaign's table says about each requirement.

    The table is read a chunk at a time; the memory needed does not grow with the runs. Quantiles are right to half a
    thousandth of themselves, counts, bounds and extremes exactly.

    Parameters
    ----------
    table
        Parquet files, or a dict of columns: `run`, `manoeuvre`, the metrics `angle`, `attitude`, `torque_share`, for
        each its `..._passed` (null where the manoeuvre has no such limit), `passed` and `ended`.
    limits
        Limits of each manoeuvre by metric: `Manoeuvre.limits` by name, SI units.
    confidence
        Probability of the two-sided Clopper-Pearson bounds.
    worst
        How many of the worst runs to name for each requirement.

    Raises
    ------
    ArgumentError
        A column is missing.
    InputError
        The files cannot be read.
    """
    answers = answer_columns(table)
    metrics = tuple(name for name in RUN_METRICS if name in column_names(table))
    counts = _Counts(metrics, answers, limits, worst)
    endings: dict[str, int] = {}
    runs = simulated = 0
    for batch in batches(table, (RUN, MANOEUVRE, *metrics, *answers.values(), ENDED)):
        for text, number in zip(*np.unique(batch[ENDED].astype(str), return_counts=True), strict=True):
            kind = DIVERGED if text.startswith(DIVERGED) else str(text)
            kind = kind if kind in endings or len(endings) < _MOST_ENDINGS else "other reasons"
            endings[kind] = endings.get(kind, 0) + int(number)
        rows = was_simulated(batch)
        runs, simulated = runs + len(rows), simulated + int(rows.sum())
        counts.add({name: column[rows] for name, column in batch.items()})
    whole = counts.of(None, PASSED)
    return CampaignStatistics(
        runs=runs,
        simulated=simulated,
        diverged=endings.get(DIVERGED, 0),
        endings=dict(sorted(endings.items(), key=lambda item: -item[1])),
        violation=clopper_pearson(whole.violated, whole.limited, confidence),
        requirements=counts.requirements(confidence),
        worst=tuple(whole.worst),
        confidence=confidence,
    )


def limits_of(names: Iterable[str], requirement: str, limits: Limits) -> FloatArray:
    """Return the limit that each manoeuvre has for a metric; NaN where it has none."""
    return np.array([limits.get(name, {}).get(requirement, np.nan) for name in names])


def in_order(names: Iterable[str], limits: Limits) -> list[str]:
    """Return names of manoeuvres in the order of the job file, whatever was drawn first."""
    return sorted(names, key=lambda name: list(limits).index(name) if name in limits else len(limits))


def answer_columns(table: Table) -> dict[str, str]:
    """Return the columns that say whether requirements are met."""
    present = column_names(table)
    return {name: f"{name}_passed" for name in RUN_METRICS if f"{name}_passed" in present} | {PASSED: PASSED}


@dataclass
class _Count:
    """Counts of one requirement, over all manoeuvres or within one."""

    limited: int = 0  # runs with this limit
    violated: int = 0
    distribution: Distribution = field(default_factory=Distribution)
    worst: list[WorstRun] = field(default_factory=list)


class _Counts:
    """Counts of all requirements, over all manoeuvres and within each."""

    def __init__(self, metrics: tuple[str, ...], answers: Mapping[str, str], limits: Limits, keep: int) -> None:
        self._metrics, self._answers, self._limits, self._keep = metrics, answers, limits, keep
        self._found: dict[tuple[str | None, str], _Count] = {}
        self._known: dict[str, int] = {}

    def of(self, manoeuvre: str | None, requirement: str) -> _Count:
        return self._found.setdefault((manoeuvre, requirement), _Count())

    def add(self, batch: Mapping[str, Array]) -> None:
        """Count some runs."""
        place = codes(batch[MANOEUVRE], self._known)
        if not place.size:
            return
        limit = np.array([limits_of(self._known, name, self._limits)[place] for name in self._metrics])
        values = np.array(
            [np.where(np.isfinite(batch[name]), batch[name], worst_value(name)) for name in self._metrics]
        )
        # Where there is no limit no metric is bad.
        ratio = np.array([over_limit(name, *rows) for name, *rows in zip(self._metrics, values, limit, strict=True)])
        ratio = np.where(np.isnan(limit), -np.inf, ratio.reshape(limit.shape))
        for manoeuvre in (None, *self._known):
            here = np.ones(len(place), dtype=bool) if manoeuvre is None else place == self._known[manoeuvre]
            if not here.any():
                continue
            for requirement, column in self._answers.items():
                count, answer = self.of(manoeuvre, requirement), batch[column][here]
                count.limited += int((answer >= 0).sum())
                count.violated += int((answer == 0).sum())
            for k, name in enumerate(self._metrics):
                # Over all manoeuvres relative to each limit: without one a metric means something else, as the attitude
                # of a platform that is turned on purpose.
                own = here & ~np.isnan(limit[k]) if manoeuvre is None else here
                self.of(manoeuvre, name).distribution.add((ratio if manoeuvre is None else values)[k][own])
            for k, name in enumerate((*self._metrics, PASSED) if self._metrics else ()):
                which = ratio.argmax(axis=0) if name == PASSED else np.full(len(place), k)
                self._worst(self.of(manoeuvre, name), batch, np.array([values, limit, ratio]), which, here)

    def _worst(
        self,
        count: _Count,
        batch: Mapping[str, Array],
        numbers: FloatArray,
        which: NDArray[np.intp],
        here: NDArray[np.bool_],
    ) -> None:
        """Keep the runs with the largest ratios of the metric `which` of each; ties go to the lower run."""
        found, limit, ratio = numbers[:, which, np.arange(len(which))]
        least = count.worst[-1].ratio if len(count.worst) == self._keep else -np.inf
        rows = np.flatnonzero(here & (ratio >= least) & (ratio > -np.inf))
        rows = rows[np.lexsort((batch[RUN][rows], -ratio[rows]))[: self._keep]]
        more = [
            WorstRun(
                run=int(batch[RUN][k]),
                manoeuvre=str(batch[MANOEUVRE][k]),
                requirement=self._metrics[which[k]],
                value=float(found[k]),
                limit=float(limit[k]),
                ratio=float(ratio[k]),
                ended=str(batch[ENDED][k]),
            )
            for k in rows
        ]
        count.worst = sorted(count.worst + more, key=lambda one: (-one.ratio, one.run))[: self._keep]

    def requirements(self, confidence: float) -> tuple[RequirementStatistics, ...]:
        """Return the statistics of every requirement that some run has."""
        out = []
        for manoeuvre in (None, *in_order(self._known, self._limits)):
            for name in (*RUN_METRICS, PASSED):
                count = self.of(manoeuvre, name)
                if not count.limited:
                    continue
                shown = count.distribution if name in self._metrics else None
                limit = 1.0 if manoeuvre is None else self._limits.get(manoeuvre, {}).get(name)
                out.append(
                    RequirementStatistics(
                        requirement=name,
                        manoeuvre=manoeuvre,
                        limit=None if name == PASSED else limit,
                        violation=clopper_pearson(count.violated, count.limited, confidence),
                        quantiles={} if shown is None else {share: shown.quantile(share) for share in QUANTILES},
                        largest=float("nan") if shown is None else shown.largest,
                        distribution=shown,
                        worst=tuple(count.worst),
                    )
                )
        return tuple(out)
