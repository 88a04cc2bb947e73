"""D + C (z I - A)^-1 B at many points z by a recurrence with an error bound.

An orthogonal change of states turns b into beta e1 and A into Hessenberg form H. All rows but the first of
(z I - H) x = beta e1 then give x[k-1] from x[k], x[k+1], ...: from an arbitrary last component, n²/2 multiplications by
real numbers lead to the first row, which determines the scale of x (Hyman; Wilkinson, The Algebraic Eigenvalue Problem,
ch. 7, sec. 11). Each row is solved with a small relative error in each entry of H: x belongs to a matrix that differs
from A by rounding errors of size |A|, whatever A's eigenvectors. No pivoting is needed.

The error of an output c' x is at most |w| times this rounding error times |x|, where w' = c' (z I - A)^-1; the same
recurrence for the transposed system gives |w|, for a combination of all outputs at once. Points at which the bound is
too large (near lightly damped poles, in steep roll-off, for widely spaced poles) are solved by `refinement`.

Two registers of points are computed together. Their complex numbers take four slots: real and imaginary parts of the
first register, then of the second.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis.arrays import ComplexArray
from platform_ctrl.analysis.hessenberg_form import Chains
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
    memory,
    root,
    store,
    store_pairs,
)
from platform_ctrl.common.values import FloatArray

# Complex numbers of two registers of points.
Four = tuple[Number, Number, Number, Number]
# Points computed together.
POINTS = 2 * LANES
# Components whose square exceeds LARGE are multiplied by SHRINK, in a second attempt after an overflow.
LARGE, SHRINK = 2.0**400, 2.0**-200
# Limits of the squares of the solution and of the divisor, beyond which overflow or underflow may have cost digits.
LARGEST, SMALLEST = 2.0**1000, 2.0**-800
# Rounding error of the recurrence, relative to |A| + |z|.
ROUNDING = 8.0 * 2.0**-53
# Errors are relative to the entry, or to this times the largest one at that point.
FLOOR = 1e-3


def respond(
    chains: Chains, D: FloatArray, z: ComplexArray, H: ComplexArray, turned: bool, tolerated: float, least: float = 0.0
) -> NDArray[np.int64]:
    """Write D + C (z I - A)^-1 B into H (p, m, N), or (m, p, N) if `turned`; return the points to be refined.

    At these the error bound exceeds `tolerated`, relative to the entry, or to `least` if the entry is smaller.
    """
    (p, m), N = D.shape, len(z)
    size = math.isqrt(len(chains.rows) // (m + 1))
    down, across = (1, p) if turned else (m, 1)
    poor, work = np.empty(N, dtype=np.int64), workspace(size, m, p)
    return poor[: quick(z, *chains[:3], D, H.reshape(p * m, N), size, down, across, tolerated, least, poor, work)]


def workspace(size: int, inputs: int, outputs: int) -> FloatArray:
    """Return the work array of `quick`."""
    return memory(4 * (size + inputs * outputs + 1) + 2 * (inputs + 1))


@compiled
def quick(
    z: ComplexArray,
    rows: FloatArray,
    lasts: NDArray[np.int64],
    norms: FloatArray,
    D: FloatArray,
    H: ComplexArray,
    size: int,
    down: int,
    across: int,
    tolerated: float,
    least: float,
    poor: NDArray[np.int64],
    work: FloatArray,
) -> int:
    """Write the entry of output i and input j into row i down + j across of H; return the number of `poor` points.

    Errors of entries below `least` are relative to `least`.
    """
    (p, m), N, found = D.shape, H.shape[1], 0
    # Layout of `work`: a solution, the entries, points, norms of the solutions.
    entries = 4 * size
    at = entries + 4 * m * p
    sizes = at + 4
    for start in range(0, N, POINTS):
        for t in range(POINTS):
            # Unused lanes repeat the last point.
            one, slot = z[min(start + t, N - 1)], at + t // LANES * 2
            work[slot, t % LANES], work[slot + 1, t % LANES] = one.real, one.imag
        for j in range(m + 1):
            last = lasts[j]
            # Overflow is rare: the first attempt does not rescale.
            for large in (math.inf, LARGE):
                if _solved(rows, j * size, size, p, last, at, large, work, sizes + 2 * j):
                    break
            if j < m:
                for i in range(p):
                    re, im, re_2, im_2 = _sums(rows, (j * size + i) * size, p + 1, last, work)
                    entry = entries + 4 * (j * p + i)
                    _put_entry(work, entry, 4 * p, re, im, D[i, j])
                    _put_entry(work, entry + 2, 4 * p + 2, re_2, im_2, D[i, j])
        for half in range(2):
            entry, first = entries + 2 * half, start + half * LANES
            store(work, 0, None, _missed(at + 2 * half, norms, D, tolerated, least, work, entry, sizes + half))
            count = min(LANES, N - first)
            for t in range(count):
                if load(work, 0, t) > 0.0:
                    poor[found] = first + t
                    found += 1
            for j in range(m):
                for i in range(p):
                    row = i * down + j * across
                    if count == LANES:
                        store_pairs(H, row * N + first, load(work, entry, None), load(work, entry + 1, None))
                    else:
                        for t in range(count):
                            H[row, first + t] = complex(load(work, entry, t), load(work, entry + 1, t))
                    entry += 4
    return found


@inlined
def _solved(
    rows: FloatArray, top: int, size: int, p: int, last: int, at: int, large: float, x: FloatArray, length: int
) -> bool:
    """Solve along a chain for the points at slot `at`; return whether all numbers stayed in range.

    Components p + 1, ..., `last` of x are the solution but for a factor, which becomes component p; |x| with it goes to
    slots `length` and `length` + 1.
    """
    point = _four(x, at)
    total = total_2 = zero = 0.0 * point[0]
    newest = zero + 1.0, zero, zero + 1.0, zero
    _put(x, 4 * last, newest)
    # Four rows at a time: their sums over the columns that they share are taken at once.
    for first in range(last, p, -4):
        a, b, c, d = _four_sums(rows, top, size, p, first, last, x)
        for r in range(first, max(first - 4, p), -1):
            square, square_2 = _squares(newest)
            total, total_2 = total + square, total_2 + square_2
            before, newest = newest, _next(rows, (top + r) * size + r - 1, point, newest, a)
            _put(x, 4 * r - 4, newest)
            if large < math.inf:
                factor, factor_2 = _shrink(x, 4 * r - 4, 4 * last, large), _shrink(x, 4 * r - 2, 4 * last, large)
                total, total_2 = total * factor * factor, total_2 * factor_2 * factor_2
                newest, before = _scaled(newest, factor, factor_2), _scaled(before, factor, factor_2)
                b, c, d = _scaled(b, factor, factor_2), _scaled(c, factor, factor_2), _scaled(d, factor, factor_2)
            a = _plus(b, load(rows, (top + max(r - 1, p)) * size + r, 0), before)
            b = _plus(c, load(rows, (top + max(r - 2, p)) * size + r, 0), before)
            c = _plus(d, load(rows, (top + max(r - 3, p)) * size + r, 0), before)
    fine = _finish(x, 4 * p, length, total, newest[0], newest[1])
    return _finish(x, 4 * p + 2, length + 1, total_2, newest[2], newest[3]) and fine


@inlined
def _squares(numbers: Four) -> tuple[Number, Number]:
    re, im, re_2, im_2 = numbers
    return re * re + im * im, re_2 * re_2 + im_2 * im_2


@inlined
def _scaled(numbers: Four, factor: Number, factor_2: Number) -> Four:
    return numbers[0] * factor, numbers[1] * factor, numbers[2] * factor_2, numbers[3] * factor_2


@inlined
def _plus(sums: Four, factor: float, numbers: Four) -> Four:
    """Return sums and a multiple of other numbers."""
    re, im, re_2, im_2 = numbers
    return sums[0] + factor * re, sums[1] + factor * im, sums[2] + factor * re_2, sums[3] + factor * im_2


@inlined
def _finish(x: FloatArray, slot: int, length: int, total: Number, re: Number, im: Number) -> bool:
    square = re * re + im * im
    within = (square < LARGEST) & (total < LARGEST)
    # NaN marks points at which digits may have been lost.
    factor = choose(within & (square > SMALLEST), 1.0 / square, math.nan)
    store(x, slot, None, factor * re)
    store(x, slot + 1, None, -factor * im)
    store(x, length, None, root(factor * total))
    return not anywhere(~within)


@inlined
def _four(x: FloatArray, slot: int) -> Four:
    return load(x, slot, None), load(x, slot + 1, None), load(x, slot + 2, None), load(x, slot + 3, None)


@inlined
def _sums(rows: FloatArray, row: int, first: int, last: int, x: FloatArray) -> Four:
    """Return the product of the columns `first` to `last` of a row with those components of x."""
    zero = 0.0 * load(x, 4 * last, None)
    sums = zero, zero, zero, zero
    # In descending order: the newest component, the last of the sum, is available last.
    for k in range(last, first - 1, -1):
        sums = _plus(sums, load(rows, row + k, 0), _four(x, 4 * k))
    return sums


@inlined
def _four_sums(
    rows: FloatArray, top: int, size: int, p: int, first: int, last: int, x: FloatArray
) -> tuple[Four, Four, Four, Four]:
    """Return `_sums` of the columns right of `first`, of that row and of the three above it, none above row p."""
    zero = 0.0 * load(x, 4 * last, None)
    a = b = c = d = zero, zero, zero, zero
    row_b, row_c, row_d = max(first - 1, p), max(first - 2, p), max(first - 3, p)
    for k in range(last, first, -1):
        numbers = _four(x, 4 * k)
        a = _plus(a, load(rows, (top + first) * size + k, 0), numbers)
        b = _plus(b, load(rows, (top + row_b) * size + k, 0), numbers)
        c = _plus(c, load(rows, (top + row_c) * size + k, 0), numbers)
        d = _plus(d, load(rows, (top + row_d) * size + k, 0), numbers)
    return a, b, c, d


@inlined
def _next(rows: FloatArray, diagonal: int, point: Four, newest: Four, sums: Four) -> Four:
    """Return the component before the newest one; the row's entry left of the diagonal is at slot `diagonal`."""
    unit, own = load(rows, diagonal, 0), load(rows, diagonal + 1, 0)
    a, b, a_2, b_2 = point[0] * unit - own, point[1] * unit, point[2] * unit - own, point[3] * unit
    re, im, re_2, im_2 = newest
    return (
        (a * re - sums[0]) - b * im,
        (a * im - sums[1]) + b * re,
        (a_2 * re_2 - sums[2]) - b_2 * im_2,
        (a_2 * im_2 - sums[3]) + b_2 * re_2,
    )


