"""Both bounds of the structured singular value for many matrices, compiled: bare floats and arrays only.

One matrix after the other, each started from its neighbour's answer, which along a frequency response is close. The
power iteration of Packard, Fan and Doyle (27th CDC, 1988) climbs to vectors with M b = beta a and M' z = beta w, |a|
= |b| and |w| = |z| entry by entry. They give both bounds: phases Q with spectral radius rho(M Q) = beta below, and
the scalings D_i^2 = |z_i|/|a_i|, for which beta is a singular value of D M D^-1. It is the largest one whenever the
two bounds meet at that beta, and one Cholesky factorisation of beta^2 - N' N tells. Only where it fails (the climb
ended too low, or bounds of four and more channels differ) the upper bound is minimised by itself: the method of
centres, as the barrier -log det(t - N' N), N = D M D^-1, is convex and smooth in the logarithms of D.

All compiled functions stand in this one file: numba's cache notices changes of a function's own file only.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np
from numba import njit

from platform_ctrl.analysis.arrays import ComplexArray
from platform_ctrl.common.values import FloatArray

F = TypeVar("F", bound=Callable[..., Any])

# Steps of the power iteration from one start, and after how many it is looked at; Newton steps at most.
STEPS, CHECKED, LOOKS, CENTRES = 48, 3, 6, 80
# Largest ratio of two scalings: channels that hardly couple ask for no more.
FARTHEST = 1e12


def _compiled(function: F, **options: Any) -> F:
    try:
        return cast(F, njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"}, **options)(function))
    except RuntimeError:  # nowhere to keep a cache: compile in every process
        return cast(F, njit(nogil=True, error_model="numpy", fastmath={"contract"}, **options)(function))


def _internal(function: F) -> F:
    return _compiled(function, no_cpython_wrapper=True, no_cfunc_wrapper=True)


@_compiled
def mu_bounds(
    M: ComplexArray, tolerance: float, upper: FloatArray, lower: FloatArray, D: FloatArray, Q: ComplexArray
) -> None:
    """Fill in mu's bounds for M (N, m, m): `upper` (N,) with D (N, m), `lower` (N,) with the phases Q (N, m)."""
    N, m = M.shape[0], M.shape[1]
    S = np.empty((m, m), dtype=np.complex128)
    W = np.empty((m, m), dtype=np.complex128)
    vectors = np.empty((4, m), dtype=np.complex128)
    kept = np.ones((2, m), dtype=np.complex128)
    d = np.ones(m)
    work = np.empty((7, m, m), dtype=np.complex128)
    newton = np.empty((m + 3, m))
    for k in range(N):
        size = 0.0
        for i in range(m):
            for j in range(m):
                size += M[k, i, j].real ** 2 + M[k, i, j].imag ** 2
        size = math.sqrt(size)
        upper[k] = lower[k] = size
        for i in range(m):
            D[k, i] = 1.0
            Q[k, i] = 1.0
        if m == 1:
            Q[k, 0] = M[k, 0, 0].conjugate() / size if size > 0.0 else 1.0
            continue
        if not (size > 0.0 and size < math.inf):
            continue
        # From the neighbour's vectors and scalings, then from the matrix's own.
        upper[k] = math.inf
        lower[k] = 0.0
        for start in range(0 if k > 0 else 1, 2):
            if start == 1:
                for i in range(m):
                    d[i] = 1.0
                _osborne(M[k], d)
            for i in range(m):
                for j in range(m):
                    S[i, j] = M[k, i, j] * (d[i] / d[j]) / size
            if start == 1:
                _strongest(S, vectors)
            else:
                for i in range(m):
                    vectors[0, i] = kept[0, i]
                    vectors[1, i] = kept[1, i]
            beta = _climb(S, W, vectors, d, tolerance, D[k], Q[k])
            lower[k] = max(lower[k], abs(beta))
            if beta > 0.0:
                upper[k] = beta * (1.0 + tolerance)
                break
        if upper[k] == math.inf:
            upper[k] = _centres(M[k], size, work, newton, d, tolerance)
            for i in range(m):
                D[k, i] = d[i]
                for j in range(m):
                    S[i, j] = M[k, i, j] * (d[i] / d[j]) / size
            enough = upper[k] * (1.0 - 2.0 * tolerance)
            lower[k] = _from_centre(S, work, vectors, Q[k], lower[k], enough)
            if lower[k] < enough:
                lower[k] = _restarted(S, vectors, Q[k], lower[k], enough)
            lower[k] = min(lower[k], upper[k])
        for i in range(m):
            kept[0, i] = vectors[0, i]
            kept[1, i] = vectors[1, i]
            d[i] = D[k, i]
        upper[k] *= size
        lower[k] *= size


