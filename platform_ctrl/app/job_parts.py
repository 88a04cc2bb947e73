"""The parts of a job that have verdicts of their own: loops, the coupled check, the budget, the simulated runs."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from platform_ctrl.analysis.system import StateSpace
from platform_ctrl.app.closed_loops import ClosedLoops
from platform_ctrl.app.plants import Bounded
from platform_ctrl.app.settings import Settings
from platform_ctrl.common.values import value
from platform_ctrl.design.loop import limits_and_goals
from platform_ctrl.errors import PlatformCtrlError
from platform_ctrl.job.job import LoopSpec
from platform_ctrl.job.judging import CheckResult
from platform_ctrl.verification.budget import PreparedBudget
from platform_ctrl.verification.budget_result import LineOfSightBudget, left_to_runs, unstable_results
from platform_ctrl.verification.coupled import ALL_LOOPS, coupled_requirements

# Budgets that are kept: a few steps back and forth.
_BUDGETS = 16
_WAITING = "Computed as soon as the sliders rest"
_QUICK = "While sliders move: limits at the gimbal angles that decided them when the sliders last rested"
_FRICTION = ", dry friction as it was balanced then"


@value
class BudgetState:
    """The budget of settings: `found`, or None and a `line` that says why; where it is not `exact` a line as well."""

    found: LineOfSightBudget | None
    exact: bool
    line: str


class SightBudgets:
    """The budgets of a job, which all its pages share; safe in several threads."""

    def __init__(self, loops: ClosedLoops) -> None:
        self._loops = loops
        self._exact: Bounded[LineOfSightBudget] = Bounded(_BUDGETS)
        # Prepared for the plants of the last exact budget, and for those of slider positions since.
        self._prepared: tuple[Hashable, PreparedBudget] | None = None
        self._lock = threading.Lock()

    def exact(self, settings: Settings) -> LineOfSightBudget:
        """Return the budget as `platform-ctrl budget` computes it."""
        key = self._loops.whole_key(settings)
        found = self._exact.found(key)
        if found is not None:
            return found
        controllers = self._loops.controllers(settings)
        with np.errstate(all="ignore"):
            prepared = PreparedBudget(self._loops.job(settings), controllers)
        with self._lock:
            self._prepared = _key(settings, controllers), prepared
        self._exact.put(key, prepared.first)
        return prepared.first

    def results(self, settings: Settings) -> tuple[CheckResult, ...]:
        """Return the budget's limits as `check` judges them."""
        if not self._loops.coupled(settings).stable_at_all_angles:
            return unstable_results(self._loops.job(settings))
        return self.exact(settings).results

    def now(self, settings: Settings) -> BudgetState:
        """Return the budget within some milliseconds: exact if it is known, else from the last that is."""
        found = self._exact.found(self._loops.whole_key(settings))
        if found is not None:
            return BudgetState(found=found, exact=True, line="")
        try:
            quick = self._quick(settings)
        except PlatformCtrlError as error:
            return BudgetState(found=None, exact=False, line=str(error))
        line = _WAITING if quick is None else _QUICK + (_FRICTION if quick.friction.frictions else "")
        return BudgetState(found=quick, exact=False, line=line)

    def quick_results(self, settings: Settings) -> tuple[CheckResult, ...]:
        """Return the limits with the budget that is computed within some milliseconds; none before there is one."""
        if self._prepared is None:
            return ()
        found = self.now(settings).found
        return unstable_results(self._loops.job(settings)) if found is None else found.results

    def _quick(self, settings: Settings) -> LineOfSightBudget | None:
        controllers = self._loops.controllers(settings)
        key = _key(settings, controllers)
        with self._lock, np.errstate(all="ignore"):
            if self._prepared is None:
                return None
            known, prepared = self._prepared
            if known == key:
                return prepared.of(controllers)
            prepared = PreparedBudget(self._loops.job(settings), controllers, like=prepared)
            self._prepared = key, prepared
            return prepared.first


def _key(settings: Settings, controllers: Sequence[StateSpace]) -> Hashable:
    """Return the signals and the limits for which a budget is prepared."""
    return tuple(tuple(one.input_labels) for one in controllers), tuple(sorted(settings.limits.items()))


Results = tuple[CheckResult, ...]


class Chip(NamedTuple):
    """A chip of the strip: `key` is its own, `label` its words.

    A click chooses a `loop` of the job, or goes to a `panel` of the page.
    """

    key: str
    label: str
    loop: str = ""
    panel: str = ""


@value
class JobPart:
    """Something that `measure` compares with the limits of the job; the results of equal `stamp`s are equal.

    Several parts may share a chip. `count` is the number of its limits. One that is measured only `on_request` takes
    long: what has been measured is kept under its stamp.
    """

    chip: Chip
    count: int
    stamp: Hashable
    measure: Callable[[], Results]
    on_request: bool = False


BUDGET = "budget"  # key of its chip, and the view of the page


def loop_stamp(loops: ClosedLoops, settings: Settings, spec: LoopSpec) -> Hashable:
    """Return the stamp of a loop with plants of its own."""
    return ("loop", loops.shown_key(settings, spec))


