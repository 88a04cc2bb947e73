"""The line of sight's budget for settings: as the command computes it at rest, quickly while a slider moves."""

from __future__ import annotations

import threading
from collections.abc import Hashable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.app.closed_loops import ClosedLoops
from platform_ctrl.app.plants import Bounded
from platform_ctrl.app.settings import Settings
from platform_ctrl.common.values import value
from platform_ctrl.errors import PlatformCtrlError
from platform_ctrl.job.judging import CheckResult
from platform_ctrl.verification.budget import PreparedBudget
from platform_ctrl.verification.budget_result import LineOfSightBudget, unstable_results

if TYPE_CHECKING:
    import control

# Budgets that are kept: a few steps back and forth.
_ROOM = 16
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
        self._exact: Bounded[LineOfSightBudget] = Bounded(_ROOM)
        # Prepared for the plants of the last exact one, and for those that sliders have come to since.
        self._prepared: tuple[Hashable, PreparedBudget] | None = None
        self._lock = threading.Lock()

    def exact(self, settings: Settings) -> LineOfSightBudget:
        """Return the budget as `platform-ctrl budget` computes it."""
        key = self._loops.whole_key(settings)
        found = self._exact.found(key)
        if found is not None:
            return found
        controllers = [one.system for one in self._loops.controllers(settings)]
        with np.errstate(all="ignore"):
            prepared = PreparedBudget(self._loops.job(settings), controllers)
        with self._lock:
            self._prepared = _key(settings, controllers), prepared
        self._exact.put(key, prepared.first)
        return prepared.first

    def results(self, settings: Settings) -> tuple[CheckResult, ...]:
        """Return the budget's limits as `check` judges them."""
        if not self._loops.coupled(settings).stable:
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
        if quick is None:
            return BudgetState(found=None, exact=False, line=_WAITING)
        return BudgetState(found=quick, exact=False, line=_QUICK + (_FRICTION if quick.friction is not None else ""))

    def quick_results(self, settings: Settings) -> tuple[CheckResult, ...]:
        """Return the limits with the budget that is computed within some milliseconds; none before there is one."""
        if self._prepared is None or not self._prepared[1].first.results:
            return ()
        try:
            found = self._quick(settings)
        except PlatformCtrlError:
            return unstable_results(self._loops.job(settings))
        return () if found is None else found.results

    def _quick(self, settings: Settings) -> LineOfSightBudget | None:
        controllers = [one.system for one in self._loops.controllers(settings)]
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


def _key(settings: Settings, controllers: Sequence[control.StateSpace]) -> Hashable:
    """Return the signals and the limits for which a budget is prepared."""
    return tuple(tuple(one.input_labels) for one in controllers), tuple(sorted(settings.limits.items()))
