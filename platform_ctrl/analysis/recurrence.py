"""The recurrence of states from sample to sample, compiled: it cannot be written as operations on whole arrays."""

from __future__ import annotations

import numba

from platform_ctrl.common.values import FloatArray


@numba.njit(cache=True, fastmath={"contract"})  # type: ignore[untyped-decorator]
def states(transposed: FloatArray, x: FloatArray) -> None:
    """Turn what drives each step, x[1:] (N - 1, n), into the states x[k+1] = A x[k] + x[k+1], A transposed (n, n)."""
    n = x.shape[1]
    for k in range(1, len(x)):
        for j in range(n):
            factor = x[k - 1, j]
            for i in range(n):
                x[k, i] += factor * transposed[j, i]
