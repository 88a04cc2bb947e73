"""Largest singular values of many small matrices, compiled: one-sided Jacobi rotations (Hestenes) on LANES of them."""

from __future__ import annotations

import math

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray
from platform_ctrl.frozen import FloatArray
from platform_ctrl.lanes import (
    LANES,
    Number,
    anywhere,
    choose,
    compiled,
    greater,
    inlined,
    internal,
    load,
    root,
    store,
)

SWEEPS = 30


@compiled
def largest_singular_values(H: ComplexArray, out: FloatArray) -> None:
    """Fill in the largest singular value of each of the matrices (N, p, m); inf where one is not finite."""
    N, p, m = H.shape
    largest_of_columns(np.ascontiguousarray(H.reshape(N, p * m).T), p, m, out)


@internal
def largest_of_columns(entries: ComplexArray, p: int, m: int, out: FloatArray) -> None:
    """Fill in the same of matrices (p, m) whose entries, row by row, are the columns of `entries`, (p m, N)."""
    N, tall = entries.shape[1], p >= m
    # Rows are made orthogonal, or columns, whichever are fewer. Of each component: real and imaginary part.
    length, count = (p, m) if tall else (m, p)
    first, following = (1, m) if tall else (m, 1)
    work = np.zeros((2 * count * length + 2, LANES))
    size, result = 2 * count * length, 2 * count * length + 1
    for start in range(0, N, LANES):
        for t in range(LANES):
            # The last matrix fills what is left.
            k, largest = min(start + t, N - 1), 0.0
            for entry in entries[:, k]:
                part = max(abs(entry.real), abs(entry.imag))
                # Not a number compares as false.
                largest = max(largest, part) if part <= math.inf else math.inf
            plain = 0.0 < largest < math.inf
            work[size, t] = largest if plain else 1.0
            out[k] = largest
            for i in range(count):
                for r in range(length):
                    entry, slot = entries[i * first + r * following, k], 2 * (i * length + r)
                    work[slot, t], work[slot + 1, t] = (entry.real, entry.imag) if plain else (0.0, 0.0)
        _divide(work, size)
        for _ in range(SWEEPS):
            if not _swept(work, count, length):
                break
        store(work, result, None, _longest(work, count, length) * load(work, size, None))
        for t in range(min(LANES, N - start)):
            if 0.0 < out[start + t] < math.inf:
                out[start + t] = work[result, t]


@internal
def _divide(work: FloatArray, size: int) -> None:
    """Divide all slots before `size` by that one."""
    unit = load(work, size, None)
    for slot in range(size):
        store(work, slot, None, load(work, slot, None) / unit)


@internal
def _swept(work: FloatArray, count: int, length: int) -> bool:
    """Make each pair of vectors orthogonal; return whether any was not."""
    turned = False
    for i in range(count):
        for j in range(i + 1, count):
            turned = _turned(work, 2 * i * length, 2 * j * length, 2 * length) or turned
    return turned


@inlined
def _turned(work: FloatArray, one: int, other: int, length: int) -> bool:
    alpha = beta = re = im = 0.0 * load(work, one, None)
    for r in range(0, length, 2):
        a, b = load(work, one + r, None), load(work, one + r + 1, None)
        c, d = load(work, other + r, None), load(work, other + r + 1, None)
        alpha, beta = alpha + (a * a + b * b), beta + (c * c + d * d)
        re, im = re + (a * c + b * d), im + (a * d - b * c)
    size = root(re * re + im * im)
    some = size > 0.0
    inverse = choose(some, 1.0 / size, 0.0)
    ratio = 0.5 * (beta - alpha) * inverse
    t = 1.0 / (greater(ratio, -ratio) + root(1.0 + ratio * ratio))
    # What the longer one would gain does not reach the largest value's digits.
    some = some & (t * size > 1e-17 * greater(greater(alpha, beta), 0.0 * alpha + 1e-2))
    if not anywhere(some):
        return False
    t = choose(some, choose(ratio < 0.0, -t, t), 0.0)
    c = 1.0 / root(1.0 + t * t)
    _rotate(work, one, other, length, c, c * t, choose(some, re * inverse, 1.0), choose(some, im * inverse, 0.0))
    return True


@inlined
def _rotate(work: FloatArray, one: int, other: int, length: int, c: Number, s: Number, re: Number, im: Number) -> None:
    """Turn both vectors, the other one times re - j im."""
    for r in range(0, length, 2):
        a, b = load(work, one + r, None), load(work, one + r + 1, None)
        x, y = load(work, other + r, None), load(work, other + r + 1, None)
        u, v = x * re + y * im, y * re - x * im
        store(work, one + r, None, c * a - s * u)
        store(work, one + r + 1, None, c * b - s * v)
        store(work, other + r, None, s * a + c * u)
        store(work, other + r + 1, None, s * b + c * v)


@internal
def _longest(work: FloatArray, count: int, length: int) -> Number:
    best = zero = 0.0 * load(work, 0, None)
    for i in range(count):
        total = zero
        for slot in range(2 * i * length, 2 * (i + 1) * length):
            total += load(work, slot, None) * load(work, slot, None)
        best = greater(total, best)
    return root(best)