def run_stamp(loops: ClosedLoops, settings: Settings, manoeuvre: str) -> Hashable:
    """Return the stamp of a simulated manoeuvre."""
    return ("run", manoeuvre, loops.whole_key(settings))


# Results that are kept: a few steps back and forth of a job with many runs.
_ROOM = 256


@value
class ChipState:
    """State of a chip: of `count` limits `checked` are known for the settings as they are, `missed` of them violated.

    `worst` is the result with the least margin, or None; `error` the line of what could not be measured. `on_request`:
    the rest is measured only on request.
    """

    chip: Chip
    count: int
    checked: int
    missed: int
    worst: CheckResult | None
    on_request: bool
    error: str = ""

    @property
    def measuring(self) -> bool:
        """Whether nothing is known yet of what is measured without a request."""
        return self.worst is None and not self.on_request and not self.error and self.count > 0


class JobParts:
    """The results of a job's parts, which all its pages share; safe in several threads."""

    def __init__(self, loops: ClosedLoops, sight: SightBudgets) -> None:
        self._loops, self._sight = loops, sight
        self._results: Bounded[Results | str] = Bounded(_ROOM)

    def parts(self, settings: Settings) -> Iterator[JobPart]:
        """Return all parts of the job for these settings: loops, limits on all of them, the budget, and the runs."""
        loops = self._loops
        job, whole = loops.read, loops.whole_key(settings)
        subjects = [subject for subject, _ in coupled_requirements(job)]
        servo = next((spec.name for spec in job.loops if not spec.has_plants), "")

        def coupled(chip: Chip, subject: str) -> JobPart:
            def measure() -> Results:
                return tuple(one for one in loops.coupled(settings).results if one.subject == subject)

            return JobPart(chip=chip, count=subjects.count(subject), stamp=(chip.key, whole), measure=measure)

        for spec in job.loops:
            chip = Chip(key=f"loop {spec.name}", label=spec.name, loop=spec.name)
            if spec.has_plants:
                count, stamp = sum(one.hard for one in spec.requests), loop_stamp(loops, settings, spec)
                yield JobPart(chip=chip, count=count, stamp=stamp, measure=partial(self._of_loop, settings, spec))
            else:
                yield coupled(chip, spec.name)
        yield coupled(Chip(key="coupled", label="coupled", loop=servo), ALL_LOOPS)
        if job.budget is not None:
            chip, count = Chip(key=BUDGET, label=BUDGET, panel=BUDGET), len(unstable_results(job))
            yield JobPart(chip=chip, count=count, stamp=(BUDGET, whole), measure=lambda: self._sight.results(settings))
        chip = Chip(key="runs", label="runs", panel="tree")
        for one in job.manoeuvres:
            # `JobParts.keep` keeps what was simulated.
            stamp = run_stamp(loops, settings, one.name)
            yield JobPart(chip=chip, count=len(one.limits), stamp=stamp, measure=tuple, on_request=True)

    def _of_loop(self, settings: Settings, spec: LoopSpec) -> Results:
        at = settings.but(loop=spec.name, design=self._loops.closed(settings)[spec.name], plant="nominal")
        loop, _ = self._loops.caged(at)
        return limits_and_goals(loop.spec, loop.design, loop.plants, self._loops.metrics(at, loop))[0]

    def keep(self, stamp: Hashable, results: Results) -> None:
        """Keep what was measured elsewhere: for a picture, or on request."""
        self._results.put(stamp, results)

    def open(self, parts: Iterable[JobPart]) -> list[JobPart]:
        """Return the parts that can be measured at once and are not yet."""
        return [one for one in parts if not one.on_request and self._results.found(one.stamp) is None]

    def measure(self, part: JobPart) -> None:
        """Measure a part and keep the results, or the line of its error."""
        try:
            found: Results | str = part.measure()
        except PlatformCtrlError as error:
            found = str(error)
        self._results.put(part.stamp, found)

    def states(self, parts: Iterable[JobPart]) -> list[ChipState]:
        """Return the chips of the strip with what is known."""
        chips: dict[str, list[JobPart]] = {}
        for part in parts:
            chips.setdefault(part.chip.key, []).append(part)
        return [self._state(one) for one in chips.values()]

    def _state(self, parts: list[JobPart]) -> ChipState:
        found = [self._results.found(one.stamp) for one in parts]
        measured = [one for each in found if isinstance(each, tuple) for one in each if one.hard]
        results = [one for one in measured if not left_to_runs(one, self._loops.read.budget)]
        return ChipState(
            chip=parts[0].chip,
            count=sum(
                one.count if each is None or isinstance(each, str) else sum(result.hard for result in each)
                for one, each in zip(parts, found, strict=True)
            ),
            checked=len(results),
            missed=sum(not one.passed for one in results),
            worst=min(
                results, key=lambda one: (one.passed, -math.inf if math.isnan(one.margin) else one.margin), default=None
            ),
            on_request=any(one.on_request for one in parts) or len(results) < len(measured),
            error=next((each for each in found if isinstance(each, str)), ""),
        )
