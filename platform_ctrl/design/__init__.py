"""Loop design: full order, fixed structure, matrix inequalities, measured responses, torque limits, and jobs."""

from __future__ import annotations

from platform_ctrl.design.antiwindup.compensator import anti_windup, largest_Omega
from platform_ctrl.design.antiwindup.job import caging_largest_Omega
from platform_ctrl.design.antiwindup.loop import limited_loop
from platform_ctrl.design.classical.complex_coordinates import complex_plant
from platform_ctrl.design.classical.complex_shaping import complex_loop
from platform_ctrl.design.classical.crossover import from_crossover_and_margin
from platform_ctrl.design.fixed_structure.pid import PID
from platform_ctrl.design.fixed_structure.sections import Lead, Notch, Series
from platform_ctrl.design.fixed_structure.structures import StateSpaceOrder, Static
from platform_ctrl.design.fixed_structure.synthesis import structured
from platform_ctrl.design.jobs import loops
from platform_ctrl.design.lmi.caging import scheduled_caging
from platform_ctrl.design.lmi.multiobjective import multiobjective
from platform_ctrl.design.lmi.robust import robust
from platform_ctrl.design.lmi.scheduled import scheduled
from platform_ctrl.design.measured.data import read_measurement
from platform_ctrl.design.measured.design import measured_pid
from platform_ctrl.design.riccati.h2 import h2
from platform_ctrl.design.riccati.lq import lqe, lqg, lqr
from platform_ctrl.design.riccati.pole_placement import pole_placement
from platform_ctrl.design.riccati.sampled_hinf import sampled_hinf
from platform_ctrl.design.synthesis import hinf

__all__ = [
    "PID",
    "Lead",
    "Notch",
    "Series",
    "StateSpaceOrder",
    "Static",
    "anti_windup",
    "caging_largest_Omega",
    "complex_loop",
    "complex_plant",
    "from_crossover_and_margin",
    "h2",
    "hinf",
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
]
