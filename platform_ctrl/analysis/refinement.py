"""D + C (z I - A)^-1 B at single points z by elimination and refinement: what is done where `resolvent` is not enough.

z I - A is eliminated with pivots in the states as they are given, and the solution is refined with residuals in twice
the digits (Demmel et al., Error bounds from extra-precise iterative refinement, ACM Trans. Math. Software 32, 2006).
A register of points at a time, each with pivots of its own. A complex number takes two slots of a memory.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis.arrays import ComplexArray
from platform_ctrl.common.simd import (
    LANES,
    Mask,
    Number,
    anywhere,
    choose,
    compiled,
    fused,
    greater,
    inlined,
    internal,
    load,
    memory,
    store,
    store_pairs,
)
from platform_ctrl.common.values import FloatArray

# Solutions at most, the first one among them: each gains what the condition leaves of 16 digits.
STEPS = 11
# What the next step may still change an entry by.
ENOUGH = 1e-12
# Slots of a state: x, its low-order part, and the residual, which becomes the correction of x.
STATE, LOW, CHANGE = 6, 2, 4
# Fewer states are taken in the order that they have.
SPARSE = 12
# How far entries are below and above the diagonal; from a row of the factors to the next; the first one.
Shape = tuple[int, int, int, int]


class Band(NamedTuple):
    """States in an order in which the entries of A are next to its diagonal."""

    order: NDArray[np.int64]  # (n,): row and column `order[k]` of A becomes row and column k
    # below, above: how far entries are from the diagonal
    below: int
    above: int

    def work(self, inputs: int) -> int:
        """Return multiplications a state and a point that elimination and refinement take, about."""
        rows = self.below + self.above + 1
        return 8 * self.below * rows + inputs * (16 * (rows + self.below) + 50 * rows)


def band(A: FloatArray) -> Band:
    """Return the order of states (n,) in which A has a narrow band (reverse Cuthill-McKee), or the order they have.

    Blocks on the diagonal in any order of their states, chains of masses and beams of finite elements become narrow.
    """
    n = len(A)
    found = Band(np.arange(n), n - 1, n - 1)
    if n < SPARSE or np.count_nonzero(A) > n * n // 4:
        return found
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import reverse_cuthill_mckee

    # Of the sum with the transpose: w and -w would cancel.
    order = reverse_cuthill_mckee(csr_array(np.abs(A))).astype(np.int64)
    row, column = np.nonzero(A[np.ix_(order, order)])
    below, above = max(0, int((row - column).max(initial=0))), max(0, int((column - row).max(initial=0)))
    return Band(order, below, above) if 2 * below + above < n else found


class Refinement:
    """D + C (z I - A)^-1 B by elimination with pivots, refined.

    `A_low` (n,) is the low-order part of A's diagonal in double-double precision, `narrow` is ``band(A)``.
    """

    def __init__(
        self, A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, A_low: FloatArray, narrow: Band
    ) -> None:
        n, order = len(A), narrow.order
        self._A, self._A_low = np.ascontiguousarray(A[np.ix_(order, order)]), A_low[order]
        self._B, self._C, self._D = np.ascontiguousarray(B[order]), np.ascontiguousarray(C[:, order]), D
        whole = 2 * narrow.below + narrow.above >= n
        # Rows of the factors are cut off where their band ends.
        self._stride, self._first = (n, 0) if whole else (2 * narrow.below + narrow.above, narrow.below)
        self._below, self._above = narrow.below, narrow.above

    def at(self, z: ComplexArray, z_low: ComplexArray) -> ComplexArray:
        """Return the response at z (N,), (m, p, N), `z_low` being the low-order part of z; inf at a pole."""
        n, (p, m), N = len(self._A), self._D.shape, len(z)
        # The last point fills what is left of a register.
        points = np.empty((2, -(-N // LANES) * LANES), dtype=np.complex128)
        points[0, :N], points[1, :N] = z, z_low
        points[:, N:] = points[:, N - 1 : N]
        found = np.empty((m, p, points.shape[1]), dtype=np.complex128)
        shape = self._below, self._above, self._stride, self._first
        factors = memory(2 * (n * self._stride + n + self._first + 1) + n * self._below)
        system = self._A, self._A_low, self._B, self._C, self._D
        _refined(*system, points, shape, factors, memory(STATE * n), memory(4), found)
        return found[..., :N]


@compiled
def _refined(
    A: FloatArray,
    A_low: FloatArray,
    B: FloatArray,
    C: FloatArray,
    D: FloatArray,
    points: ComplexArray,
    shape: Shape,
    factors: FloatArray,
    x: FloatArray,
    z: FloatArray,
    found: ComplexArray,
) -> None:
    """Write the response at `points` (2, N), z and its low-order part, into `found` (m, p, N); LANES divides N."""
    (n, m), p, N = B.shape, C.shape[0], points.shape[1]
    for first in range(0, N, LANES):
        for t in range(LANES):
            for k in range(2):
                one = points[k, first + t]
                z[2 * k, t], z[2 * k + 1, t] = one.real, one.imag
        _factor(A, z, factors, shape)
        zero = 0.0 * load(z, 0, None)
        for j in range(m):
            before = zero + math.inf
            going, solved = before > zero, before < zero
            for slot in range(STATE * n):
                store(x, slot, None, zero)
            for i in range(n):
                store(x, STATE * i + CHANGE, None, zero + B[i, j])
            for _ in range(STEPS):
                size, whole = _solve(factors, n, x, shape)
                going = going & (size < before)
                before, solved = 0.5 * size, solved | going
                for slot in range(0, STATE * n, STATE):
                    _correct(x, slot, going)
                    _correct(x, slot + 1, going)
                ready = going
                for i in range(p):
                    re, im, change = _output(C, i, D[i, j], x)
                    store_pairs(found, (j * p + i) * N + first, choose(solved, re, math.inf), choose(solved, im, 0.0))
                    # The next correction is smaller than this one as this one is than x.
                    ready = ready & (change * size <= ENOUGH * (_absolute(re) + _absolute(im)) * whole)
                going = going & ~ready
                if not anywhere(going):
                    break
                for i in range(n):
                    _residual(A, i, A_low[i], B[i, j], z, x, shape)


@inlined
def _absolute(x: Number) -> Number:
    return greater(x, -x)


@internal
def _factor(A: FloatArray, z: FloatArray, M: FloatArray, shape: Shape) -> None:
    """Put the factors of z I - A into M, inverse pivots among them, and behind them which rows were swapped."""
    (below, above, stride, first), n = shape, A.shape[0]
    zero = 0.0 * load(z, 0, None)
    for i in range(n):
        row = 2 * (i * stride + first)
        for k in range(max(0, i - below), min(n, i + below + above + 1)):
            _put(M, row + 2 * k, zero - A[i, k], zero)
        _put(M, row + 2 * i, load(z, 0, None) - A[i, i], load(z, 1, None))
    swaps = 2 * (n * stride + n + first)
    for k in range(n):
        last = min(n, k + below + above + 1)
        pivot = 2 * (k * stride + k + first)
        for i in range(k + 1, min(n, k + below + 1)):
            other = 2 * (i * stride + k + first)
            larger = _size(M, other) > _size(M, pivot)
            store(M, swaps + k * below + i - k - 1, None, choose(larger, 1.0, 0.0))
            if anywhere(larger):
                for column in range(0, 2 * (last - k), 2):
                    _swap(M, pivot + column, other + column, larger)
        # Squares might be out of range. Of a pivot that is zero this is not a number.
        size, re, im = _size(M, pivot), load(M, pivot, None), load(M, pivot + 1, None)
        a, b = re / size, im / size
        size = re * a + im * b
        _put(M, pivot, a / size, -b / size)
        for i in range(k + 1, min(n, k + below + 1)):
            factor = 2 * (i * stride + k + first)
            re, im = _product(M, factor, M, pivot)
            _put(M, factor, re, im)
            for column in range(2, 2 * (last - k), 2):
                _subtract(M, factor + column, M, factor, M, pivot + column)


@internal
def _solve(M: FloatArray, n: int, x: FloatArray, shape: Shape) -> tuple[Number, Number]:
    """Turn the residual into a correction by the factors M; return its size and that of x."""
    below, above, stride, first = shape
    swaps = 2 * (n * stride + n + first)
    for k in range(n):
        # Rows of the lower factor have not been swapped again: what is below a pivot belongs to the rows as they stood.
        for i in range(k + 1, min(n, k + below + 1)):
            swapped = load(M, swaps + k * below + i - k - 1, None) > 0.0
            _swap(x, STATE * k + CHANGE, STATE * i + CHANGE, swapped)
        for i in range(k + 1, min(n, k + below + 1)):
            _subtract(x, STATE * i + CHANGE, M, 2 * (i * stride + k + first), x, STATE * k + CHANGE)
    size = whole = 0.0 * load(x, 0, None)
    for i in range(n - 1, -1, -1):
        own, row = STATE * i + CHANGE, 2 * (i * stride + first)
        for k in range(i + 1, min(n, i + below + above + 1)):
            _subtract(x, own, M, row + 2 * k, x, STATE * k + CHANGE)
        re, im = _product(M, row + 2 * i, x, own)
        _put(x, own, re, im)
        size, whole = size + _size(x, own), whole + _size(x, STATE * i)
    return size, whole


@inlined
def _put(memory: FloatArray, slot: int, re: Number, im: Number) -> None:
    store(memory, slot, None, re)
    store(memory, slot + 1, None, im)


@inlined
def _size(memory: FloatArray, slot: int) -> Number:
    return _absolute(load(memory, slot, None)) + _absolute(load(memory, slot + 1, None))


@internal
def _swap(memory: FloatArray, one: int, other: int, where: Mask) -> None:
    """Swap two complex numbers at the points of the mask `where`."""
    for k in range(2):
        a, b = load(memory, one + k, None), load(memory, other + k, None)
        store(memory, one + k, None, choose(where, b, a))
        store(memory, other + k, None, choose(where, a, b))


@inlined
def _product(a: FloatArray, slot: int, b: FloatArray, other: int) -> tuple[Number, Number]:
    ar, ai, br, bi = load(a, slot, None), load(a, slot + 1, None), load(b, other, None), load(b, other + 1, None)
    return ar * br - ai * bi, ar * bi + ai * br


@inlined
def _subtract(x: FloatArray, slot: int, a: FloatArray, factor: int, b: FloatArray, other: int) -> None:
    """Subtract a product from what is at `slot`."""
    re, im = _product(a, factor, b, other)
    _put(x, slot, load(x, slot, None) - re, load(x, slot + 1, None) - im)


@internal
def exact_sum(a: Number, b: Number) -> tuple[Number, Number]:
    """Return a + b rounded, and its rounding error (Knuth)."""
    total = a + b
    part = total - a
    return total, (a - (total - part)) + (b - part)


@internal
def plus_product(total: Number, low: Number, a: Number, b: Number) -> tuple[Number, Number]:
    """Add a b to a sum in twice the digits (Ogita, Rump, Oishi, SIAM J. Sci. Comput. 26, 2005)."""
    # Not a product to the compiler, which might take it into the sum.
    product = fused(a, b, -0.0)
    rest = fused(a, b, -product)
    total, more = exact_sum(total, product)
    return total, low + (rest + more)


@internal
def _correct(x: FloatArray, slot: int, going: Mask) -> None:
    """Add the correction to a part of x, in twice the digits."""
    change = choose(going, load(x, slot + CHANGE, None), 0.0)
    total, low = exact_sum(load(x, slot, None), load(x, slot + LOW, None) + change)
    store(x, slot, None, total)
    store(x, slot + LOW, None, low)


@internal
def _residual(A: FloatArray, i: int, A_low: float, b: float, z: FloatArray, x: FloatArray, shape: Shape) -> None:
    """Put row i of b - (z I - A) x in twice the digits into its slots."""
    zr, zi, own = load(z, 0, None), load(z, 1, None), STATE * i
    xr, xi, low_r, low_i = (
        load(x, own, None),
        load(x, own + 1, None),
        load(x, own + LOW, None),
        load(x, own + LOW + 1, None),
    )
    low_order_r, low_order_i, zero = A_low - load(z, 2, None), -load(z, 3, None), 0.0 * zr
    re_low = (low_order_r * xr - low_order_i * xi) - (zr * low_r - zi * low_i)
    im_low = (low_order_r * xi + low_order_i * xr) - (zr * low_i + zi * low_r)
    re, re_low = plus_product(zero + b, re_low, -zr, xr)
    re, re_low = plus_product(re, re_low, zi, xi)
    im, im_low = plus_product(zero, im_low, -zr, xi)
    im, im_low = plus_product(im, im_low, -zi, xr)
    for k in range(max(0, i - shape[0]), min(A.shape[0], i + shape[1] + 1)):
        if A[i, k] != 0.0:
            re, re_low, im, im_low = _plus_state(re, re_low, im, im_low, zero + A[i, k], x, STATE * k)
    _put(x, own + CHANGE, re + re_low, im + im_low)


@internal
def _plus_state(
    re: Number, re_low: Number, im: Number, im_low: Number, factor: Number, x: FloatArray, slot: int
) -> tuple[Number, Number, Number, Number]:
    """Add a multiple of a state to a complex sum in twice the digits."""
    re, re_low = plus_product(re, re_low, factor, load(x, slot, None))
    im, im_low = plus_product(im, im_low, factor, load(x, slot + 1, None))
    re_low += factor * load(x, slot + LOW, None)
    im_low += factor * load(x, slot + LOW + 1, None)
    return re, re_low, im, im_low


@internal
def _output(C: FloatArray, i: int, direct: float, x: FloatArray) -> tuple[Number, Number, Number]:
    """Return row i of D + C x, summed in twice the digits, and by how much the correction changes it."""
    zero = 0.0 * load(x, 0, None)
    re, re_low, im, im_low, change_r, change_i = zero + direct, zero, zero, zero, zero, zero
    for k in range(C.shape[1]):
        factor, slot = zero + C[i, k], STATE * k
        re, re_low, im, im_low = _plus_state(re, re_low, im, im_low, factor, x, slot)
        change_r += factor * load(x, slot + CHANGE, None)
        change_i += factor * load(x, slot + CHANGE + 1, None)
    return re + re_low, im + im_low, _absolute(change_r) + _absolute(change_i)
