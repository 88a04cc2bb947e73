"""Refined responses of systems of many states without structure, at the points where `resolvent` is not accurate.

A is reduced to Hessenberg form H once, by an orthogonal change of states. At each point z I - H is then eliminated by
columns, the last one first: only two columns are stored, no factors, and all inputs are solved at once (G. Henry, The
shifted Hessenberg system solve computation, Cornell Theory Center report CTC94TR163, 1994). Residuals are computed in
the original states and in double-double precision, by matrix products without rounding errors: A and the solutions are
split into parts of so few bits that sums of their products are exact (Ozaki, Ogita, Oishi and Rump, Numerical
Algorithms 59, 2012). The refined solution is therefore that of A as given.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis.arrays import ComplexArray
from platform_ctrl.analysis.refinement import exact_sum, plus_product
from platform_ctrl.common.simd import (
    LANES,
    Number,
    choose,
    compiled,
    greater,
    inlined,
    internal,
    load,
    memory,
    store,
)
from platform_ctrl.common.values import FloatArray

# Points at a time.
CHUNK = 16 * LANES
# Corrections at most.
STEPS = 4
# Largest ratio of correction to solution: above it the system is singular to working precision; refinement cannot help.
CONTRACTING = 0.1
# Share of the tolerance that the next correction may have; errors are relative to the entry, or to FLOOR times the
# largest entry at that point.
ENOUGH, FLOOR = 0.04, 1e-3
# Rounding error of the first correction relative to it, and of its contribution to an entry, relative to that one.
ROUNDED, ROUNDED_ENTRY = 2.0**-18, 2.0**-12


class HessenbergRefinement:
    """D + C (z I - A)^-1 B of a system with two states or more by elimination in Hessenberg form, refined.

    `A_low` (n,) is the low-order part of the diagonal of A in double-double precision; A = Q H Q'.
    """

    def __init__(
        self,
        A: FloatArray,
        B: FloatArray,
        C: FloatArray,
        D: FloatArray,
        A_low: FloatArray,
        H: FloatArray,
        Q: FloatArray,
    ) -> None:
        n = len(A)
        self._columns, self._Q = np.ascontiguousarray(H.T), Q
        self._A, self._B, self._D, self._A_low = A, B, D, A_low
        # In the states of the Hessenberg form.
        self._driven, self._seen = self._Q.T @ B, C @ self._Q
        self._weights = np.linalg.norm(C, axis=1)
        # A sum of n products of two numbers of so many bits is exact in a double.
        self._bits = (52 - math.ceil(math.log2(n))) // 2
        self._top, self._rest = _parted(np.vstack([A, C]), self._bits, axis=1)
        self._middle, self._end = _parted(self._rest, self._bits - 1, axis=1)

    def at(
        self, z: ComplexArray, z_low: ComplexArray, tolerated: float, least: float
    ) -> tuple[ComplexArray, NDArray[np.int64]]:
        """Return the response at z (N,), (m, p, N), and the points at which the error may exceed `tolerated`.

        `z_low` is the low-order part of z in double-double precision. The response is inf at a pole z = 0. Entries
        that are much smaller than the solution they are formed from may be inaccurate. Errors due to the finite
        precision of A itself are not reported.
        """
        N, (p, m) = len(z), self._D.shape
        found, short = np.empty((m, p, N), dtype=np.complex128), np.empty(N, dtype=np.bool_)
        for first in range(0, N, CHUNK):
            part = slice(first, min(first + CHUNK, N))
            with np.errstate(all="ignore"):  # at a pole
                found[:, :, part], short[part] = self._refined(z[part], z_low[part], tolerated, least)
                again = first + np.flatnonzero(short[part])
                if again.size:
                    found[:, :, again], short[again] = self._refined(z[again], z_low[again], tolerated, least, True)
        return found, np.flatnonzero(short)

    def _refined(
        self, z: ComplexArray, z_low: ComplexArray, tolerated: float, least: float, precise: bool = False
    ) -> tuple[ComplexArray, NDArray[np.bool_]]:
        (p, m), (n, _), count = self._D.shape, self._B.shape, len(z)
        N = -(-count // LANES) * LANES
        points = np.empty((4, N))
        points[:, :count] = z.real, z.imag, z_low.real, z_low.imag
        # Unused lanes repeat the last point.
        points[:, count:] = points[:, count - 1 : count]
        # Axes of these arrays: states (or outputs), real and imaginary part, inputs, points.
        change = np.zeros((n, 2, m, N))
        change[:, 0] = self._driven[:, :, None]
        low, residual = np.zeros_like(change), np.empty_like(change)
        self._solve(points, change)
        x, whole = _times(self._Q, change), _size(change)
        found, going = np.empty((p, m, N), dtype=np.complex128), np.ones(N, dtype=np.bool_)
        short, rounded = np.zeros(N, dtype=np.bool_), np.zeros((p, m, N))
        for step in range(STEPS):
            product, product_low = self._product(x, low, precise)
            solution, image = (_lanes(x), _lanes(low)), (_lanes(product), _lanes(product_low))
            _residuals(_lanes(points), *solution, *image, self._B, self._A_low, _lanes(residual))
            change = _times(self._Q.T, residual)
            self._solve(points, change)
            entries, added = self._entries(product[n:], product_low[n:], change)
            found[:, :, going] = entries[:, :, going]
            missing = _size(change)
            share = missing / whole
            weighted = self._weights[:, None, None] * missing
            if step == 0:
                rounded = np.minimum(ROUNDED * weighted, ROUNDED_ENTRY * np.abs(added))
                rounded *= 2.0 ** (2 - self._bits) if precise else 1.0
            size = np.abs(entries)
            size = ENOUGH * tolerated * np.maximum(size, np.maximum(least, FLOOR * size.max(axis=(0, 1))))
            going &= (share < CONTRACTING).all(axis=0)
            short[going] = (rounded > 10.0 * size).any(axis=(0, 1))[going]
            # The next correction is smaller than this one as this one is than x.
            going &= ~short & (weighted * share > size).any(axis=(0, 1))
            if not going.any() or step == STEPS - 1:
                break
            x, low = _exact_sums(x, low + _times(self._Q, change))
        self._at_rest(z, z_low, found)
        return found[:, :, :count].swapaxes(0, 1), short[:count]

    def _product(self, x: FloatArray, low: FloatArray, precise: bool) -> tuple[FloatArray, FloatArray]:
        """Return A and C times x + low in double-double precision; with one part more if `precise`."""
        top, rest = _parted(x, self._bits, axis=0)
        product = _times(self._top, top)
        if not precise:
            return product, _times(self._top, rest + low) + _times(self._rest, x)
        middle, end = _parted(rest, self._bits - 1, axis=0)
        product, more = _exact_sums(product, _times(self._top, middle))
        product, again = _exact_sums(product, _times(self._middle, top))
        end += low
        more += again + _times(self._top, end) + _times(self._middle, middle + end) + _times(self._end, x)
        return product, more

    def _at_rest(self, z: ComplexArray, z_low: ComplexArray, found: ComplexArray) -> None:
        """Write inf where z = 0 is a pole: elimination finds A exactly singular."""
        from scipy.linalg.lapack import dgetrf

        rest = np.flatnonzero((z == 0.0) & (z_low == 0.0))
        if rest.size and not np.any(self._A_low) and dgetrf(self._A)[2] > 0:
            found[:, :, rest] = np.inf

    def _solve(self, points: FloatArray, numbers: FloatArray) -> None:
        """Solve (z I - H) x = `numbers` (n, 2, m, N) in place."""
        n, _, m, _ = numbers.shape
        _eliminated(self._columns, _lanes(points), _lanes(numbers), memory(2 * n * (m + 1)), memory(3 * n))

    def _entries(self, product: FloatArray, low: FloatArray, change: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """Return the corrected entries (p, m, N) and their correction; `product` and `low` are C x."""
        added = _times(self._seen, change)
        total, more = _exact_sums(product[:, 0], self._D[:, :, None])
        out: ComplexArray = total + (low[:, 0] + more + added[:, 0]) + 1j * (product[:, 1] + (low[:, 1] + added[:, 1]))
        return out, added[:, 0] + 1j * added[:, 1]


def _lanes(array: FloatArray) -> FloatArray:
    """Return an array (..., N) as a memory (slots, LANES)."""
    return array.reshape(-1, LANES)


def _times(matrix: FloatArray, numbers: FloatArray) -> FloatArray:
    """Return a matrix times numbers (n, 2, m, N)."""
    out: FloatArray = (matrix @ numbers.reshape(len(numbers), -1)).reshape(-1, *numbers.shape[1:])
    return out


def _size(numbers: FloatArray) -> FloatArray:
    """Return Euclidean norms over the states, (m, N)."""
    out: FloatArray = np.sqrt(np.einsum("ikjt,ikjt->jt", numbers, numbers))
    return out


def _parted(numbers: FloatArray, bits: int, axis: int) -> tuple[FloatArray, FloatArray]:
    """Split numbers exactly into leading bits, counted from the largest one along an axis, and the rest."""
    largest = np.abs(numbers).max(axis=axis, keepdims=True)
    # Adding and subtracting this rounds to the leading bits.
    pad = np.ldexp(0.75, np.frexp(largest)[1] + 54 - bits)
    top = (numbers + pad) - pad
    return top, numbers - top


def _exact_sums(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return a + b rounded, and its rounding error (Knuth)."""
    total = a + b
    part = total - a
    return total, (a - (total - part)) + (b - part)


