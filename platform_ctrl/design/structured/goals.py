"""Requirements as smooth pieces: ratios of single plants at single frequencies or poles, with analytic gradients.

The largest ratio of a requirement over plants, frequencies and poles has kinks; each candidate by itself is smooth in
the controller. So a requirement is taken apart into pieces, only those near the worst are worked out, and the
optimiser sees several at once. With everything of the controller in one matrix

    M = [[A_K, B_K], [C_K, D_K]]

every piece f has a gradient of the form ∂f/∂M = Σ Re(a bᵀ):

* a singular value of S, T, (S − T)/2, P S or K with singular vectors u, v: dS_output = S_output P dK S_output,
  dS_input = S_input dK P S_input, dK = [C_K R, I] dM [R B_K; I] with R = (zI − A_K)⁻¹;
* a pole λ with eigenvectors y, x (yᴴx = 1): dλ = yᴴ dA x of the closed loop;
* the variance of a torque: X = A X Aᵀ + B Bᵀ and its adjoint.

A peak between grid points is followed to its top. The bandwidth has no smooth pieces of its own where S lies along the
level; so the question is turned round: S is at most 1/√2 up to a frequency, which a search may move.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.design.structured.loops import ClosedLoops, Pieces, joined
from platform_ctrl.design.structured.maps import (
    ANGLE_PER_OMEGA,
    ANGLE_PER_TORQUE,
    CONTROLLER,
    HALF_INPUT,
    HALF_OUTPUT,
    S_INPUT,
    S_OUTPUT,
    T_INPUT,
    T_OUTPUT,
    Map,
    torque_per_Omega,
)
from platform_ctrl.job.requirements import LoopRequirement

_PEAKS: dict[str, tuple[Map, ...]] = {
    "sensitivity peak": (S_OUTPUT, S_INPUT),
    "complementary peak": (T_OUTPUT, T_INPUT),
    "torque rejection": (ANGLE_PER_TORQUE,),
    "Omega rejection": (ANGLE_PER_OMEGA,),
}


def pieces(loops: ClosedLoops, requirement: LoopRequirement, floor: float = 0.8) -> Pieces:
    """Return the pieces of a requirement whose ratio is at least `floor`, and the worst.

    A requirement is met where all its pieces are at most 1. Most are its ratios; "bandwidth" asks for S at most 1/√2
    up to its limit, "stability" counts decay rates in a share of the nutation frequency.

    Parameters
    ----------
    loops
        The controller closed around the plants.
    requirement
        Of any kind; "H-infinity norm" and "H2 norm" with signals of their own have no pieces here.
    floor
        Ratio below which a piece is of no interest.
    """
    plants, limit = loops.plants, requirement.limit
    members = members_of(plants, requirement)
    nominal = np.zeros(1, dtype=np.intp)
    if not len(members):
        return loops.none()
    match requirement.kind:
        case "bandwidth":
            return loops.level(2.0 * np.pi * limit, floor)[0]
        case "stability":
            return loops.decay(limit, members)
        case "damping":
            return loops.damping(floor, limit, members)
        case "fastest pole":
            return loops.fastest(floor, limit, members)
        case "torque noise":
            return loops.noise(limit, members)
        case "controller poles":
            return loops.controller_poles(floor, limit)
        case "tracking" if requirement.frequency is not None:
            inside = loops.peaks(S_OUTPUT, floor * limit, members, (0.0, requirement.frequency))
            return joined([inside, loops.edge(S_OUTPUT, requirement.frequency, members)]).times(1.0 / limit)
        case "controller gain":
            low = 0.1 * plants.nutation if requirement.frequency is None else requirement.frequency
            inside = loops.peaks(CONTROLLER, floor * limit, nominal, (low, np.inf))
            return joined([inside, loops.edge(CONTROLLER, low, nominal)]).times(1.0 / limit)
        case "disk margin":
            return joined([loops.peaks(of, floor / limit, members) for of in (HALF_OUTPUT, HALF_INPUT)]).times(limit)
        case "torque limit":
            band = (0.0, np.inf if requirement.frequency is None else requirement.frequency)
            limited = [k for k in range(loops.m) if np.isfinite(plants.torque_limit[k])]
            maps = [torque_per_Omega(k, plants) for k in limited]
            return joined([loops.none(), *(loops.peaks(of, floor * limit, members, band) for of in maps)]).times(
                1.0 / limit
            )
        case "sensitivity peak" | "complementary peak" | "torque rejection" | "Omega rejection":
            maps = list(_PEAKS[requirement.kind])
            return joined([loops.peaks(of, floor * limit, members) for of in maps]).times(1.0 / limit)
    return loops.none()


def members_of(plants: PlantSet, requirement: LoopRequirement) -> NDArray[np.intp]:
    """Return the numbers of the plants of which a requirement is requested."""
    return np.flatnonzero([group in requirement.over for group in plants.groups])
