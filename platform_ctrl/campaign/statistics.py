"""What a campaign says: how often each requirement is violated, with bounds, quantiles, and the worst runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from platform_ctrl.arguments import positive
from platform_ctrl.campaign.distribution import Distribution
from platform_ctrl.campaign.table import (
    ENDED,
    FIGURES,
    MANOEUVRE,
    PASSED,
    RUN,
    Array,
    Table,
    batches,
    codes,
    column_names,
)
from platform_ctrl.errors import ArgumentError
from platform_ctrl.frozen import value

CONFIDENCE = 0.95
QUANTILES = (0.5, 0.9, 0.99, 0.999)
# Different endings that are told apart; further ones are counted together.
_MOST_ENDINGS = 20

Limits = Mapping[str, Mapping[str, float]]


@value
class Probability:
    """How often something happened, with exact bounds.

    Attributes
    ----------
    events, runs
        How many runs of how many.
    low, high
        Clopper and Pearson's bounds: of all runs that could be drawn the share lies between them, both together at
        least with probability `confidence`.
    confidence
        Two-sided.
    """

    events: int
    runs: int
    low: float
    high: float
    confidence: float

    @property
    def estimate(self) -> float:
        """Share of the runs; NaN without runs."""
        return self.events / self.runs if self.runs else float("nan")


def clopper_pearson(events: int, runs: int, confidence: float = CONFIDENCE) -> Probability:
    """Return the probability of an event seen `events` times in `runs` independent runs.

    With no event the upper bound is 1 − (α/2)^(1/runs), about 3.7/runs at 95 %: two-sided throughout, also where the
    lower bound can only be zero.

    Parameters
    ----------
    events, runs
        Whole numbers, 0 ≤ events ≤ runs.
    confidence
        Two-sided, between 0 and 1.

    Raises
    ------
    ArgumentError
        More events than runs, or a confidence that is none.

    Notes
    -----
    Exact for independent runs (Clopper and Pearson, Biometrika 26, 1934). Points of a Sobol sequence or a Latin
    hypercube fill the space more evenly than that: the estimate scatters less, the bounds err on the safe side as a
    rule, but nobody guarantees it.
    """
    if not 0 <= events <= runs:
        raise ArgumentError(f"events: given {events} of {runs} runs; expected 0 <= events <= runs")
    if not 0.0 < positive("confidence", confidence) < 1.0:
        raise ArgumentError(f"confidence: given {confidence}; expected a number between 0 and 1")
    low, high = 0.0, 1.0
    if runs:
        from scipy import stats

        tail = 0.5 * (1.0 - confidence)
        low = float(stats.beta.ppf(tail, events, runs - events + 1)) if events else 0.0
        high = float(stats.beta.isf(tail, events + 1, runs - events)) if events < runs else 1.0
    return Probability(events=events, runs=runs, low=low, high=high, confidence=confidence)


@value
class RunFigure:
    """One run's figure held against its limit.

    Attributes
    ----------
    run, manoeuvre, ended
        Which run, and how it ended; ``platform-ctrl simulate JOB.toml --run RUN`` flies it again.
    figure
        Name of the limit.
    value, limit, ratio
        The figure, what is asked at most, and the one over the other (above 1: violated); infinite where it diverged.
    """

    run: int
    manoeuvre: str
    figure: str
    value: float
    limit: float
    ratio: float
    ended: str


@value
class RequirementStatistics:
    """What the campaign says about one requirement.

    Attributes
    ----------
    figure
        Name of the limit: ``"angle"``, ``"attitude"``, ``"torque_share"``; or ``"passed"``: all that are asked.
    manoeuvre
        The manoeuvre, or None over all.
    limit
        What is asked at most; None over manoeuvres that ask different things, and for ``"passed"``.
    violation
        How often it is violated, of the runs that were flown and of which it is asked. A run that diverged violates
        whatever is asked of it.
    quantiles
        Figure by share of the runs; empty for ``"passed"``. Infinite where that share of the runs did not do.
    largest
        Largest figure.
    distribution
        Of the figure over these runs; None for ``"passed"``.
    worst
        The runs with the largest figures over their limits, the worst first.
    """

    figure: str
    manoeuvre: str | None
    limit: float | None
    violation: Probability
    quantiles: dict[float, float]
    largest: float
    distribution: Distribution | None
    worst: tuple[RunFigure, ...]


@value
class CampaignStatistics:
    """What the runs of a campaign say together.

    Attributes
    ----------
    runs, flown, diverged
        Rows of the table; those that were flown; those of them that diverged.
    endings
        How many runs ended how: ``"completed"``, ``"diverged"``, ``"not flown: ..."``.
    violation
        How often a run violates any of its requirements.
    requirements
        Each over all manoeuvres, then by manoeuvre.
    worst
        The runs with the largest figures over any of their limits.
    confidence
        Of all bounds.
    """

    runs: int
    flown: int
    diverged: int
    endings: dict[str, int]
    violation: Probability
    requirements: tuple[RequirementStatistics, ...]
    worst: tuple[RunFigure, ...]
    confidence: float

    @property
    def not_flown(self) -> int:
        """Runs that nothing is known of."""
        return self.runs - self.flown

    @property
    def passed(self) -> bool:
        """Whether every run was flown and met whatever was asked of it."""
        return self.not_flown == 0 and self.violation.events == 0

    def of(self, figure: str, manoeuvre: str | None = None) -> RequirementStatistics:
        """Return the statistics of one requirement, over all manoeuvres by default.

        Raises
        ------
        ArgumentError
            It was not asked.
        """
        for one in self.requirements:
            if (one.figure, one.manoeuvre) == (figure, manoeuvre):
                return one
        asked = ", ".join(sorted({repr(one.figure) for one in self.requirements}))
        raise ArgumentError(f"requirement: given {figure!r} of {manoeuvre or 'all manoeuvres'!r}; expected {asked}")


class _Tally:
    """Counts of one manoeuvre's runs."""

    def __init__(self) -> None:
        self.asked = dict.fromkeys((*FIGURES, PASSED), 0)
        self.violated = dict.fromkeys((*FIGURES, PASSED), 0)
        self.distributions: dict[str, Distribution] = {}

    def count(self, figure: str, answers: Array) -> None:
        self.asked[figure] += int((answers >= 0).sum())
        self.violated[figure] += int((answers == 0).sum())

    def spread(self, figure: str, figures: Array) -> None:
        self.distributions.setdefault(figure, Distribution()).add(figures)

    def merge(self, other: _Tally) -> None:
        for figure in self.asked:
            self.asked[figure] += other.asked[figure]
            self.violated[figure] += other.violated[figure]
        for figure, distribution in other.distributions.items():
            # Where it is not asked a figure means something else: the attitude of a platform that is turned on purpose.
            if other.asked[figure]:
                self.distributions.setdefault(figure, Distribution()).merge(distribution)


