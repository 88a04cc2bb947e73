"""The method "lmi" of jobs: its options; the design is in `design.lmi.method`, which needs cvxpy."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from platform_ctrl.design.method import Designed, LoopProblem, Method, Option, number
from platform_ctrl.design.methods.hinf import BACKOFF, WEIGHTS, default_weights
from platform_ctrl.design.partition import Channels
from platform_ctrl.job.job import DesignSpec

# Pole decay where it is not given, relative to the slowest bandwidth in rad/s.
_DECAY = 0.05

OPTIONS: dict[str, Option] = (
    WEIGHTS
    | {"backoff": BACKOFF}
    | {
        "share": number("share", "part of a limit that its inequality must prove", 0.1, 1.0),
        "pole_decay": number("pole decay", "decay rate that all poles must have", 1e-2, 1e4, unit="1/s"),
        "pole_damping": number(
            "pole damping", "damping ratio that all poles must have: four times the effort", 0.01, 0.7
        ),
        "rejection_share": number("rejection share", "the same for the rejection of Omega", 0.05, 1.0),
        "time_limit": number("time limit", "longest time for one convex problem", 0.1, 600.0, unit="s"),
    }
)


class LMI(Method):
    """Least torque noise for a weighted H-infinity norm, with the loop's limits as matrix inequalities."""

    key = "lmi"
    options = OPTIONS
    advice = "a lower bandwidth_hz, or a larger backoff"
    tunable = tuple(WEIGHTS)
    tunes = True
    families: ClassVar = {"speed": {"bandwidth_hz": 1.0, "inertial_bandwidth_hz": 1.0}}

    def defaults(self, design: DesignSpec, channel: Channels, nutation: float, period: float) -> dict[str, float]:
        """Return all options, those not given from rules of thumb; `pole_damping` is there only if it is given."""
        weights = default_weights(channel, nutation)
        slowest = min(design.options.get(name, x) for name, x in weights.items() if name.endswith("bandwidth_hz"))
        decay = _DECAY * 2.0 * np.pi * slowest
        optional = {name: x for name, x in design.options.items() if name in ("pole_damping", "rejection_share")}
        defaults = weights | {"backoff": 0.1, "share": 0.5, "pole_decay": decay, "time_limit": 30.0} | optional
        return self.completed(design.options, defaults, period)

    def design(self, problem: LoopProblem) -> Designed:
        """Return the loop, as `design.lmi.method` says."""
        from platform_ctrl.design.lmi.method import lmi_design

        plants = problem.plants
        return lmi_design(problem, self.defaults(problem.design, problem.channel, plants.nutation, plants.period))
