"""The states of many sampled systems over time, x[k+1] = A x[k] + b[k], compiled."""

from __future__ import annotations

from platform_ctrl.frozen import FloatArray
from platform_ctrl.lanes import compiled


@compiled
def recur(A: FloatArray, x: FloatArray) -> None:
    """Turn what drives N systems, x (N, T, n), into their states after it; `A` (N, n, n) are transposed matrices."""
    N, T, n = x.shape
    for i in range(N):
        for k in range(1, T):
            for column in range(n):
                state = x[i, k - 1, column]
                for row in range(n):
                    x[i, k, row] += A[i, column, row] * state