class _Worst:
    """The `keep` largest ratios seen so far, ties to the lower run."""

    def __init__(self, keep: int) -> None:
        self.keep = keep
        self.found: list[RunFigure] = []

    def see(self, ratio: Array, made: Sequence[Array], figure: Array, endings: Array, names: Sequence[str]) -> None:
        run, value_, limit = made
        asked = np.flatnonzero(~np.isnan(ratio))
        if len(self.found) == self.keep and asked.size:
            asked = asked[ratio[asked] >= self.found[-1].ratio] if self.keep else asked[:0]
        best = asked[np.lexsort((run[asked], -ratio[asked]))[: self.keep]]
        self.found += [
            RunFigure(
                run=int(run[k]),
                manoeuvre=names[k],
                figure=str(figure[k]),
                value=float(value_[k]),
                limit=float(limit[k]),
                ratio=float(ratio[k]),
                ended=str(endings[k]),
            )
            for k in best
        ]
        self.found = sorted(self.found, key=lambda one: (-one.ratio, one.run))[: self.keep]


def statistics(table: Table, limits: Limits, *, confidence: float = CONFIDENCE, worst: int = 10) -> CampaignStatistics:
    """Return what a campaign's table says about each requirement.

    The table is read a piece at a time; the memory needed does not grow with the runs. Quantiles are right to half a
    thousandth of themselves, counts, bounds and extremes exactly.

    Parameters
    ----------
    table
        Parquet files, or a dict of columns: `run`, `manoeuvre`, the figures `angle`, `attitude`, `torque_share`, for
        each that is asked its `..._passed` (null where the manoeuvre asks nothing), `passed` and `ended`.
    limits
        What each manoeuvre asks of each figure at most: `Manoeuvre.limits` by name.
    confidence
        Of the two-sided Clopper-Pearson bounds.
    worst
        How many of the worst runs to name for each requirement.

    Raises
    ------
    ArgumentError
        A column is missing.
    InputError
        The files cannot be read.
    """
    present = column_names(table)
    figures = [name for name in FIGURES if name in present]
    answers = [name for name in (f"{figure}_passed" for figure in figures) if name in present]
    known: dict[str, int] = {}
    tallies: list[_Tally] = []
    worsts: dict[tuple[str, str | None], _Worst] = {}
    endings: dict[str, int] = {}
    runs = flown_runs = diverged = 0
    for batch in batches(table, (RUN, MANOEUVRE, *figures, *answers, PASSED, ENDED)):
        ended = batch[ENDED]
        kinds, kind = _endings(ended, endings)
        runs += len(ended)
        missing = np.array([one.startswith("not flown") for one in kinds])[kind]
        diverged += int(np.array([one == "diverged" for one in kinds])[kind].sum())
        flown_runs += int((~missing).sum())
        batch = {name: column[~missing] for name, column in batch.items()}
        place = codes(batch[MANOEUVRE], known)
        tallies += [_Tally() for _ in range(len(known) - len(tallies))]
        names = list(known)
        asked = _asked(batch, figures, names, place, limits)
        for k in range(len(names)):
            here = place == k
            if not here.any():
                continue
            tallies[k].count(PASSED, batch[PASSED][here])
            for figure in figures:
                tallies[k].spread(figure, batch[figure][here])
                if f"{figure}_passed" in batch:
                    tallies[k].count(figure, batch[f"{figure}_passed"][here])
        _see_worst(worsts, batch, figures, asked, place, names, worst)
    return _summed(
        dict(zip(known, tallies, strict=True)),
        worsts,
        limits,
        figures,
        confidence,
        (runs, flown_runs, diverged),
        endings,
    )


