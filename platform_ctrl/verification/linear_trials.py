"""The linear part of a check for one changed design after the other."""

from __future__ import annotations

import dataclasses
import math
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np

from platform_ctrl.analysis.loop_metrics import measure
from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.jobs import LoopOutcome
from platform_ctrl.design.loop import (
    LoopDesign,
    LoopProblem,
    designed,
    in_signals,
    limits_and_goals,
    requirements_of,
    with_commands,
    with_controller,
)
from platform_ctrl.design.partition import Channels
from platform_ctrl.design.plants import tracking_plants
from platform_ctrl.design.reduced_jobs import design_job, plant_job
from platform_ctrl.design.tuning import (
    SHARE,
    OptionEffects,
    OptionValue,
    Score,
    candidates,
    option_effects,
)
from platform_ctrl.errors import PlatformCtrlError
from platform_ctrl.job.job import DesignSpec, Job
from platform_ctrl.job.judging import CheckResult
from platform_ctrl.job.methods import METHODS, DesignMethod, resolved
from platform_ctrl.mechanics.linearisation import LinearModel
from platform_ctrl.verification.budget import PreparedBudget
from platform_ctrl.verification.coupled import coupled_check

if TYPE_CHECKING:
    import control

    from platform_ctrl.verification.verdict import JobResult

# Relative moves of an option: wider than those of a slider, since a missed limit may be far.
_MOVES = (*(-0.05 * k for k in range(10, 0, -1)), *(0.05 * k for k in range(1, 11)), 0.6, 0.8, 1.0)
# Shares of the move that is expected to be best that are tried: nothing is as linear as expected.
_PARTS = (0.6, 1.0, 1.4)
# What is measured beside the changed loop itself.
Scope = Literal["loop", "budget", "coupled", "all"]
# What stands for the options of a design that is not built from any.
GAIN = "gain"

# Subject, stage and name of a requirement.
Key = tuple[str, str, str]
Results = dict[Key, CheckResult]


@value
class Trial:
    """An option (or the gain) of a loop's closed design at another value, or another design closed in the loop."""

    kind: Literal["option", "gain", "design"]
    loop: str
    design: str
    name: str
    before: float = math.nan
    after: float = math.nan


def keyed(results: tuple[CheckResult, ...]) -> Results:
    """Return results by subject, stage and name."""
    return {(one.subject, one.stage, one.name): one for one in results}


