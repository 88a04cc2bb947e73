"""Both bounds of the structured singular value for many matrices, compiled: bare floats and arrays only.

One matrix after the other, each started from its neighbour's answer, which along a frequency response is close. The
power iteration of Packard, Fan and Doyle (27th CDC, 1988) climbs to vectors with M b = beta a and M' z = beta w, |a|
= |b| and |w| = |z| entry by entry. They give both bounds: phases Q with spectral radius rho(M Q) = beta below, and
the scalings D_i^2 = |z_i|/|a_i|, for which beta is a singular value of D M D^-1. It is the largest one whenever the
two bounds meet at that beta, and one Cholesky factorisation of beta^2 - N' N tells. Only where it fails (the climb
ended too low, or bounds of four and more channels differ) the upper bound is minimised by itself (`mu_centre`).
"""

from __future__ import annotations

import math

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray
from platform_ctrl.analysis.mu_centre import (
    FARTHEST,
    centred,
    factored,
    least_upper_bound,
    lower_bound_at_centre,
    modulus,
    osborne,
    times,
    turn,
)
from platform_ctrl.common.simd import compiled, internal
from platform_ctrl.common.values import FloatArray

# Steps of the power iteration from one start, and after how many it is checked.
STEPS, CHECKED, LOOKS = 48, 3, 6


@compiled
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
                osborne(M[k], d)
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
            upper[k] = least_upper_bound(M[k], size, work, newton, d, tolerance)
            for i in range(m):
                D[k, i] = d[i]
                for j in range(m):
                    S[i, j] = M[k, i, j] * (d[i] / d[j]) / size
            enough = upper[k] * (1.0 - 2.0 * tolerance)
            lower[k] = lower_bound_at_centre(S, work, vectors, Q[k], lower[k], enough)
            if lower[k] < enough:
                lower[k] = _restarted(S, vectors, Q[k], lower[k], enough)
            lower[k] = min(lower[k], upper[k])
        for i in range(m):
            kept[0, i] = vectors[0, i]
            kept[1, i] = vectors[1, i]
            d[i] = D[k, i]
        upper[k] *= size
        lower[k] *= size


@internal
def _strongest(S: ComplexArray, vectors: ComplexArray) -> None:
    """Start b, w near the singular vector of the largest singular value."""
    m = len(S)
    for i in range(m):
        vectors[0, i] = 1.0 + 0.1j * i
    for _ in range(3):
        times(S, vectors[0], vectors[2])
        times(S, vectors[2], vectors[0], True)
    for i in range(m):
        vectors[1, i] = vectors[0, i]


@internal
def _step(S: ComplexArray, vectors: ComplexArray) -> float:
    """Take one step of the power iteration on b, w, a, z (rows of `vectors`); return |S b|."""
    b, w, a, z = vectors[0], vectors[1], vectors[2], vectors[3]
    beta = times(S, b, a)
    for i in range(len(b)):
        size = modulus(a[i])
        z[i] = a[i] * (modulus(w[i]) / size) if size > 0.0 else complex(modulus(w[i]), 0.0)
    times(S, z, w, True)
    for i in range(len(b)):
        size = modulus(w[i])
        b[i] = w[i] * (modulus(a[i]) / size) if size > 0.0 else complex(modulus(a[i]), 0.0)
    return beta


@internal
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
                Q[i] = turn(vectors[0, i], vectors[2, i])
        # Channels that take no part keep the scaling that they came with.
        most, least = 0.0, math.inf
        for i in range(m):
            D[i] = math.sqrt((modulus(vectors[3, i]) + 1e-7) / (modulus(vectors[2, i]) + 1e-7))
            most, least = max(most, D[i] * d[i]), min(least, D[i] * d[i])
        if most <= FARTHEST * least and _below(S, W, D, beta * (1.0 + tolerance)):
            for i in range(m):
                D[i] *= d[i]
            centred(D)
            return beta
    return -found


@internal
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
        q = turn(b[i], a[i])
        rest += modulus(q * a[i] - b[i]) ** 2
        vectors[3, i] = modulus(w[i]) * turn(a[i], 1.0 + 0j)
        top += w[i].conjugate() * q * a[i] * size
        bottom += w[i].conjugate() * b[i]
    back = 0.0
    length = 0.0
    for i in range(m):
        total = 0j
        for j in range(m):
            total += S[j, i].conjugate() * vectors[3, j]
        back += modulus(total - size * w[i]) ** 2
        length += modulus(total) ** 2
    if rest > 1e-10 or back > 1e-10 * length or modulus(bottom) < 1e-6:
        return 0.0
    return modulus(top / bottom)


@internal
def _restarted(S: ComplexArray, vectors: ComplexArray, Q: ComplexArray, best: float, enough: float) -> float:
    """Return the best lower bound of longer power iterations from several starts; at least `best` and |S_ii|."""
    m = len(S)
    for i in range(m):
        if modulus(S[i, i]) > best:
            # One channel alone.
            best = modulus(S[i, i])
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
                    Q[i] = turn(vectors[0, i], vectors[2, i])
                if beta > enough:
                    return best
            if beta > 0.0 and beta < before * (1.0 + 1e-6):
                break
            before = beta
    return best


@internal
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
    return factored(W)
