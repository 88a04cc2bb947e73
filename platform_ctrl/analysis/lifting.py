"""One period of a sampled loop as one step: the lifted plant, equivalent in norm to continuous w and z.

For a level γ the worst w of a period solves a linear-quadratic problem whose Hamiltonian maps state and costate over
the period. Its three blocks A, G, Q are those of a discrete plant in which γ has become 1 (Bamieh and Pearson, Systems
& Control Letters 18, 1992; Kabamba and Hara, IEEE Trans. Autom. Control 38, 1993). Instead of one long matrix
exponential short ones are joined two by two: that keeps every number moderate, and shows at once where γ is too small
for the period alone.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.common.values import FloatArray

# Short enough that the exponential of the Hamiltonian over it is near the identity: no conjugate point inside.
_SHORT = 0.4
# Beyond so many of these a period is no period of this plant.
_LONGEST = 1e15


class PeriodExceedsLevel(Exception):
    """Within a single period z is larger than the level allows: the level lies below the norm."""


class SampledPlant(NamedTuple):
    """A continuous plant with inputs [w, u] and outputs [z, y] in a sampled loop, its period and delay in periods."""

    A: FloatArray
    B1: FloatArray
    B2: FloatArray
    C1: FloatArray
    C2: FloatArray
    D12: FloatArray
    D22: FloatArray
    period: float
    whole: int
    part: float

    @property
    def reach(self) -> int:
        """Number of past controls that still act in a period."""
        return self.whole + (1 if self.part > 0.0 else 0)


class Step(NamedTuple):
    """What a stretch of time does to the state v and the costate λ of ∫ z'z − w'w: v₁ = A v₀ + G λ₁, λ₀ = Q v₀ + A' λ₁.

    G and Q are positive semidefinite: w reaches G^(1/2), and Q^(1/2) v₀ is what the worst w makes of v₀.
    """

    A: FloatArray
    G: FloatArray
    Q: FloatArray


def lifted_plant(plant: SampledPlant, s: FloatArray) -> StateArrays:
    """Return the discrete plant of one period: inputs [w, u], outputs [z, y]; B B' and C' C are its Gramians.

    States: those of the plant, over the scaling s (n,), then the controls u[k-1], u[k-2], ... that the delay
    needs.
    """
    A, B1, B2, C1, C2, D12, D22, period, _, part = plant
    n, m, p = len(A), B2.shape[1], len(C2)
    A, B1, B2, C1, C2 = A * s / s[:, None], B1 / s[:, None], B2 / s[:, None], C1 * s, C2 * s
    # The unit of a control is what it does to the states in a period, or to z at once.
    unit = np.maximum(np.abs(B2).max(axis=0, initial=0.0) * period, np.abs(D12).max(axis=0, initial=0.0))
    unit = np.where(unit > 0.0, 1.0 / np.where(unit > 0.0, unit, 1.0), 1.0)
    late = _stretch(A, B1, B2 * unit, C1, D12 * unit, (1.0 - part) * period)
    # v = [x, u₁, u₂]: u₁ acts before the delay's fractional part is over, u₂ after it.
    first, second = list(range(n + m)), [*range(n), *range(n + m, n + 2 * m)]
    whole = _embedded(late, second, n + 2 * m)
    if part > 0.0:
        early = _stretch(A, B1, B2 * unit, C1, D12 * unit, part * period)
        whole = joined(_embedded(early, first, n + 2 * m), whole, False)
    reach = plant.reach
    size = n + reach * m
    into = np.zeros((n + 2 * m, size + m))
    into[:n, :n] = np.eye(n)
    # Controls in the order [u[k-1], ..., u[k-reach], u[k]] behind x; u[k - j] as a column of `into`.
    column = [size if j == 0 else n + (j - 1) * m for j in range(reach + 1)]
    if part > 0.0:
        into[n : n + m, column[plant.whole + 1] : column[plant.whole + 1] + m] = np.diag(1.0 / unit)
    into[n + m :, column[plant.whole] : column[plant.whole] + m] = np.diag(1.0 / unit)
    B_w = factor(whole.G[:n, :n])
    C_z = factor(whole.Q).T @ into
    state = np.zeros((size, size + m))
    state[:n] = whole.A[:n] @ into
    for j in range(reach):
        state[n + j * m : n + (j + 1) * m, column[j] : column[j] + m] = np.eye(m)
    y = np.zeros((p, size + m))
    y[:, :n] = C2
    y[:, column[reach] : column[reach] + m] += D22
    nw, nz = B_w.shape[1], len(C_z)
    return StateArrays(
        A=state[:, :size],
        B=np.hstack([np.vstack([B_w, np.zeros((reach * m, nw))]), state[:, size:]]),
        C=np.vstack([C_z, y])[:, :size],
        D=np.hstack([np.zeros((nz + p, nw)), np.vstack([C_z, y])[:, size:]]),
        dt=period,
    )


def _stretch(
    A: FloatArray,
    B1: FloatArray,
    B2: FloatArray,
    C1: FloatArray,
    D12: FloatArray,
    duration: float,
) -> Step:
    """Return the step over `duration` of the state [x, u], u held."""
    n, m = B2.shape
    F, B, C = np.zeros((n + m, n + m)), np.zeros((n + m, B1.shape[1])), np.hstack([C1, D12])
    F[:n, :n], F[:n, n:] = A, B2
    B[:n] = B1
    step, doublings = _halved(F, B @ B.T, C.T @ C, duration)
    for _ in range(doublings):
        step = joined(step, step, False)
    return step


def _halved(F: FloatArray, G: FloatArray, Q: FloatArray, duration: float) -> tuple[Step, int]:
    """Return the step over duration/2^k, short enough for one exponential, and k."""
    from scipy.linalg import expm

    size = len(F)
    none = np.zeros((size, size))
    hamiltonian = np.block([[F, G], [none, -F.T]])
    long = float(np.linalg.norm(np.block([[F, G], [Q, F.T]]), 1)) * duration
    if not long < _LONGEST:
        raise PeriodExceedsLevel
    doublings = max(0, math.ceil(math.log2(long / _SHORT))) if long > 0.0 else 0
    h = duration / 2.0**doublings
    phi = expm(hamiltonian * h)
    A = phi[:size, :size]
    seen = expm(np.block([[-F.T, Q], [none, F]]) * h)[:size, size:]
    return Step(A, _symmetric(phi[:size, size:] @ A.T), _symmetric(A.T @ seen)), doublings


def joined(first: Step, second: Step, finite: bool) -> Step:
    """Return one step after the other; at an infinite level G and Q are Gramians and add up.

    Where the level is finite and below what the two together reach, `PeriodExceedsLevel` is raised.
    """
    middle, G, Q = np.eye(len(first.A)), first.G, second.Q
    if finite:
        # The eigenvalues of G Q are those of the symmetric B' Q B with G = B B'.
        B = factor(first.G)
        gain = _symmetric(B.T @ second.Q @ B)
        if gain.size and not np.linalg.eigvalsh(gain)[-1] < 1.0:
            raise PeriodExceedsLevel
        # (I − G Q)⁻¹ = I + B (I − B' Q B)⁻¹ B' Q: the symmetric core keeps G and Q of the whole positive.
        core = np.linalg.inv(np.eye(len(gain)) - gain)
        seen = second.Q @ B
        middle, G, Q = middle + B @ core @ seen.T, B @ core @ B.T, second.Q + seen @ core @ seen.T
    return Step(
        second.A @ middle @ first.A,
        _symmetric(second.G + second.A @ G @ second.A.T),
        _symmetric(first.Q + first.A.T @ Q @ first.A),
    )


def _embedded(step: Step, where: list[int], size: int) -> Step:
    """Return the step for a longer state of which it moves the entries `where`; the others stay."""
    A, G, Q = np.eye(size), np.zeros((size, size)), np.zeros((size, size))
    index = np.ix_(where, where)
    A[index], G[index], Q[index] = step.A, step.G, step.Q
    return Step(A, G, Q)


def factor(square: FloatArray) -> FloatArray:
    """Return B with B B' = a positive semidefinite matrix, one column for each direction above rounding."""
    if square.size == 0:
        return np.zeros((len(square), 0))
    values, vectors = np.linalg.eigh(square)
    kept = values > len(square) * np.finfo(float).eps * max(float(values[-1]), 0.0)
    out: FloatArray = vectors[:, kept] * np.sqrt(values[kept])
    return out


def _symmetric(matrix: FloatArray) -> FloatArray:
    out: FloatArray = 0.5 * (matrix + matrix.T)
    return out
