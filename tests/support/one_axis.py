"""A camera that turns about one axis on a moving base, and the true figures of its loop by an oracle of its own.

The equation of motion is written down here, J (q'' + W') = -c q' - (k + m g r_z) q + Q, for a small angle q of the
gimbal on a base that turns at W; the loop is that of `continuous_loop`. Nothing of the package's loop code is used.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import expm

from continuous_loop import ContinuousLoop

J, G = 0.01, 9.81


class OneAxis(NamedTuple):
    """The numbers of a job: SI units, Hz and rates as named."""

    rate_hz: float
    delay: float  # in sample periods
    lag: float  # in sample periods
    stiffness: float
    weight: float  # moment, kg m, above the axis where negative
    viscous: float
    bandwidth_hz: float  # of the gyro
    late: float  # of the gyro, in sample periods
    crossover_hz: float
    integral_hz: float
    double_hz: float  # 0: no second integral
    fed: bool  # feedforward of the base's rate, whose gyro is as good

    @property
    def period(self) -> float:
        return 1.0 / self.rate_hz

    def job(self, limits: dict[str, float]) -> dict[str, object]:
        """The job as `read_job` takes it."""
        T = self.period
        design = {"name": "PI", "method": "pi", "crossover_hz": self.crossover_hz, "integral_hz": self.integral_hz}
        design |= {"double_integral_hz": self.double_hz} if self.double_hz else {}
        design |= {"feedforward": {"sensors": ["base"]}} if self.fed else {}
        gyro = {"noise_density": 6e-5, "bandwidth_hz": self.bandwidth_hz, "delay": self.late * T}
        plant = {
            "schema": 1,
            "name": "one axis",
            "source": "assumed",
            "root": {"name": "base", "inertia": [10.0, 10.0, 10.0], "specific_force": [0.0, 0.0, -G]},
            "gimbal": [{"name": "pitch", "parent": "base", "axis": [0, 1, 0], "inertia": [J, J, J]}],
            "torquer": [{"gimbal": "pitch", "limit": 1.0, "lag": self.lag * T}],
            "rate_sensor": [
                {"name": "gyro", "body": "pitch", "axis": [0, 1, 0]} | gyro,
                {"name": "base", "root_axis": 2} | gyro,
            ],
            "friction": [{"gimbal": "pitch", "viscous": self.viscous}],
            "line_of_sight": {"body": "pitch", "direction": [1, 0, 0]},
        }
        if self.stiffness:
            plant["spring"] = [{"gimbal": "pitch", "stiffness": self.stiffness}]
        if self.weight:
            plant["unbalance"] = [{"body": "pitch", "moment": [0.0, 0.0, self.weight]}]
        loop = {"name": "los", "kind": "rate", "gimbals": ["pitch"], "sensors": ["gyro"], "use": "PI"}
        return {
            "schema": 2,
            "name": "one axis",
            "plant": plant,
            "operation": {"Omega": [0.0, 0.3, 0.0]},
            "sampling": {"rate_hz": self.rate_hz, "delay": self.delay * T},
            "loop": [loop | {"limits": limits, "design": [design]}],
        }


class Truth:
    """The true figures of a controller (A, B, C, D) from the gyro, with feedforward from the base's gyro behind it."""

    def __init__(self, one: OneAxis, K, noise: float) -> None:
        self.one, self.noise, T = one, noise, one.period
        k = one.stiffness + one.weight * G
        w = 2.0 * np.pi * one.bandwidth_hz
        # States: angle q, inertial rate v, then the low-passes of both gyros. v' = (-c (v - W) - k q + Q)/J.
        A = np.zeros((6, 6))
        A[0, 1] = 1.0
        A[1, :2] = -k / J, -one.viscous / J
        for at, source in ((2, 1), (4, None)):
            A[at, at + 1] = w
            A[at + 1, at : at + 2] = -w, -np.sqrt(2.0) * w
            if source is not None:
                A[at + 1, source] = w
        B_u, B_w = np.zeros((6, 1)), np.zeros((6, 1))
        B_u[1] = 1.0 / J
        B_w[0], B_w[1], B_w[5] = -1.0, one.viscous / J, w
        B_d = B_u.copy()
        C_y = np.zeros((2, 6))
        C_y[0, 2] = C_y[1, 4] = 1.0
        C_z = np.zeros((1, 6))
        C_z[0, 1] = 1.0
        late = int(np.ceil(one.late - 1e-9))
        A_K, B_K, C_K, D_K = (np.asarray(item, dtype=float) for item in K[:4])
        if B_K.shape[1] == 1:
            B_K, D_K = np.hstack([B_K, np.zeros_like(B_K)]), np.hstack([D_K, np.zeros_like(D_K)])
        both = (A_K, B_K, C_K, D_K)

        def loop(B, C_z):
            zero = np.zeros
            plant = (A, B_u, B, C_y, C_z, zero((2, 1)), zero((len(C_z), 1)))
            return ContinuousLoop(plant, both, T, delay=one.delay * T, lag=[one.lag * T], late=[late, late])

        self.of_rate, self.of_torque = loop(B_w, C_z), loop(B_d, C_y[:1])
        self.reading = loop(B_w, C_y[:1])
        # The base's gyro is no part of the loop.
        self.own = (A_K, B_K[:, :1], C_K, D_K[:, :1])
        poles = self.of_rate.poles()
        self.poles = poles[np.argsort(np.abs(poles - 1.0))]
        # With an integral the loop is in balance at any angle: one pole at 1, which the gyro does not see.
        integrates = np.abs(np.linalg.eigvals(A_K) - 1.0).min(initial=1.0) < 1e-9
        if integrates or k == 0.0:
            assert abs(self.poles[0] - 1.0) < 1e-6
            self.poles = self.poles[1:]
        with np.errstate(divide="ignore", invalid="ignore"):
            self.s = np.log(self.poles.astype(complex)) / T
        self.stable = bool(np.abs(self.poles).max() < 1.0)
        moving = np.abs(self.s[np.isfinite(self.s)])
        self.slow = float(moving[moving > 1e-9].min())

    def grid(self, low: float, high: float) -> np.ndarray:
        """Frequencies from `low` to `high`, dense around every pole."""
        s = self.s[np.isfinite(self.s)]
        near = [np.abs(p.imag) + np.linspace(-4.0, 4.0, 41) * np.abs(p.real) for p in s]
        w = np.concatenate([np.geomspace(low, high, 1500), *near, np.abs(s), [high]])
        return np.unique(w[(w >= low) & (w <= high)])

    def _loop(self, w):
        """P and K of the gyro's loop, (F,)."""
        z = np.exp(1j * w * self.one.period)
        A, B, C, D = self.own
        K = (C @ np.linalg.solve(z[:, None, None] * np.eye(len(A)) - A, B.astype(complex)) + D)[:, 0, 0]
        return self.of_rate.sampled_plant(w)[:, 0, 0], K

    def values(self, band_hz: float, from_hz: float) -> dict[str, float]:
        """All figures in the units of limits; `band_hz` is the edge of the bands, `from_hz` where torque's begins."""
        T, one = self.one.period, self.one
        out = {"minimum decay rate": float(-self.s.real[np.isfinite(self.s)].max())}
        if not self.stable:
            return out
        nyquist = np.pi / T
        w = self.grid(1e-2 * self.slow, nyquist * (1.0 - 1e-9))
        P, K = self._loop(w)
        L = -P * K
        S = 1.0 / (1.0 + L)
        above = np.flatnonzero(np.abs(S) >= np.sqrt(0.5))
        out |= {
            "disk margin": 1.0 / np.abs(S - 0.5).max(),
            "sensitivity peak": np.abs(S).max(),
            "complementary sensitivity peak": np.abs(1.0 - S).max(),
            "bandwidth": w[above[0]] / (2.0 * np.pi) if above.size else np.inf,
            "tracking error": np.abs(S[w <= 2.0 * np.pi * band_hz]).max(),
        }
        phase = np.angle(L)
        crossing = np.flatnonzero((np.abs(phase[1:] - phase[:-1]) > np.pi) & (np.abs(L[1:]) > 1e-3))
        # Where L is real, between two frequencies.
        share = np.abs(L.imag[crossing]) / np.maximum(np.abs(L.imag[crossing] - L.imag[crossing + 1]), 1e-300)
        gains = np.abs(L.real[crossing] + share * (L.real[crossing + 1] - L.real[crossing]))
        if np.pi - abs(phase[0]) < 0.05:
            gains = np.append(gains, np.abs(L[0]))
        out["gain margin"] = float(np.abs(20.0 * np.log10(gains)).min(initial=np.inf))
        unit = np.flatnonzero((np.abs(L[1:]) - 1.0) * (np.abs(L[:-1]) - 1.0) < 0.0)
        out["phase margin"] = float(np.degrees(np.pi - np.abs(np.angle(L[unit])).max(initial=0.0)))
        # Limits at zero frequency.
        slow = np.array([1e-4, 2e-4]) * min(self.slow, 2.0 * np.pi * one.integral_hz)
        P0, K0 = self._loop(slow)
        left = np.abs(1.0 / (1.0 - P0 * K0))
        out["steady-state error"] = float(left[0]) if left[0] > 1e-3 else 0.0
        growing = left[1] / left[0] > 1.5
        out["ramp error"] = float(left[0] / slow[0]) if growing else np.inf
        high = self.grid(1e-2 * self.slow, 3.0 * nyquist)
        high = high[np.abs(high - 2.0 * nyquist) > 1e-3 * nyquist]
        out["rate from Omega"] = float(self.reading.gain(high).max())
        out["rate from torque"] = float(self.of_torque.gain(high).max())
        band = self.grid(1e-2 * self.slow, 2.0 * np.pi * band_hz)
        out["attenuation of base motion"] = float(-20.0 * np.log10(self.of_rate.gain(band).max()))
        torque = self.grid(2.0 * np.pi * from_hz, 2.0 * np.pi * band_hz)
        out["torque at full Omega over its limit"] = float(0.3 * np.abs(self.of_rate.torques(torque)).max())
        out |= dict(zip(("overshoot", "settling time"), self._steps(), strict=True))
        first = 1.0 / (np.pi * 3600.0)
        fine = np.concatenate([np.geomspace(first, w[0], 2000)[:-1], w])
        P, K = self._loop(fine)
        density = np.abs(K / (1.0 - P * K)) ** 2
        if self.one.fed:
            density = density + self._noise_of_feedforward(fine, P, K)
        out["torque noise, rms"] = float(self.noise * np.sqrt(T / np.pi * np.trapezoid(density, fine)))
        return out

    def _noise_of_feedforward(self, w, P, K):
        both = self.of_rate.controller(w)[:, 0]
        return np.abs(both[:, 1] / (1.0 - P * K)) ** 2

    def _steps(self) -> tuple[float, float]:
        """Overshoot and settling time of the gyro's own signal behind a step of its command, u = K (y - r)."""
        loop, T, fine = self.of_rate, self.one.period, 24
        A, B, C, N, _ = loop._discrete()
        late, p = int(loop.late.max()), 1
        A_K, B_K, C_K, D_K = self.own
        size = N + late * p + len(A_K)
        read = np.zeros((1, size))
        if late:
            read[0, N + late - 1] = 1.0
        else:
            read[0, :N] = C[0]
        u = D_K @ read
        u[:, N + late :] += C_K
        whole = np.zeros((size, size))
        whole[:N, :N] = A
        whole[:N] += B @ u
        if late:
            whole[N, :N] = C[0]
            for j in range(1, late):
                whole[N + j, N + j - 1] = 1.0
        whole[N + late :] = B_K @ read
        whole[N + late :, N + late :] += A_K
        drive = np.zeros(size)
        drive[:N] -= (B @ D_K)[:, 0]
        drive[N + late :] -= B_K[:, 0]
        decay = -self.s.real[np.isfinite(self.s)].max()
        count = int(np.clip(np.ceil(12.0 / (decay * T)), 100, 100_000))
        X = np.zeros((count, size))
        for k in range(1, count):
            X[k] = whole @ X[k - 1] + drive
        # The signal between samples, from the state and the torques there.
        n, slow = len(loop.A), loop.lag[0] > 0.0
        M = np.zeros((n + 2, n + 2))
        M[:n, :n], M[:n, n] = loop.A, loop.B_u[:, 0]
        if slow:
            M[n, n], M[n, n + 1] = -1.0 / loop.lag[0], 1.0 / loop.lag[0]
        wholes, part = divmod(loop.delay / T + 1e-12, 1.0)
        commands = (X @ u.T)[:, 0] - D_K[0, 0]
        new = np.concatenate([np.zeros(int(wholes)), commands])[:count]
        time, y = [], []
        state = X[:, : n + 2]
        for j in range(fine):
            tau = j / fine
            if tau < part or (part == 0.0 and tau == 0.0):
                at = state @ expm(M * tau * T).T
            else:
                before = state @ expm(M * part * T).T
                before[:, n + 1] = new
                if not slow:
                    before[:, n] = new
                at = before @ expm(M * (tau - part) * T).T
            time.append(tau * T + T * np.arange(count))
            y.append(at[:, :n] @ loop.C_y[0])
        t, y = np.array(time).T.ravel(), np.array(y).T.ravel()
        outside = np.flatnonzero(np.abs(y - 1.0) > 0.02)
        settled = np.inf if outside.size and outside[-1] == len(y) - 1 else t[outside[-1]] if outside.size else 0.0
        return max(float(y.max() - 1.0), 0.0), float(settled)
