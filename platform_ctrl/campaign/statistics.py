"""What a campaign says: how often each requirement is violated, with bounds, quantiles, and the worst runs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.campaign.probability import CONFIDENCE, Distribution, Probability, clopper_pearson
from platform_ctrl.campaign.table import (
    DIVERGED,
    ENDED,
    FIGURES,
    MANOEUVRE,
    NOT_FLOWN,
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
class RunFigure:
    """One run's figure held against its limit.

    Attributes
    ----------
    run, manoeuvre, ended
        Which run, and how it ended; ``platform-ctrl simulate JOB.toml --run RUN`` flies it again.
    figure
        Name of the limit.
    value, limit, ratio
        The figure, what is asked at most, both in its unit (rad, rad, share), and the ratio of the one to the other
        (above 1: violated); infinite where it diverged.
    """

    run: int
    manoeuvre: str
    figure: str
    value: float
    limit: float
    ratio: float
    ended: str


class WorstRuns:
    """The `keep` runs with the largest figures over their limits, of each requirement; ties go to the lower run."""

    def __init__(self, keep: int) -> None:
        self.keep = keep
        self._found: dict[tuple[str, str | None], list[RunFigure]] = {}

    def of(self, figure: str, manoeuvre: str | None) -> tuple[RunFigure, ...]:
        """Return the worst runs of one requirement, the worst first."""
        return tuple(self._found.get((figure, manoeuvre), ()))

    def see(
        self,
        batch: Mapping[str, Array],
        asked: Mapping[str, FloatArray],
        place: NDArray[np.intp],
        names: Sequence[str],
    ) -> None:
        """Look at some runs.

        Parameters
        ----------
        batch
            Columns of the table.
        asked
            Every run's limit of each figure; NaN where its manoeuvre asks nothing.
        place, names
            Every run's manoeuvre.
        """
        if not asked or not place.size:
            return
        figures = tuple(asked)
        limit = np.array([asked[figure] for figure in figures])
        figure = np.array([batch[name] for name in figures])
        figure = np.where(np.isfinite(figure), figure, np.inf)
        # Where nothing is asked no figure is bad.
        ratio = np.where(np.isnan(limit), -np.inf, figure / limit)
        worst = ratio.argmax(axis=0)
        for k, name in enumerate(figures):
            which = np.full(len(place), k)
            self._see((name, None), batch, figures, (figure, limit, ratio), which, place, names)
            for m, manoeuvre in enumerate(names):
                here = np.where(place == m, ratio, -np.inf)
                self._see((name, manoeuvre), batch, figures, (figure, limit, here), which, place, names)
        self._see((PASSED, None), batch, figures, (figure, limit, ratio), worst, place, names)
        for m, manoeuvre in enumerate(names):
            here = np.where(place == m, ratio, -np.inf)
            self._see((PASSED, manoeuvre), batch, figures, (figure, limit, here), worst, place, names)

    def _see(
        self,
        key: tuple[str, str | None],
        batch: Mapping[str, Array],
        figures: Sequence[str],
        numbers: tuple[FloatArray, FloatArray, FloatArray],
        which: NDArray[np.intp],
        place: NDArray[np.intp],
        names: Sequence[str],
    ) -> None:
        figure, limit, ratio = (one[which, np.arange(len(place))] for one in numbers)
        found = self._found.setdefault(key, [])
        least = found[-1].ratio if len(found) == self.keep else -np.inf
        rows = np.flatnonzero((ratio >= least) & (ratio > -np.inf))
        rows = rows[np.lexsort((batch[RUN][rows], -ratio[rows]))[: self.keep]]
        more = [
            RunFigure(
                run=int(batch[RUN][k]),
                manoeuvre=names[place[k]],
                figure=figures[which[k]],
                value=float(figure[k]),
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
    figure
        Name of the limit: ``"angle"``, ``"attitude"``, ``"torque_share"``; or ``"passed"``: all that are asked.
    manoeuvre
        The manoeuvre, or None over all.
    limit
        What is asked at most, in the figure's unit (rad, rad, share of the torque limit); None for ``"passed"``. Over
        all manoeuvres a figure counts relative to its manoeuvre's limit, and this is 1.
    violation
        How often it is violated, of the runs that were flown and of which it is asked. A run that diverged violates
        whatever is asked of it.
    quantiles
        Figure, in the unit of `limit`, by share of the runs; empty for ``"passed"``. Infinite where that share of the
        runs did not do.
    largest
        Largest figure, in the unit of `limit`.
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
        Of all bounds, a probability.
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

    @check_arguments
    def of(self, figure: str, manoeuvre: str | None = None) -> RequirementStatistics:
        """Return the statistics of one requirement, over all manoeuvres by default.

        Parameters
        ----------
        figure
            ``"angle"``, ``"attitude"``, ``"torque_share"`` or ``"passed"``.
        manoeuvre
            Its name; None: over all.

        Returns
        -------
        RequirementStatistics
            Of this figure there.

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


@check_arguments
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
        What each manoeuvre asks of each figure at most: `Manoeuvre.limits` by name, SI units.
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
    figures = [name for name in FIGURES if name in present]
    answers = [name for name in (f"{figure}_passed" for figure in figures) if name in present]
    counted = _Counted(worst)
    for batch in batches(table, (RUN, MANOEUVRE, *figures, *answers, PASSED, ENDED)):
        counted.see(batch, figures, limits)
    return counted.summed(limits, confidence)


