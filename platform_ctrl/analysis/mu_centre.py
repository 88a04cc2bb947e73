"""The upper bound of mu by the method of centres, and the lower bound that its centre offers; compiled.

The largest singular value of N = D M D^-1 is minimised over the scalings D: the barrier -log det(t - N' N) is convex
and smooth in the logarithms of D.
"""

from __future__ import annotations

import math

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray
from platform_ctrl.common.simd import internal
from platform_ctrl.common.values import FloatArray

# Newton steps at most.
CENTRES = 80
# Largest ratio of two scalings: channels that hardly couple ask for no more.
FARTHEST = 1e12


@internal
def modulus(x: complex) -> float:
    """Return |x| without the care for overflow that abs takes: entries are of size 1."""
    return math.sqrt(x.real * x.real + x.imag * x.imag)


@internal
def turn(x: complex, y: complex) -> complex:
    """Return the phase that takes y to x."""
    product = x * y.conjugate()
    size = modulus(product)
    return product * (1.0 / size) if size > 0.0 else 1.0 + 0j


@internal
def square(x: complex) -> float:
    """Return |x|²."""
    return x.real * x.real + x.imag * x.imag


@internal
def times(S: ComplexArray, x: ComplexArray, out: ComplexArray, star: bool = False) -> float:
    """Put S x, or S' x, into `out`, made a unit vector; return its length."""
    m = len(x)
    size = 0.0
    for i in range(m):
        total = 0j
        for j in range(m):
            total += (S[j, i].conjugate() if star else S[i, j]) * x[j]
        out[i] = total
        size += total.real**2 + total.imag**2
    size = math.sqrt(size)
    if size > 0.0:
        scale = 1.0 / size
        for i in range(m):
            out[i] *= scale
    return size


@internal
def osborne(M: ComplexArray, d: FloatArray) -> None:
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
    centred(d)


@internal
def centred(d: FloatArray) -> None:
    """Give d the geometric mean 1."""
    mean = 0.0
    for i in range(len(d)):
        mean += math.log(d[i])
    scale = math.exp(-mean / len(d))
    for i in range(len(d)):
        d[i] *= scale


@internal
def factored(W: ComplexArray | FloatArray) -> bool:
    """Overwrite the lower triangle of Hermitian W with its Cholesky factor; return whether it is positive definite."""
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


@internal
def least_upper_bound(
    M: ComplexArray, size: float, work: ComplexArray, newton: FloatArray, d: FloatArray, tolerance: float
) -> float:
    """Return the least largest singular value of D M D^-1 over `size`; d becomes that D."""
    m = len(d)
    N, W, R, RW, WRW, NR, F = work[0], work[1], work[2], work[3], work[4], work[5], work[6]
    gradient, step, kept, hessian = newton[0], newton[1], newton[2], newton[3:]
    for i in range(m):
        d[i] = 1.0
        step[i] = 0.0
    osborne(M, d)
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
    centred(d)
    return math.sqrt(best)


@internal
def _resolvent(W: ComplexArray, level: float, factor: ComplexArray, R: ComplexArray) -> bool:
    """R = (level - W)^-1; whether level - W is positive definite."""
    m = len(W)
    for i in range(m):
        for j in range(i + 1):
            factor[i, j] = -W[i, j]
        factor[i, i] += level
    if not factored(factor):
        return False
    for column in range(m):
        for i in range(m):
            R[i, column] = 1.0 if i == column else 0.0
        _solve(factor, R[:, column])
    return True


@internal
def _solve(factor: ComplexArray | FloatArray, x: ComplexArray | FloatArray) -> None:
    """Put the solution for the right-hand side x in its place, by a Cholesky factor."""
    m = len(x)
    for i in range(m):
        total = x[i]
        for k in range(i):
            total -= factor[i, k] * x[k]
        x[i] = total * (1.0 / factor[i, i].real)
    for i in range(m - 1, -1, -1):
        total = x[i]
        for k in range(i + 1, m):
            total -= np.conj(factor[k, i]) * x[k]
        x[i] = total * (1.0 / factor[i, i].real)


