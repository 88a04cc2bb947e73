"""Figures of a sampled loop found by brute force: no Hamiltonian, no norm, nothing of `analysis`.

The loop is closed by hand, its response is solved for at many frequencies around every closed-loop pole, down to a
hundredth of the pole's own width, and the highest of them are refined by bisection.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np


class Loop(NamedTuple):
    """x⁺ = A x + B w, with the blocks of w = [d, Omega, n] and of z = [u, y] by name."""

    A: np.ndarray
    B: dict[str, np.ndarray]
    C: dict[str, np.ndarray]
    D: dict[tuple[str, str], np.ndarray]
    period: float


def closed(plants, k, K) -> Loop:
    """Close u = K (y + n), y = P (u + d) + P_Omega Omega around plant k; the plant has no direct term."""
    A, B, C, E = plants.A[k], plants.B[k], plants.C[k], plants.B_Omega[k]
    assert not np.any(plants.D)
    m, p = B.shape[1], C.shape[0]
    q = len(K.A)
    whole = np.block([[A + B @ K.D @ C, B @ K.C], [K.B @ C, K.A]])
    into = {"d": np.vstack([B, np.zeros((q, m))]), "Omega": np.vstack([E, np.zeros((q, 3))])}
    into["n"] = np.vstack([B @ K.D, K.B])
    out = {"u": np.hstack([K.D @ C, K.C]), "y": np.hstack([C, np.zeros((p, q))])}
    direct = {("u", "d"): np.zeros((m, m)), ("u", "Omega"): np.zeros((m, 3)), ("u", "n"): K.D}
    direct |= {("y", "d"): np.zeros((p, m)), ("y", "Omega"): np.zeros((p, 3)), ("y", "n"): np.zeros((p, p))}
    return Loop(whole, into, out, direct, plants.period)


def response(loop: Loop, z: str, w: str, frequency: np.ndarray) -> np.ndarray:
    """Return the response from w to z at each frequency, (F, ...)."""
    points = np.exp(1j * np.asarray(frequency) * loop.period)
    pencil = points[:, None, None] * np.eye(len(loop.A)) - loop.A
    return loop.C[z] @ np.linalg.solve(pencil, loop.B[w].astype(complex)) + loop.D[z, w]


def around_poles(A: np.ndarray, period: float) -> np.ndarray:
    """Return frequencies, rad/s: a fine grid, and for every pole some at all distances down to a hundredth of its
    width."""
    nyquist = np.pi / period
    z = np.linalg.eigvals(A)
    z = z[np.abs(z) > 1e-12]
    s = np.log(z.astype(complex)) / period
    steps = np.concatenate([[0.0], np.geomspace(1e-2, 1e3, 80)])
    near = [np.abs(one.imag) + sign * steps * max(abs(one.real), 1e-9) for one in s for sign in (-1.0, 1.0)]
    w = np.concatenate([[0.0, nyquist], np.geomspace(1e-3, nyquist, 1500), *near])
    return np.unique(w[(w >= 0.0) & (w <= nyquist)])


def highest(gain: Callable[[np.ndarray], np.ndarray], w: np.ndarray, band: tuple[float, float]) -> float:
    """Return the largest gain within a band, from the sizes at `w` refined around the three highest tops."""
    low, top = band[0], min(band[1], w[-1])
    w = np.unique(np.concatenate([[low, top], w[(w >= low) & (w <= top)]]))
    sizes = gain(w)
    padded = np.concatenate([[-np.inf], sizes, [-np.inf]])
    tops = np.flatnonzero((sizes >= padded[:-2]) & (sizes >= padded[2:]))
    best = 0.0
    for k in tops[np.argsort(-sizes[tops])][:3]:
        left, right = w[max(k - 1, 0)], w[min(k + 1, len(w) - 1)]
        for _ in range(14):
            fan = np.linspace(left, right, 21)
            found = gain(fan)
            i = int(np.argmax(found))
            best = max(best, float(found[i]))
            left, right = fan[max(i - 1, 0)], fan[min(i + 1, 20)]
    return best


def size(matrices: np.ndarray) -> np.ndarray:
    return np.linalg.norm(matrices, 2, axis=(-2, -1))


def figure(kind: str, plants, k: int, K, frequency: float | None = None) -> float:
    """Return a figure of plant k with the controller, as the job file defines it."""
    loop = closed(plants, k, K)
    if np.abs(np.linalg.eigvals(loop.A)).max() >= 1.0:
        return 0.0 if kind in ("disk margin", "bandwidth") else np.inf
    w = around_poles(loop.A, loop.period)
    band = (0.0, np.inf if frequency is None else frequency)
    share = plants.Omega / plants.torque_limit[:, None]

    def peak(of: Callable[[np.ndarray], np.ndarray]) -> float:
        return highest(lambda f: size(of(f)), w, band)

    def S(f: np.ndarray, at: str, half: float = 1.0) -> np.ndarray:
        T = response(loop, "u", "d", f) if at == "input" else response(loop, "y", "n", f)
        return half * np.eye(T.shape[-1]) + T

    match kind:
        case "sensitivity peak":
            return max(peak(lambda f: S(f, "input")), peak(lambda f: S(f, "output")))
        case "complementary sensitivity peak":
            return max(peak(lambda f: S(f, "input", 0.0)), peak(lambda f: S(f, "output", 0.0)))
        case "disk margin":
            return 1.0 / max(peak(lambda f: S(f, "input", 0.5)), peak(lambda f: S(f, "output", 0.5)))
        case "tracking":
            return peak(lambda f: S(f, "output"))
        case "Omega rejection":
            return peak(lambda f: response(loop, "y", "Omega", f))
        case "torque rejection":
            return peak(lambda f: response(loop, "y", "d", f))
        case "torque limit":
            rows = range(len(plants.torques))
            return max(peak(lambda f, j=j: response(loop, "u", "Omega", f)[:, j : j + 1] * share[j]) for j in rows)
        case "bandwidth":
            return min(first_above(lambda f, at=at: size(S(f, at)), w) for at in ("input", "output")) / (2.0 * np.pi)
    raise AssertionError(kind)


def first_above(gain: Callable[[np.ndarray], np.ndarray], w: np.ndarray) -> float:
    """Return the lowest frequency at which a gain reaches 1/sqrt(2)."""
    sizes = gain(w[1:])
    above = np.flatnonzero(sizes >= np.sqrt(0.5))
    if not above.size:
        return float(w[-1])
    k = int(above[0])
    if k == 0:
        return 0.0
    left, right = w[k], w[k + 1]
    for _ in range(60):
        middle = 0.5 * (left + right)
        left, right = (left, middle) if gain(np.array([middle]))[0] >= np.sqrt(0.5) else (middle, right)
    return float(right)


def controller_gain(K, start: float) -> float:
    """Return the largest gain of a controller from a frequency on."""

    def gain(f: np.ndarray) -> np.ndarray:
        points = np.exp(1j * f * K.dt)[:, None, None]
        return size(K.C @ np.linalg.solve(points * np.eye(len(K.A)) - K.A, K.B.astype(complex)) + K.D)

    return highest(gain, around_poles(K.A, K.dt), (start, np.inf))


def eigenvalues(A: np.ndarray) -> np.ndarray:
    """Return the eigenvalues of a matrix of doubles from 60 digits, without those of pure delays."""
    from flint import acb_mat, ctx

    with ctx.workprec(200):
        found = np.array([complex(one) for one in acb_mat(A.tolist()).eig(algorithm="approx")])
    return found[np.abs(found) > 1e-9]


def noise(loop: Loop, rms: np.ndarray) -> np.ndarray:
    """Return the rms of the torques from white samples at the pick-offs."""
    from scipy.linalg import solve_discrete_lyapunov

    B, C, D = loop.B["n"] * rms, loop.C["u"], loop.D["u", "n"] * rms
    return np.sqrt(np.diag(C @ solve_discrete_lyapunov(loop.A, B @ B.T, method="bilinear") @ C.T + D @ D.T))