@_internal
def _modulus(x: complex) -> float:
    # Without the care for overflow that abs takes: entries are of size 1.
    return math.sqrt(x.real * x.real + x.imag * x.imag)


@_internal
def _osborne(M: ComplexArray, d: FloatArray) -> None:
    """Make row i and column i of D M D^-1 equally long, the diagonal left out."""
    m = len(d)
    for _ in range(8):
        for i in range(m):
            row = column = 1e-60
            for j in range(m):
                if j != i:
                    row += (M[i, j].real ** 2 + M[i, j].imag ** 2) / d[j] ** 2
                    column += (M[j, i].real ** 2 + M[j, i].imag ** 2) * d[j] ** 2
            d[i] = min(max(math.sqrt(math.sqrt(column / row)), 1e-5), 1e5)
    _centred(d)


@_internal
def _centred(d: FloatArray) -> None:
    """Give d the geometric mean 1."""
    mean = 0.0
    for i in range(len(d)):
        mean += math.log(d[i])
    scale = math.exp(-mean / len(d))
    for i in range(len(d)):
        d[i] *= scale


@_internal
def _times(S: ComplexArray, x: ComplexArray, out: ComplexArray) -> float:
    """Put S x into `out`, made a unit vector; return its length."""
    m = len(x)
    size = 0.0
    for i in range(m):
        total = 0j
        for j in range(m):
            total += S[i, j] * x[j]
        out[i] = total
        size += total.real**2 + total.imag**2
    size = math.sqrt(size)
    if size > 0.0:
        scale = 1.0 / size
        for i in range(m):
            out[i] *= scale
    return size


@_internal
def _star_times(S: ComplexArray, x: ComplexArray, out: ComplexArray) -> float:
    """Put S' x into `out`, made a unit vector; return its length."""
    m = len(x)
    size = 0.0
    for i in range(m):
        total = 0j
        for j in range(m):
            total += S[j, i].conjugate() * x[j]
        out[i] = total
        size += total.real**2 + total.imag**2
    size = math.sqrt(size)
    if size > 0.0:
        scale = 1.0 / size
        for i in range(m):
            out[i] *= scale
    return size


@_internal
def _strongest(S: ComplexArray, vectors: ComplexArray) -> None:
    """Start b, w near the singular vector of the largest singular value."""
    m = len(S)
    for i in range(m):
        vectors[0, i] = 1.0 + 0.1j * i
    for _ in range(3):
        _times(S, vectors[0], vectors[2])
        _star_times(S, vectors[2], vectors[0])
    for i in range(m):
        vectors[1, i] = vectors[0, i]


@_internal
def _step(S: ComplexArray, vectors: ComplexArray) -> float:
    """Take one step of the power iteration on b, w, a, z (rows of `vectors`); return |S b|."""
    b, w, a, z = vectors[0], vectors[1], vectors[2], vectors[3]
    beta = _times(S, b, a)
    for i in range(len(b)):
        size = _modulus(a[i])
        z[i] = a[i] * (_modulus(w[i]) / size) if size > 0.0 else complex(_modulus(w[i]), 0.0)
    _star_times(S, z, w)
    for i in range(len(b)):
        size = _modulus(w[i])
        b[i] = w[i] * (_modulus(a[i]) / size) if size > 0.0 else complex(_modulus(a[i]), 0.0)
    return beta


