"""Changes that would take missed requirements of a checked job to their limits, and their price elsewhere.

Nothing is designed again: options are moved of designs that are built from them directly, or another design of the loop
is closed. A change is measured in its own loop, in a loop around it, in the coupled system and in the budget; simulated
runs are not repeated.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from platform_ctrl.analysis.loop_metrics import measure
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design import tuning
from platform_ctrl.design.loop import Design, LoopOutcome, commanded, limits_and_goals, takes_commands, with_commands
from platform_ctrl.design.method import LoopProblem
from platform_ctrl.design.methods import METHODS
from platform_ctrl.design.plants import tracking_plants
from platform_ctrl.errors import PlatformCtrlError
from platform_ctrl.job.judging import CheckResult
from platform_ctrl.verification.budget import PreparedBudget
from platform_ctrl.verification.coupled import coupled_check

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
# How much lost margin counts beside limits that are violated, and the ratio beyond which all count alike.
_LOSS, _WORST = 0.05, 10.0
# A limit that is missed already is violated further by more than rounding.
_FURTHER = 1.001
# Relative moves of an option: wider than those of a slider, since a missed limit may be far.
_MOVES = (*(-0.05 * k for k in range(10, 0, -1)), *(0.05 * k for k in range(1, 11)), 0.6, 0.8, 1.0)
# Shares of the move that is expected to be best that are tried: nothing is as linear as expected.
_PARTS = (0.6, 1.0, 1.4)

# What is measured beside the changed loop itself.
Scope = Literal["loop", "budget", "coupled", "all"]
# Subject, stage and name of a requirement.
Key = tuple[str, str, str]
Results = dict[Key, CheckResult]


def keyed(results: Sequence[CheckResult]) -> Results:
    """Return results by subject, stage and name."""
    return {(one.subject, one.stage, one.name): one for one in results}


@value
class Change:
    """A change of one number or design, with what it does to the requirement that it is for.

    Attributes
    ----------
    kind
        ``"option"`` of a design, or another ``"design"`` of the loop.
    loop, design
        Where.
    name
        Option, or other design.
    before, after
        Of an option, in the units of the job file; of a design nan.
    target
        The requirement that it is for.
    violated
        Requirements that it takes beyond their limits, or further beyond, the worst first.
    loss
        The requirement that loses most margin; None where none does.
    """

    kind: Literal["option", "design"]
    loop: str
    design: str
    name: str
    before: float
    after: float
    target: tuning.ResultChange
    violated: tuple[tuning.ResultChange, ...] = ()
    loss: tuning.ResultChange | None = None


class _Trial(NamedTuple):
    """An option of a loop's closed design at another value, or another design closed in the loop."""

    kind: Literal["option", "design"]
    loop: str
    design: str
    name: str
    before: float = math.nan
    after: float = math.nan


def changes(result: JobResult) -> tuple[Change, ...]:
    """Return at most five changes for missed requirements: each takes a requirement to its limit, or nearer to it.

    A requirement is left out if no single change gains half of that, and so are changes that only a new design or a
    simulated run could measure.
    """
    if result.passed:
        return ()
    trials = _Trials(result)
    out: dict[_Trial, Change] = {}
    with np.errstate(all="ignore"):
        missed = sorted((key for key, one in trials.before.items() if one.ratio > 1.0), key=trials.margin)[:_TARGETS]
        queues: dict[Key, list[_Trial]] = {}
        # The best for each target, then a second one.
        for key in missed * 2:
            if key not in queues:
                queues[key] = trials.ranked(key)
            queue, found = queues[key], None
            while queue and found is None:
                if (trial := queue.pop(0)) not in out:
                    found = _change(trials, trial, key)
            if found is not None:
                out[trial] = found
            if len(out) == _ROWS:
                break
    return tuple(out.values())


def _score(at: int, before: FloatArray) -> tuning.Score:
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


