"""What options of a design do to requirements, and which of them is best moved."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from platform_ctrl.analysis.loop_metrics import LoopMetrics
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import PlatformCtrlError
from platform_ctrl.job.judging import CheckResult
from platform_ctrl.job.requirements import LoopRequirement

# Share of its value by which an option is moved to see what it does.
SHARE = 0.05
# Relative moves of an option that are considered, and how many are tried after the estimate.
MOVES, _TRIED = (-0.2, -0.1, -0.05, -0.025, 0.025, 0.05, 0.1, 0.2), 4
# Least reduction of a ratio that is worth a move, and least loss of margin that is called a cost.
_GAIN, _COST = 2e-3, 1e-3

# How bad ratios (R,) are: of two moves the one with the smaller number is better.
Score = Callable[[FloatArray], float]


@value
class OptionValue:
    """An option that may be moved between `low` and `high`, in the units of the job file; `value` is not zero."""

    name: str
    value: float
    low: float = 0.0
    high: float = np.inf

    def moved(self, after: float, part: float) -> float:
        """Return the value after a part of the move to `after`."""
        return float(f"{self.value * (after / self.value) ** part:.3g}")


@value
class OptionEffects:
    """The effect of each option on each requirement.

    `ratios` (R,) are those of the `requirements`, at most 1 where met. `change` (R, K) is the change of a ratio for an
    option that is 5 % larger: negative is better, inf where the loop becomes unstable, nan where it is already.
    """

    options: tuple[str, ...]
    requirements: tuple[str, ...]
    ratios: FloatArray
    change: FloatArray


@value
class ResultChange:
    """A requirement before and after a move."""

    before: CheckResult
    after: CheckResult


@value
class OptionMove:
    """An option moved to another value: what the target gains, and the requirement that loses most margin, or None."""

    option: str
    after: float
    gain: ResultChange
    cost: ResultChange | None


def option_effects(
    options: Sequence[str],
    requirements: Sequence[str],
    before: FloatArray,
    after: Sequence[Callable[[], FloatArray]],
) -> OptionEffects:
    """Return the effects of `options`; `after` computes the ratios (R,) with each of them 5 % larger."""
    change = np.full((len(before), len(options)), np.nan)
    for k, ratios in enumerate(after):
        try:
            moved = ratios()
        except PlatformCtrlError:
            continue
        with np.errstate(invalid="ignore"):
            change[:, k] = moved - before
    return OptionEffects(options=tuple(options), requirements=tuple(requirements), ratios=before, change=change)


def largest(ratios: FloatArray) -> float:
    """Return the largest ratio, the score of a design as a whole."""
    return float(ratios.max())


def candidates(
    effects: OptionEffects, options: Sequence[OptionValue], score: Score = largest, moves: Sequence[float] = MOVES
) -> list[tuple[str, float]]:
    """Return the names of options with new values, those first that are expected to help most.

    All ratios are taken to be linear in the option; of each option the best of the relative `moves` counts.
    """
    column = {name: k for k, name in enumerate(effects.options)}
    found = []
    for option in options:
        slope = effects.change[:, column[option.name]] / SHARE
        if not np.all(np.isfinite(slope)):
            continue
        for move in moves:
            after = float(f"{option.value * (1.0 + move):.4g}")
            expected = score(effects.ratios + slope * move)
            if option.low <= after <= option.high and np.isfinite(expected):
                found.append((expected, option.name, after))
    found.sort(key=lambda one: one[0])
    out: dict[str, tuple[str, float]] = {}
    for _, name, after in found:
        out.setdefault(name, (name, after))
    return list(out.values())[:_TRIED]


def best_move(
    before: Sequence[CheckResult],
    target: int,
    tried: Sequence[tuple[str, float]],
    results: Callable[[str, float], Sequence[CheckResult]],
    score: Score = largest,
) -> OptionMove | None:
    """Return the best of the moves that are `tried`, measured by `results`; None where none helps the `target`."""
    best, step = _score(before, score) - _GAIN * before[target].ratio, None
    for name, after in tried:
        try:
            found = results(name, after)
        except PlatformCtrlError:
            continue
        reached = _score(found, score)
        if reached >= best:
            continue
        best = reached
        cost = largest_loss(before, found)
        step = OptionMove(
            option=name, after=after, gain=ResultChange(before=before[target], after=found[target]), cost=cost
        )
    return step


def _score(results: Sequence[CheckResult], score: Score) -> float:
    return score(np.array([one.ratio for one in results]))


def largest_loss(before: Sequence[CheckResult], after: Sequence[CheckResult]) -> ResultChange | None:
    """Return the requirement that loses most margin, those with more than 100 % apart; None where none loses any."""
    losses = [min(a.margin, 1.0) - min(b.margin, 1.0) for a, b in zip(before, after, strict=True)]
    dearest = int(np.argmax(losses))
    return ResultChange(before=before[dearest], after=after[dearest]) if losses[dearest] > _COST else None


def deciding(measures: LoopMetrics, requests: Sequence[LoopRequirement]) -> list[int]:
    """Return the nominal plant and the two that are worst for each requirement."""
    out = {0}
    for one in requests:
        ratios = one.ratios(measures)
        if one.metric.of != "controller" and one.beyond_nominal and len(ratios):
            plants = np.flatnonzero(measures.of(one.over))
            out |= {int(plants[k]) for k in np.argsort(-ratios)[:2]}
    return sorted(out)


def largest_ratios(measures: LoopMetrics, requests: Sequence[LoopRequirement]) -> FloatArray:
    """Return the largest ratio of each requirement (k,)."""
    return np.array([float(one.ratios(measures).max(initial=0.0)) for one in requests])
