"""The exact non-linear plant in time: many free runs, and the sampled closed loop.

numba is loaded, and the kernel compiled or taken from its cache, with the first run.
"""

from platform_ctrl.job.scenario import Fault, HalfCosine, Scenario, TimeTable, Vibration
from platform_ctrl.simulation.batch import Figures, acting, fly
from platform_ctrl.simulation.closed_loop import Trajectory, flight, simulate
from platform_ctrl.simulation.free_motion import Rollout, rollout
from platform_ctrl.simulation.stepping import Stepper

__all__ = [
    "Fault",
    "Figures",
    "HalfCosine",
    "Rollout",
    "Scenario",
    "Stepper",
    "TimeTable",
    "Trajectory",
    "Vibration",
    "acting",
    "flight",
    "fly",
    "rollout",
    "simulate",
]
