"""The mechanics: kinematics of the tree, the matrices of the method, and the equations of motion."""

from __future__ import annotations

from platform_ctrl.mechanics.equations import forward_dynamics, inverse_dynamics
from platform_ctrl.mechanics.forces import element_forces
from platform_ctrl.mechanics.kinematics import Kinematics, Topology, kinematics, topology
from platform_ctrl.mechanics.matrices import MagnusMatrices, matrices
from platform_ctrl.mechanics.rotors import (
    RotorMomenta,
    rotor_momenta,
    with_free_rotors,
    with_regulated_rotors,
    with_rotors_as_gimbals,
)

__all__ = [
    "Kinematics",
    "MagnusMatrices",
    "RotorMomenta",
    "Topology",
    "element_forces",
    "forward_dynamics",
    "inverse_dynamics",
    "kinematics",
    "matrices",
    "rotor_momenta",
    "topology",
    "with_free_rotors",
    "with_regulated_rotors",
    "with_rotors_as_gimbals",
]
