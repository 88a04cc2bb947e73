"""What the compiled plant does in the first instant of a run, for comparison with the equations."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np

from platform_ctrl import Platform
from platform_ctrl.simulation import Scenario, TimeTable, rollout, simulate

AT_REST = (1.0, 0.0, 0.0, 0.0)


def first_slopes(
    platform: Platform, q: Any, u: Any, force: Any, free: bool = True, attitude: Any = AT_REST, h: float = 2e-4
) -> np.ndarray:
    """Return [q', u'] of [q, u] under [M, Q] = `force`; a prescribed Omega stays. From runs of h, h/2, ..."""
    rows = []
    for step in h / 2.0 ** np.arange(5):
        if free:
            out = rollout(platform, [q], [u], step=step, steps=1, attitude=[attitude], force=[force])
            end = np.r_[out.q[0], out.velocity[0]]
        else:
            names = platform.gimbal_names
            torques = tuple((name, np.array([[0.0, Q]])) for name, Q in zip(names, force[3:], strict=True))
            held = TimeTable(t=[0.0], values=[u[:3]])
            start = {"q": q, "rate": u[3:], "Omega_table": held, "attitude": attitude, "gimbal_torques": torques}
            run = Scenario(platform=platform, mode="caged", duration=step, delay=0.0, **start)
            ran = simulate(run, [], period=step, step=step)
            end = np.r_[ran.q[-1], ran.Omega[-1], ran.rate[-1]]
        rows.append((end - np.r_[q, u]) / step)
    for k in range(1, len(rows)):  # Richardson's extrapolation
        rows = [(2.0**k * finer - coarser) / (2.0**k - 1.0) for coarser, finer in itertools.pairwise(rows)]
    return rows[0]
