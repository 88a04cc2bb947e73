"""Largest singular values of many small matrices, compiled: one-sided Jacobi rotations (Hestenes) on LANES of them."""

from __future__ import annotations

import math

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray
from platform_ctrl.common.simd import (
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
from platform_ctrl.common.values import FloatArray

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


@inlined
def _eliminate(W: ComplexArray) -> bool:
    """Turn [X, I] into [I, X^-1]; return whether X has no inverse."""
    m = W.shape[0]
    for c in range(m):
        best, at = 0.0, c
        for i in range(c, m):
            size = abs(W[i, c].real) + abs(W[i, c].imag)
            if size > best:
                best, at = size, i
        if best == 0.0:  # nor is a pivot found among what is no number
            return True
        factor = 1.0 / W[at, c]
        for j in range(c, 2 * m):
            W[at, j], W[c, j] = W[c, j], W[at, j] * factor
        for i in range(m):
            if i != c:
                other = W[i, c]
                for j in range(c, 2 * m):
                    W[i, j] -= other * W[c, j]
    return False


@compiled
def invert(X: ComplexArray) -> None:
    """Put the inverse in the place of each of the matrices (N, m, m); inf all over where one is singular."""
    N, m = X.shape[:2]
    W = np.empty((m, 2 * m), dtype=np.complex128)
    for k in range(N):
        for i in range(m):
            for j in range(m):
                W[i, j], W[i, m + j] = X[k, i, j], 1.0 if i == j else 0.0
        singular = _eliminate(W)
        for i in range(m):
            for j in range(m):
                X[k, i, j] = np.inf if singular else W[i, m + j]


@compiled
def close(P: ComplexArray, K: ComplexArray, S_output: ComplexArray, S_input: ComplexArray) -> None:
    """Write both sensitivities of plants (N, F, p, m) with one controller (F, m, p); inf where I - P K is singular."""
    N, F, p, m = P.shape
    W, KS = np.empty((p, 2 * p), dtype=np.complex128), np.empty((m, p), dtype=np.complex128)
    for n in range(N):
        for f in range(F):
            for i in range(p):
                for j in range(p):
                    loop = 0j
                    for r in range(m):
                        loop += P[n, f, i, r] * K[f, r, j]
                    one = 1.0 if i == j else 0.0
                    W[i, j], W[i, p + j] = one - loop, one
            singular = _eliminate(W)
            for i in range(p):
                for j in range(p):
                    S_output[n, f, i, j] = np.inf if singular else W[i, p + j]
            for i in range(m):
                for j in range(p):
                    KS[i, j] = 0j
                    for r in range(p):
                        KS[i, j] += K[f, i, r] * S_output[n, f, r, j]
                for j in range(m):
                    through = 0j
                    for r in range(p):
                        through += KS[i, r] * P[n, f, r, j]
                    S_input[n, f, i, j] = np.inf if singular else through + (1.0 if i == j else 0.0)


def outputs(
    A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, u: FloatArray, x0: FloatArray, doublings: int
) -> FloatArray:
    """Return y (p, N) for u (m, N) and x[0] = x0, in blocks of 2**doublings samples."""
    (n, m), p, N, L = B.shape, len(C), u.shape[1], 1 << doublings
    blocks = -(-N // L)
    inputs = np.zeros((blocks * L, m))
    inputs[:N] = u.T
    inputs = inputs.reshape(blocks, L * m)
    # Of rows: the states that outputs see, those that inputs drive, A^L transposed.
    turned = np.array(A.T, order="C")
    seen, driven, within = np.zeros((L * p, n)), np.zeros((L * m, n)), np.zeros((L * m, L * p))
    seen[:p], driven[-m:] = C, B.T
    power = _matrices(np.array(A, order="C"), turned, np.array(D, order="C"), doublings, seen, driven, within)
    x = inputs @ driven
    _between(power, np.array(x0), x)
    y = inputs @ within + x @ seen.T
    return np.ascontiguousarray(y.reshape(blocks * L, p)[:N].T)


@compiled
def _matrices(
    A: FloatArray,
    turned: FloatArray,
    D: FloatArray,
    doublings: int,
    seen: FloatArray,
    driven: FloatArray,
    within: FloatArray,
) -> FloatArray:
    """Go on with `seen` (L p, n), C at its top, and `driven` (L m, n), B transposed at its end; return A^L transposed.

    The inputs of a block have the outputs inputs times `within` (L m, L p) in it.
    """
    p, m = D.shape
    L = 1 << doublings
    for row in range(p, L * p):
        _add_product(seen, row - p, A, seen, row)
    for row in range(L * m - m - 1, -1, -1):
        _add_product(driven, row + m, turned, driven, row)
    for row in range(L):
        for i in range(p):
            for j in range(m):
                within[row * m + j, row * p + i] = D[i, j]
                # The response to the input that is `row` samples old, wherever it came.
                response = 0.0
                if row > 0:
                    for k in range(len(A)):
                        response += seen[(row - 1) * p + i, k] * driven[(L - 1) * m + j, k]
                for column in range(L - row if row > 0 else 0):
                    within[column * m + j, (column + row) * p + i] = response
    power = turned
    for _ in range(doublings):
        square = np.zeros(A.shape)
        for row in range(len(A)):
            _add_product(power, row, power, square, row)
        power = square
    return power


@internal
def _add_product(X: FloatArray, row: int, Y: FloatArray, out: FloatArray, to: int) -> None:
    """Add a row of X times Y to a row of `out`."""
    for k in range(Y.shape[0]):
        factor = X[row, k]
        for j in range(Y.shape[1]):
            out[to, j] += factor * Y[k, j]


@compiled
def _between(power: FloatArray, before: FloatArray, x: FloatArray) -> None:
    """Put the states before the blocks into x (blocks, n), which comes with what the inputs of each block add."""
    blocks, n = x.shape
    after = before.copy()
    for b in range(blocks):
        for i in range(n):
            after[i] = x[b, i]
        # Two at a time: what is added to waits for what was added before.
        for k in range(0, n - 1, 2):
            one, other = before[k], before[k + 1]
            for i in range(n):
                after[i] += power[k, i] * one + power[k + 1, i] * other
        if n % 2:
            for i in range(n):
                after[i] += power[n - 1, i] * before[n - 1]
        for i in range(n):
            x[b, i] = before[i]
            before[i] = after[i]
