"""Loop design: full order, fixed structure, matrix inequalities, measured responses, torque limits, and jobs."""

from __future__ import annotations

from platform_ctrl.design.antiwindup.compensator import AntiWindup, LargestOmega, anti_windup, largest_Omega
from platform_ctrl.design.antiwindup.job import LoopLargestOmega, caging_largest_Omega, caging_loop_limits
from platform_ctrl.design.antiwindup.loop import LimitedLoop, limited_loop
from platform_ctrl.design.classical.complex_coordinates import ComplexSystem, complex_plant, complex_response
from platform_ctrl.design.classical.complex_shaping import ComplexLoop, TwoSidedNyquist, complex_loop, two_sided_nyquist
from platform_ctrl.design.classical.crossover import CrossoverDesign, from_crossover_and_margin
from platform_ctrl.design.jobs import LoopOutcome, loops
from platform_ctrl.design.lmi.caging import ScheduledCaging, scheduled_caging
from platform_ctrl.design.lmi.multiobjective import Multiobjective, multiobjective
from platform_ctrl.design.lmi.robust import Robust, robust
from platform_ctrl.design.lmi.scheduled import Scheduled, scheduled
from platform_ctrl.design.loop import LoopDesign
from platform_ctrl.design.measured import MeasuredDesign, measured_pid, read_measurement
from platform_ctrl.design.riccati.h2 import h2
from platform_ctrl.design.riccati.intersample_loop import IntersampleGains, intersample_gains
from platform_ctrl.design.riccati.lq import Estimator, LqgDesign, StateFeedback, lqe, lqg, lqr
from platform_ctrl.design.riccati.pole_placement import PolePlacement, pole_placement
from platform_ctrl.design.riccati.sampled_hinf import SampledSynthesis, sampled_hinf
from platform_ctrl.design.structured.pid import PID
from platform_ctrl.design.structured.result import StructuredDesign
from platform_ctrl.design.structured.structures import Lead, Notch, Series, StateSpaceOrder, Static, Structure
from platform_ctrl.design.structured.synthesis import structured
from platform_ctrl.design.synthesis import Claim, Synthesis, hinf

__all__ = [
    "PID",
    "AntiWindup",
    "Claim",
    "ComplexLoop",
    "ComplexSystem",
    "CrossoverDesign",
    "Estimator",
    "IntersampleGains",
    "LargestOmega",
    "Lead",
    "LimitedLoop",
    "LoopDesign",
    "LoopLargestOmega",
    "LoopOutcome",
    "LqgDesign",
    "MeasuredDesign",
    "Multiobjective",
    "Notch",
    "PolePlacement",
    "Robust",
    "SampledSynthesis",
    "Scheduled",
    "ScheduledCaging",
    "Series",
    "StateFeedback",
    "StateSpaceOrder",
    "Static",
    "Structure",
    "StructuredDesign",
    "Synthesis",
    "TwoSidedNyquist",
    "anti_windup",
    "caging_largest_Omega",
    "caging_loop_limits",
    "complex_loop",
    "complex_plant",
    "complex_response",
    "from_crossover_and_margin",
    "h2",
    "hinf",
    "intersample_gains",
    "largest_Omega",
    "limited_loop",
    "loops",
    "lqe",
    "lqg",
    "lqr",
    "measured_pid",
    "multiobjective",
    "pole_placement",
    "read_measurement",
    "robust",
    "sampled_hinf",
    "scheduled",
    "scheduled_caging",
    "structured",
    "two_sided_nyquist",
]