@inlined
def _put(x: FloatArray, slot: int, numbers: Four) -> None:
    for k in range(4):
        store(x, slot + k, None, numbers[k])


@internal
def _shrink(x: FloatArray, slot: int, last: int, large: float) -> Number:
    """Scale down solutions whose newest component, at `slot`, has a square above `large`; return the factor."""
    re, im = load(x, slot, None), load(x, slot + 1, None)
    factor = choose(re * re + im * im > large, SHRINK, 1.0)
    for k in range(slot, last + 4, 4):
        store(x, k, None, factor * load(x, k, None))
        store(x, k + 1, None, factor * load(x, k + 1, None))
    return factor


@internal
def _put_entry(work: FloatArray, entry: int, factor: int, re: Number, im: Number, direct: float) -> None:
    """Put D plus an output of x, scaled by the factor of x, into its slots."""
    real, imaginary = load(work, factor, None), load(work, factor + 1, None)
    store(work, entry, None, (re * real - im * imaginary) + direct)
    store(work, entry + 1, None, re * imaginary + im * real)


@internal
def _size(numbers: FloatArray, slot: int) -> Number:
    re, im = load(numbers, slot, None), load(numbers, slot + 1, None)
    return greater(re, -re) + greater(im, -im)


@inlined
def _missed(
    at: int, norms: FloatArray, D: FloatArray, tolerated: float, least: float, work: FloatArray, first: int, sizes: int
) -> Number:
    """Return 1 for points at which the error bound of an entry exceeds the tolerance, else 0."""
    p, m = D.shape
    largest = zero = 0.0 * load(work, at, None)
    for entry in range(first, first + 4 * m * p, 4):
        largest = greater(largest, _size(work, entry))
    unit = ROUNDING * (norms[p] + _size(work, at)) * load(work, sizes + 2 * m, None)
    # False for NaN.
    fine, entry = largest == largest, first
    for j in range(m):
        wrong = unit * load(work, sizes + 2 * j, None)
        for i in range(p):
            found = greater(greater(_size(work, entry), FLOOR * largest), zero + least)
            fine = fine & (wrong * norms[i] + ROUNDING * abs(D[i, j]) <= tolerated * found)
            entry += 4
    return choose(fine, 0.0, 1.0)
