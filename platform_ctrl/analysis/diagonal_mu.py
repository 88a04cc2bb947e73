"""Structured singular value of complex matrices for diagonal complex perturbations, many matrices at once.

mu(M) = 1 / min {max_i |delta_i| : det(I - M diag(delta)) = 0}. Upper bound: the smallest largest singular value of
D M D^-1 over diagonal D > 0 (exact up to three channels: Packard and Doyle, Automatica 29, 1993). Lower bound: the
spectral radius of M Q over unitary diagonal Q, climbed by their power iteration. The smallest scaled singular value is
found by the method of centres: in the logarithms of D the barrier -log det(t - N' N), N = D M D^-1, is convex and
smooth, and t descends towards the largest eigenvalue of N' N whenever Newton's method has centred D.
"""

from __future__ import annotations

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray
from platform_ctrl.frozen import FloatArray


def mu_upper_bound(M: ComplexArray, tolerance: float = 1e-6, iterations: int = 100) -> tuple[FloatArray, FloatArray]:
    """Return the least largest singular value of D M D^-1 over diagonal D > 0, and D.

    Parameters
    ----------
    M : complex (N, m, m)
        Finite.
    tolerance
        Relative; every returned value is an upper bound whatever the tolerance.
    iterations
        Newton steps at most.

    Returns
    -------
    bound : (N,)
    D : (N, m)
        Geometric mean 1.
    """
    N, m, _ = M.shape
    size = np.linalg.norm(M, axis=(-2, -1))
    if m == 1 or N == 0:
        return size, np.ones((N, m))
    whole = M / np.where(size > 0.0, size, 1.0)[:, None, None]
    log_d = _osborne(np.abs(whole) ** 2)
    best = np.where(size > 0.0, np.inf, 0.0)
    best_log_d = log_d.copy()
    level = np.full(N, np.inf)
    step = np.zeros((N, m))
    centred = np.ones(N, dtype=np.bool_)
    live = np.flatnonzero(size > 0.0)
    # Two channels: the product of the singular values is fixed, so the least norm is also the least peak.
    for _ in range(1 if m == 2 else iterations):
        d = np.exp(log_d[live])
        scaled = whole[live] * d[:, :, None] / d[:, None, :]
        eigenvalues, V = np.linalg.eigh(np.conj(np.swapaxes(scaled, -1, -2)) @ scaled)
        largest = eigenvalues[:, -1]
        better = largest < best[live]
        best[live[better]] = largest[better]
        best_log_d[live[better]] = log_d[live[better]]
        # A step that left the barrier's domain is taken back by three quarters.
        outside = largest >= level[live]
        step[live[outside]] *= 0.25
        log_d[live[outside]] -= 3.0 * step[live[outside]]
        inside = ~outside
        live_in, largest = live[inside], largest[inside]
        first = ~np.isfinite(level[live_in])
        gap = np.where(first, largest, level[live_in] - largest)
        done = centred[live_in] & ~first & (gap < 0.5 * tolerance * largest)
        gap = np.where(centred[live_in] & ~first, 0.3 * gap, gap)
        level[live_in] = largest + np.maximum(gap, 1e-13 * largest)
        new, decrement = _newton_step(scaled[inside], eigenvalues[inside], V[inside], level[live_in])
        step[live_in] = new
        centred[live_in] = decrement < 0.7
        log_d[live_in] += new
        live = np.setdiff1d(live, live_in[done], assume_unique=True)
        if live.size == 0:
            break
    return np.sqrt(best) * size, np.exp(best_log_d - best_log_d.mean(axis=-1, keepdims=True))


def _osborne(weight: FloatArray, sweeps: int = 8) -> FloatArray:
    """Return log D that makes row i and column i of D M D^-1 equally long; `weight`: squared moduli of M."""
    N, m, _ = weight.shape
    log_d = np.zeros((N, m))
    tiny = 1e-30
    others = weight * (1.0 - np.eye(m))
    for _ in range(sweeps):
        for i in range(m):
            ratio = np.exp(2.0 * (log_d - log_d[:, i : i + 1]))
            row = np.sum(others[:, i, :] / ratio, axis=-1)
            column = np.sum(others[:, :, i] * ratio, axis=-1)
            log_d[:, i] += 0.25 * np.log(np.maximum(column, tiny) / np.maximum(row, tiny))
    return np.asarray(np.clip(log_d - log_d.mean(axis=-1, keepdims=True), -20.0, 20.0), dtype=np.float64)


