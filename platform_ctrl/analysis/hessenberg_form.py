"""A system in the states that `resolvent` needs: one chain of states for each input, from that input on.

An orthogonal change of states turns b into beta e1 and A into Hessenberg form, by Householder's reflections (Golub and
Van Loan, Matrix Computations, sec. 7.4). Short chains are found side by side, a register of them at a time.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis.arrays import MANY_STATES
from platform_ctrl.common.simd import LANES, Number, choose, compiled, greater, internal, load, memory, root, store
from platform_ctrl.common.values import FloatArray

# What is below this share of |A| goes on to no state behind.
NOTHING = 2.0**-54


class Chains(NamedTuple):
    """A chain for each column of B, and one of the transposed system for a mixture of the rows of C."""

    # ((m + 1) (p + 1 + n)²,): matrices row by row: C in the first p rows and H in the last n, with the states in the
    # last n columns. Rows of H are divided by the entry left of the diagonal, beta in the first one, and have its
    # inverse there.
    rows: FloatArray
    lasts: NDArray[np.int64]  # (m + 1,): column of the last state that the chain reaches; p if none
    norms: FloatArray  # (p + 1,): of each row of C, and |A|
    # (p + 1 + n, p + 1 + n) and (p + n,), optional: what LAPACK's dgehrd returns for the first chain, with many
    # states
    reflected: tuple[FloatArray, FloatArray] | None = None

    def hessenberg(self) -> tuple[FloatArray, FloatArray]:
        """Return H and Q with A = Q H Q', both (n, n)."""
        from scipy.linalg.lapack import dorghr

        assert self.reflected is not None
        M, tau = self.reflected
        top = len(self.norms)
        Q = dorghr(M, tau, lo=top - 1, hi=len(M) - 1, lwork=32 * len(M))[0]
        return np.triu(M[top:, top:], -1), Q[top:, top:]


def chains(A: FloatArray, B: FloatArray, C: FloatArray) -> Chains:
    """Return the chains of a system with states, inputs and outputs; arrays are contiguous and may be written to."""
    (n, m), p = B.shape, C.shape[0]
    if n >= MANY_STATES:
        return _long_chains(A, B, C)
    size = p + 1 + n
    out = Chains(np.empty((m + 1) * size * size), np.empty(m + 1, dtype=np.int64), np.empty(p + 1))
    work = memory(size * size + n)
    reduce(A, B, C, work[:-n], work[-n:], *out[:3])
    return out


def _long_chains(A: FloatArray, B: FloatArray, C: FloatArray) -> Chains:
    """Return the chains, each by LAPACK's blocked reflections."""
    from scipy.linalg.lapack import dgehrd

    (n, m), p = B.shape, C.shape[0]
    size = p + 1 + n
    norms = np.append(np.linalg.norm(C, axis=1), np.linalg.norm(A))
    rows, lasts = np.empty((m + 1, size, size)), np.full(m + 1, p, dtype=np.int64)
    for j in range(m + 1):
        M = np.zeros((size, size), order="F")
        M[:p, p + 1 :] = C
        M[p + 1 :, p + 1 :] = A if j < m else A.T
        M[p + 1 :, p] = B[:, j] if j < m else _mixture(C, norms[:p])
        M, tau, _ = dgehrd(M, lo=p, hi=size - 1, lwork=32 * size, overwrite_a=1)
        if j == 0:
            reflected = M, tau
        below = M.diagonal(-1)[p:].copy()
        ends = np.abs(below) <= NOTHING * norms[p]
        ends[0] = below[0] == 0.0
        count = int(np.argmax(ends)) if np.any(ends) else n
        lasts[j] = p + count
        rows[j] = M
        reached, before = np.arange(p + 1, p + 1 + count), np.arange(p, p + count)
        rows[j, reached] /= below[:count, None]
        rows[j, reached, before] = 1.0 / below[:count]
    return Chains(rows.ravel(), lasts, norms, reflected)


def _mixture(C: FloatArray, norms: FloatArray) -> FloatArray:
    """Return a sum of the rows of C: each as large as the others, in a proportion that no symmetry of a system has."""
    k = np.arange(len(C))
    out: FloatArray = (np.cos(2.0 + 3.0 * k * k) / np.where(norms > 0.0, norms, np.inf)) @ C
    return out


