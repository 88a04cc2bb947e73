"""What has moved since a baseline was accepted."""

from __future__ import annotations

import math
from functools import partial
from typing import Literal

from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.values import value
from platform_ctrl.job.judging import Sense
from platform_ctrl.verification import JobResult
from platform_ctrl.verification.baselines.record import (
    AcceptedFigure,
    Baseline,
    Figure,
    LoopMatrices,
    figures_of,
    loops_of,
)

State = Literal["within", "worse", "better", "missing", "new"]


@value
class Change:
    """One figure, before and now.

    Attributes
    ----------
    subject, name, unit, sense
        Which; see `Figure`.
    before, now
        The accepted value and the measured one, in `unit`; None where there is none.
    allowed
        How far `now` may be worse than `before`, in `unit`.
    state
        ``"within"`` the tolerance, ``"worse"`` or ``"better"`` by more than it, ``"missing"``: accepted once and
        measured no more, ``"new"``: measured and not in the baseline.
    limit
        The limit in the job, in `unit`; None without one.
    """

    subject: str
    name: str
    unit: str
    sense: Sense
    before: float | None
    now: float | None
    allowed: float
    state: State
    limit: float | None = None

    @property
    def loss(self) -> float:
        """How much worse it has become, in `unit`: negative where it is better, infinite where it is no number now."""
        before, now = (math.inf if number is None else number for number in (self.before, self.now))
        if math.isfinite(before) and math.isfinite(now):
            return before - now if self.sense == "at least" else now - before
        if math.isfinite(before):
            return math.inf
        return -math.inf if math.isfinite(now) else 0.0

    @property
    def share(self) -> float:
        """The change as a share of the accepted value, with its sign; not a number where it cannot be said."""
        if self.before is None or self.now is None or not math.isfinite(self.before) or self.before == 0.0:
            return math.nan
        return (self.now - self.before) / abs(self.before)

    @property
    def of_tolerance(self) -> float:
        """The ratio of `loss` to `allowed`: above 1 where it is worse beyond its tolerance."""
        if self.loss == 0.0:
            return 0.0
        return self.loss / self.allowed if self.allowed > 0.0 else math.copysign(math.inf, self.loss)


@value
class Comparison:
    """A job compared with its baseline.

    Attributes
    ----------
    changes
        One for every figure: those of the job in its order, then those that are missing.
    before, now
        The closed loops, by the same name where both have it.
    """

    changes: tuple[Change, ...]
    before: tuple[LoopMatrices, ...]
    now: tuple[LoopMatrices, ...]

    def of(self, *states: State) -> tuple[Change, ...]:
        """Return the changes in one of a few states.

        Parameters
        ----------
        *states
            As of `Change.state`.

        Returns
        -------
        tuple of Change
            In the order of `changes`.
        """
        return tuple(change for change in self.changes if change.state in states)

    @property
    def failed(self) -> tuple[Change, ...]:
        """What is worse beyond its tolerance, or no longer measured."""
        return self.of("worse", "missing")

    @property
    def passed(self) -> bool:
        """Whether nothing is worse and nothing missing; what is better or new is no failure."""
        return not self.failed

    @property
    def pairs(self) -> tuple[tuple[LoopMatrices, LoopMatrices], ...]:
        """The loops that both have, before and now."""
        found = {loop.loop: loop for loop in self.before}
        return tuple((found[loop.loop], loop) for loop in self.now if loop.loop in found)


@check_arguments
def compare(result: JobResult, baseline: Baseline) -> Comparison:
    """Compare the figures of a job with accepted ones.

    Parameters
    ----------
    result
        From `verification.check_job`.
    baseline
        From `read_baseline`, or `accepted`.

    Returns
    -------
    Comparison
        `Comparison.passed` unless a figure is worse beyond its tolerance, or no longer there. A figure that was a
        finite number and is none now (an unstable loop, a run that diverged) is worse whatever its tolerance.
    """
    known = {figure.key: figure for figure in baseline.figures}
    measured = figures_of(result)
    changes = [_change(figure, known.get(figure.key), baseline) for figure in measured]
    seen = {figure.key for figure in measured}
    changes += [_made(figure, "missing", figure.value, None) for figure in baseline.figures if figure.key not in seen]
    return Comparison(changes=tuple(changes), before=baseline.loops, now=loops_of(result))


def _change(figure: Figure, before: AcceptedFigure | None, baseline: Baseline) -> Change:
    made = partial(_made, figure, now=figure.value, limit=figure.limit)
    if before is None:
        return made("new", None)
    tolerance = before.tolerance or baseline.tolerance
    allowed = tolerance.allowed(before.value) if math.isfinite(before.value) else 0.0
    loss = made("within", before.value, allowed=allowed).loss
    # A figure at its tolerance is within it, whatever the last bit says.
    edge = allowed * (1.0 + 1e-9) + 1e-9 * abs(before.value) if math.isfinite(before.value) else 0.0
    return made("worse" if loss > edge else "better" if loss < -edge else "within", before.value, allowed=allowed)


def _made(
    figure: Figure | AcceptedFigure,
    state: State,
    before: float | None,
    now: float | None,
    allowed: float = 0.0,
    limit: float | None = None,
) -> Change:
    return Change(
        subject=figure.subject,
        name=figure.name,
        unit=figure.unit,
        sense=figure.sense,
        before=before,
        now=now,
        allowed=allowed,
        state=state,
        limit=limit,
    )
