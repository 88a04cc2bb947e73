"""Largest singular values of many small matrices, compiled: one-sided Jacobi rotations (Hestenes)."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from platform_ctrl.analysis.arrays import ComplexArray
from platform_ctrl.frozen import FloatArray


def _largest_singular_values(H: ComplexArray, out: FloatArray) -> None:
    """Fill in the largest singular value of each of the matrices (N, p, m); inf where one is not finite."""
    N, p, m = H.shape
    tall = p >= m
    length, count = (p, m) if tall else (m, p)
    W = np.empty((count, length), dtype=np.complex128)
    for k in range(N):
        largest = 0.0
        for i in range(p):
            for j in range(m):
                size = max(abs(H[k, i, j].real), abs(H[k, i, j].imag))
                # Not a number compares as false.
                largest = max(largest, size) if size <= math.inf else math.inf
        if largest == 0.0 or largest == math.inf:
            out[k] = largest
            continue
        for i in range(count):
            for j in range(length):
                W[i, j] = (H[k, j, i] if tall else H[k, i, j]) / largest
        for _ in range(30):
            turned = False
            for i in range(count):
                for j in range(i + 1, count):
                    alpha = beta = 0.0
                    gamma = 0j
                    for r in range(length):
                        alpha += W[i, r].real ** 2 + W[i, r].imag ** 2
                        beta += W[j, r].real ** 2 + W[j, r].imag ** 2
                        gamma += W[i, r].conjugate() * W[j, r]
                    size = abs(gamma)
                    if size == 0.0:
                        continue
                    ratio = (beta - alpha) / (2.0 * size)
                    t = math.copysign(1.0, ratio) / (abs(ratio) + math.sqrt(1.0 + ratio * ratio))
                    # What the larger one would gain does not reach the largest value's digits.
                    if abs(t) * size <= 1e-17 * max(alpha, beta, 1e-2):
                        continue
                    turned = True
                    c = 1.0 / math.sqrt(1.0 + t * t)
                    s = c * t
                    phase = gamma.conjugate() / size
                    for r in range(length):
                        x, y = W[i, r], W[j, r] * phase
                        W[i, r] = c * x - s * y
                        W[j, r] = s * x + c * y
            if not turned:
                break
        best = 0.0
        for i in range(count):
            total = 0.0
            for r in range(length):
                total += W[i, r].real ** 2 + W[i, r].imag ** 2
            best = max(best, total)
        out[k] = math.sqrt(best) * largest


try:
    largest_singular_values = njit(cache=True, nogil=True, error_model="numpy")(_largest_singular_values)
except RuntimeError:  # nowhere to keep a cache: compile in every process
    largest_singular_values = njit(nogil=True, error_model="numpy")(_largest_singular_values)
