"""D + C (z I - A)^-1 B at single points z by elimination and refinement: what is done where `resolvent` is not enough.

z I - A is eliminated with pivots in the states as they are given, and the solution is refined with residuals in twice
the digits (Demmel et al., Error bounds from extra-precise iterative refinement, ACM Trans. Math. Software 32, 2006).
A register of points at a time, each with pivots of its own. A complex number takes two slots of a memory.
"""

from __future__ import annotations

import math

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray
from platform_ctrl.frozen import FloatArray
from platform_ctrl.lanes import (
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

# Solutions at most, the first one among them: each gains what the condition leaves of 16 digits.
STEPS = 11
# What the next step may still change an entry by.
ENOUGH = 1e-12
# Slots of a state: x, what it lacks, and the residual, which becomes the correction of x.
STATE, LACKING, CHANGE = 6, 2, 4


def refine(
    A: FloatArray, lacks: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, z: ComplexArray, beyond: ComplexArray
) -> ComplexArray:
    """Return D + C (z I - A)^-1 B, (m, p, N), at the points z (N,); inf at a pole.

    `lacks` (n,) and `beyond` (N,) are what the diagonal of A and z have beyond their doubles.
    """
    n, (p, m), N = len(A), D.shape, len(z)
    # The last point fills what is left of a register.
    points = np.empty((2, -(-N // LANES) * LANES), dtype=np.complex128)
    points[0, :N], points[1, :N] = z, beyond
    points[:, N:] = points[:, N - 1 : N]
    found = np.empty((m, p, points.shape[1]), dtype=np.complex128)
    work = memory(3 * n * n + STATE * n + 4)
    _refined(A, lacks, B, C, D, points, work[: 3 * n * n], work[3 * n * n : -4], work[-4:], found)
    return found[..., :N]


@compiled
def _refined(
    A: FloatArray,
    lacks: FloatArray,
    B: FloatArray,
    C: FloatArray,
    D: FloatArray,
    points: ComplexArray,
    factors: FloatArray,
    x: FloatArray,
    z: FloatArray,
    found: ComplexArray,
) -> None:
    """Write the response at `points` (2, N), z and what it lacks, into `found` (m, p, N); N is a multiple of LANES."""
    (n, m), p, N = B.shape, C.shape[0], points.shape[1]
    for first in range(0, N, LANES):
        for t in range(LANES):
            for k in range(2):
                one = points[k, first + t]
                z[2 * k, t], z[2 * k + 1, t] = one.real, one.imag
        _factor(A, z, factors)
        zero = 0.0 * load(z, 0, None)
        for j in range(m):
            before = zero + math.inf
            going, solved = before > zero, before < zero
            for slot in range(STATE * n):
                store(x, slot, None, zero)
            for i in range(n):
                store(x, STATE * i + CHANGE, None, zero + B[i, j])
            for _ in range(STEPS):
                size, whole = _solve(factors, n, x)
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
                    _residual(A, i, lacks[i], B[i, j], z, x)


@inlined
def _absolute(x: Number) -> Number:
    return greater(x, -x)


@internal
def _factor(A: FloatArray, z: FloatArray, M: FloatArray) -> None:
    """Put the factors of z I - A into M, inverse pivots among them, and behind them which rows were swapped."""
    n = A.shape[0]
    zero = 0.0 * load(z, 0, None)
    for i in range(n):
        for k in range(n):
            _put(M, 2 * (i * n + k), zero - A[i, k], zero)
        _put(M, 2 * (i * n + i), load(z, 0, None) - A[i, i], load(z, 1, None))
    for k in range(n):
        pivot = 2 * (k * n + k)
        for i in range(k + 1, n):
            larger = _size(M, 2 * (i * n + k)) > _size(M, pivot)
            store(M, 2 * n * n + k * n + i, None, choose(larger, 1.0, 0.0))
            if anywhere(larger):
                for column in range(0, 2 * n, 2):
                    _swap(M, 2 * k * n + column, 2 * i * n + column, larger)
        # Squares might be out of range. Of a pivot that is zero this is not a number.
        size, re, im = _size(M, pivot), load(M, pivot, None), load(M, pivot + 1, None)
        a, b = re / size, im / size
        size = re * a + im * b
        _put(M, pivot, a / size, -b / size)
        for i in range(k + 1, n):
            factor = 2 * (i * n + k)
            re, im = _product(M, factor, M, pivot)
            _put(M, factor, re, im)
            for column in range(2, 2 * (n - k), 2):
                _subtract(M, factor + column, M, factor, M, pivot + column)


@internal
def _solve(M: FloatArray, n: int, x: FloatArray) -> tuple[Number, Number]:
    """Turn the residual into a correction by the factors M; return its size and that of x."""
    for k in range(n):
        for i in range(k + 1, n):
            swapped = load(M, 2 * n * n + k * n + i, None) > 0.0
            _swap(x, STATE * k + CHANGE, STATE * i + CHANGE, swapped)
    size = whole = 0.0 * load(x, 0, None)
    for i in range(n):
        for k in range(i):
            _subtract(x, STATE * i + CHANGE, M, 2 * (i * n + k), x, STATE * k + CHANGE)
    for i in range(n - 1, -1, -1):
        own = STATE * i + CHANGE
        for k in range(i + 1, n):
            _subtract(x, own, M, 2 * (i * n + k), x, STATE * k + CHANGE)
        re, im = _product(M, 2 * (i * n + i), x, own)
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
    """Swap two complex numbers at the points `where` it is said."""
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
def _sum(a: Number, b: Number) -> tuple[Number, Number]:
    """Return a + b as a number and what it lacks (Knuth)."""
    total = a + b
    part = total - a
    return total, (a - (total - part)) + (b - part)


@internal
def _plus_product(total: Number, lacking: Number, a: Number, b: Number) -> tuple[Number, Number]:
    """Add a b to a sum in twice the digits (Ogita, Rump, Oishi, SIAM J. Sci. Comput. 26, 2005)."""
    # Not a product to the compiler, which might take it into the sum.
    product = fused(a, b, -0.0)
    rest = fused(a, b, -product)
    total, more = _sum(total, product)
    return total, lacking + (rest + more)


@internal
def _correct(x: FloatArray, slot: int, going: Mask) -> None:
    """Add the correction to a part of x, in twice the digits."""
    change = choose(going, load(x, slot + CHANGE, None), 0.0)
    total, lacking = _sum(load(x, slot, None), load(x, slot + LACKING, None) + change)
    store(x, slot, None, total)
    store(x, slot + LACKING, None, lacking)


@internal
def _residual(A: FloatArray, i: int, lacks: float, b: float, z: FloatArray, x: FloatArray) -> None:
    """Put row i of b - (z I - A) x in twice the digits into its slots."""
    zr, zi, own = load(z, 0, None), load(z, 1, None), STATE * i
    xr, xi, low_r, low_i = (
        load(x, own, None),
        load(x, own + 1, None),
        load(x, own + LACKING, None),
        load(x, own + LACKING + 1, None),
    )
    beyond_r, beyond_i, zero = lacks - load(z, 2, None), -load(z, 3, None), 0.0 * zr
    re_low = (beyond_r * xr - beyond_i * xi) - (zr * low_r - zi * low_i)
    im_low = (beyond_r * xi + beyond_i * xr) - (zr * low_i + zi * low_r)
    re, re_low = _plus_product(zero + b, re_low, -zr, xr)
    re, re_low = _plus_product(re, re_low, zi, xi)
    im, im_low = _plus_product(zero, im_low, -zr, xi)
    im, im_low = _plus_product(im, im_low, -zi, xr)
    for k in range(A.shape[0]):
        if A[i, k] != 0.0:
            re, re_low, im, im_low = _plus_state(re, re_low, im, im_low, zero + A[i, k], x, STATE * k)
    _put(x, own + CHANGE, re + re_low, im + im_low)


@internal
def _plus_state(
    re: Number, re_low: Number, im: Number, im_low: Number, factor: Number, x: FloatArray, slot: int
) -> tuple[Number, Number, Number, Number]:
    """Add a multiple of a state to a complex sum in twice the digits."""
    re, re_low = _plus_product(re, re_low, factor, load(x, slot, None))
    im, im_low = _plus_product(im, im_low, factor, load(x, slot + 1, None))
    re_low += factor * load(x, slot + LACKING, None)
    im_low += factor * load(x, slot + LACKING + 1, None)
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