@_internal
def _climb(
    S: ComplexArray,
    W: ComplexArray,
    vectors: ComplexArray,
    d: FloatArray,
    tolerance: float,
    D: FloatArray,
    Q: ComplexArray,
) -> float:
    """Climb; return mu(S) where both bounds meet, else minus the best lower bound, 0 for none."""
    m = len(d)
    found = 0.0
    for _ in range(STEPS // CHECKED):
        for _ in range(CHECKED):
            _step(S, vectors)
        beta = _reached(S, vectors)
        if beta <= 0.0:
            continue
        if beta > found:
            found = beta
            for i in range(m):
                Q[i] = _turn(vectors[0, i], vectors[2, i])
        # Channels that take no part keep the scaling that they came with.
        most, least = 0.0, math.inf
        for i in range(m):
            D[i] = math.sqrt((_modulus(vectors[3, i]) + 1e-7) / (_modulus(vectors[2, i]) + 1e-7))
            most, least = max(most, D[i] * d[i]), min(least, D[i] * d[i])
        if most <= FARTHEST * least and _below(S, W, D, beta * (1.0 + tolerance)):
            for i in range(m):
                D[i] *= d[i]
            _centred(D)
            return beta
    return -found


@_internal
def _turn(x: complex, y: complex) -> complex:
    """Return the phase that takes y to x."""
    product = x * y.conjugate()
    size = _modulus(product)
    return product * (1.0 / size) if size > 0.0 else 1.0 + 0j


@_internal
def _reached(S: ComplexArray, vectors: ComplexArray) -> float:
    """Return |eigenvalue| of Q S near the vectors, by their two-sided Rayleigh quotient; 0 if they have not settled."""
    b, w, a = vectors[0], vectors[1], vectors[2]
    m = len(b)
    # Q S b = lambda b, and (Q S)' w = conj(lambda) w, with Q = phases of b over those of the S b before.
    top = bottom = 0j
    size = 0.0
    for i in range(m):
        total = 0j
        for j in range(m):
            total += S[i, j] * b[j]
        a[i] = total
        size += total.real**2 + total.imag**2
    size = math.sqrt(size)
    if size == 0.0:
        return 0.0
    rest = 0.0
    for i in range(m):
        a[i] *= 1.0 / size
        q = _turn(b[i], a[i])
        rest += _modulus(q * a[i] - b[i]) ** 2
        vectors[3, i] = _modulus(w[i]) * _turn(a[i], 1.0 + 0j)
        top += w[i].conjugate() * q * a[i] * size
        bottom += w[i].conjugate() * b[i]
    back = 0.0
    length = 0.0
    for i in range(m):
        total = 0j
        for j in range(m):
            total += S[j, i].conjugate() * vectors[3, j]
        back += _modulus(total - size * w[i]) ** 2
        length += _modulus(total) ** 2
    if rest > 1e-10 or back > 1e-10 * length or _modulus(bottom) < 1e-6:
        return 0.0
    return _modulus(top / bottom)


@_internal
def _from_centre(
    S: ComplexArray, work: ComplexArray, vectors: ComplexArray, Q: ComplexArray, best: float, least: float
) -> float:
    """Return the lower bound that the scaled matrix S itself offers at the least upper bound; at least `best`.

    There the weights R say which singular vectors x, y = S x of the largest value have |x_i| = |y_i| in the mean. A
    single x that has it gives the phases. Two coinciding singular values leave a sphere of x, and each channel asks for
    a plane through it: up to three channels these planes share a line that meets the sphere.
    """
    m = len(S)
    R, V, X, Y = work[2], work[3], work[4], work[5]
    _eigenvectors(R, V)
    first = second = 0
    for i in range(1, m):
        if R[i, i].real > R[first, first].real:
            first = i
    second = 1 if first == 0 else 0
    for i in range(m):
        if i != first and R[i, i].real > R[second, second].real:
            second = i
    # The mean in the sphere: only its third coordinate is not zero.
    mean = (R[first, first].real - R[second, second].real) / (R[first, first].real + R[second, second].real)
    for i in range(m):
        X[0, i], X[1, i] = V[i, first], V[i, second]
    for k in range(2):
        _times(S, X[k], Y[k])
    # Each channel's plane: |y_i|^2 - |x_i|^2 for x = u1 X1 + u2 X2, in the point of the sphere that represents u.
    planes = np.empty((m, 3))
    for i in range(m):
        across = Y[0, i].conjugate() * Y[1, i] - X[0, i].conjugate() * X[1, i]
        planes[i, 0], planes[i, 1] = across.real, -across.imag
        planes[i, 2] = 0.5 * (_square(Y[0, i]) - _square(X[0, i]) - _square(Y[1, i]) + _square(X[1, i]))
    q0, q1, q2, length = 1.0, 0.0, 0.0, 1e-24
    for i in range(m):
        for j in range(i):
            c0 = planes[i, 1] * planes[j, 2] - planes[i, 2] * planes[j, 1]
            c1 = planes[i, 2] * planes[j, 0] - planes[i, 0] * planes[j, 2]
            c2 = planes[i, 0] * planes[j, 1] - planes[i, 1] * planes[j, 0]
            if c0 * c0 + c1 * c1 + c2 * c2 > length:
                q0, q1, q2, length = c0, c1, c2, c0 * c0 + c1 * c1 + c2 * c2
    if length > 1e-24:
        length = 1.0 / math.sqrt(length)
        q0, q1, q2 = q0 * length, q1 * length, q2 * length
    along = mean * q2
    root = math.sqrt(max(along * along - mean * mean + 1.0, 0.0))
    s = np.empty(3)
    for choice in range(3):
        far = -along + root * (1.0 - 2.0 * choice)
        s[0], s[1], s[2] = far * q0, far * q1, mean + far * q2
        if choice == 2:
            s[0], s[1], s[2] = 0.0, 0.0, 1.0
        one = math.sqrt(max(0.5 * (1.0 + s[2]), 0.0))
        other = complex(s[0], s[1]) / (2.0 * one) if one > 1e-8 else 1.0 + 0j
        for i in range(m):
            x = one * X[0, i] + other * X[1, i]
            y = one * Y[0, i] + other * Y[1, i]
            vectors[0, i] = vectors[1, i] = x
            vectors[2, i] = _turn(x, y)
        found = _radius(S, vectors[2], vectors[3], vectors[0], work[6], least)
        if found > best:
            best = found
            for i in range(m):
                Q[i] = vectors[2, i]
    return best


@_internal
def _square(x: complex) -> float:
    return x.real * x.real + x.imag * x.imag


@_internal
def _radius(
    S: ComplexArray, Q: ComplexArray, y: ComplexArray, x: ComplexArray, T: ComplexArray, expected: float
) -> float:
    """Return |eigenvalue| of Q S next to x and to `expected` by Rayleigh's iteration; 0 if it does not settle."""
    m = len(x)
    value = 0j
    for step in range(6):
        top, bottom, rest = 0j, 0.0, 0.0
        for i in range(m):
            total = 0j
            for j in range(m):
                total += S[i, j] * x[j]
            y[i] = Q[i] * total
            top += x[i].conjugate() * y[i]
            bottom += _square(x[i])
        value = top / bottom
        for i in range(m):
            rest += _square(y[i] - value * x[i])
        if rest < 1e-26 * bottom:
            return _modulus(value)
        if step == 5:
            break
        for i in range(m):
            for j in range(m):
                T[i, j] = Q[i] * S[i, j]
            # What is looked for is real: the phases turn y to x. Later steps follow the vector alone.
            T[i, i] -= expected if step == 0 else value
            y[i] = x[i]
        # Elimination with pivots; next to an eigenvalue the last pivot is all but zero, which only makes x large.
        for k in range(m):
            at = k
            for i in range(k + 1, m):
                if _square(T[i, k]) > _square(T[at, k]):
                    at = i
            for j in range(m):
                T[k, j], T[at, j] = T[at, j], T[k, j]
            y[k], y[at] = y[at], y[k]
            if _square(T[k, k]) < 1e-34:
                T[k, k] = 1e-17
            for i in range(k + 1, m):
                factor = T[i, k] / T[k, k]
                for j in range(k + 1, m):
                    T[i, j] -= factor * T[k, j]
                y[i] -= factor * y[k]
        size = 0.0
        for i in range(m - 1, -1, -1):
            for j in range(i + 1, m):
                y[i] -= T[i, j] * y[j]
            y[i] /= T[i, i]
            size += _square(y[i])
        size = 1.0 / math.sqrt(size)
        for i in range(m):
            x[i] = y[i] * size
    return 0.0


@_internal
def _eigenvectors(R: ComplexArray, V: ComplexArray) -> None:
    """Turn Hermitian R into its eigenvalues on the diagonal, their vectors in the columns of V (Jacobi)."""
    m = len(R)
    for i in range(m):
        for j in range(m):
            V[i, j] = 1.0 if i == j else 0.0
    for _ in range(12):
        off = on = 0.0
        for i in range(m):
            on += _square(R[i, i])
            for j in range(i):
                off += _square(R[i, j])
        if off <= 1e-28 * on:
            return
        for i in range(m):
            for j in range(i + 1, m):
                size = _modulus(R[i, j])
                if size == 0.0:
                    continue
                phase = R[i, j].conjugate() / size
                ratio = (R[j, j].real - R[i, i].real) / (2.0 * size)
                t = math.copysign(1.0, ratio) / (abs(ratio) + math.sqrt(1.0 + ratio * ratio))
                c = 1.0 / math.sqrt(1.0 + t * t)
                s = c * t
                for k in range(m):
                    x, y = R[k, i], R[k, j] * phase
                    R[k, i], R[k, j] = c * x - s * y, s * x + c * y
                    x, y = V[k, i], V[k, j] * phase
                    V[k, i], V[k, j] = c * x - s * y, s * x + c * y
                for k in range(m):
                    x, y = R[i, k], R[j, k] * phase.conjugate()
                    R[i, k], R[j, k] = c * x - s * y, s * x + c * y


@_internal
def _restarted(S: ComplexArray, vectors: ComplexArray, Q: ComplexArray, best: float, enough: float) -> float:
    """Return the best lower bound of longer power iterations from several starts; at least `best` and |S_ii|."""
    m = len(S)
    for i in range(m):
        if _modulus(S[i, i]) > best:
            # One channel alone.
            best = _modulus(S[i, i])
            for j in range(m):
                Q[j] = 0.0
            Q[i] = S[i, i].conjugate() / best
    for start in range(-1, m):
        if start == -1:
            _strongest(S, vectors)
        else:
            for i in range(m):
                angle = 2.0 * math.pi * start * (i + 0.3) / m
                vectors[0, i] = vectors[1, i] = complex(math.cos(angle), math.sin(angle)) / math.sqrt(m)
        before = 0.0
        for _ in range(LOOKS):
            for _ in range(STEPS):
                _step(S, vectors)
            beta = _reached(S, vectors)
            if beta > best:
                best = beta
                for i in range(m):
                    Q[i] = _turn(vectors[0, i], vectors[2, i])
                if beta > enough:
                    return best
            if beta > 0.0 and beta < before * (1.0 + 1e-6):
                break
            before = beta
    return best


@_internal
def _centres(
    M: ComplexArray, size: float, work: ComplexArray, newton: FloatArray, d: FloatArray, tolerance: float
) -> float:
    """Return the least largest singular value of D M D^-1 over `size`; d becomes that D."""
    m = len(d)
    N, W, R, RW, WRW, NR, F = work[0], work[1], work[2], work[3], work[4], work[5], work[6]
    gradient, step, kept, hessian = newton[0], newton[1], newton[2], newton[3:]
    for i in range(m):
        d[i] = 1.0
        step[i] = 0.0
    _osborne(M, d)
    level = math.inf
    best = math.inf
    for _ in range(CENTRES):
        for i in range(m):
            for j in range(m):
                N[i, j] = M[i, j] * (d[i] / d[j]) / size
        _product(N, N, W, True)
        if level == math.inf:
            level = 1e-300
            for i in range(m):
                level += 1.01 * W[i, i].real
        if not _resolvent(W, level, F, R):
            # The step left the barrier's domain: three quarters of it are taken back.
            for i in range(m):
                d[i] *= math.exp(-0.75 * step[i])
                step[i] *= 0.25
            continue
        trace = 0.0
        for i in range(m):
            trace += R[i, i].real
        best = level
        most, least = 0.0, math.inf
        for i in range(m):
            kept[i] = d[i]
            most, least = max(most, d[i]), min(least, d[i])
        if most > FARTHEST * least:
            break
        _product(R, W, RW, False)
        _product(W, RW, WRW, False)
        _product(N, R, NR, False)
        decrement = _newton(N, W, R, RW, WRW, NR, F, gradient, step, hessian)
        if decrement < 0.7:
            if m < tolerance * level * trace:
                break
            # Largest eigenvalue of W <= level - 1/trace.
            level -= 0.9 / trace
        for i in range(m):
            d[i] *= math.exp(step[i])
    for i in range(m):
        d[i] = kept[i]
    _centred(d)
    return math.sqrt(best)


@_internal
def _product(X: ComplexArray, Y: ComplexArray, out: ComplexArray, star: bool) -> None:
    """X Y, or X' Y, in `out`."""
    m = len(X)
    for i in range(m):
        for j in range(m):
            total = 0j
            for k in range(m):
                total += (X[k, i].conjugate() if star else X[i, k]) * Y[k, j]
            out[i, j] = total


@_internal
def _resolvent(W: ComplexArray, level: float, factor: ComplexArray, R: ComplexArray) -> bool:
    """R = (level - W)^-1; whether level - W is positive definite."""
    m = len(W)
    for i in range(m):
        for j in range(i + 1):
            factor[i, j] = -W[i, j]
        factor[i, i] += level
    if not _factored(factor):
        return False
    for column in range(m):
        for i in range(m):
            total = 1.0 + 0j if i == column else 0j
            for k in range(i):
                total -= factor[i, k] * R[k, column]
            R[i, column] = total / factor[i, i]
        for i in range(m - 1, -1, -1):
            total = R[i, column]
            for k in range(i + 1, m):
                total -= factor[k, i].conjugate() * R[k, column]
            R[i, column] = total / factor[i, i]
    return True


@_internal
def _newton(
    N: ComplexArray,
    W: ComplexArray,
    R: ComplexArray,
    RW: ComplexArray,
    WRW: ComplexArray,
    NR: ComplexArray,
    F: ComplexArray,
    gradient: FloatArray,
    step: FloatArray,
    hessian: FloatArray,
) -> float:
    """Put the damped Newton step in log D into `step`; return the Newton decrement."""
    m = len(N)
    most = trace = 0.0
    for i in range(m):
        for j in range(m):
            total = 0j
            for k in range(m):
                total += NR[i, k] * N[j, k].conjugate()
            F[i, j] = total
    for i in range(m):
        row, column = F[i, i].real, RW[i, i].real
        gradient[i] = 2.0 * (row - column)
        most = max(most, row)
        for j in range(i + 1):
            # Second derivatives of W(log D), weighted by R, and the square of the first ones, weighted by R twice.
            ahead = back = 0j
            for k in range(m):
                ahead += N[i, k] * RW[k, j]
                back += N[j, k] * RW[k, i]
            cross = (NR[i, j].conjugate() * ahead).real + (NR[j, i].conjugate() * back).real
            mixed = (NR[i, j] * N[i, j].conjugate()).real + (NR[j, i] * N[j, i].conjugate()).real
            entry = 4.0 * _modulus(F[i, j]) ** 2 - 4.0 * cross - 4.0 * mixed
            entry += _modulus(RW[i, j]) ** 2 + _modulus(RW[j, i]) ** 2
            entry += 2.0 * (R[i, j] * (WRW[i, j] + W[i, j]).conjugate()).real
            hessian[i, j] = entry
        hessian[i, i] += 4.0 * row + 2.0 * column
        trace += hessian[i, i]
    # D times a number changes nothing: pin that direction, and whatever an uncoupled channel leaves free.
    pin = trace / m + 1e-10 * (1.0 + most)
    for i in range(m):
        for j in range(i + 1):
            hessian[i, j] += pin / m
        hessian[i, i] += 1e-12 * pin
        step[i] = -gradient[i]
    for j in range(m):
        pivot = hessian[j, j]
        for k in range(j):
            pivot -= hessian[j, k] ** 2
        root = math.sqrt(max(pivot, 1e-14 * pin))
        hessian[j, j] = root
        for i in range(j + 1, m):
            entry = hessian[i, j]
            for k in range(j):
                entry -= hessian[i, k] * hessian[j, k]
            hessian[i, j] = entry / root
    for i in range(m):
        for k in range(i):
            step[i] -= hessian[i, k] * step[k]
        step[i] /= hessian[i, i]
    for i in range(m - 1, -1, -1):
        for k in range(i + 1, m):
            step[i] -= hessian[k, i] * step[k]
        step[i] /= hessian[i, i]
    decrement = longest = 0.0
    for i in range(m):
        decrement -= step[i] * gradient[i]
        longest = max(longest, abs(step[i]))
    decrement = math.sqrt(max(decrement, 0.0))
    damped = 1.0 / (1.0 + decrement)
    damped /= max(1.0, longest * damped)
    for i in range(m):
        step[i] *= damped
    return decrement


@_internal
def _below(S: ComplexArray, W: ComplexArray, d: FloatArray, level: float) -> bool:
    """Whether the largest singular value of D S D^-1 is below `level`: Cholesky of level^2 - N' N."""
    m = len(d)
    for i in range(m):
        for j in range(i + 1):
            total = 0j
            for k in range(m):
                total += S[k, i].conjugate() * S[k, j] * (d[k] * d[k])
            W[i, j] = -total / (d[i] * d[j])
        W[i, i] += level * level
    return _factored(W)


@_internal
def _factored(W: ComplexArray) -> bool:
    """Overwrite the lower triangle of Hermitian W with its Cholesky factor; whether it is positive definite."""
    m = len(W)
    for j in range(m):
        pivot = W[j, j].real
        for k in range(j):
            pivot -= W[j, k].real ** 2 + W[j, k].imag ** 2
        if not pivot > 0.0:
            return False
        root = math.sqrt(pivot)
        W[j, j] = root
        for i in range(j + 1, m):
            total = W[i, j]
            for k in range(j):
                total -= W[i, k] * W[j, k].conjugate()
            W[i, j] = total * (1.0 / root)
    return True
