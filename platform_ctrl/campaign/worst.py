"""The runs of a campaign that came nearest to a limit, or went farthest beyond it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.campaign.table import ENDED, PASSED, RUN, Array
from platform_ctrl.frozen import FloatArray, value


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

    References
    ----------
    See docs/campaign.md.
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
