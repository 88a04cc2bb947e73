"""What a campaign says: how often each requirement is violated, with bounds, quantiles, and the worst runs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis.metrics import RUN_METRICS
from platform_ctrl.campaign.probability import CONFIDENCE, Distribution, Probability, clopper_pearson
from platform_ctrl.campaign.table import (
    DIVERGED,
    ENDED,
    MANOEUVRE,
    NOT_SIMULATED,
    PASSED,
    RUN,
    Array,
    Table,
    batches,
    codes,
    column_names,
)
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError


@value
class WorstRun:
    """One run's metric held against its limit.

    Attributes
    ----------
    run, manoeuvre, ended
        Which run, and how it ended; ``platform-ctrl simulate JOB.toml --run RUN`` simulates it again.
    requirement
        Name of the limit.
    value, limit, ratio
        The metric, what is asked at most, both in its unit (rad, rad, share), and the ratio of the one to the other
        (above 1: violated); infinite where it diverged.
    """

    run: int
    manoeuvre: str
    requirement: str
    value: float
    limit: float
    ratio: float
    ended: str


class WorstRuns:
    """The `keep` runs with the largest metrics over their limits, of each requirement; ties go to the lower run."""

    def __init__(self, keep: int) -> None:
        self.keep = keep
        self._found: dict[tuple[str, str | None], list[WorstRun]] = {}

    def of(self, requirement: str, manoeuvre: str | None) -> tuple[WorstRun, ...]:
        """Return the worst runs of one requirement, the worst first."""
        return tuple(self._found.get((requirement, manoeuvre), ()))

    def see(
        self,
        batch: Mapping[str, Array],
        asked: Mapping[str, FloatArray],
        place: NDArray[np.intp],
        names: Sequence[str],
    ) -> None:
        """Look at some runs."""
        if not asked or not place.size:
            return
        metrics = tuple(asked)
        limit = np.array([asked[requirement] for requirement in metrics])
        values = np.array([batch[name] for name in metrics])
        values = np.where(np.isfinite(values), values, np.inf)
        # Where nothing is asked no metric is bad.
        ratio = np.where(np.isnan(limit), -np.inf, values / limit)
        places = {name: np.full(len(place), k) for k, name in enumerate(metrics)} | {PASSED: ratio.argmax(axis=0)}
        for name, which in places.items():
            for m, manoeuvre in enumerate((None, *names), -1):
                here = ratio if manoeuvre is None else np.where(place == m, ratio, -np.inf)
                self._see((name, manoeuvre), batch, metrics, (values, limit, here), which, place, names)

    def _see(
        self,
        key: tuple[str, str | None],
        batch: Mapping[str, Array],
        metrics: Sequence[str],
        numbers: tuple[FloatArray, FloatArray, FloatArray],
        which: NDArray[np.intp],
        place: NDArray[np.intp],
        names: Sequence[str],
    ) -> None:
        value, limit, ratio = (one[which, np.arange(len(place))] for one in numbers)
        found = self._found.setdefault(key, [])
        least = found[-1].ratio if len(found) == self.keep else -np.inf
        rows = np.flatnonzero((ratio >= least) & (ratio > -np.inf))
        rows = rows[np.lexsort((batch[RUN][rows], -ratio[rows]))[: self.keep]]
        more = [
            WorstRun(
                run=int(batch[RUN][k]),
                manoeuvre=names[place[k]],
                requirement=metrics[which[k]],
                value=float(value[k]),
                limit=float(limit[k]),
                ratio=float(ratio[k]),
                ended=str(batch[ENDED][k]),
            )
            for k in rows
        ]
        self._found[key] = sorted(found + more, key=lambda one: (-one.ratio, one.run))[: self.keep]


QUANTILES = (0.5, 0.9, 0.99, 0.999)
# Different endings that are told apart; further ones are counted together.
_MOST_ENDINGS = 20

Limits = Mapping[str, Mapping[str, float]]


@value
class RequirementStatistics:
    """What the campaign says about one requirement.

    Attributes
    ----------
    requirement
        Name of the limit: ``"angle"``, ``"attitude"``, ``"torque_share"``; or ``"passed"``: all that are asked.
    manoeuvre
        The manoeuvre, or None over all.
    limit
        What is asked at most, in the metric's unit (rad, rad, share of the torque limit); None for ``"passed"``. Over
        all manoeuvres a metric counts relative to its manoeuvre's limit, and this is 1.
    violation
        How often it is violated, of the runs that were simulated and of which it is asked. A run that diverged violates
        whatever is asked of it.
    quantiles
        Metric, in the unit of `limit`, by share of the runs; empty for ``"passed"``. Infinite where that share of the
        runs did not do.
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
        """Runs that nothing is known of."""
        return self.runs - self.simulated

    @property
    def passed(self) -> bool:
        """Whether every run was simulated and met whatever was asked of it."""
        return self.not_simulated == 0 and self.violation.events == 0

    @check_arguments
    def of(self, requirement: str, manoeuvre: str | None = None) -> RequirementStatistics:
        """Return the statistics of one requirement, over all manoeuvres by default.

        Parameters
        ----------
        requirement
            ``"angle"``, ``"attitude"``, ``"torque_share"`` or ``"passed"``.
        manoeuvre
            Its name; None: over all.

        Returns
        -------
        RequirementStatistics
            Of this metric there.

        Raises
        ------
        ArgumentError
            It was not asked.
        """
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
        each that is asked its `..._passed` (null where the manoeuvre asks nothing), `passed` and `ended`.
    limits
        What each manoeuvre asks of each metric at most: `Manoeuvre.limits` by name, SI units.
    confidence
        Probability of the two-sided Clopper-Pearson bounds.
    worst
        How many of the worst runs to name for each requirement.

    Returns
    -------
    CampaignStatistics
        Of all runs in the table.

    Raises
    ------
    ArgumentError
        A column is missing.
    InputError
        The files cannot be read.

    References
    ----------
    C. J. Clopper, E. S. Pearson, Biometrika 26, 1934.

    See docs/campaign.md.
    """
    present = column_names(table)
    metrics = [name for name in RUN_METRICS if name in present]
    answers = [name for name in (f"{requirement}_passed" for requirement in metrics) if name in present]
    counted = _Counted(worst)
    for batch in batches(table, (RUN, MANOEUVRE, *metrics, *answers, PASSED, ENDED)):
        counted.see(batch, metrics, limits)
    return counted.summed(limits, confidence)


def limits_of(names: Iterable[str], requirement: str, limits: Limits) -> FloatArray:
    """Return what each manoeuvre asks of a metric at most; NaN where it asks nothing."""
    return np.array([limits.get(name, {}).get(requirement, np.nan) for name in names])


class _Tally:
    """Counts of some runs."""

    def __init__(self) -> None:
        self.asked = dict.fromkeys((*RUN_METRICS, PASSED), 0)
        self.violated = dict.fromkeys((*RUN_METRICS, PASSED), 0)
        self.distributions: dict[str, Distribution] = {}

    def answer(self, requirement: str, answers: Array) -> None:
        self.asked[requirement] += int((answers >= 0).sum())
        self.violated[requirement] += int((answers == 0).sum())

    def spread(self, requirement: str, metrics: Array) -> None:
        self.distributions.setdefault(requirement, Distribution()).add(metrics)

    def requirement(
        self,
        requirement: str,
        manoeuvre: str | None,
        limit: float | None,
        confidence: float,
        worst: tuple[WorstRun, ...],
    ) -> RequirementStatistics:
        spread = self.distributions.get(requirement)
        return RequirementStatistics(
            requirement=requirement,
            manoeuvre=manoeuvre,
            limit=limit,
            violation=clopper_pearson(self.violated[requirement], self.asked[requirement], confidence),
            quantiles={} if spread is None else {share: spread.quantile(share) for share in QUANTILES},
            largest=float("nan") if spread is None else spread.largest,
            distribution=spread,
            worst=worst,
        )


class _Counted:
    """Everything that is counted of a table, a chunk after the other."""

    def __init__(self, keep: int) -> None:
        self.runs = self.simulated = self.diverged = 0
        self.endings: dict[str, int] = {}
        self.known: dict[str, int] = {}
        self.tallies: list[_Tally] = []
        self.whole = _Tally()
        self.worst = WorstRuns(keep)

    def see(self, batch: Mapping[str, Array], metrics: Sequence[str], limits: Limits) -> None:
        """Count some runs."""
        simulated = self._endings(batch[ENDED])
        batch = {name: column[simulated] for name, column in batch.items()}
        place = codes(batch[MANOEUVRE], self.known)
        self.tallies += [_Tally() for _ in range(len(self.known) - len(self.tallies))]
        names = list(self.known)
        asked = {requirement: limits_of(names, requirement, limits)[place] for requirement in metrics} if names else {}
        self.whole.answer(PASSED, batch[PASSED])
        for requirement, limit in asked.items():
            # Where it is not asked a metric means something else: the attitude of a platform that is turned on purpose.
            own = ~np.isnan(limit)
            self.whole.spread(requirement, batch[requirement][own] / limit[own])
            if f"{requirement}_passed" in batch:
                self.whole.answer(requirement, batch[f"{requirement}_passed"])
        for k, tally in enumerate(self.tallies):
            here = place == k
            if not here.any():
                continue
            tally.answer(PASSED, batch[PASSED][here])
            for requirement in metrics:
                tally.spread(requirement, batch[requirement][here])
                if f"{requirement}_passed" in batch:
                    tally.answer(requirement, batch[f"{requirement}_passed"][here])
        self.worst.see(batch, asked, place, names)

    def _endings(self, ended: Array) -> NDArray[np.bool_]:
        """Count how runs ended; return which of them were simulated."""
        known: dict[str, int] = {}
        exact = codes(ended, known)
        numbers = np.bincount(exact, minlength=len(known))
        for text, number in zip(known, numbers, strict=True):
            kind = DIVERGED if text.startswith(DIVERGED) else text
            kind = kind if kind in self.endings or len(self.endings) < _MOST_ENDINGS else "other reasons"
            self.endings[kind] = self.endings.get(kind, 0) + int(number)
        simulated = ~np.array([text.startswith(NOT_SIMULATED) for text in known], dtype=bool)[exact]
        self.runs += len(ended)
        self.simulated += int(simulated.sum())
        self.diverged += int(np.array([text.startswith(DIVERGED) for text in known], dtype=bool)[exact].sum())
        return np.asarray(simulated)

    def summed(self, limits: Limits, confidence: float) -> CampaignStatistics:
        """Return what was counted."""
        requirements = [
            self.whole.requirement(
                requirement, None, None if requirement == PASSED else 1.0, confidence, self.worst.of(requirement, None)
            )
            for requirement in (*RUN_METRICS, PASSED)
            if self.whole.asked[requirement]
        ]
        # In the order of the job file, whatever was drawn first.
        for name in sorted(self.known, key=lambda name: list(limits).index(name) if name in limits else len(limits)):
            tally = self.tallies[self.known[name]]
            requirements += [
                tally.requirement(
                    requirement,
                    name,
                    limits.get(name, {}).get(requirement),
                    confidence,
                    self.worst.of(requirement, name),
                )
                for requirement in (*RUN_METRICS, PASSED)
                if tally.asked[requirement]
            ]
        return CampaignStatistics(
            runs=self.runs,
            simulated=self.simulated,
            diverged=self.diverged,
            endings=dict(sorted(self.endings.items(), key=lambda item: -item[1])),
            violation=clopper_pearson(self.whole.violated[PASSED], self.whole.asked[PASSED], confidence),
            requirements=tuple(requirements),
            worst=self.worst.of(PASSED, None),
            confidence=confidence,
        )
