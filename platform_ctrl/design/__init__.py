"""Loop design: the classical caging loop, H-infinity synthesis, the platform servo, and the loops of a job."""

from __future__ import annotations

from platform_ctrl.design.h2 import h2
from platform_ctrl.design.jobs import LoopOutcome, loops
from platform_ctrl.design.lmi.caging import ScheduledCaging, scheduled_caging
from platform_ctrl.design.lmi.multiobjective import Multiobjective, multiobjective
from platform_ctrl.design.lmi.robust import Robust, robust
from platform_ctrl.design.lmi.scheduled import Scheduled, scheduled
from platform_ctrl.design.loop import LoopDesign
from platform_ctrl.design.lq import Estimator, LqgDesign, StateFeedback, lqe, lqg, lqr
from platform_ctrl.design.synthesis import Claim, Synthesis, hinf

__all__ = [
    "Claim",
    "Estimator",
    "LoopDesign",
    "LoopOutcome",
    "LqgDesign",
    "Multiobjective",
    "Robust",
    "Scheduled",
    "ScheduledCaging",
    "StateFeedback",
    "Synthesis",
    "h2",
    "hinf",
    "loops",
    "lqe",
    "lqg",
    "lqr",
    "multiobjective",
    "robust",
    "scheduled",
    "scheduled_caging",
]