@internal
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
            entry = 4.0 * modulus(F[i, j]) ** 2 - 4.0 * cross - 4.0 * mixed
            entry += modulus(RW[i, j]) ** 2 + modulus(RW[j, i]) ** 2
            entry += 2.0 * (R[i, j] * (WRW[i, j] + W[i, j]).conjugate()).real
            hessian[i, j] = entry
        hessian[i, i] += 4.0 * row + 2.0 * column
        trace += hessian[i, i]
    # D times a number changes nothing: pin that direction, and whatever an uncoupled channel leaves free.
    pin = trace / m + 1e-10 * (1.0 + most)
    for i in range(m):
        for j in range(i + 1):
            hessian[i, j] += pin / m
            hessian[j, i] = hessian[i, j]
        hessian[i, i] += 1e-12 * pin
    # A call of LAPACK takes as long as all of the step in four channels.
    factored(hessian)
    for i in range(m):
        step[i] = -gradient[i]
    _solve(hessian, step)
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


@internal
def _product(X: ComplexArray, Y: ComplexArray, out: ComplexArray, star: bool) -> None:
    """X Y, or X' Y, in `out`."""
    m = len(X)
    for i in range(m):
        for j in range(m):
            total = 0j
            for k in range(m):
                total += (X[k, i].conjugate() if star else X[i, k]) * Y[k, j]
            out[i, j] = total


@internal
def lower_bound_at_centre(
    S: ComplexArray, work: ComplexArray, vectors: ComplexArray, Q: ComplexArray, best: float, least: float
) -> float:
    """Return the lower bound that the scaled matrix S itself offers at the least upper bound; at least `best`.

    There the weights R say which singular vectors x, y = S x of the largest value have |x_i| = |y_i| in the mean. A
    single x that has it gives the phases. Two coinciding singular values leave a sphere of x, and each channel asks for
    a plane through it: up to three channels these planes share a line that meets the sphere.
    """
    m = len(S)
    R, X, Y = work[2], work[4], work[5]
    weights, V = np.linalg.eigh(R)
    # The mean in the sphere of both largest: only its third coordinate is not zero.
    mean = (weights[m - 1] - weights[m - 2]) / (weights[m - 1] + weights[m - 2])
    for i in range(m):
        X[0, i], X[1, i] = V[i, m - 1], V[i, m - 2]
    for k in range(2):
        times(S, X[k], Y[k])
    # Each channel's plane: |y_i|^2 - |x_i|^2 for x = u1 X1 + u2 X2, in the point of the sphere that represents u.
    planes = np.empty((m, 3))
    for i in range(m):
        across = Y[0, i].conjugate() * Y[1, i] - X[0, i].conjugate() * X[1, i]
        planes[i, 0], planes[i, 1] = across.real, -across.imag
        planes[i, 2] = 0.5 * (square(Y[0, i]) - square(X[0, i]) - square(Y[1, i]) + square(X[1, i]))
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
            vectors[2, i] = turn(x, y)
        found = _radius(S, vectors[2], vectors[3], vectors[0], work[6], least)
        if found > best:
            best = found
            for i in range(m):
                Q[i] = vectors[2, i]
    return best


@internal
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
            bottom += square(x[i])
        value = top / bottom
        for i in range(m):
            rest += square(y[i] - value * x[i])
        if rest < 1e-26 * bottom:
            return modulus(value)
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
                if square(T[i, k]) > square(T[at, k]):
                    at = i
            for j in range(m):
                T[k, j], T[at, j] = T[at, j], T[k, j]
            y[k], y[at] = y[at], y[k]
            if square(T[k, k]) < 1e-34:
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
            size += square(y[i])
        size = 1.0 / math.sqrt(size)
        for i in range(m):
            x[i] = y[i] * size
    return 0.0
