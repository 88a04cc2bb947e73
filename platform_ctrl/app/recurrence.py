"""The states of many sampled systems over time, compiled; a module of its own because it loads numba."""

from __future__ import annotations

from platform_ctrl.common.simd import compiled
from platform_ctrl.common.values import FloatArray


@compiled
def recur(A: FloatArray, x: FloatArray) -> None:
    """Replace inputs b, x (N, T, n), by the states x[k+1] = A x[k] + b[k]; `A` (N, n, n) are transposed matrices."""
    N, T, n = x.shape
    for i in range(N):
        for k in range(1, T):
            for column in range(n):
                state = x[i, k - 1, column]
                for row in range(n):
                    x[i, k, row] += A[i, column, row] * state
