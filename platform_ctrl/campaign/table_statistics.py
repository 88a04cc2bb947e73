"""What a campaign says: how often each requirement is violated, with bounds, quantiles and the worst runs.

And how often with a fault, a manoeuvre or a chosen value, and how often without it: shares of variance do not see a
rare cause. A fault in one run of fifty has hardly any share of a metric's variance, even where every violating run has
it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis.run_metrics import RUN_METRICS, over_limit, worst_value
from platform_ctrl.campaign.probability import (
    CONFIDENCE,
    SIGNIFICANCE,
    Distribution,
    Probability,
    clopper_pearson,
    holm,
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
    input_names,
    was_simulated,
)
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError

QUANTILES = (0.5, 0.9, 0.99, 0.999)
# Different endings that are counted separately; further ones are counted together.
_MOST_ENDINGS = 20
# A number with more values than this, or with about one for each run, is no choice among a few.
_MOST_LEVELS = 12

# What each manoeuvre allows each metric at most, SI units.
Limits = Mapping[str, Mapping[str, float]]
Level = bool | float | str


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
    answers = _answers(table)
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


def _answers(table: Table) -> dict[str, str]:
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


@value
class Contrast:
    """How often a requirement is violated with one value of an input, and how often with its other values.

    Attributes
    ----------
    requirement
        Name of the limit, or ``"passed"``: whether a run violates anything at all.
    manoeuvre
        Within this manoeuvre alone; None: over all.
    parameter, level
        Name of the input, and the value: True for a fault that happens, a manoeuvre's name, one of a few numbers.
    present, absent
        Violations among the runs with this value, and among the others.
    p_value
        Probability that a value without influence looks like this (Fisher's exact test, two-sided), all values of all
        such inputs for this metric and manoeuvre together (Holm).
    """

    requirement: str
    manoeuvre: str | None
    parameter: str
    level: Level
    present: Probability
    absent: Probability
    p_value: float

    @property
    def driver(self) -> bool:
        """Whether chance alone is no explanation."""
        return bool(self.p_value < SIGNIFICANCE)

    @property
    def in_every_violation(self) -> bool:
        """Whether there are violations, and none without this value."""
        return self.present.events > 0 and self.absent.events == 0


# Runs with the limit and violations, by metric and manoeuvre.
_Pairs = dict[tuple[str, str], tuple[int, int]]


@check_arguments
def contrasts(
    table: Table, limits: Limits, *, inputs: Sequence[str] | None = None, confidence: float = CONFIDENCE
) -> tuple[Contrast, ...]:
    """Return how often each requirement is violated with and without every value of the inputs that have few.

    All runs that were simulated are counted, a chunk of the table at a time. Arguments and errors are those of
    `statistics`; `inputs` are the columns of inputs, by default all that are no outcome. Every requirement over all
    manoeuvres comes first, then within each, the least p-value first.
    """
    names = tuple(input_names(table) if inputs is None else inputs)
    counts, simulated = _counted(table, names)
    few = min(_MOST_LEVELS, simulated // 2)
    discrete = {name: levels for name, levels in counts.items() if not _numeric(levels) or len(levels) <= few}
    manoeuvres = in_order(
        sorted({m for levels in discrete.values() for one in levels.values() for _, m in one}), limits
    )
    out: list[Contrast] = []
    for manoeuvre in (None, *(manoeuvres if len(manoeuvres) > 1 else ())):
        for requirement in (*RUN_METRICS, PASSED):
            out += _of_one(requirement, manoeuvre, discrete, confidence)
    return tuple(out)


def _numeric(levels: Iterable[Level]) -> bool:
    return any(isinstance(level, float) for level in levels)


def _counted(table: Table, names: Sequence[str]) -> tuple[dict[str, dict[Level, _Pairs]], int]:
    """Return the counts by input and value, and how many runs were simulated."""
    answers = _answers(table)
    counts: dict[str, dict[Level, _Pairs]] = {name: {} for name in names}
    simulated = 0
    for batch in batches(table, tuple(dict.fromkeys((MANOEUVRE, *names, *answers.values(), ENDED)))):
        rows = was_simulated(batch)
        simulated += int(rows.sum())
        manoeuvres, place = np.unique(batch[MANOEUVRE][rows].astype(str), return_inverse=True)
        given = {requirement: batch[column][rows] for requirement, column in answers.items()}
        for name in list(counts):
            for level, here in _levels(batch[name][rows]):
                own = counts[name].setdefault(level, {})
                for requirement, answer in given.items():
                    limited = np.bincount(place[here & (answer >= 0)], minlength=len(manoeuvres)).tolist()
                    violated = np.bincount(place[here & (answer == 0)], minlength=len(manoeuvres)).tolist()
                    for k, manoeuvre in enumerate(manoeuvres.tolist()):
                        before = own.get((requirement, manoeuvre), (0, 0))
                        own[requirement, manoeuvre] = (before[0] + limited[k], before[1] + violated[k])
            if len(counts[name]) > _MOST_LEVELS and _numeric(counts[name]):
                del counts[name]
    return counts, simulated


def _levels(column: Array) -> Iterator[tuple[Level, Array]]:
    """Walk the values of a column with the runs that have them; of a column of numbers no more than are few."""
    if column.dtype == np.int8:
        yield from ((bool(level), column == int(level)) for level in (True, False) if np.any(column == int(level)))
    elif column.dtype.kind == "f":
        yield from ((float(level), column == level) for level in np.unique(column)[: _MOST_LEVELS + 1])
    else:
        text = column.astype(str)
        yield from ((str(level), text == level) for level in np.unique(text))


def _of_one(
    requirement: str, manoeuvre: str | None, discrete: Mapping[str, Mapping[Level, _Pairs]], confidence: float
) -> list[Contrast]:
    """Return all contrasts of a metric, over all manoeuvres or within one."""
    from scipy import stats

    found = []
    for name, levels in discrete.items():
        sums = {
            level: np.sum(
                [pair for (one, m), pair in own.items() if one == requirement and manoeuvre in (None, m)] or [(0, 0)],
                axis=0,
            )
            for level, own in levels.items()
        }
        whole = np.sum(list(sums.values()), axis=0) if sums else np.zeros(2, dtype=int)
        for level, one in sums.items():
            # That a fault does not happen is the other side of that it does.
            if level is False or not 0 < one[0] < whole[0]:
                continue
            pairs = [(int(violated), int(limited)) for limited, violated in (one, whole - one)]
            p = stats.fisher_exact([(events, runs - events) for events, runs in pairs])[1]
            found.append((name, level, [clopper_pearson(*pair, confidence) for pair in pairs], float(p)))
    p_values = holm([p for *_, p in found])
    out = [
        Contrast(
            requirement=requirement,
            manoeuvre=manoeuvre,
            parameter=name,
            level=level,
            present=present,
            absent=absent,
            p_value=float(p),
        )
        for (name, level, (present, absent), _), p in zip(found, p_values, strict=True)
    ]
    return sorted(out, key=lambda one: (one.p_value, one.parameter, str(one.level)))
