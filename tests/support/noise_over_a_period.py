"""The rms in continuous time of a sampled loop under white noise: covariances integrated over a period."""

from __future__ import annotations

import control
import numpy as np
from scipy.linalg import expm, solve_discrete_lyapunov


def continuous_rms(P: control.StateSpace, K: control.StateSpace, delay: float) -> float:
    """Return the rms of z, [z, y] = P [w, u], one of each, w white noise of unit density, u = K y late and held."""
    A, B1, B2 = P.A, P.B[:, :1], P.B[:, 1:]
    T, n = float(K.dt), len(P.A)
    whole, part = divmod(round(delay / T, 12), 1.0)
    held = int(whole) + 1  # u[k], u[k-1], ...: the oldest acts first in each period
    Ck, Dk = K.C, K.D
    nk = len(K.A)
    size = n + nk + held

    def flow(duration: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return Φ, the response to u held, and the covariance that w adds."""
        block = np.block([[-A, B1 @ B1.T], [np.zeros((n, n)), A.T]])
        moved = expm(block * duration)
        Phi = moved[n:, n:].T
        inputs = expm(np.block([[A, B2], [np.zeros((1, n + 1))]]) * duration)[:n, n:]
        return Phi, inputs, Phi @ moved[:n, n:]

    # States [x, xk, u[k-1], ..., u[k-held]] at a sample; u[k] = Ck xk + Dk C x.
    now = np.hstack([Dk @ P.C[1:], Ck, np.zeros((1, held))])
    command = [now, *(np.eye(1, size, n + nk + j) for j in range(held))]
    pieces = [(part * T, command[held]), ((1.0 - part) * T, command[held - 1])]
    M, added = np.eye(n, size), np.zeros((n, n))
    for duration, u in pieces:
        Phi, inputs, W = flow(duration)
        M, added = Phi @ M + inputs @ u, Phi @ added @ Phi.T + W
    step = np.zeros((size, size))
    step[:n] = M
    step[n : n + nk] = np.hstack([K.B @ P.C[1:], K.A, np.zeros((nk, held))])
    step[n + nk] = now
    for j in range(1, held):
        step[n + nk + j, n + nk + j - 1] = 1.0
    noise = np.zeros((size, size))
    noise[:n, :n] = added
    X = solve_discrete_lyapunov(step, noise)
    # The mean of the variance over the period, by Gauss and Legendre on each piece.
    nodes, weights = np.polynomial.legendre.leggauss(40)
    total, M, added = 0.0, np.eye(n, size), np.zeros((n, n))
    for duration, u in pieces:
        for node, weight in zip(nodes, weights, strict=True):
            Phi, inputs, W = flow(0.5 * duration * (1.0 + node))
            seen = P.C[:1] @ (Phi @ M + inputs @ u) + P.D[:1, 1:] @ u
            variance = seen @ X @ seen.T + P.C[:1] @ (Phi @ added @ Phi.T + W) @ P.C[:1].T
            total += 0.5 * duration * weight * float(variance[0, 0])
        Phi, inputs, W = flow(duration)
        M, added = Phi @ M + inputs @ u, Phi @ added @ Phi.T + W
    return float(np.sqrt(total / T))
