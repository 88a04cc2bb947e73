"""Loop design: the classical caging loop, H-infinity synthesis, the platform servo, and the loops of a job."""

from __future__ import annotations

from platform_ctrl.design.jobs import LoopOutcome, loops
from platform_ctrl.design.loop import LoopDesign
from platform_ctrl.design.synthesis import Synthesis, hinf

__all__ = ["LoopDesign", "LoopOutcome", "Synthesis", "hinf", "loops"]
