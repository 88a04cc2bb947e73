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

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis.loop_set import Transfer
from platform_ctrl.analysis.measuring import ControllerGain, Peak
from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.design.fixed_structure.loops import ClosedLoops, Pieces, joined
from platform_ctrl.design.fixed_structure.maps import CONTROLLER, Map, map_of, torque_per_Omega
from platform_ctrl.job.requirements import LoopRequirement


def pieces(loops: ClosedLoops, requirement: LoopRequirement, floor: float = 0.8) -> Pieces:
    """Return the pieces of a requirement whose ratio is at least `floor`, and the worst.

    A requirement is met where all its pieces are at most 1. Most are its ratios; "bandwidth" requires S at most 1/√2 up
    to its limit, "stability" counts decay rates in a share of the nutation frequency. Metrics without a gradient, and
    norms between named signals, have no pieces.
    """
    plants, metric = loops.plants, requirement.metric
    limit, measure = metric.in_SI(requirement.limit), metric.measure
    members = members_of(plants, requirement)
    if not len(members):
        return loops.none()
    if isinstance(measure, Peak):
        below, factor = (floor / limit, limit) if measure.reciprocal else (floor * limit, 1.0 / limit)
        edges = [w for w in (requirement.lowest, requirement.frequency) if w]
        band = (requirement.lowest, requirement.frequency or np.inf)
        maps = [of for transfer in measure.transfers for of in _maps(transfer, plants)]
        found = [loops.peaks(of, below, members, band) for of in maps]
        found += [loops.edge(of, edge, members) for of in maps for edge in edges]
        return joined([loops.none(), *found]).times(factor)
    if isinstance(measure, ControllerGain):
        nominal = np.zeros(1, dtype=np.intp)
        low = 0.1 * plants.nutation if requirement.frequency is None else requirement.frequency
        inside = loops.peaks(CONTROLLER, floor * limit, nominal, (low, np.inf))
        return joined([inside, loops.edge(CONTROLLER, low, nominal)]).times(1.0 / limit)
    found_pieces: Pieces = loops.none() if measure.gradient is None else measure.gradient(loops, limit, floor, members)
    return found_pieces


def _maps(transfer: Transfer, plants: PlantSet) -> Iterator[Map]:
    if not transfer.of_limit:
        yield map_of(transfer)
        return
    for k in np.flatnonzero(np.isfinite(plants.torque_limit)):
        yield torque_per_Omega(int(k), plants)


def members_of(plants: PlantSet, requirement: LoopRequirement) -> NDArray[np.intp]:
    """Return the numbers of the plants that a requirement is about."""
    return np.flatnonzero([group in requirement.over for group in plants.groups])
