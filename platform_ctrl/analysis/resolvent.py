"""D + C (z I - A)^-1 B at many points z, compiled: a short recurrence where it is accurate, elimination where not.

The recurrence. An orthogonal change of states turns b into beta e1 and A into Hessenberg form H. All rows but the
first of (z I - H) x = beta e1 then give x[k-1] from x[k], x[k+1], ...: started with any last component, n²/2
multiplications by real numbers lead to the first row, which says how large x is (Hyman; Wilkinson, The Algebraic
Eigenvalue Problem, ch. 7, sec. 11). Each row is solved with a small relative error in each entry of H: x belongs to a
matrix that differs from A by rounding of |A|, whatever A's eigenvectors, and no pivot is sought.

An output c' x is then wrong by no more than |w| times this rounding times |x|, where w' = c' (z I - A)^-1; the same
recurrence for the transposed system gives |w|, for a mixture of all outputs at once. Where that is too much (next to
lightly damped poles, in steep roll-off, in widely spread systems), z I - A is eliminated with pivots in the states as
they are given, and the solution is refined with residuals in twice the digits (Demmel et al., Error bounds from
extra-precise iterative refinement, ACM Trans. Math. Software 32, 2006).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np
from numba import njit
from numpy.typing import NDArray

from platform_ctrl.frozen import FloatArray

ComplexArray = NDArray[np.complex128]
F = TypeVar("F", bound=Callable[..., Any])

# Points that advance side by side, and the bytes of their workspace: it stays in the nearest cache.
LANES, LEAST_LANES, WORKSPACE = 128, 32, 40_000
# Doublings along a chain that fourth powers can carry; square of the remainder below which underflow costs digits.
RANGE, SMALLEST = 240.0, 2.0**-800
# Rounding of the recurrence, in units of |A| + |z|.
ROUNDING = 8.0 * 2.0**-53
# Error above which a point is eliminated: relative to the entry, or to FLOOR times the largest one at that point.
TOLERATED, FLOOR = 2.5e-10, 1e-3
# Steps of refinement at most: each gains what the condition leaves of 16 digits.
STEPS = 10
# Columns of zeros behind a chain and rows of zeros behind its solution: products are taken four at a time.
SPARE = 4


def _compiled(function: F, **options: Any) -> F:
    # error_model="numpy": a vanishing pivot becomes inf or NaN.
    try:
        return cast(F, njit(cache=True, nogil=True, error_model="numpy", **options)(function))
    except RuntimeError:  # nowhere to keep a cache: compile in every process
        return cast(F, njit(nogil=True, error_model="numpy", **options)(function))


def _internal(function: F) -> F:
    """Compile for callers in this file alone."""
    return _compiled(function, no_cpython_wrapper=True, no_cfunc_wrapper=True)


def _reordered(function: F) -> F:
    """Compile for callers in this file a function whose sums may be taken in any order."""
    fast = {"contract", "reassoc", "nsz"}
    return _compiled(function, fastmath=fast, no_cpython_wrapper=True, no_cfunc_wrapper=True)


@_reordered
def _reflection(x: FloatArray, first: int, v: FloatArray) -> float:
    """Find v with |v|² = 2 that reflects x[first:] to its first component; return that component."""
    n = len(x)
    largest = 0.0
    for i in range(n):
        v[i] = 0.0
    for i in range(first, n):
        largest = max(largest, abs(x[i]))
    if largest == 0.0:
        return 0.0
    below = 0.0
    for i in range(first + 1, n):
        v[i] = x[i] / largest
        below += v[i] * v[i]
    if below == 0.0:
        return float(x[first])
    head = x[first] / largest
    length = math.sqrt(head * head + below)
    if head < 0.0:
        length = -length
    v[first] = head + length
    unit = math.sqrt(2.0 / (v[first] * v[first] + below))
    for i in range(first, n):
        v[i] *= unit
    return float(-length * largest)


@_reordered
def _reflected(H: FloatArray, seen: FloatArray, v: FloatArray, first: int, total: FloatArray) -> None:
    """Reflect the states from `first` on at v in the system matrix and in the rows that see the states."""
    n = len(v)
    for j in range(n):
        total[j] = 0.0
    for i in range(first, n):
        for j in range(n):
            total[j] += v[i] * H[i, j]
    for i in range(first, n):
        for j in range(n):
            H[i, j] -= v[i] * total[j]
    for i in range(n):
        along = 0.0
        for j in range(first, n):
            along += H[i, j] * v[j]
        for j in range(first, n):
            H[i, j] -= along * v[j]
    for i in range(seen.shape[0]):
        along = 0.0
        for j in range(first, n):
            along += seen[i, j] * v[j]
        for j in range(first, n):
            seen[i, j] -= along * v[j]


@_reordered
def _chain(b: FloatArray, H: FloatArray, seen: FloatArray, inverse: FloatArray) -> tuple[float, int]:
    """Turn the states so that `b` is beta e1, the system matrix Hessenberg; return beta and how many states b reaches.

    H (n, n + SPARE) comes with A and is left with its rows divided by their subdiagonal entries (the first by 1), whose
    inverses are written; `seen` (p, n) comes with C and is left with C in the new states.
    """
    n = len(b)
    v, column, total = np.zeros(n), np.zeros(n), np.zeros(n)
    size = 0.0
    for i in range(n):
        for j in range(n):
            size += H[i, j] * H[i, j]
    size = math.sqrt(size)
    beta = _reflection(b, 0, v)
    _reflected(H, seen, v, 0, total)
    inverse[0] = 1.0
    order = n
    for k in range(n - 1):
        for i in range(n):
            column[i] = H[i, k]
        along = _reflection(column, k + 1, v)
        # Below rounding of A nothing goes on to the states behind.
        if abs(along) <= 2.0**-54 * size:
            order = k + 1
            break
        _reflected(H, seen, v, k + 1, total)
        inverse[k + 1] = 1.0 / along
    for k in range(1, order):
        for j in range(k, order):
            H[k, j] *= inverse[k]
    for k in range(order):
        for j in range(order, n):
            H[k, j] = 0.0
    return beta, order


@_compiled
def prepared(
    A: FloatArray, B: FloatArray, C: FloatArray
) -> tuple[float, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, NDArray[np.int64]]:
    """Return |A|, norms of the rows of C, chains (m + 1, n, n + SPARE), inverses, C in their states, betas, orders.

    Chains belong to the columns of B, the last one to A transposed and a mixture of the rows of C.
    """
    n, m, p = A.shape[0], B.shape[1], C.shape[0]
    chains, inverses = np.zeros((m + 1, n, n + SPARE)), np.zeros((m + 1, n))
    seen, nothing = np.empty((m, p, n)), np.empty((0, n))
    betas, orders, b, norms = np.empty(m + 1), np.empty(m + 1, dtype=np.int64), np.zeros(n), np.zeros(p)
    for j in range(m):
        for i in range(n):
            b[i] = B[i, j]
            for k in range(n):
                chains[j, i, k] = A[i, k]
        for i in range(p):
            for k in range(n):
                seen[j, i, k] = C[i, k]
        betas[j], orders[j] = _chain(b, chains[j], seen[j], inverses[j])
    size = 0.0
    for i in range(n):
        b[i] = 0.0
        for k in range(n):
            chains[m, i, k] = A[k, i]
            size += A[i, k] * A[i, k]
    for i in range(p):
        for k in range(n):
            norms[i] += C[i, k] * C[i, k]
        norms[i] = math.sqrt(norms[i])
        # Each output as large as the others, in a proportion that no symmetry of a system has.
        weight = math.cos(2.0 + 3.0 * i * i) / norms[i] if norms[i] > 0.0 else 0.0
        for k in range(n):
            b[k] += weight * C[i, k]
    betas[m], orders[m] = _chain(b, chains[m], nothing, inverses[m])
    return math.sqrt(size), norms, chains, inverses, seen, betas, orders


@_reordered
def _exponents(G: FloatArray, inverse: FloatArray, order: int, zr: float, zi: float, exponents: FloatArray) -> None:
    """Write the binary exponents of x[-1] (the remainder), x[0], x[1], ... of a chain at one point z."""
    re, im, shift = np.zeros(order + 1), np.zeros(order + 1), 0.0
    re[order] = 1.0
    exponents[order] = 0.0
    for k in range(order - 1, -1, -1):
        a, b = zr * inverse[k], zi * inverse[k]
        real, imaginary = a * re[k + 1] - b * im[k + 1], a * im[k + 1] + b * re[k + 1]
        for j in range(k, order):
            real -= G[k, j] * re[j + 1]
            imaginary -= G[k, j] * im[j + 1]
        re[k], im[k] = real, imaginary
        size = abs(real) + abs(imaginary)
        # On a pole, and beyond all numbers, any exponent will do.
        exponents[k] = shift + math.floor(math.log2(size)) if 0.0 < size < np.inf else exponents[k + 1]
        if size > 2.0**200:
            shift += 200.0
            for j in range(k, order + 1):
                re[j] *= 2.0**-200
                im[j] *= 2.0**-200
    # The remainder may vanish near a pole: it has no size of its own.
    exponents[0] = exponents[1]


@_reordered
def _recurrence(
    chain: FloatArray,
    inverses: FloatArray,
    beta: float,
    order: int,
    width: int,
    z: FloatArray,
    x: FloatArray,
    scale: FloatArray,
) -> None:
    """Run a chain at the points z (2, LANES): x[1:] (SPARE + n + 1, 2, LANES) is the solution but for its scale.

    The rows of `scale` (3, LANES): real and imaginary part of the factor that x still needs, and |x| with it.
    """
    zr, zi = z[0, width // 2], z[1, width // 2]
    exponents, G, inverse, growth = np.zeros(order + 1), chain, inverses, 0.0
    for k in range(1, order):
        growth += math.log2(1.0 + (abs(zr) + abs(zi)) * abs(inverse[k]) + abs(G[k, k]) + abs(G[k, k + 1]))
    if not growth < RANGE:
        # Each component in units of its size at the middle point.
        G, inverse = np.zeros(chain.shape), np.empty(order)
        _exponents(chain, inverses, order, zr, zi, exponents)
        for k in range(order):
            inverse[k] = inverses[k] * 2.0 ** (exponents[k + 1] - exponents[k])
            for j in range(k, order):
                G[k, j] = chain[k, j] * 2.0 ** (exponents[j + 1] - exponents[k])
    for k in range(order, order + SPARE + 1):
        for t in range(width):
            x[k, 0, t] = 0.0
            x[k, 1, t] = 0.0
    for t in range(width):
        x[order, 0, t] = 1.0
    for k in range(order - 1, -1, -1):
        unit, g = inverse[k], G[k, k]
        g0, g1, g2, g3 = G[k, k + 1], G[k, k + 2], G[k, k + 3], G[k, k + 4]
        for t in range(width):
            a, b = z[0, t] * unit - g, z[1, t] * unit
            re, im = x[k + 1, 0, t], x[k + 1, 1, t]
            real = (g0 * x[k + 2, 0, t] + g1 * x[k + 3, 0, t]) + (g2 * x[k + 4, 0, t] + g3 * x[k + 5, 0, t])
            imaginary = (g0 * x[k + 2, 1, t] + g1 * x[k + 3, 1, t]) + (g2 * x[k + 4, 1, t] + g3 * x[k + 5, 1, t])
            x[k, 0, t] = a * re - b * im - real
            x[k, 1, t] = a * im + b * re - imaginary
        for j in range(k + 5, order, 4):
            g0, g1, g2, g3 = G[k, j], G[k, j + 1], G[k, j + 2], G[k, j + 3]
            for t in range(width):
                real = (g0 * x[j + 1, 0, t] + g1 * x[j + 2, 0, t]) + (g2 * x[j + 3, 0, t] + g3 * x[j + 4, 0, t])
                imaginary = (g0 * x[j + 1, 1, t] + g1 * x[j + 2, 1, t]) + (g2 * x[j + 3, 1, t] + g3 * x[j + 4, 1, t])
                x[k, 0, t] -= real
                x[k, 1, t] -= imaginary
    if not growth < RANGE:
        largest = exponents[0]
        for k in range(order + 1):
            largest = max(largest, exponents[k])
        for k in range(order + 1):
            unit = 2.0 ** (exponents[k] - largest)
            for t in range(width):
                x[k, 0, t] *= unit
                x[k, 1, t] *= unit
    for t in range(width):
        scale[2, t] = 0.0
    for k in range(1, order + 1, 4):
        for t in range(width):
            r0, r1, r2, r3 = x[k, 0, t], x[k + 1, 0, t], x[k + 2, 0, t], x[k + 3, 0, t]
            i0, i1, i2, i3 = x[k, 1, t], x[k + 1, 1, t], x[k + 2, 1, t], x[k + 3, 1, t]
            real, imaginary = (r0 * r0 + r1 * r1) + (r2 * r2 + r3 * r3), (i0 * i0 + i1 * i1) + (i2 * i2 + i3 * i3)
            scale[2, t] += real + imaginary
    for t in range(width):
        re, im = x[0, 0, t], x[0, 1, t]
        square = re * re + im * im
        # Lost digits are no digits.
        factor = beta / square if square > SMALLEST else np.inf
        scale[0, t] = factor * re
        scale[1, t] = -factor * im
        scale[2, t] = abs(factor) * math.sqrt(square * scale[2, t])


@_reordered
def _outputs(
    seen: FloatArray, order: int, width: int, x: FloatArray, scale: FloatArray, D: FloatArray, entries: FloatArray
) -> None:
    """Write D[:, 0] + seen (p, n) times x times its scale into entries (p, 2, LANES)."""
    for i in range(seen.shape[0]):
        for t in range(width):
            entries[i, 0, t] = 0.0
            entries[i, 1, t] = 0.0
        for k in range(0, order, 4):
            c0, c1, c2, c3 = seen[i, k], 0.0, 0.0, 0.0
            if k + 1 < order:
                c1 = seen[i, k + 1]
            if k + 2 < order:
                c2 = seen[i, k + 2]
            if k + 3 < order:
                c3 = seen[i, k + 3]
            for t in range(width):
                found = (c0 * x[k + 1, 0, t] + c1 * x[k + 2, 0, t]) + (c2 * x[k + 3, 0, t] + c3 * x[k + 4, 0, t])
                entries[i, 0, t] += found
                found = (c0 * x[k + 1, 1, t] + c1 * x[k + 2, 1, t]) + (c2 * x[k + 3, 1, t] + c3 * x[k + 4, 1, t])
                entries[i, 1, t] += found
        for t in range(width):
            re, im = entries[i, 0, t], entries[i, 1, t]
            entries[i, 0, t] = D[i] + (re * scale[0, t] - im * scale[1, t])
            entries[i, 1, t] = re * scale[1, t] + im * scale[0, t]


@_reordered
def _missed(
    norm: float,
    D: FloatArray,
    norms: FloatArray,
    width: int,
    points: FloatArray,
    scale: FloatArray,
    sizes: FloatArray,
    entries: FloatArray,
    missed: FloatArray,
) -> None:
    """Count in missed[0] (3, LANES) the entries that may be wrong by more than is tolerated."""
    m, p = D.shape
    for t in range(width):
        missed[0, t] = missed[1, t] = 0.0
        missed[2, t] = ROUNDING * (norm + abs(points[0, t]) + abs(points[1, t])) * scale[2, t]
    for j in range(m):
        for i in range(p):
            for t in range(width):
                found = abs(entries[j, i, 0, t]) + abs(entries[j, i, 1, t])
                missed[1, t] = found if found > missed[1, t] else missed[1, t]
    for j in range(m):
        for i in range(p):
            share, direct = norms[i], ROUNDING * abs(D[j, i])
            for t in range(width):
                found = abs(entries[j, i, 0, t]) + abs(entries[j, i, 1, t])
                least = FLOOR * missed[1, t]
                found = found if found > least else least
                # What is not a number misses as well.
                missed[0, t] += 0.0 if missed[2, t] * share * sizes[j, t] + direct <= TOLERATED * found else 1.0


@_compiled
def quick(
    D: FloatArray,
    z: ComplexArray,
    H: ComplexArray,
    norm: float,
    norms: FloatArray,
    chains: FloatArray,
    inverses: FloatArray,
    seen: FloatArray,
    betas: FloatArray,
    orders: NDArray[np.int64],
) -> NDArray[np.int64]:
    """Write D + C (z I - A)^-1 B into H (m, p, N) by the recurrence; return the points where that is not good enough.

    D (m, p) is transposed as H is; what follows H is from `prepared`.
    """
    (m, p, n), N = seen.shape, len(z)
    poor, count_poor = np.empty(N, dtype=np.int64), 0
    lanes = min(LANES, max(LEAST_LANES, WORKSPACE // (16 * (n + SPARE + 1)) // LEAST_LANES * LEAST_LANES))
    x, scale, points = np.empty((n + SPARE + 1, 2, lanes)), np.empty((3, lanes)), np.empty((2, lanes))
    entries, sizes, missed = np.empty((m, p, 2, lanes)), np.empty((m, lanes)), np.empty((3, lanes))
    for start in range(0, N, lanes):
        count = min(lanes, N - start)
        # Whole registers: the rest repeats the last point.
        width = (count + 7) // 8 * 8
        for t in range(width):
            one = z[start + min(t, count - 1)]
            points[0, t], points[1, t] = one.real, one.imag
        for j in range(m):
            _recurrence(chains[j], inverses[j], float(betas[j]), int(orders[j]), width, points, x, scale)
            _outputs(seen[j], int(orders[j]), width, x, scale, D[j], entries[j])
            for t in range(width):
                sizes[j, t] = scale[2, t]
            for i in range(p):
                for t in range(count):
                    H[j, i, start + t] = complex(entries[j, i, 0, t], entries[j, i, 1, t])
        _recurrence(chains[m], inverses[m], float(betas[m]), int(orders[m]), width, points, x, scale)
        _missed(norm, D, norms, width, points, scale, sizes, entries, missed)
        for t in range(count):
            if missed[0, t] > 0.0:
                poor[count_poor] = start + t
                count_poor += 1
    return poor[:count_poor]


@_internal
def _sum(a: float, b: float) -> tuple[float, float]:
    """Return a + b as a number and what it lacks (Knuth)."""
    total = a + b
    part = total - a
    return total, (a - (total - part)) + (b - part)


@_internal
def _halves(a: float) -> tuple[float, float]:
    """Split a number into two of half its digits (Dekker)."""
    high = a * 134217729.0
    high = high - (high - a)
    return high, a - high


@_internal
def _plus_product(
    total: float, lacks: float, a: float, a_high: float, a_low: float, b: float, b_high: float, b_low: float
) -> tuple[float, float]:
    """Add a b, given with halves, to a sum in twice the digits (Ogita, Rump, Oishi, SIAM J. Sci. Comput. 26, 2005)."""
    product = a * b
    low = a_low * b_low - (((product - a_high * b_high) - a_low * b_high) - a_high * b_low)
    total, more = _sum(total, product)
    return total, lacks + (low + more)


@_internal
def _factored(M: ComplexArray, pivots: NDArray[np.int64]) -> bool:
    """Factor M = P L U in place; False if a pivot vanishes or is not finite."""
    n = M.shape[0]
    for k in range(n):
        best, at = -1.0, k
        for i in range(k, n):
            size = abs(M[i, k].real) + abs(M[i, k].imag)
            if size > best:
                best, at = size, i
        pivots[k] = at
        if not 0.0 < best < np.inf:
            return False
        if at != k:
            for j in range(n):
                M[k, j], M[at, j] = M[at, j], M[k, j]
        inverse = 1.0 / M[k, k]
        for i in range(k + 1, n):
            if M[i, k] != 0.0:
                factor = M[i, k] * inverse
                M[i, k] = factor
                for j in range(k + 1, n):
                    M[i, j] -= factor * M[k, j]
    return True


@_internal
def _solve(M: ComplexArray, pivots: NDArray[np.int64], x: ComplexArray) -> None:
    """Solve with the factors of `_factored`, in place."""
    n = M.shape[0]
    for k in range(n):
        x[k], x[pivots[k]] = x[pivots[k]], x[k]
    for k in range(n):
        for i in range(k + 1, n):
            x[i] -= M[i, k] * x[k]
    for k in range(n - 1, -1, -1):
        for j in range(k + 1, n):
            x[k] -= M[k, j] * x[j]
        x[k] /= M[k, k]


@_internal
def _halved(x: ComplexArray, halves: FloatArray) -> None:
    """Write the halves of the real and of the imaginary parts of x (n,) into halves (n, 4)."""
    for k in range(len(x)):
        halves[k, 0], halves[k, 1] = _halves(x[k].real)
        halves[k, 2], halves[k, 3] = _halves(x[k].imag)


@_internal
def _residual(
    A: FloatArray,
    A_high: FloatArray,
    lacks: FloatArray,
    b: FloatArray,
    z: complex,
    z_lacks: complex,
    x: ComplexArray,
    low: ComplexArray,
    halves: FloatArray,
    out: ComplexArray,
) -> None:
    """Write b - (z I - A) (x + low) in twice the digits; the diagonal of A and z come with what their doubles lack."""
    n = len(b)
    zr, zi = z.real, z.imag
    zr_high, zr_low = _halves(zr)
    zi_high, zi_low = _halves(zi)
    for i in range(n):
        xr, xi = x[i].real, x[i].imag
        r_high, r_low, i_high, i_low = halves[i, 0], halves[i, 1], halves[i, 2], halves[i, 3]
        re, re_low = _plus_product(b[i], 0.0, -zr, -zr_high, -zr_low, xr, r_high, r_low)
        re, re_low = _plus_product(re, re_low, zi, zi_high, zi_low, xi, i_high, i_low)
        im, im_low = _plus_product(0.0, 0.0, -zr, -zr_high, -zr_low, xi, i_high, i_low)
        im, im_low = _plus_product(im, im_low, -zi, -zi_high, -zi_low, xr, r_high, r_low)
        small = (lacks[i] - z_lacks) * x[i] - z * low[i]
        for j in range(n):
            a = A[i, j]
            if a != 0.0:
                high = A_high[i, j]
                re, re_low = _plus_product(re, re_low, a, high, a - high, x[j].real, halves[j, 0], halves[j, 1])
                im, im_low = _plus_product(im, im_low, a, high, a - high, x[j].imag, halves[j, 2], halves[j, 3])
                small += a * low[j]
        out[i] = complex(re + (re_low + small.real), im + (im_low + small.imag))


@_internal
def _output(c: FloatArray, d: float, x: ComplexArray, low: ComplexArray, halves: FloatArray) -> complex:
    """Return d + c (x + low), summed in twice the digits."""
    re, re_low, im, im_low = d, 0.0, 0.0, 0.0
    for k in range(len(c)):
        high, rest = _halves(c[k])
        re, re_low = _plus_product(re, re_low, c[k], high, rest, x[k].real, halves[k, 0], halves[k, 1])
        im, im_low = _plus_product(im, im_low, c[k], high, rest, x[k].imag, halves[k, 2], halves[k, 3])
        re_low += c[k] * low[k].real
        im_low += c[k] * low[k].imag
    return complex(re + re_low, im + im_low)


@_compiled
def refined(
    A: FloatArray,
    lacks: FloatArray,
    B: FloatArray,
    C: FloatArray,
    D: FloatArray,
    z: ComplexArray,
    z_lacks: ComplexArray,
    chosen: NDArray[np.int64],
    H: ComplexArray,
) -> None:
    """Write D + C (z I - A)^-1 B into H (m, p, N) at the `chosen` points by elimination and refinement; inf at a pole.

    `lacks` (n,) and `z_lacks` (N,) are what the diagonal of A and z have beyond their doubles; D (m, p) is transposed.
    """
    n, m, p = A.shape[0], B.shape[1], C.shape[0]
    M, pivots = np.empty((n, n), dtype=np.complex128), np.empty(n, dtype=np.int64)
    x, low = np.empty(n, dtype=np.complex128), np.empty(n, dtype=np.complex128)
    correction, b = np.empty(n, dtype=np.complex128), np.empty(n)
    A_high, halves = np.empty((n, n)), np.empty((n, 4))
    for i in range(n):
        for j in range(n):
            A_high[i, j] = _halves(A[i, j])[0]
    for f in chosen:
        for i in range(n):
            for j in range(n):
                M[i, j] = -A[i, j]
            M[i, i] += z[f]
        if not _factored(M, pivots):
            for j in range(m):
                for i in range(p):
                    H[j, i, f] = complex(np.inf, 0.0)
            continue
        for j in range(m):
            for k in range(n):
                b[k] = B[k, j]
                x[k], low[k] = b[k], 0.0
            _solve(M, pivots, x)
            _halved(x, halves)
            before = np.inf
            for _ in range(STEPS):
                _residual(A, A_high, lacks, b, z[f], z_lacks[f], x, low, halves, correction)
                _solve(M, pivots, correction)
                size, whole = 0.0, 0.0
                for k in range(n):
                    size = max(size, abs(correction[k].real) + abs(correction[k].imag))
                    whole = max(whole, abs(x[k].real) + abs(x[k].imag))
                if not size < before:
                    break
                before = 0.5 * size
                for k in range(n):
                    re, re_low = _sum(x[k].real, low[k].real + correction[k].real)
                    im, im_low = _sum(x[k].imag, low[k].imag + correction[k].imag)
                    x[k], low[k] = complex(re, im), complex(re_low, im_low)
                _halved(x, halves)
                done = True
                for i in range(p):
                    change = 0.0j
                    for k in range(n):
                        change += C[i, k] * correction[k]
                    H[j, i, f] = _output(C[i], D[j, i], x, low, halves)
                    # The next correction is smaller than this one as this one is than x.
                    done &= abs(change) * size <= 1e-12 * abs(H[j, i, f]) * whole
                if done:
                    break
