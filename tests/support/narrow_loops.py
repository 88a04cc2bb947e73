"""Loops of gimbals 9 and 10 with a narrow notch or resonance in the controller: what a grid of frequencies misses."""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.linalg import block_diag

from platform_ctrl import read_job
from platform_ctrl.analysis.loop import Loop
from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.analysis.system import System
from platform_ctrl.design.plants import plants_of
from platform_ctrl.design.sections import first_order, notch, side_by_side

PERIOD = 5e-4
L, J9, J10 = 0.15, 5e-4, 2e-4


@cache
def plants(delay: float) -> PlantSet:
    """The nominal plant, the corners of ±10 % in J and L, and those of the platform's rate."""
    loop = {"name": "9-10", "kind": "caging", "gimbals": ["9", "10"], "use": "K"}
    job = read_job(
        {
            "schema": 2,
            "name": "9-10",
            "plant": "three_gyro_platform",
            "operation": {"Omega": [1.0, 1.0, 1.0]},
            "uncertainty": {"inertia": 0.1, "spin": 0.1},
            "sampling": {"rate_hz": 2000, "delay": delay},
            "loop": [loop | {"design": [{"name": "K", "method": "classical"}]}],
        }
    )
    found = plants_of(job, job.loops[0])
    assert found is not None, "a caging loop has plants"
    return found


def controller(numbers: np.ndarray) -> System:
    """Return a PD in either axis with cross gain, behind a notch; of a depth above 1 it is a resonance."""
    zero9, rate9, zero10, rate10, cross, centre, depth, width = numbers
    leads = []
    for J, zero, rate in ((J9, zero9, rate9), (J10, zero10, rate10)):
        a, b, c, d, _ = first_order(1.0, zero, 1.0 / (2.0 * np.pi * 800.0), 1.0, PERIOD)
        leads.append((a, b, -J * rate * c, -J * rate * d))
    A, B, C, D = (block_diag(*parts) for parts in zip(*leads, strict=True))
    D = D + L * cross * np.array([[0.0, -1.0], [1.0, 0.0]])
    one = notch(2.0 * np.pi * centre, depth, width, PERIOD)
    a, b, c, d, _ = side_by_side(one, one)
    both = np.block([[a, np.zeros((len(a), len(A)))], [B @ c, A]])
    return System(both, np.vstack([b, B @ d]), np.hstack([D @ c, C]), D @ d, PERIOD)


class OnGrid(Loop):
    """Figures at the frequencies of the grid, and nothing else."""

    narrow: dict[int, np.ndarray] = {}  # type: ignore[assignment]  # noqa: RUF012
