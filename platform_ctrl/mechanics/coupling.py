"""Which gimbals' equations are coupled: groups of connected entries, and how large an entry rounding alone can make."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.common.values import FloatArray
from platform_ctrl.mechanics.kinematics import Topology
from platform_ctrl.plant.platform import Platform

# Rounding of a sum over the tree, relative to the sum of the sizes of its terms.
_ROUNDING = 256 * np.finfo(float).eps


def connected(coupled: ArrayLike) -> list[list[int]]:
    """Return the indices, sorted, of each group that the entries of a square bool matrix connect."""
    from scipy.sparse.csgraph import connected_components

    number, group = connected_components(np.asarray(coupled, dtype=bool), directed=False)
    return [np.flatnonzero(group == k).tolist() for k in range(number)]


def inertia_rounding(tree: Topology) -> FloatArray:
    """Return the rounding to expect in what inertias give gimbals i and j, (n, n): only what both carry enters it."""
    size = np.trace(tree.inertias, axis1=1, axis2=2)
    np.add.at(size, tree.carriers, tree.C * tree.regulated)
    return _carried_by_both(tree, size)


def momentum_rounding(tree: Topology) -> FloatArray:
    """Return the rounding to expect in what rotors' L gives gimbals i and j, (n, n)."""
    size = np.zeros(len(tree.on_path))
    np.add.at(size, tree.carriers, np.abs(tree.L))
    return _carried_by_both(tree, size)


def force_rounding(platform: Platform, tree: Topology, specific_force: float) -> FloatArray:
    """Return the rounding to expect in what elements' torques on gimbal i owe to angle j, (n, n).

    Springs, friction and cages act on the diagonal alone and have none.
    """
    moments = np.zeros(len(tree.on_path))
    for unbalance in platform.unbalances:
        moments[platform.body(unbalance.body)] += np.linalg.norm(unbalance.moment)
    out = specific_force * _carried_by_both(tree, moments)
    for device in platform.erections:
        out[platform.gimbal(device.gimbal)] += _ROUNDING * abs(device.gain) * tree.on_path[platform.body(device.senses)]
    return out


def _carried_by_both(tree: Topology, size: FloatArray) -> FloatArray:
    on_path = tree.on_path.astype(np.float64)
    return np.asarray(_ROUNDING * np.einsum("bi,bj,b->ij", on_path, on_path, size))
