"""The method "structured" of jobs: its options; the design is in `design.fixed_structure.caging`."""

from __future__ import annotations

import numpy as np

from platform_ctrl.design.method import Designed, LoopProblem, Method, Option, hertz, number
from platform_ctrl.design.partition import Channels
from platform_ctrl.errors import DesignError
from platform_ctrl.job.job import DesignSpec, Structure

# Options of some structures alone.
_STRUCTURES: dict[str, tuple[Structure, ...]] = {
    "order": ("state-space",),
    "starts": ("pid", "state-space"),
    "rolloff_hz": ("pid", "state-space"),
}
DEFAULT: Structure = "pid"

OPTIONS: dict[str, Option] = {
    "order": number("order", "states beside the integrators", 1, 30, whole=True, logarithmic=False),
    "starts": number("starts", "starting points of the search", 1, 8, whole=True, logarithmic=False),
    "integral_hz": hertz("integral", "design", "corner of the integral at the start", high=0.4, below_nyquist=True),
    "rolloff_hz": hertz("roll-off", "design", "where the filter starts", high=0.45, below_nyquist=True),
    "reserve": number("reserve", "share by which limits are met", 1e-3, 0.5),
    "evaluations": number("evaluations", "most evaluations of the search", 10, 5000, whole=True),
}


class Structured(Method):
    """A controller of fixed structure, tuned on the loop's own requirements over its plants."""

    key = "structured"
    options = OPTIONS
    advice = "weaker limits, or another structure"
    structures = ("cross-axis", "pid", "state-space")
    goals = True

    def defaults(self, design: DesignSpec, channel: Channels, nutation: float, period: float) -> dict[str, float]:
        """Return all options of a structure, those not given from rules of thumb."""
        given, structure = design.options, design.structure or DEFAULT
        defaults = {
            "order": 3.0 * len(channel.basis),
            "starts": 1.0,
            "integral_hz": 0.024 * nutation / (2.0 * np.pi),
            "rolloff_hz": 0.4 / period,
            "reserve": 0.01,
            "evaluations": 400.0,
        }
        own = {name: x for name, x in defaults.items() if structure in _STRUCTURES.get(name, (structure,))}
        out = self.completed(given, own, period, f'structured, structure = "{structure}"')
        if not out["reserve"] < 1.0:
            raise DesignError(f"structured: reserve must be less than 1, got {out['reserve']:g}")
        return out

    def design(self, problem: LoopProblem) -> Designed:
        """Return the loop: its limits as constraints, its goals minimised."""
        from platform_ctrl.design.fixed_structure.caging import structured_design

        plants = problem.plants
        options = self.defaults(problem.design, problem.channel, plants.nutation, plants.period)
        return structured_design(problem, problem.design.structure or DEFAULT, options)