def _newton_step(
    N: ComplexArray, eigenvalues: FloatArray, V: ComplexArray, t: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the damped Newton step in log D for the barrier -log det(t I - N' N)."""
    V_star = np.conj(np.swapaxes(V, -1, -2))
    resolvent = 1.0 / (t[:, None] - eigenvalues)
    R = (V * resolvent[:, None, :]) @ V_star
    RW = (V * (resolvent * eigenvalues)[:, None, :]) @ V_star
    WRW = (V * (resolvent * eigenvalues**2)[:, None, :]) @ V_star
    NR = N @ R
    F = NR @ np.conj(np.swapaxes(N, -1, -2))
    NRW = N @ RW
    row = np.einsum("kii->ki", F).real
    column = np.einsum("kii->ki", RW).real
    gradient = 2.0 * (row - column)
    # Second derivatives of W(log D), weighted by R, and the square of the first ones, weighted by R twice.
    mixed = (NR * np.conj(N)).real
    cross = (np.conj(NR) * NRW).real
    square = 4.0 * np.abs(F) ** 2 - 4.0 * (cross + np.swapaxes(cross, -1, -2))
    square += 2.0 * np.abs(RW) ** 2 + 2.0 * (R * np.conj(WRW)).real
    W = (V * eigenvalues[:, None, :]) @ V_star
    hessian = square - 4.0 * (mixed + np.swapaxes(mixed, -1, -2)) + 2.0 * (R * np.conj(W)).real
    diagonal = np.arange(N.shape[-1])
    hessian[:, diagonal, diagonal] += 4.0 * row + 2.0 * column
    # D times a number changes nothing: pin that direction, and whatever an uncoupled channel leaves free.
    m = N.shape[-1]
    size = np.trace(hessian, axis1=-2, axis2=-1) / m + 1e-10 * (1.0 + row.max(axis=-1))
    hessian += size[:, None, None] * (1.0 / m + 1e-12 * np.eye(m))
    step = -np.linalg.solve(hessian, gradient[..., None])[..., 0]
    decrement = np.sqrt(np.maximum(-np.sum(step * gradient, axis=-1), 0.0))
    step /= (1.0 + decrement)[:, None]
    longest = np.abs(step).max(axis=-1, keepdims=True)
    return step / np.maximum(1.0, longest), decrement


def mu_lower_bound(M: ComplexArray, D: FloatArray | None = None, iterations: int = 40) -> FloatArray:
    """Return a value that mu(M) reaches: the largest spectral radius of M Q found over unitary diagonal Q, (N,).

    Parameters
    ----------
    M : complex (N, m, m)
        Finite.
    D : (N, m), optional
        Scaling of the upper bound: mu is the same, and the iteration starts near the answer.
    iterations
        Of the power iteration, from each of m + 1 starts.
    """
    N, m, _ = M.shape
    if N == 0:
        return np.zeros(0)
    if D is not None:
        M = M * D[:, :, None] / D[:, None, :]
    M_star = np.conj(np.swapaxes(M, -1, -2))
    _, _, V_star = np.linalg.svd(M)
    starts = [np.conj(V_star[:, k]) for k in range(m)]
    starts.append(starts[0] + 1j * starts[-1])
    best = np.abs(np.linalg.eigvals(M)).max(axis=-1)
    for b in starts:
        w = b
        for _ in range(iterations):
            # At a fixed point M b = mu a, M' z = mu w, with |b| = |a|, |z| = |w| and b = Q a, w = Q z.
            a = (M @ b[..., None])[..., 0]
            a /= np.maximum(np.linalg.norm(a, axis=-1, keepdims=True), 1e-300)
            w = (M_star @ (np.abs(w) * _phase(a))[..., None])[..., 0]
            w /= np.maximum(np.linalg.norm(w, axis=-1, keepdims=True), 1e-300)
            b = np.abs(a) * _phase(w)
        Q = _phase(w) * np.conj(_phase(a))
        best = np.maximum(best, np.abs(np.linalg.eigvals(M * Q[:, None, :])).max(axis=-1))
    return np.asarray(best, dtype=np.float64)


def _phase(x: ComplexArray) -> ComplexArray:
    size = np.abs(x)
    return np.where(size > 0.0, x / np.where(size > 0.0, size, 1.0), 1.0)