@compiled
def _residuals(
    z: FloatArray,
    x: FloatArray,
    low: FloatArray,
    product: FloatArray,
    product_low: FloatArray,
    B: FloatArray,
    A_low: FloatArray,
    residual: FloatArray,
) -> None:
    """Put B - (z I - A) x into `residual`, from A x in double-double precision; z (4, N) with its low-order part."""
    (n, m), blocks = B.shape, len(z) // 4
    for i in range(n):
        for j in range(m):
            for block in range(blocks):
                real = (2 * i * m + j) * blocks + block
                imaginary = real + m * blocks
                zr, zi = load(z, block, None), load(z, blocks + block, None)
                xr, xi = load(x, real, None), load(x, imaginary, None)
                low_r, low_i = load(low, real, None), load(low, imaginary, None)
                rest_r, rest_i = (
                    A_low[i] - load(z, 2 * blocks + block, None),
                    -load(z, 3 * blocks + block, None),
                )
                zero = 0.0 * zr
                re_low = (rest_r * xr - rest_i * xi) - (zr * low_r - zi * low_i)
                im_low = (rest_r * xi + rest_i * xr) - (zr * low_i + zi * low_r)
                re, more = exact_sum(load(product, real, None), zero + B[i, j])
                re_low += load(product_low, real, None) + more
                im, im_low = load(product, imaginary, None), im_low + load(product_low, imaginary, None)
                re, re_low = plus_product(re, re_low, -zr, xr)
                re, re_low = plus_product(re, re_low, zi, xi)
                im, im_low = plus_product(im, im_low, -zr, xi)
                im, im_low = plus_product(im, im_low, -zi, xr)
                store(residual, real, None, re + re_low)
                store(residual, imaginary, None, im + im_low)