def _change(trials: _Trials, trial: _Trial, target: Key) -> Change | None:
    """Return a trial measured as `check_job` does it; None where that finds no gain."""
    before, after = trials.before, trials.results(trial, exact=True, scope="all")
    if after is None or not after[target].ratio < before[target].ratio:
        return None
    pairs = [tuning.ResultChange(before=before[key], after=after[key]) for key in before if key != target]
    violated = [
        one
        for one in pairs
        if not one.after.passed and (one.before.passed or one.after.ratio > _FURTHER * one.before.ratio)
    ]
    return Change(
        **trial._asdict(),
        target=tuning.ResultChange(before=before[target], after=after[target]),
        violated=tuple(sorted(violated, key=lambda one: -one.after.ratio)),
        loss=tuning.largest_loss([one.before for one in pairs], [one.after for one in pairs]) if pairs else None,
    )


class _Trials:
    """The requirements of a checked job that are measured without a simulated run, with one design changed."""

    def __init__(self, result: JobResult) -> None:
        self._job, self._model = result.job, result.model
        self._outcomes = {outcome.spec.name: outcome for outcome in result.loops}
        self._around = {one.spec.around: one for one in result.loops if one.spec.around}
        self._budgeted = keyed(() if result.budget is None else result.budget.results)
        self._coupled = keyed(() if result.coupled is None else result.coupled.results)
        own = keyed([one for outcome in result.loops for one in outcome.closed.results])
        self.before = own | self._coupled | self._budgeted
        self._effects: dict[tuple[str, Scope], tuning.OptionEffects] = {}
        self._results: dict[tuple[_Trial, bool, Scope], Results | None] = {}

    def margin(self, key: Key) -> float:
        """Return the margin of a requirement."""
        return self.before[key].margin

    def ranked(self, target: Key) -> list[_Trial]:
        """Return trials for a requirement, one of each option or design, the best first."""
        keys = list(self.before)
        score = _score(keys.index(target), np.array([one.ratio for one in self.before.values()]))
        scope: Scope = "budget" if target in self._budgeted else "coupled" if target in self._coupled else "loop"
        loops = list(self._outcomes)
        if target not in self._budgeted and target[0] in self._outcomes:
            loops = [one for one in (target[0], self._outcomes[target[0]].spec.around) if one]
        scored = []
        for trial in (one for loop in loops for one in self._proposed(loop, score, scope)):
            measured = self.results(trial, exact=False, scope=scope)
            if measured is not None:
                scored.append((score(np.array([measured[key].ratio for key in keys])), trial))
        scored = sorted((one for one in scored if math.isfinite(one[0])), key=lambda one: one[0])
        best = {(one.kind, one.loop, one.name): one for _, one in reversed(scored)}
        return [one for _, one in scored if one in best.values()]

    def _proposed(self, loop: str, score: tuning.Score, scope: Scope) -> list[_Trial]:
        """Return the other designs of a loop, and the moves of its closed one that are expected to help most.

        For the coupled system the best move of a gain alone, as expected: each costs a coupled check.
        """
        outcome = self._outcomes[loop]
        out = [_Trial("design", loop, one.name, one.name) for one in outcome.alternatives]
        options = {one.name: one for one in self._options(outcome, gains=scope == "coupled")}
        if not options:
            return out
        found = tuning.candidates(self._effects_of(outcome, options, scope), list(options.values()), score, _MOVES)
        if scope == "coupled":
            found = found[:1]
        else:
            found = [(name, options[name].moved(after, part)) for name, after in found for part in _PARTS]
        return out + [
            _Trial("option", loop, outcome.closed.name, name, options[name].value, after)
            for name, after in found
            if options[name].low <= after <= options[name].high
        ]

    def results(self, trial: _Trial, exact: bool, scope: Scope) -> Results | None:
        """Return all requirements with a trial, None where it makes no loop.

        Of the changed loop they are `exact` or those on a grid; what is not in the scope is as before.
        """
        # Another design is measured already.
        key = (trial, exact or trial.kind == "design", scope)
        if key not in self._results:
            try:
                self._results[key] = self._measured(trial, exact, scope)
            except PlatformCtrlError:
                self._results[key] = None
        return self._results[key]

    def _measured(self, trial: _Trial, exact: bool, scope: Scope) -> Results:
        outcome = self._outcomes[trial.loop]
        if trial.kind == "design":
            design = next(one for one in outcome.designs if one.name == trial.name)
            own = keyed(design.results)
        else:
            closed, problem = outcome.closed, self._problem(outcome)
            assert problem is not None, "a loop with moves has a problem"
            moved = dataclasses.replace(problem.design, options={**closed.options, trial.name: trial.after}, tune=False)
            problem = dataclasses.replace(problem, design=moved)
            made = METHODS[closed.method].design(problem)
            design = commanded(made) if takes_commands(closed) else made
            own = {} if design.plants is None else _own(outcome, design, exact)
        out = self.before | own
        around = self._around.get(trial.loop)
        if around is not None:
            assert design.plants is not None, "a rate loop has plants"
            K = with_commands(design.plants, design.controller)
            plants = tracking_plants(self._job, around.spec, outcome.spec, design.plants, K)[0]
            out |= _own(around, dataclasses.replace(around.closed, plants=plants), exact)
        controllers = [
            design.controller if name == trial.loop else one.closed.controller for name, one in self._outcomes.items()
        ]
        if self._budgeted and scope in ("budget", "all"):
            # A design that reads other signals needs a budget of its own.
            same = list(outcome.closed.controller.input_labels) == list(design.controller.input_labels)
            found = self._budget.of(controllers) if same else PreparedBudget(self._job, controllers).first
            out |= keyed(found.results)
        if scope in ("coupled", "all"):
            out |= keyed(coupled_check(self._job, self._model, controllers).results)
        return out

    @cached_property
    def _budget(self) -> PreparedBudget:
        return PreparedBudget(self._job, [one.closed.controller for one in self._outcomes.values()])

    def _effects_of(
        self, outcome: LoopOutcome, options: dict[str, tuning.OptionValue], scope: Scope
    ) -> tuning.OptionEffects:
        loop, closed = outcome.spec.name, outcome.closed.name
        if (loop, scope) not in self._effects:

            def ratios(option: tuning.OptionValue, factor: float) -> FloatArray:
                trial = _Trial("option", loop, closed, option.name, option.value, factor * option.value)
                # As it is, all beside the loop is known.
                found = self._measured(trial, exact=False, scope=scope if factor != 1.0 else "loop")
                return np.array([found[key].ratio for key in self.before])

            found = tuning.option_effects(
                list(options),
                [name for _, _, name in self.before],
                ratios(next(iter(options.values())), 1.0),
                [lambda option=option: ratios(option, 1.0 + tuning.SHARE) for option in options.values()],  # type: ignore[misc]
            )
            exact = np.array([one.ratio for one in self.before.values()])
            self._effects[loop, scope] = dataclasses.replace(found, ratios=exact)
        return self._effects[loop, scope]

    def _options(self, outcome: LoopOutcome, gains: bool) -> list[tuning.OptionValue]:
        """Return the options of a closed design that may be moved; `gains`: no others."""
        if self._problem(outcome) is None:
            return []
        known, rate_hz = METHODS[outcome.closed.method].options, 1.0 / self._job.period_of(outcome.spec)
        return [
            tuning.OptionValue(
                name=name,
                value=x,
                low=0.0 if known[name].unit == "Hz" else known[name].low,
                high=known[name].high * (rate_hz if known[name].unit == "Hz" else 1.0),
            )
            for name, x in outcome.closed.options.items()
            if name in known and not known[name].whole and x > 0.0 and (known[name].group == "gains" or not gains)
        ]

    def _problem(self, outcome: LoopOutcome) -> LoopProblem | None:
        """Return what the method of a closed design is given; None where it does not build a design from options."""
        closed, method = outcome.closed, METHODS.get(outcome.closed.method)
        spec = next((one for one in outcome.spec.designs if one.name == closed.name), None)
        if spec is None or method is None or not method.instant or method.key != spec.method or not closed.options:
            return None
        return LoopProblem(
            job=self._job,
            spec=outcome.spec,
            design=spec,
            model=self._model,
            plant_set=closed.plants,
            directions=closed.directions,
        )


def _own(outcome: LoopOutcome, design: Design, exact: bool) -> Results:
    """Return the requirements of a loop with a design of it."""
    plants = design.plants
    assert plants is not None, "the loop has plants"
    measures = measure(plants, with_commands(plants, design.controller), outcome.spec.requests, exact=exact)
    return keyed(limits_and_goals(outcome.spec, design.name, plants, measures)[0])
