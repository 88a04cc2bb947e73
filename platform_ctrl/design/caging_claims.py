"""What is claimed of the caging loops of a job: the largest Omega without saturation."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.analysis.loop import Loop
from platform_ctrl.design.loop import LoopDesign, with_commands
from platform_ctrl.plant.platform import OMEGA_NAMES

if TYPE_CHECKING:
    pass

# A torque for 1 rad/s below this share of the limit counts as zero: that rate does not load the loop.
_NO_LOAD = 1e-6


def with_largest_rates(design: LoopDesign) -> LoopDesign:
    """Return a caging design with the rates that it can hold where it is closed.

    What does not exist for a loop is left out: the largest Omega of torquers without limits, of an axis that loads
    none, and of a loop that is not stable.
    """
    if design.measures is None or not design.measures.decay[0] > 0.0:
        return design
    return dataclasses.replace(design, claims=dict(design.claims) | largest_rates(design))


def largest_rates(design: LoopDesign) -> dict[str, float]:
    """Return the constant rates about the root axes at which the first torquer comes to its limit, rad/s.

    Those of the nominal plant, and where they are all stable the least over the plants of the parameter uncertainty.
    They follow from the torques in the steady state; while Omega changes the torques may be larger.
    """
    plants, measures = design.plants, design.measures
    assert plants is not None, "a caging loop has plants"
    assert measures is not None, "and is measured"
    A, B, C, D, _ = Loop(plants, with_commands(plants, design.controller)).arrays
    torques, rates = slice(len(plants.torques)), slice(len(plants.torques), len(plants.torques) + 3)
    varied = plants.of(("nominal", "uncertainty"))
    chosen = varied if np.all(measures.decay[varied] > 0.0) else np.arange(len(A)) == 0
    A, B, C, D = A[chosen], B[chosen][..., rates], C[chosen][:, torques], D[chosen][:, torques, rates]
    try:
        steady = D + C @ np.linalg.solve(np.eye(A.shape[-1]) - A, B)
    except np.linalg.LinAlgError:
        return {}
    # Per axis: share of its limit that the most loaded torquer needs for 1 rad/s.
    share = np.abs(steady / plants.torque_limit[:, None]).max(axis=1)
    out = {}
    for axis in map(int, np.flatnonzero(share[0] > _NO_LOAD)):
        out[largest_Omega_name(axis + 1)] = float(1.0 / share[0, axis])
        if len(share) > 1:
            out[largest_Omega_name(axis + 1, worst_case=True)] = float(1.0 / share[:, axis].max())
    return out


def largest_Omega_name(axis: int, *, worst_case: bool = False) -> str:
    """Return the name of the claim of the largest Omega without saturation about a root axis, 1 to 3."""
    return f"largest {OMEGA_NAMES[axis - 1]} without saturation{', worst case' if worst_case else ''}, rad/s"
