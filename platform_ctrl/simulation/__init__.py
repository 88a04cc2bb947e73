"""The exact non-linear plant in time: many free runs, and the sampled closed loop.

numba is loaded, and the kernel compiled or taken from its cache, with the first run.
"""

from platform_ctrl.simulation.closed_loop import HalfCosine, Trajectory, simulate
from platform_ctrl.simulation.free_motion import Rollout, rollout

__all__ = ["HalfCosine", "Rollout", "Trajectory", "rollout", "simulate"]
