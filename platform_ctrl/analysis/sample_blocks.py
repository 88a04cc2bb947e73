"""The recurrence x[k+1] = A x[k] + B u[k], y[k] = C x[k] + D u[k], compiled, a block of samples at a time.

The outputs of a block of L samples are O x + T u with the state x before it, the inputs u of the block,
O = [C; C A; C A²; ...] and the Toeplitz matrix T of the impulse response; one product does all blocks. What is left to
do one after another is the states between the blocks.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np
from numba import njit

from platform_ctrl.frozen import FloatArray

F = TypeVar("F", bound=Callable[..., Any])


def _compiled(function: F) -> F:
    fast = {"contract", "reassoc", "nsz"}
    try:
        return cast(F, njit(cache=True, nogil=True, error_model="numpy", fastmath=fast)(function))
    except RuntimeError:  # nowhere to keep a cache: compile in every process
        return cast(F, njit(nogil=True, error_model="numpy", fastmath=fast)(function))


@_compiled
def outputs(
    A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, u: FloatArray, x0: FloatArray, doublings: int
) -> FloatArray:
    """Return y (p, N) for u (m, N) and x[0] = x0, in blocks of 2**doublings samples; all arrays are contiguous."""
    (n, m), p, N, L = B.shape, C.shape[0], u.shape[1], 1 << doublings
    blocks = (N + L - 1) // L
    # C A^k from the top down; (A^k B) transposed from the bottom up; A^L.
    seen, driven = np.empty((L * p, n)), np.empty((L, m, n))
    A_turned, power = np.ascontiguousarray(A.T), A
    seen[:p] = C
    driven[L - 1] = np.ascontiguousarray(B.T)
    for k in range(1, L):
        seen[k * p : (k + 1) * p] = np.dot(seen[(k - 1) * p : k * p], A)
        driven[L - 1 - k] = np.dot(driven[L - k], A_turned)
    for _ in range(doublings):
        power = np.dot(power, power)
    impulse = np.dot(seen, B)
    within = np.zeros((L * m, L * p))
    for row in range(L):
        for i in range(p):
            for j in range(m):
                within[row * m + j, row * p + i] = D[i, j]
                for column in range(row):
                    within[column * m + j, row * p + i] = impulse[(row - column - 1) * p + i, j]
    inputs = np.zeros((blocks, L * m))
    for j in range(m):
        for k in range(N):
            inputs[k // L, (k % L) * m + j] = u[j, k]
    x, forced = np.empty((blocks, n)), np.dot(inputs, driven.reshape(L * m, n))
    x[0] = x0
    for b in range(1, blocks):
        for i in range(n):
            total = forced[b - 1, i]
            for j in range(n):
                total += power[i, j] * x[b - 1, j]
            x[b, i] = total
    found = np.dot(inputs, within) + np.dot(x, np.ascontiguousarray(seen.T))
    y = np.empty((p, N))
    for i in range(p):
        for k in range(N):
            y[i, k] = found[k // L, (k % L) * p + i]
    return y
