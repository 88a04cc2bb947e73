"""The mechanics: kinematics of the tree, the matrices of the method, and the equations of motion."""

from __future__ import annotations

from platform_ctrl.mechanics.equations import forward_dynamics, inverse_dynamics
from platform_ctrl.mechanics.kinematics import Kinematics, Topology, kinematics, topology
from platform_ctrl.mechanics.matrices import MagnusMatrices, matrices

__all__ = [
    "Kinematics",
    "MagnusMatrices",
    "Topology",
    "forward_dynamics",
    "inverse_dynamics",
    "kinematics",
    "matrices",
    "topology",
]
