"""A sampled loop around a continuous plant, by frequencies and their images: nothing of `analysis`.

::

    w(t) -> plant -> z(t),   y(t) -> sampler -> late by whole periods -> K -> hold -> delay -> lag -> u(t)

A component of w at a frequency reaches z there and at all images n 2π/T beside it.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm

IMAGES = 15  # amplitudes fall with the square of the number: 1e-4 of the power is beyond


def response(A, B, C, s):
    """C (s - A)^-1 B, (F, p, m): in modes where their vectors are far from dependent, else by elimination."""
    own, V = np.linalg.eig(A)
    if len(A) and np.linalg.cond(V) < 1e6:
        left, right = C @ V, np.linalg.solve(V, B.astype(complex))
        return (left / (s[:, None, None] - own)) @ right
    return C @ np.linalg.solve(s[:, None, None] * np.eye(len(A)) - A, B.astype(complex))


class ContinuousLoop:
    """`A, B_u, B_w, C_y, C_z, D_yw, D_zw` of the plant without torquers; `K` has A, B, C, D; times in s."""

    def __init__(self, plant, K, period, delay=0.0, lag=(), late=()):
        self.A, self.B_u, self.B_w, self.C_y, self.C_z, self.D_yw, self.D_zw = (np.atleast_2d(one) for one in plant)
        self.K = [np.asarray(one, dtype=float) for one in K[:4]]
        self.period, self.delay = period, delay
        m, p = self.B_u.shape[1], len(self.C_y)
        self.lag = np.array(lag if len(lag) else [0.0] * m)
        self.late = np.array(late if len(late) else [0] * p)

    def _through(self, C, B, w):
        return response(self.A, B, C, 1j * np.atleast_1d(w))

    def _hold(self, w):
        """The hold, its delay and the torquers' lags, (F, m)."""
        w = np.atleast_1d(w)
        hold = np.exp(-1j * w * (0.5 * self.period + self.delay)) * np.sinc(w * self.period / (2.0 * np.pi))
        return hold[:, None] / (1.0 + 1j * w[:, None] * self.lag)

    def sampled_plant(self, w):
        """P_d, (F, p, m): what the samples show of held torques, from the matrix exponential."""
        A, B, C, _, _ = self._discrete()
        P = response(A, B, C, np.exp(1j * np.atleast_1d(w) * self.period))
        return P * np.exp(-1j * np.outer(w, self.late) * self.period)[..., None]

    def _discrete(self):
        n, m = len(self.A), self.B_u.shape[1]
        slow = self.lag > 0.0
        size = n + 2 * m
        M = np.zeros((size, size))
        M[:n, :n], M[:n, n : n + m] = self.A, self.B_u
        for k in range(m):
            if slow[k]:
                M[n + k, n + k], M[n + k, n + m + k] = -1.0 / self.lag[k], 1.0 / self.lag[k]
        whole, part = divmod(self.delay / self.period + 1e-12, 1.0)
        whole, part = int(whole), part * self.period

        def jump(u):
            """Torques that change at once: the hold's, and behind it those without lag."""
            J = np.eye(size)
            J[n + m :, n + m :] = 0.0
            for k in range(m):
                if not slow[k]:
                    J[n + k] = 0.0
            into = np.zeros((size, m))
            into[n + m :] = np.eye(m)
            for k in range(m):
                if not slow[k]:
                    into[n + k, k] = 1.0
            return J, into

        J, into = jump(None)
        late, early = expm(M * (self.period - part)), expm(M * part)
        # States: [x, torques, held], then u[k-1], ..., u[k-whole].
        N = size + whole * m
        A, B = np.zeros((N, N)), np.zeros((N, m))
        A[:size, :size] = late @ J @ early
        if whole:
            A[:size, N - m :] = late @ into
            A[size : size + m] = 0.0
            B[size : size + m] = np.eye(m)
            for j in range(1, whole):
                A[size + j * m : size + (j + 1) * m, size + (j - 1) * m : size + j * m] = np.eye(m)
        else:
            B[:size] = late @ into
        C = np.hstack([self.C_y, np.zeros((len(self.C_y), N - n))])
        return A, B, C, N, m

    def controller(self, w):
        """K(exp(jωT)), (F, m, p)."""
        A, B, C, D = self.K
        return response(A, B, C, np.exp(1j * np.atleast_1d(w) * self.period)) + D

    def torques(self, w):
        """The torque commands for w = exp(jωt), (F, m, k)."""
        K, P = self.controller(w), self.sampled_plant(w)
        y = self._through(self.C_y, self.B_w, w) + self.D_yw
        y = y * np.exp(-1j * np.outer(w, self.late) * self.period)[..., None]
        return np.linalg.solve(np.eye(K.shape[1]) - K @ P, K @ y)

    def gain(self, w):
        """The largest root mean square of z over the amplitude of w, (F,)."""
        w = np.atleast_1d(np.asarray(w, dtype=float))
        u = self.torques(w)
        total = 0.0
        for n in range(-IMAGES, IMAGES + 1):
            at = w + 2.0 * np.pi * n / self.period
            H = self._through(self.C_z, self.B_u, at) * self._hold(at)[:, None, :]
            z = H @ u
            if n == 0:
                z = z + self._through(self.C_z, self.B_w, w) + self.D_zw
            total = total + np.swapaxes(z.conj(), -1, -2) @ z
        return np.sqrt(np.linalg.eigvalsh(total)[:, -1].real)

    def sure_gain(self, w):
        """The gain, 0 where rounding decides: where it is another one in other states of the plant.

        Far below the poles of the loop the disturbance and what the loop answers are large and cancel.
        """
        n = len(self.A)
        T = np.linalg.qr(np.random.default_rng(n).normal(size=(n, n)))[0]
        plant = (T.T @ self.A @ T, T.T @ self.B_u, T.T @ self.B_w, self.C_y @ T, self.C_z @ T, self.D_yw, self.D_zw)
        turned = ContinuousLoop(plant, self.K, self.period, self.delay, self.lag, self.late)
        one, other = self.gain(w), turned.gain(w)
        return np.where(np.abs(one - other) <= 5e-3 * np.maximum(one, other), one, 0.0)

    def poles(self):
        """Poles of the closed loop in z, with the readings late."""
        return np.linalg.eigvals(self.closed()[0])

    def closed(self):
        """From one sample to the next, (S, S), and the torques, (m, S): plant, late readings, controller."""
        A, B, C, N, _ = self._discrete()
        p = len(self.C_y)
        late = int(self.late.max(initial=0))
        A_K, B_K, C_K, D_K = self.K
        # The readings of the last samples are states: y[k-1], ..., y[k-late].
        size = N + late * p + len(A_K)
        read = np.zeros((p, size))
        for i in range(p):
            if self.late[i] == 0:
                read[i, :N] = C[i]
            else:
                read[i, N + (self.late[i] - 1) * p + i] = 1.0
        u = D_K @ read
        u[:, N + late * p :] += C_K
        out = np.zeros((size, size))
        out[:N, :N] = A
        out[:N] += B @ u
        if late:
            out[N : N + p, :N] = C
            for j in range(1, late):
                out[N + j * p : N + (j + 1) * p, N + (j - 1) * p : N + j * p] = np.eye(p)
        out[N + late * p :] = B_K @ read
        out[N + late * p :, N + late * p :] += A_K
        return out, u
