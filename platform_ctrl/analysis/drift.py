"""Equilibria of a sampled loop that nothing holds: a body that stands still in inertial space at any angle.

A rate loop whose integrals carry the torque of a spring is in balance wherever the gimbal happens to be. The closed
loop then has a pole at exactly z = 1, whose vector v is an equilibrium, A v = v, that no sensor sees, C v = 0. It is no
motion and no instability: with v as a coordinate of its own, nothing else depends on it. What is left is judged; no
pole is moved. A pole that only lies near z = 1, or that a sensor sees, stays.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays, state_scaling
from platform_ctrl.common.values import FloatArray

# Singular value of [A - I; C] in balanced states, relative to the largest, below which it is rounding: a pole that
# decays or grows in an hour at 10 kHz is larger by a thousand.
_ROUNDING = 1e-12


class Drift(NamedTuple):
    """A system without its unseen equilibria, and these (n, d)."""

    system: StateArrays
    equilibria: FloatArray


def unseen_equilibria(system: StateArrays) -> Drift:
    """Return a sampled system without the equilibria that its outputs do not see: their poles z = 1 become 0, exactly.

    Responses of the outputs stay as they are.
    """
    A, B, C, D, dt = system
    n = len(A)
    if not n or not dt:
        return Drift(system, np.zeros((n, 0)))
    s = state_scaling(A, B, C)
    balanced, rows = A * s / s[:, None], C * s
    size = np.linalg.norm(rows, axis=1, keepdims=True)
    rows = rows[size[:, 0] > 0.0] / size[size[:, 0] > 0.0]
    _, found, vectors = np.linalg.svd(np.vstack([balanced - np.eye(n), rows]))
    count = int(np.count_nonzero(found < _ROUNDING * found[0]))
    if not count:
        return Drift(system, np.zeros((n, 0)))
    V = vectors[n - count :].T
    left = (balanced - (balanced @ V) @ V.T) * s[:, None] / s
    return Drift(StateArrays(left, B, C, D, dt), V * s[:, None])


def without_drift(system: StateArrays) -> StateArrays:
    """Return sampled systems (..., n, n) without equilibria that their outputs do not see or their inputs do not reach.

    Responses stay as they are; poles z = 1 that they do not have become 0.
    """
    A, B, C, D, dt = system
    batch = A.shape[:-2]
    out = np.array(A).reshape(-1, *A.shape[-2:])
    for k, place in enumerate(np.ndindex(*batch)):
        B_k, C_k = (item[place] if item.ndim > 2 else item for item in (B, C))
        seen = unseen_equilibria(StateArrays(out[k], B_k, C_k, np.zeros((len(C_k), B_k.shape[1])), dt)).system
        reached = unseen_equilibria(StateArrays(seen.A.T, C_k.T, B_k.T, np.zeros((B_k.shape[1], len(C_k))), dt))
        out[k] = reached.system.A.T
    return StateArrays(out.reshape(A.shape), B, C, D, dt)


def drifting_rms(system: StateArrays, rms: FloatArray, duration: float) -> FloatArray:
    """Return the rms (p,) of the outputs of one system with poles z = 1 after a time, s, from white samples.

    The part along the equilibria is a random walk, whose variance grows with time; the rest is stationary. Infinite
    where the system is unstable otherwise.
    """
    from platform_ctrl.analysis.norms import noise_rms

    A, B, C, D, dt = system
    s = state_scaling(A, B, C)
    balanced = A * s / s[:, None] - np.eye(len(A))
    left, found, right = np.linalg.svd(balanced)
    count = int(np.count_nonzero(found < _ROUNDING * found[0]))
    if not count:
        return noise_rms(system, rms, allow_unstable=True)
    V, W = right[len(A) - count :].T, left[:, len(A) - count :]
    coupling = W.T @ V
    if np.linalg.svd(coupling, compute_uv=False)[-1] < math.sqrt(_ROUNDING):
        return np.full(len(C), np.inf)
    P = (V @ np.linalg.solve(coupling, W.T)) * s[:, None] / s
    rest = StateArrays(A - P, B - P @ B, C, D, dt)
    walk = (C @ P @ B) * rms
    steps = duration / dt
    return np.asarray(
        np.hypot(noise_rms(rest, rms, allow_unstable=True), math.sqrt(steps) * np.linalg.norm(walk, axis=1))
    )