def _endings(ended: Array, counted: dict[str, int]) -> tuple[list[str], Array]:
    """Count how runs ended; return the kinds in this piece, and which of them each run is."""
    known: dict[str, int] = {}
    exact = codes(ended, known)
    kinds = ["diverged" if text.startswith("diverged") else text for text in known]
    for kind, number in zip(kinds, np.bincount(exact, minlength=len(kinds)), strict=True):
        key = kind if kind in counted or len(counted) < _MOST_ENDINGS else "other reasons"
        counted[key] = counted.get(key, 0) + int(number)
    return kinds, exact


def _asked(
    batch: Mapping[str, Array], figures: Sequence[str], names: Sequence[str], place: Array, limits: Limits
) -> dict[str, Array]:
    """Return for each figure every run's limit; NaN where its manoeuvre asks nothing."""
    out = {}
    for figure in figures:
        by_name = np.array([limits.get(name, {}).get(figure, np.nan) for name in names] or [np.nan])
        out[figure] = by_name[place]
    return out


def _see_worst(
    worsts: dict[tuple[str, str | None], _Worst],
    batch: Mapping[str, Array],
    figures: Sequence[str],
    asked: Mapping[str, Array],
    place: Array,
    names: Sequence[str],
    keep: int,
) -> None:
    if not place.size or not figures:
        return
    run, ended = batch[RUN], batch[ENDED]
    manoeuvres = [names[k] for k in place]
    values = np.array([batch[figure] for figure in figures])
    bounds = np.array([asked[figure] for figure in figures])
    values = np.where(np.isfinite(values), values, np.inf)
    ratios = values / bounds
    for k, figure in enumerate(figures):
        if np.isnan(ratios[k]).all():
            continue
        same = np.full(len(run), figure, dtype=object)
        worsts.setdefault((figure, None), _Worst(keep)).see(
            ratios[k], (run, values[k], bounds[k]), same, ended, manoeuvres
        )
        for m, name in enumerate(names):
            here = np.where(place == m, ratios[k], np.nan)
            if not np.isnan(here).all():
                worsts.setdefault((figure, name), _Worst(keep)).see(
                    here, (run, values[k], bounds[k]), same, ended, manoeuvres
                )
    largest = np.where(np.isnan(ratios), -np.inf, ratios).argmax(axis=0)
    rows = np.arange(len(run))
    chosen = np.array(figures, dtype=object)[largest]
    made = (run, values[largest, rows], bounds[largest, rows])
    worsts.setdefault((PASSED, None), _Worst(keep)).see(ratios[largest, rows], made, chosen, ended, manoeuvres)


def _summed(
    tallies: Mapping[str, _Tally],
    worsts: Mapping[tuple[str, str | None], _Worst],
    limits: Limits,
    figures: Sequence[str],
    confidence: float,
    counted: tuple[int, int, int],
    endings: dict[str, int],
) -> CampaignStatistics:
    whole = _Tally()
    for tally in tallies.values():
        whole.merge(tally)
    # In the order of the job file, whatever was drawn first.
    order = [name for name in limits if name in tallies] + [name for name in tallies if name not in limits]
    requirements = []
    for manoeuvre, tally in ((None, whole), *((name, tallies[name]) for name in order)):
        for figure in (*figures, PASSED):
            if tally.asked[figure]:
                found = worsts.get((figure, manoeuvre))
                bounds = {limits[name][figure] for name in order if figure in limits.get(name, {})}
                limit = limits.get(manoeuvre, {}).get(figure) if manoeuvre is not None else None
                if manoeuvre is None and len(bounds) == 1:
                    limit = bounds.pop()
                requirements.append(
                    _requirement(figure, manoeuvre, limit, tally, confidence, tuple(found.found) if found else ())
                )
    runs, flown, diverged = counted
    overall = worsts.get((PASSED, None))
    return CampaignStatistics(
        runs=runs,
        flown=flown,
        diverged=diverged,
        endings=dict(sorted(endings.items(), key=lambda item: -item[1])),
        violation=clopper_pearson(whole.violated[PASSED], whole.asked[PASSED], confidence),
        requirements=tuple(requirements),
        worst=tuple(overall.found) if overall else (),
        confidence=confidence,
    )


def _requirement(
    figure: str,
    manoeuvre: str | None,
    limit: float | None,
    tally: _Tally,
    confidence: float,
    worst: tuple[RunFigure, ...],
) -> RequirementStatistics:
    spread = tally.distributions.get(figure)
    return RequirementStatistics(
        figure=figure,
        manoeuvre=manoeuvre,
        limit=limit,
        violation=clopper_pearson(tally.violated[figure], tally.asked[figure], confidence),
        quantiles={} if spread is None else {share: spread.quantile(share) for share in QUANTILES},
        largest=float("nan") if spread is None else spread.largest,
        distribution=spread,
        worst=worst,
    )