@compiled
def reduce(
    A: FloatArray,
    B: FloatArray,
    C: FloatArray,
    M: FloatArray,
    v: FloatArray,
    rows: FloatArray,
    lasts: NDArray[np.int64],
    norms: FloatArray,
) -> None:
    """Write the chains of few states into `rows`, `lasts` and `norms`; M and v are memory."""
    (n, m), p = B.shape, C.shape[0]
    size, square = p + 1 + n, 0.0
    for i in range(p):
        for k in range(n):
            square += C[i, k] * C[i, k]
        norms[i] = math.sqrt(square)
        square = 0.0
    for i in range(n):
        for k in range(n):
            square += A[i, k] * A[i, k]
    norms[p] = math.sqrt(square)
    for start in range(0, m + 1, LANES):
        for t in range(LANES):
            # The last chain fills what is left of a register.
            j = min(start + t, m)
            for k in range(n):
                for i in range(n):
                    M[(p + 1 + i) * size + p + 1 + k, t] = A[i, k] if j < m else A[k, i]
                b = B[k, j] if j < m else 0.0
                for i in range(p):
                    M[i * size + p + 1 + k, t] = C[i, k]
                    if j == m and norms[i] > 0.0:
                        # Each output as large as the others, in a proportion that no symmetry of a system has.
                        b += math.cos(2.0 + 3.0 * i * i) / norms[i] * C[i, k]
                M[(p + 1 + k) * size + p, t] = b
        for first in range(p + 1, size):
            _reflect(M, size, first, v)
        for t in range(min(LANES, m + 1 - start)):
            lasts[start + t] = _divide(M, t, size, p, NOTHING * float(norms[p]), rows, (start + t) * size * size)


@internal
def _reflect(M: FloatArray, size: int, first: int, v: FloatArray) -> None:
    """Reflect the states from `first` on so that the column before them ends there."""
    # Of an entry that is set: the others hold what was in memory before, NaN perhaps.
    zero = 0.0 * load(M, first * size + first - 1, None)
    largest, square = zero, zero
    for k in range(first, size):
        entry = load(M, k * size + first - 1, None)
        largest = greater(greater(entry, -entry), largest)
    unit = choose(largest > 0.0, 1.0 / largest, 0.0)
    for k in range(first, size):
        entry = unit * load(M, k * size + first - 1, None)
        store(v, k - first, None, entry)
        square += entry * entry
    head, length = load(v, 0, None), root(square)
    length = choose(head < 0.0, -length, length)
    store(v, 0, None, head + length)
    store(M, first * size + first - 1, None, -length * largest)
    square += head * length
    twice = choose(square > 0.0, 1.0 / square, 0.0)
    # Entries of a row, then of a column: one slot apart, or `size`.
    for step in range(1, size + 1, size - 1):
        for k in range(first if step > 1 else 0, size):
            _turn(M, first * step + k * (size + 1 - step), step, size - first, v, twice)


@internal
def _turn(M: FloatArray, first: int, step: int, count: int, v: FloatArray, twice: Number) -> None:
    """Reflect `count` entries, `step` slots apart, at v."""
    along = 0.0 * twice
    for k in range(count):
        along += load(v, k, None) * load(M, first + k * step, None)
    along = along * twice
    for k in range(count):
        slot = first + k * step
        store(M, slot, None, load(M, slot, None) - along * load(v, k, None))


@internal
def _divide(M: FloatArray, t: int, size: int, p: int, nothing: float, rows: FloatArray, top: int) -> int:
    """Write the rows of the chain in column t of the memory; return the last state that is reached."""
    last, least = p, 0.0
    for r in range(size):
        factor, first = 1.0, p + 1
        if r > p:
            below = load(M, r * size + r - 1, t)
            if abs(below) <= least:
                break
            factor, first, last, least = 1.0 / below, r, r, nothing
            rows[top + r * size + r - 1] = factor
        for k in range(first, size):
            rows[top + r * size + k] = factor * load(M, r * size + k, t)
    return last