class LinearTrials:
    """The requirements of a checked job that are measured without a simulated run, with one design changed.

    Parameters
    ----------
    result
        The checked job.

    Attributes
    ----------
    before
        The requirements as they are.
    """

    def __init__(self, result: JobResult) -> None:
        self._job, self._model = result.job, result.model
        self._outcomes = {outcome.spec.name: outcome for outcome in result.loops}
        self._inner = {one.spec.around: one for one in result.loops if one.spec.around}
        self._limits_budget = () if result.budget is None else result.budget.results
        self._coupled = () if result.coupled is None else result.coupled.results
        of_loops = tuple(one for outcome in result.loops for one in outcome.closed.results)
        self.before = keyed((*of_loops, *self._coupled, *self._limits_budget))
        self._builders: dict[str, _Builder | None] = {}
        self._effects: dict[tuple[str, Scope], OptionEffects] = {}
        self._results: dict[tuple[Trial, bool, Scope], Results | None] = {}

    def loops_for(self, key: Key) -> list[str]:
        """Return the loops whose designs a requirement depends on."""
        subject = key[0]
        if key not in keyed(self._limits_budget) and subject in self._outcomes:
            around = self._outcomes[subject].spec.around
            return [subject, around] if around else [subject]
        return list(self._outcomes)

    def scope(self, key: Key) -> Scope:
        """Return what has to be measured for a requirement."""
        if key in keyed(self._limits_budget):
            return "budget"
        return "coupled" if key in keyed(self._coupled) else "loop"

    def trials(self, loop: str, score: Score, scope: Scope) -> list[Trial]:
        """Return the other designs of a loop, and the moves of its closed one that are expected to help most.

        For the coupled system the best move of a gain alone, as expected: each costs a coupled check.
        """
        outcome = self._outcomes[loop]
        closed = outcome.closed
        out = [Trial(kind="design", loop=loop, design=one.name, name=one.name) for one in outcome.alternatives]
        builder = self._builder(loop)
        if builder is None:
            return out
        coupled = scope == "coupled"
        options = {one.name: one for one in builder.options(coupled)}
        effects = self._effects_of(loop, tuple(options.values()), scope)
        found = candidates(effects, list(options.values()), score, _MOVES)
        if coupled:
            found = found[:1]
        else:
            found = [(name, options[name].moved(after, part)) for name, after in found for part in _PARTS]
        kind: Literal["gain", "option"] = "gain" if GAIN in options else "option"
        return out + [
            Trial(kind=kind, loop=loop, design=closed.name, name=name, before=options[name].value, after=after)
            for name, after in found
            if options[name].low <= after <= options[name].high
        ]

    def results(self, trial: Trial, exact: bool, scope: Scope) -> Results | None:
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

    def _measured(self, trial: Trial, exact: bool, scope: Scope) -> Results:
        outcome = self._outcomes[trial.loop]
        if trial.kind == "design":
            design = next(one for one in outcome.designs if one.name == trial.name)
            own = keyed(design.results)
        else:
            builder = self._builder(trial.loop)
            assert builder is not None, "a loop with moves has a builder"
            design = builder.design(trial.name, trial.after)
            own = {} if design.plants is None else self._own(outcome, design, exact)
        out = self.before | own
        around = self._inner.get(trial.loop)
        if around is not None:
            plants, _ = _around(self._job, around, outcome, design)
            out |= self._own(around, dataclasses.replace(around.closed, plants=plants), exact)
        closed = [design if name == trial.loop else one.closed for name, one in self._outcomes.items()]
        controllers = [one.controller for one in closed]
        if self._limits_budget and scope in ("budget", "all"):
            out |= keyed(self._budget_of(trial, controllers))
        if scope in ("coupled", "all"):
            out |= keyed(coupled_check(self._job, self._model, controllers).results)
        return out

    def _own(self, outcome: LoopOutcome, design: LoopDesign, exact: bool) -> Results:
        plants = design.plants
        assert plants is not None, "the loop has plants"
        K = with_commands(plants, design.controller)
        measures = measure(plants, K, requirements_of(outcome.spec), exact=exact)
        return keyed(limits_and_goals(outcome.spec, design.name, plants, measures)[0])

    @cached_property
    def _budget(self) -> PreparedBudget:
        return PreparedBudget(self._job, [one.closed.controller for one in self._outcomes.values()])

    def _budget_of(self, trial: Trial, controllers: list[control.StateSpace]) -> tuple[CheckResult, ...]:
        """Return the limits of the budget; designs that read other signals need one of their own."""
        old, new = self._outcomes[trial.loop].closed.controller, controllers[list(self._outcomes).index(trial.loop)]
        if list(old.input_labels) == list(new.input_labels):
            return self._budget.of(controllers).results
        return PreparedBudget(self._job, controllers).first.results

    def _builder(self, loop: str) -> _Builder | None:
        if loop not in self._builders:
            outcome = self._outcomes[loop]
            inner = self._outcomes.get(outcome.spec.around or "")
            self._builders[loop] = _builder(self._job, self._model, outcome, inner)
        return self._builders[loop]

    def _effects_of(self, loop: str, options: tuple[OptionValue, ...], scope: Scope) -> OptionEffects:
        if (loop, scope) not in self._effects:
            closed = self._outcomes[loop].closed
            kind: Literal["gain", "option"] = "gain" if options[0].name == GAIN else "option"

            def ratios(option: OptionValue, factor: float) -> FloatArray:
                after = option.value * factor
                one = Trial(
                    kind=kind, loop=loop, design=closed.name, name=option.name, before=option.value, after=after
                )
                # As it is, all beside the loop is known.
                found = self._measured(one, exact=False, scope=scope if factor != 1.0 else "loop")
                return np.array([found[key].ratio for key in self.before])

            found = option_effects(
                [option.name for option in options],
                [name for _, _, name in self.before],
                ratios(options[0], 1.0),
                [lambda option=option: ratios(option, 1.0 + SHARE) for option in options],  # type: ignore[misc]
            )
            exact = np.array([one.ratio for one in self.before.values()])
            self._effects[loop, scope] = dataclasses.replace(found, ratios=exact)
        return self._effects[loop, scope]