@compiled
def _eliminated(columns: FloatArray, z: FloatArray, x: FloatArray, work: FloatArray, steps: FloatArray) -> None:
    """Solve (z I - H) x = x in place; row k of `columns` is column k of H, x (n, 2, m, blocks), z (4, blocks)."""
    n, blocks = len(columns), len(z) // 4
    m = len(x) // (2 * n * blocks)
    right = 2 * n
    for block in range(blocks):
        zr, zi = load(z, block, None), load(z, blocks + block, None)
        for i in range(n):
            for part in range(2):
                for j in range(m):
                    store(
                        work,
                        right + 2 * (j * n + i) + part,
                        None,
                        load(x, ((2 * i + part) * m + j) * blocks + block, None),
                    )
            store(work, 2 * i, None, 0.0 * zr - columns[n - 1, i])
            store(work, 2 * i + 1, None, 0.0 * zr)
        store(work, 2 * n - 2, None, load(work, 2 * n - 2, None) + zr)
        store(work, 2 * n - 1, None, zi)
        for k in range(n - 1, 0, -1):
            _step(columns[k - 1], k, n, m, zr, zi, work, steps)
        re, im = _inverse(load(work, 0, None), load(work, 1, None))
        for j in range(m):
            first = right + 2 * j * n
            br, bi = load(work, first, None), load(work, first + 1, None)
            vr, vi = br * re - bi * im, br * im + bi * re
            for k in range(1, n):
                lr, li, swapped = (
                    load(steps, 3 * k, None),
                    load(steps, 3 * k + 1, None),
                    load(steps, 3 * k + 2, None) > 0.0,
                )
                tr = load(work, first + 2 * k, None) - (lr * vr - li * vi)
                ti = load(work, first + 2 * k + 1, None) - (lr * vi + li * vr)
                slot = (2 * (k - 1) * m + j) * blocks + block
                store(x, slot, None, choose(swapped, tr, vr))
                store(x, slot + m * blocks, None, choose(swapped, ti, vi))
                vr, vi = choose(swapped, vr, tr), choose(swapped, vi, ti)
            slot = (2 * (n - 1) * m + j) * blocks + block
            store(x, slot, None, vr)
            store(x, slot + m * blocks, None, vi)


