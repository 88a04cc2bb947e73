"""Directions and inertias of a platform's bodies by turning matrices, from its public fields alone."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from platform_ctrl import Platform


class Directions(NamedTuple):
    """In root axes; bodies are the root, then the gimbals."""

    rotations: np.ndarray  # (1 + n, 3, 3): from body axes
    axes: np.ndarray  # (n, 3): of gimbals
    spin_axes: np.ndarray  # (m, 3): of rotors
    jacobians: np.ndarray  # (1 + n, 3, 3 + n): rates of bodies by [Omega, q̇]


def directions(platform: Platform, q: np.ndarray) -> Directions:
    n = len(platform.gimbals)
    rotations, jacobians, axes = np.zeros((1 + n, 3, 3)), np.zeros((1 + n, 3, 3 + n)), np.zeros((n, 3))
    rotations[0], jacobians[0, :, :3] = np.eye(3), np.eye(3)
    done = {-1}
    while len(done) <= n:  # a parent before its children
        for k in [k for k in range(n) if k not in done and int(platform.parents[k]) in done]:
            parent, gimbal = 1 + int(platform.parents[k]), platform.gimbals[k]
            axes[k] = rotations[parent] @ gimbal.axis
            rotations[1 + k] = rotations[parent] @ Rotation.from_rotvec(q[k] * gimbal.axis).as_matrix()
            jacobians[1 + k] = jacobians[parent]
            jacobians[1 + k, :, 3 + k] = axes[k]
            done.add(k)
    carried = [
        rotations[1 + int(body)] @ rotor.axis for rotor, body in zip(platform.rotors, platform.carriers, strict=True)
    ]
    return Directions(rotations, axes, np.array(carried).reshape(len(carried), 3), jacobians)


def guides(platform: Platform, body: int, k: int) -> bool:
    """Whether gimbal k is the body, of number 1 + its gimbal's, or carries it."""
    gimbal = body - 1
    while gimbal not in (-1, k):
        gimbal = int(platform.parents[gimbal])
    return gimbal == k


def inertias(platform: Platform, q: np.ndarray) -> np.ndarray:
    """Return the inertias of bodies without rotors in root axes, (1 + n, 3, 3)."""
    own = np.array([platform.root_inertia, *(gimbal.inertia for gimbal in platform.gimbals)])
    turned = directions(platform, q).rotations
    return np.asarray(turned @ own @ turned.transpose(0, 2, 1))
