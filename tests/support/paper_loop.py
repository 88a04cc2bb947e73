"""A caging loop of the three-gyro platform closed by hand: (27), hold, delay and lag, without `analysis`.

Torques act one sample late (the job's delay is one period), behind a hold and the torquers' lag.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import sympy
from numpy.typing import NDArray
from scipy.linalg import expm, solve_discrete_lyapunov

from platform_ctrl import read_platform
from three_gyro_paper import ROWS, numbers
from three_gyro_paper import TORQUES as NAMES

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
# The torquers' time constant, s, and the rms of a sample of a pick-off, rad: as in the plant file.
LAG, NOISE = 2e-4, 5e-6


@dataclass(frozen=True)
class PaperPlant:
    """The sampled plant of a subsystem at rest: A, B, C, period, and the frequency above which damping counts."""

    A: Array
    B: Array
    C: Array
    period: float
    nutation: float


def paper_plant(gimbals: tuple[str, ...], period: float = 5e-4) -> PaperPlant:
    """Sample (27) at Omega = 0: J q'' + G q' = Q, states q, q', the lags' torques, the torques of the last sample."""
    names = {gimbal: sympy.Symbol(f"{'alpha' if gimbal in '49' else 'beta'}{gimbal}") for gimbal in gimbals}
    values = numbers(read_platform("three_gyro_platform"))
    still = [sympy.Symbol(f"Omega{k}{dot}") for k in (1, 2, 3) for dot in ("", "_dot")]
    n = len(gimbals)
    J, G = np.zeros((n, n)), np.zeros((n, n))
    for i, gimbal in enumerate(gimbals):
        left = (ROWS[gimbal][0] - ROWS[gimbal][1] + sum(NAMES)).subs(dict.fromkeys(still, 0)).subs(values)
        for j, name in enumerate(names.values()):
            G[i, j] = left.coeff(sympy.Symbol(f"{name}_dot"))
            J[i, j] = left.coeff(sympy.Symbol(f"{name}_ddot"))
    none, one = np.zeros((n, n)), np.eye(n)
    inverse = np.linalg.inv(J)
    A = np.block([[none, one, none], [none, -inverse @ G, inverse], [none, none, -one / LAG]])
    B = np.vstack([none, none, one / LAG])
    held = expm(period * np.block([[A, B], [np.zeros((n, 4 * n))]]))
    phi, gamma = held[: 3 * n, : 3 * n], held[: 3 * n, 3 * n :]
    nutation = float(np.abs(np.linalg.eigvals(-inverse @ G)).max())
    return PaperPlant(
        A=np.block([[phi, gamma], [np.zeros((n, 4 * n))]]),
        B=np.vstack([np.zeros((3 * n, n)), one]),
        C=np.hstack([one, np.zeros((n, 3 * n))]),
        period=period,
        nutation=nutation,
    )


@dataclass(frozen=True)
class PaperValues:
    """Decay rate 1/s, damping, disk margin and rms of the torques, N m, of a closed loop."""

    decay: float
    damping: float
    disk_margin: float
    torque_noise: Array


def closed_by_hand(plant: PaperPlant, K: object) -> PaperValues:
    """Close u = K y, a `control.StateSpace` from all angles to all torques, around the plant."""
    Ak, Bk, Ck, Dk = (np.asarray(getattr(K, name)) for name in "ABCD")
    A, B, C = plant.A, plant.B, plant.C
    closed = np.block([[A + B @ Dk @ C, B @ Ck], [Bk @ C, Ak]])
    z = np.linalg.eigvals(closed)
    s = np.log(z[np.abs(z) > 1e-6].astype(np.complex128)) / plant.period
    fast = s[np.abs(s) > 0.1 * plant.nutation]
    into, out = np.vstack([B @ Dk, Bk]), np.hstack([Dk @ C, Ck])
    covariance = solve_discrete_lyapunov(closed, NOISE**2 * into @ into.T)
    variance = np.diag(out @ covariance @ out.T) + NOISE**2 * np.diag(Dk @ Dk.T)
    return PaperValues(
        decay=float(-s.real.max()),
        damping=float((-fast.real / np.abs(fast)).min()),
        disk_margin=min(_disk_margin(plant, (Ak, Bk, Ck, Dk), at) for at in ("input", "output")),
        torque_noise=np.sqrt(variance),
    )


def _disk_margin(plant: PaperPlant, K: tuple[Array, ...], at: str) -> float:
    """1/max σ((S − T)/2) over frequency, (S − T)/2 = (1 + L)(1 − L)⁻¹/2 for u = K y, refined about its peak."""

    def gain(w: Array) -> Array:
        z = np.exp(1j * w * plant.period)
        P, C = (_response(item, z) for item in ((plant.A, plant.B, plant.C, np.zeros((len(plant.C),) * 2)), K))
        L = C @ P if at == "input" else P @ C
        eye = np.eye(L.shape[-1])
        return np.linalg.norm(0.5 * (eye + L) @ np.linalg.inv(eye - L), 2, axis=(1, 2))

    w = np.geomspace(1.0, np.pi / plant.period, 3000)
    for _ in itertools.repeat(None, 3):
        k = int(gain(w).argmax())
        w = np.linspace(w[max(k - 1, 0)], w[min(k + 1, len(w) - 1)], 200)
    return float(1.0 / gain(w).max())


def _response(system: tuple[Array, ...], z: Complex) -> Complex:
    A, B, C, D = system
    shifted = z[:, None, None] * np.eye(len(A)) - A
    return np.asarray(C @ np.linalg.solve(shifted, np.broadcast_to(B, (len(z), *B.shape))) + D)
