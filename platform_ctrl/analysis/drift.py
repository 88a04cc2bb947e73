"""Equilibria of a sampled loop that nothing holds: a body that stands still in inertial space at any angle.

A rate loop whose integrals carry the torque of a spring is in balance wherever the gimbal happens to be. The closed
loop then has a pole at exactly z = 1, whose vector v is an equilibrium, A v = v, that no sensor sees, C v = 0. It is no
motion and no instability: with v as a coordinate of its own, nothing else depends on it. What is left is judged; no
pole is moved. A pole that only lies near z = 1, or that a sensor sees, stays.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from platform_ctrl.analysis.system import System, state_scaling
from platform_ctrl.common.values import FloatArray

# Singular value of [A - I; C] in balanced states, relative to the largest, below which it is rounding: a pole that
# decays or grows in an hour at 10 kHz is larger by a thousand.
_ROUNDING = 1e-12
# Share of a state in an equilibrium, and of the largest coupling of states, below which there is none.
_NO_PART, _NOTHING = 1e-13, 1e-30


class Drift(NamedTuple):
    """A system without its unseen equilibria, and these (n, d)."""

    system: System
    equilibria: FloatArray


def unseen_equilibria(system: System) -> Drift:
    """Return a sampled system without the equilibria that its outputs do not see: their poles z = 1 become 0, exactly.

    Responses of the outputs stay as they are.
    """
    V, L = _equilibria(system)
    return Drift(system._replace(A=system.A - (system.A @ V) @ L), V)


def _equilibria(system: System) -> tuple[FloatArray, FloatArray]:
    """Return unseen equilibria V (n, d) and how much of each there is in a state, L (d, n): L V = 1."""
    A, B, C, _, dt = system
    n = len(A)
    if not n or not dt:
        return np.zeros((n, 0)), np.zeros((0, n))
    s = state_scaling(*map(_coupling, (A, B, C)))
    balanced, rows = A * s / s[:, None], C * s
    size = np.linalg.norm(rows, axis=1, keepdims=True)
    rows = rows[size[:, 0] > 0.0] / size[size[:, 0] > 0.0]
    _, found, vectors = np.linalg.svd(np.vstack([balanced - np.eye(n), rows]))
    count = int(np.count_nonzero(found < _ROUNDING * found[0]))
    V = vectors[n - count :].T
    # States that have no part may have any scale.
    V = np.where(np.abs(V) > _NO_PART, V, 0.0)
    return V * s[:, None], V.T / s


def _coupling(matrix: FloatArray) -> FloatArray:
    """Return a matrix without what has decayed to nothing, over a long cycle say: no scale is to make up for it."""
    size = np.abs(matrix)
    return np.asarray(np.where(size > _NOTHING * size.max(initial=0.0), matrix, 0.0))


def without_drift(system: System) -> System:
    """Return sampled systems (..., n, n) without equilibria that their outputs do not see or their inputs do not reach.

    Responses stay as they are; poles z = 1 that they do not have become 0.
    """
    A, B, C, D, dt = system
    batch = A.shape[:-2]
    out = np.array(A).reshape(-1, *A.shape[-2:])
    for k, place in enumerate(np.ndindex(*batch)):
        B_k, C_k = (item[place] if item.ndim > 2 else item for item in (B, C))
        (V, L), (W, M) = _no_part(System(out[k], B_k, C_k, np.zeros((len(C_k), B_k.shape[1])), dt))
        left = out[k] - (out[k] @ V) @ L
        out[k] = left - M.T @ (W.T @ left)
    return System(out.reshape(A.shape), B, C, D, dt)


def over_a_cycle(systems: Sequence[System]) -> System:
    """Return systems that take turns as one, from the inputs of all samples to the outputs of all, without D."""
    state, seen = np.eye(systems[0].A.shape[1]), []
    for one in systems:
        seen.append(one.C @ state)
        state = one.A @ state
    after, reached = np.eye(len(state)), []
    for one in reversed(systems):
        reached.append(after @ one.B)
        after = after @ one.A
    B, C = np.hstack(reached), np.vstack(seen)
    return System(state, B, C, np.zeros((len(C), B.shape[1])), systems[0].dt)


def without_drift_over_a_cycle(systems: Sequence[System]) -> list[System]:
    """Return systems that take turns as `without_drift` does: what has no part in responses ends with each cycle."""
    (V, L), (W, M) = _no_part(over_a_cycle(systems))
    out = list(systems)
    out[0] = out[0]._replace(A=out[0].A - (out[0].A @ V) @ L)
    out[-1] = out[-1]._replace(A=out[-1].A - M.T @ (W.T @ out[-1].A))
    return out


def _no_part(system: System) -> tuple[tuple[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]:
    """Return the equilibria that outputs do not see, and of the transpose those that inputs do not reach."""
    A, B, C, D, dt = system
    V, L = _equilibria(system)
    return (V, L), _equilibria(System((A - (A @ V) @ L).T, C.T, B.T, D.T, dt))


def drifting_rms(system: System, rms: FloatArray, duration: float) -> FloatArray:
    """Return the rms (p,) of the outputs of one system with poles z = 1 after a time, s, from white samples.

    The part along the equilibria is a random walk, whose variance grows with time; the rest is stationary. Infinite
    where the system is unstable otherwise.
    """
    from platform_ctrl.analysis.norms import noise_rms

    A, B, C, D, dt = system
    s = state_scaling(*map(_coupling, (A, B, C)))
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
    rest = System(A - P, B - P @ B, C, D, dt)
    walk = (C @ P @ B) * rms
    steps = duration / dt
    return np.asarray(
        np.hypot(noise_rms(rest, rms, allow_unstable=True), math.sqrt(steps) * np.linalg.norm(walk, axis=1))
    )