def limits_of(names: Iterable[str], figure: str, limits: Limits) -> FloatArray:
    """Return what each manoeuvre asks of a figure at most; NaN where it asks nothing."""
    return np.array([limits.get(name, {}).get(figure, np.nan) for name in names])


class _Tally:
    """Counts of some runs."""

    def __init__(self) -> None:
        self.asked = dict.fromkeys((*FIGURES, PASSED), 0)
        self.violated = dict.fromkeys((*FIGURES, PASSED), 0)
        self.distributions: dict[str, Distribution] = {}

    def answer(self, figure: str, answers: Array) -> None:
        self.asked[figure] += int((answers >= 0).sum())
        self.violated[figure] += int((answers == 0).sum())

    def spread(self, figure: str, figures: Array) -> None:
        self.distributions.setdefault(figure, Distribution()).add(figures)

    def requirement(
        self, figure: str, manoeuvre: str | None, limit: float | None, confidence: float, worst: tuple[RunFigure, ...]
    ) -> RequirementStatistics:
        spread = self.distributions.get(figure)
        return RequirementStatistics(
            figure=figure,
            manoeuvre=manoeuvre,
            limit=limit,
            violation=clopper_pearson(self.violated[figure], self.asked[figure], confidence),
            quantiles={} if spread is None else {share: spread.quantile(share) for share in QUANTILES},
            largest=float("nan") if spread is None else spread.largest,
            distribution=spread,
            worst=worst,
        )


class _Counted:
    """Everything that is counted of a table, a piece after the other."""

    def __init__(self, keep: int) -> None:
        self.runs = self.flown = self.diverged = 0
        self.endings: dict[str, int] = {}
        self.known: dict[str, int] = {}
        self.tallies: list[_Tally] = []
        self.whole = _Tally()
        self.worst = WorstRuns(keep)

    def see(self, batch: Mapping[str, Array], figures: Sequence[str], limits: Limits) -> None:
        """Count some runs."""
        flown = self._endings(batch[ENDED])
        batch = {name: column[flown] for name, column in batch.items()}
        place = codes(batch[MANOEUVRE], self.known)
        self.tallies += [_Tally() for _ in range(len(self.known) - len(self.tallies))]
        names = list(self.known)
        asked = {figure: limits_of(names, figure, limits)[place] for figure in figures} if names else {}
        self.whole.answer(PASSED, batch[PASSED])
        for figure, limit in asked.items():
            # Where it is not asked a figure means something else: the attitude of a platform that is turned on purpose.
            own = ~np.isnan(limit)
            self.whole.spread(figure, batch[figure][own] / limit[own])
            if f"{figure}_passed" in batch:
                self.whole.answer(figure, batch[f"{figure}_passed"])
        for k, tally in enumerate(self.tallies):
            here = place == k
            if not here.any():
                continue
            tally.answer(PASSED, batch[PASSED][here])
            for figure in figures:
                tally.spread(figure, batch[figure][here])
                if f"{figure}_passed" in batch:
                    tally.answer(figure, batch[f"{figure}_passed"][here])
        self.worst.see(batch, asked, place, names)

    def _endings(self, ended: Array) -> NDArray[np.bool_]:
        """Count how runs ended; return which of them were flown."""
        known: dict[str, int] = {}
        exact = codes(ended, known)
        numbers = np.bincount(exact, minlength=len(known))
        for text, number in zip(known, numbers, strict=True):
            kind = DIVERGED if text.startswith(DIVERGED) else text
            kind = kind if kind in self.endings or len(self.endings) < _MOST_ENDINGS else "other reasons"
            self.endings[kind] = self.endings.get(kind, 0) + int(number)
        flown = ~np.array([text.startswith(NOT_FLOWN) for text in known], dtype=bool)[exact]
        self.runs += len(ended)
        self.flown += int(flown.sum())
        self.diverged += int(np.array([text.startswith(DIVERGED) for text in known], dtype=bool)[exact].sum())
        return np.asarray(flown)

    def summed(self, limits: Limits, confidence: float) -> CampaignStatistics:
        """Return what was counted."""
        requirements = [
            self.whole.requirement(
                figure, None, None if figure == PASSED else 1.0, confidence, self.worst.of(figure, None)
            )
            for figure in (*FIGURES, PASSED)
            if self.whole.asked[figure]
        ]
        # In the order of the job file, whatever was drawn first.
        for name in sorted(self.known, key=lambda name: list(limits).index(name) if name in limits else len(limits)):
            tally = self.tallies[self.known[name]]
            requirements += [
                tally.requirement(
                    figure, name, limits.get(name, {}).get(figure), confidence, self.worst.of(figure, name)
                )
                for figure in (*FIGURES, PASSED)
                if tally.asked[figure]
            ]
        return CampaignStatistics(
            runs=self.runs,
            flown=self.flown,
            diverged=self.diverged,
            endings=dict(sorted(self.endings.items(), key=lambda item: -item[1])),
            violation=clopper_pearson(self.whole.violated[PASSED], self.whole.asked[PASSED], confidence),
            requirements=tuple(requirements),
            worst=self.worst.of(PASSED, None),
            confidence=confidence,
        )
