"""The exact non-linear plant in time: many free runs, and the sampled closed loop.

numba is loaded, and the kernel compiled or taken from its cache, with the first run.
"""

from platform_ctrl.job.faults import Fault
from platform_ctrl.job.scenario import HalfCosine, Scenario, Sine, TimeTable, Vibration
from platform_ctrl.simulation.batch import simulate_batch
from platform_ctrl.simulation.closed_loop import simulate
from platform_ctrl.simulation.free_motion import rollout

__all__ = ["Fault", "HalfCosine", "Scenario", "Sine", "TimeTable", "Vibration", "rollout", "simulate", "simulate_batch"]
