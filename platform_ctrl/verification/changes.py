"""What would take missed requirements of a checked job to their limits, and what that costs elsewhere.

Nothing is designed again: options are moved of designs that are built from them directly, the gain of others is scaled,
another design of the loop is closed, a source of the budget is made smaller. A change is measured in its own loop, in a
loop around it, in the coupled system and in the budget; simulated runs are not repeated.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np

from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.tuning import ResultChange, Score, largest_loss
from platform_ctrl.job.judging import CheckResult
from platform_ctrl.verification.budget_limits import LINE_OF_SIGHT, reduced_source
from platform_ctrl.verification.linear_trials import Key, LinearTrials, Trial

if TYPE_CHECKING:
    from platform_ctrl.verification.verdict import JobResult

# Rows that are returned; missed requirements that are looked at for them.
_ROWS, _TARGETS = 5, 8
# Ratio that is wanted of a missed requirement: moves are estimated, and not all errors are on one side.
_MET = 0.99
# Share of what is wanted, and of the ratio, that a change has to gain: the less of the two.
_LEAST, _GAIN = 0.5, 0.05
# How much it counts that a missed limit is still missed, beside the share that is left of it.
_MISSED = 0.5
# How much lost margin counts beside limits that are violated, and the largest ratio that is told from others.
_LOSS, _WORST = 0.05, 10.0
# A limit that is missed already is violated further by more than rounding.
_FURTHER = 1.001
# Factor of a source's amplitude where its limit is met.
_SMALLER = 0.9

Kind = Literal["option", "gain", "design", "source"]


@value
class Change:
    """A change of one number or design, with what it does to the requirement that it is for.

    Attributes
    ----------
    kind
        ``"option"`` of a design, ``"gain"`` of a controller as a whole, another ``"design"`` of the loop, or a
        ``"source"`` of the budget.
    loop, design
        Where; empty for a source.
    name
        Option, other design, or source.
    before, after
        Of an option, in the units of the job file; of a gain, and of the amplitude of a source, 1 and the factor; of a
        design nan.
    target
        The requirement that it is for.
    violated
        Requirements that it takes beyond their limits, or further beyond, the worst first.
    loss
        The requirement that loses most margin; None where none does.
    """

    kind: Kind
    loop: str
    design: str
    name: str
    before: float
    after: float
    target: ResultChange
    violated: tuple[ResultChange, ...] = ()
    loss: ResultChange | None = None


def changes(result: JobResult) -> tuple[Change, ...]:
    """Return at most five changes for missed requirements: what takes each to its limit, or nearer to it.

    There is none for a requirement of which no single change gains half of that, and none that only a new design or a
    simulated run could measure.
    """
    if result.passed:
        return ()
    trials = LinearTrials(result)
    out: dict[tuple[str, str, float], Change] = {}
    with np.errstate(all="ignore"):
        targets = _targets(trials.before)
        queues: dict[Key, list[Trial | Change]] = {}
        # The best for each target, then a second one.
        for key in targets * 2:
            if key not in queues:
                queues[key] = _ranked(result, trials, key)
            found = _next(trials, key, queues[key], out)
            if found is not None:
                out[found.loop, found.name, found.after] = found
            if len(out) == _ROWS:
                break
    return tuple(out.values())


def _targets(before: dict[Key, CheckResult]) -> list[Key]:
    """Return the requirements that are missed, those by most first."""
    missed = [key for key in before if before[key].ratio > 1.0]
    return sorted(missed, key=lambda key: before[key].margin)[:_TARGETS]


def _ranked(result: JobResult, trials: LinearTrials, target: Key) -> list[Trial | Change]:
    """Return trials for a requirement, one of each option, gain or design, the best first.

    A source of the budget that suffices leads.
    """
    own, keys = trials.before[target], list(trials.before)
    ratios = np.array([one.ratio for one in trials.before.values()])
    score = _score(keys.index(target), ratios)
    scope = trials.scope(target)
    scored = []
    for loop in trials.loops_for(target):
        for one in trials.trials(loop, score, scope):
            measured = trials.results(one, exact=False, scope=scope)
            if measured is not None:
                scored.append((score(np.array([measured[key].ratio for key in keys])), one))
    scored = sorted((one for one in scored if math.isfinite(one[0])), key=lambda one: one[0])
    best = {(one.kind, one.loop, one.name): one for _, one in reversed(scored)}
    found: list[Trial | Change] = [one for _, one in scored if one in best.values()]
    source = _source(result, own)
    if source is not None:
        # It costs nothing in the loops.
        found.insert(0 if source.target.after.passed else 1, source)
    return found


def _next(
    trials: LinearTrials, target: Key, queue: list[Trial | Change], known: dict[tuple[str, str, float], Change]
) -> Change | None:
    """Return the next change for a requirement that is not among the known ones, and take it from the queue."""
    while queue:
        one = queue.pop(0)
        if (one.loop, one.name, one.after) not in known:
            found = one if isinstance(one, Change) else _measured(trials, one, target)
            if found is not None:
                return found
    return None


def _score(at: int, before: FloatArray) -> Score:
    """Return how far from its limit ratio `at` is left, and what is violated for that; inf without a gain."""
    size = before[at] - _MET
    least = min(_LEAST * size, _GAIN * before[at])
    known = np.clip(before, 0.0, _WORST)

    def of(ratios: FloatArray) -> float:
        if not before[at] - ratios[at] >= least and not (np.isinf(before[at]) and np.isfinite(ratios[at])):
            return math.inf
        if np.any(~np.isfinite(ratios) & np.isfinite(before)):
            return math.inf
        now = np.clip(np.nan_to_num(ratios, nan=_WORST), 0.0, _WORST)
        others = np.delete(now, at)
        allowed = np.maximum(np.delete(known, at), 1.0)
        short = max(ratios[at] - _MET, 0.0) / (size if np.isfinite(size) else 1.0)
        lost = float((others - np.delete(known, at)).max(initial=0.0))
        missed = _MISSED if now[at] > 1.0 else 0.0
        return float(short + missed + np.maximum(others - allowed, 0.0).sum() + _LOSS * lost)

    return of


def _measured(trials: LinearTrials, trial: Trial, target: Key) -> Change | None:
    """Return a trial measured as `check_job` does it; None where that finds no gain."""
    before, after = trials.before, trials.results(trial, exact=True, scope="all")
    if after is None or not after[target].ratio < before[target].ratio:
        return None
    pairs = [ResultChange(before=before[key], after=after[key]) for key in before if key != target]
    violated = [
        one
        for one in pairs
        if not one.after.passed and (one.before.passed or one.after.ratio > _FURTHER * one.before.ratio)
    ]
    return Change(
        kind=trial.kind,
        loop=trial.loop,
        design=trial.design,
        name=trial.name,
        before=trial.before,
        after=trial.after,
        target=ResultChange(before=before[target], after=after[target]),
        violated=tuple(sorted(violated, key=lambda one: -one.after.ratio)),
        loss=_loss(pairs),
    )


def _loss(pairs: Sequence[ResultChange]) -> ResultChange | None:
    return largest_loss([one.before for one in pairs], [one.after for one in pairs]) if pairs else None


def _source(result: JobResult, target: CheckResult) -> Change | None:
    """Return the source of the budget that counts most for `target`, smaller: to the limit if that is possible."""
    if result.budget is None or target.subject != LINE_OF_SIGHT or target.stage != "coupled":
        return None
    found = reduced_source(result.budget.names, result.budget.rms, target, _SMALLER)
    if found is None:
        return None
    name, factor, after = found
    pair = ResultChange(before=target, after=after)
    return Change(kind="source", loop="", design="", name=name, before=1.0, after=factor, target=pair)