@internal
def _step(
    column: FloatArray, k: int, n: int, m: int, zr: Number, zi: Number, work: FloatArray, steps: FloatArray
) -> None:
    """Eliminate row k of the current column, in the first slots, and of column k - 1; solve for one unknown."""
    zero = 0.0 * zr
    ar, ai, c = load(work, 2 * k, None), load(work, 2 * k + 1, None), zero - column[k]
    swapped = greater(c, -c) > greater(ar, -ar) + greater(ai, -ai)
    re, im = _inverse(choose(swapped, c, ar), choose(swapped, 0.0, ai))
    other_r, other_i = choose(swapped, ar, c), choose(swapped, ai, 0.0)
    lr, li = other_r * re - other_i * im, other_r * im + other_i * re
    store(steps, 3 * k, None, lr)
    store(steps, 3 * k + 1, None, li)
    store(steps, 3 * k + 2, None, choose(swapped, zero + 1.0, zero))
    # Column k - 1 contains z in row k - 1 only.
    column_z = k - 1
    for j in range(m):
        slot = 2 * (n + j * n + k)
        br, bi = load(work, slot, None), load(work, slot + 1, None)
        store(work, slot, None, br * re - bi * im)
        store(work, slot + 1, None, br * im + bi * re)
    for i in range(k):
        cr, ci = zero - column[i], zero
        if i == column_z:
            cr, ci = cr + zr, zi
        ar, ai = load(work, 2 * i, None), load(work, 2 * i + 1, None)
        pr, pi = choose(swapped, cr, ar), choose(swapped, ci, ai)
        store(work, 2 * i, None, choose(swapped, ar, cr) - (lr * pr - li * pi))
        store(work, 2 * i + 1, None, choose(swapped, ai, ci) - (lr * pi + li * pr))
        for j in range(m):
            slot, y = 2 * (n + j * n + i), 2 * (n + j * n + k)
            yr, yi = load(work, y, None), load(work, y + 1, None)
            store(work, slot, None, load(work, slot, None) - (yr * pr - yi * pi))
            store(work, slot + 1, None, load(work, slot + 1, None) - (yr * pi + yi * pr))


@inlined
def _inverse(re: Number, im: Number) -> tuple[Number, Number]:
    """Return 1/(re + j im) without squares that could overflow."""
    size = greater(re, -re) + greater(im, -im)
    a, b = re / size, im / size
    size = re * a + im * b
    return a / size, -b / size
