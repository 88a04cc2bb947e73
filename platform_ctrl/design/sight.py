"""The budget of the line of sight of a job, for designs of one loop that it limits, all other loops closed."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import field

import numpy as np

from platform_ctrl.analysis.budget_integrals import motion_transfer
from platform_ctrl.analysis.metrics import METRICS
from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.analysis.response import frequency_response
from platform_ctrl.analysis.sight import MeanSquare, mean_square
from platform_ctrl.analysis.system import ComplexArray, StateSpace, System
from platform_ctrl.common.values import FloatArray, replaced, value
from platform_ctrl.design.budget_friction import TOLERANCE, Balanced, balanced_at_trims, prepared
from platform_ctrl.design.budget_loop import BudgetLoop
from platform_ctrl.design.loop import delivered
from platform_ctrl.design.sections import gain
from platform_ctrl.errors import ArgumentError, NotFoundError
from platform_ctrl.job.job import Job

# Keys of limits: the axes that count together, and what of a motion within an exposure counts and how often.
_BOTH = (0, 1)
_WINDOWED = {"windowed_jitter": ((2, 3), 1.0), "smear": ((2,), math.sqrt(12.0))}


@value
class LoopSight:
    """The budget of a job with any controller of one loop."""

    job: Job
    loop: str
    plants: PlantSet  # of the loop, as its design reads it
    beside: Mapping[str, StateSpace] = field(default_factory=dict)  # controllers of the other loops
    sense: FloatArray | None = None  # from its readings to what controllers read

    def in_directions(self, sense: FloatArray) -> LoopSight:
        """Return the same for controllers of combinations of the readings."""
        return replaced(self, {"sense": sense if self.sense is None else sense @ self.sense})

    def exact(self, controller: System) -> Mapping[str, float]:
        """Return the limits' values at the job's gimbal angles where they are worst; infinite or 0 without a budget."""
        out = {one.key: one.worst for one in METRICS.values() if one.of_sight}
        try:
            loop, places = self._balanced(controller)
            found = [prepared(loop, at)[1].of(self._whole(loop, controller, at), TOLERANCE) for at in places]
        except (ArgumentError, NotFoundError):
            return out
        if not all(at.friction.valid.all() for at in places):
            return out
        out["jitter"] = max(math.hypot(*one.total[:2]) for one in found)
        out["jitter_per_axis"] = max(float(one.total[:2].max()) for one in found)
        for key in _WINDOWED if loop.budget.exposure else ():
            factor, both = _WINDOWED[key][1], key == "windowed_jitter"
            rms = [np.hypot(w.smear, w.jitter) if both else factor * w.smear for one in found for w in one.windows]
            out[key] = max(math.hypot(*one[:2]) for one in rms)
        if nu := loop.budget.spatial_frequencies:
            axes = [(float(w.jitter[k]), float(w.smear[k])) for one in found for w in one.windows for k in _BOTH]
            out["contrast"] = min((float(motion_transfer(nu, *axis).min()) for axis in axes), default=0.0)
        return out

    def forms(self, controller: System) -> Mapping[str, tuple[MeanSquare, ...]]:
        """Return the same as forms in the controller, with the friction that there is with this one."""
        loop, places = self._balanced(controller)
        parts: list[tuple[str, tuple[int, ...], tuple[int, ...], float]] = [("jitter", _BOTH, (0,), 1.0)]
        parts += [("jitter_per_axis", (k,), (0,), 1.0) for k in _BOTH]
        for key, (weights, factor) in _WINDOWED.items():
            parts += [(key, _BOTH, tuple(3 * k + w for w in weights), factor) for k in range(len(loop.budget.exposure))]
        if nu := loop.budget.spatial_frequencies:
            windows = [(3 * k + 2, 3 * k + 3) for k in range(len(loop.budget.exposure))]
            parts += [("contrast", (axis,), window, max(nu)) for axis in _BOTH for window in windows]
        rows = [loop.torquers.index(name) for name in self.plants.torques]
        out: dict[str, tuple[MeanSquare, ...]] = {}
        for at in places:
            budget = prepared(loop, at)[1]

            def others(theta: FloatArray, at: Balanced = at) -> tuple[ComplexArray, ComplexArray]:
                return self._others(loop, at, theta)

            for key, axes, weights, factor in parts:
                out[key] = (*out.get(key, ()), mean_square(budget, axes, weights, factor, others, rows))
        return out

    def _named(self, controller: System) -> list[StateSpace]:
        K = controller._replace(dt=self.plants.period)
        K = K if self.sense is None else K._replace(B=K.B @ self.sense, D=K.D @ self.sense)
        own = delivered(K, self.plants, "loop")
        for one in self.job.loops:
            if one.name not in (self.loop, *self.beside):
                raise ArgumentError(
                    f"line of sight: the loop {one.name!r} moves it too, and has no controller yet; design it"
                )
        return [own if one.name == self.loop else self.beside[one.name] for one in self.job.loops]

    def _balanced(self, controller: System) -> tuple[BudgetLoop, list[Balanced]]:
        assert self.job.budget is not None, "the job has a budget"
        loop = BudgetLoop(self.job, self.job.budget, self._named(controller))
        return loop, balanced_at_trims(loop)

    def _whole(self, loop: BudgetLoop, controller: System, at: Balanced) -> System:
        """Return the controller from all sensors to all torquers, with what drives add."""
        return loop.with_drives(loop.controllers_of(self._named(controller), at.q), at.friction.fed).fast

    def _others(self, loop: BudgetLoop, at: Balanced, theta: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """Return E and F at frequencies: the whole controller is K E + F, by what becomes of single gains."""
        m, q = len(self.plants.torques), len(self.plants.angles if self.sense is None else self.sense)

        def response(D: FloatArray) -> ComplexArray:
            return frequency_response(self._whole(loop, gain(D), at), theta, -3)

        F = response(np.zeros((m, q)))
        first = loop.torquers.index(self.plants.torques[0])
        E = [(response(np.outer(np.eye(m)[0], one)) - F)[:, first] for one in np.eye(q)]
        return np.stack(E, axis=1), F


def beside(plants: PlantSet, controllers: Mapping[str, StateSpace]) -> PlantSet:
    """Return plants of a loop whose line of sight is that with these controllers of the job's other loops, by name."""
    if plants.sight_budget is None:
        return plants
    return replaced(plants, {"sight_budget": replaced(plants.sight_budget, {"beside": dict(controllers)})})