@value
class _Builder:
    """Makes the closed design of a loop again: of its options by its method, or with its gain scaled."""

    closed: LoopDesign
    rate_hz: float
    method: DesignMethod | None = None
    problem: LoopProblem | None = None

    def options(self, gains: bool) -> list[OptionValue]:
        """Return what may be moved; `gains`: no others."""
        if self.method is None:
            return [OptionValue(name=GAIN, value=1.0)]
        known = self.method.options
        return [
            OptionValue(
                name=name,
                value=x,
                low=0.0 if known[name].unit == "Hz" else known[name].low,
                high=known[name].high * (self.rate_hz if known[name].unit == "Hz" else 1.0),
            )
            for name, x in self.closed.options.items()
            if name in known and not known[name].whole and x > 0.0 and (known[name].group == "gains" or not gains)
        ]

    def design(self, name: str, after: float) -> LoopDesign:
        """Return the design with one number moved, not measured."""
        if self.method is None or self.problem is None:
            assert self.closed.plants is not None, "a gain is scaled of a loop with plants"
            K = with_commands(self.closed.plants, self.closed.controller)
            return with_controller(self.closed, K._replace(C=after * K.C, D=after * K.D))
        moved = dataclasses.replace(self.problem.design, options={**self.closed.options, name: after}, tune=False)
        problem = dataclasses.replace(self.problem, design=moved)
        if problem.plant_set is None:
            return designed(problem)
        return with_controller(self.closed, in_signals(problem, resolved(self.method.design)(problem).controller))


def _builder(job: Job, model: LinearModel, outcome: LoopOutcome, inner: LoopOutcome | None) -> _Builder | None:
    """Return what makes the closed design of a loop; None for one without plants and options."""
    closed, rate_hz = outcome.closed, 1.0 / job.period_of(outcome.spec)
    spec = next((one for one in outcome.spec.designs if one.name == closed.name), None)
    method = METHODS.get(closed.method)
    if spec is None or method is None or not method.instant or method.key != spec.method or not closed.options:
        return None if closed.plants is None else _Builder(closed=closed, rate_hz=rate_hz)
    return _Builder(closed=closed, rate_hz=rate_hz, method=method, problem=_problem(job, model, outcome, spec, inner))


def _problem(
    job: Job, model: LinearModel, outcome: LoopOutcome, design: DesignSpec, inner: LoopOutcome | None
) -> LoopProblem:
    """Return what the method of a closed design is given."""
    alone = design_job(job, outcome.spec, design)
    problem = LoopProblem(job=alone, spec=alone.loops[-1], design=design, model=model, plant_set=outcome.closed.plants)
    if outcome.closed.plants is None:
        return problem
    directions = problem.channel if inner is None else _around(job, outcome, inner, inner.closed)[1]
    return dataclasses.replace(problem, directions=directions)


def _around(job: Job, outcome: LoopOutcome, inner: LoopOutcome, design: LoopDesign) -> tuple[PlantSet, Channels]:
    """Return the plants of a tracking loop around a `design` of the loop inside, and their directions."""
    assert design.plants is not None, "a rate loop has plants"
    K = with_commands(design.plants, design.controller)
    return tracking_plants(plant_job(job, outcome.spec, inner.spec), outcome.spec, inner.spec, design.plants, K)
