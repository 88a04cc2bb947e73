"""The benchmark collections of algebraic Riccati equations: CAREX, 20 continuous, and DAREX, 19 discrete examples.

P. Benner, A. J. Laub, V. Mehrmann, A Collection of Benchmark Examples for the Numerical Solution of Algebraic Riccati
Equations I and II, 1995; the discrete ones as extended by J. Abels and P. Benner, SLICOT Working Note 1999-16. With
their default parameters. Examples given by numbers are in data/riccati.json.
"""

from __future__ import annotations

import json
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from platform_ctrl.common.values import FloatArray


class Example(NamedTuple):
    """A' X + X A + Q = (X B + N) R^-1 (B' X + N'), or A' X A - X + Q = (A' X B + N) (R + B' X B)^-1 (B' X A + N')."""

    name: str
    A: FloatArray
    B: FloatArray
    Q: FloatArray
    R: FloatArray
    N: FloatArray
    X: FloatArray | None
    discrete: bool


@lru_cache(maxsize=1)
def _data() -> dict[str, Any]:
    return json.loads((Path(__file__).parents[1] / "data" / "riccati.json").read_text(encoding="utf-8"))


def _given(name: str) -> dict[str, FloatArray]:
    return {key: np.array(item, dtype=np.float64) for key, item in _data()[name].items()}


# I - 2/3 of ones: orthogonal and symmetric.
_TURN = np.eye(3) - 2.0 / 3.0


def carex(number: int) -> Example:
    """Return example 1 to 20 of the continuous collection."""
    found = dict(_carex(number))
    A, B = np.atleast_2d(found["A"]), found["B"]
    n, m = B.shape
    C = found.get("C", np.eye(n))
    Q = C.T @ found.get("Q", np.eye(len(C))) @ C
    return Example(f"CAREX {number}", A, B, Q, found.get("R", np.eye(m)), np.zeros((n, m)), found.get("X"), False)


def _carex(number: int) -> dict[str, Any]:
    if number in (3, 4, 5, 6):
        return _given(f"carex {number}")
    return _CAREX[number]()


def _carex_7(e: float = 1e-6) -> dict[str, Any]:
    root = np.hypot(1.0, e)
    x12 = 1.0 / (2.0 + root)
    X = np.array([[(1.0 + root) / e**2, x12], [x12, 0.25 * (1.0 - e * x12) * (1.0 + e * x12)]])
    return {"A": np.diag([1.0, -2.0]), "B": np.array([[e], [0.0]]), "C": np.ones((1, 2)), "X": X}


def _carex_10(e: float = 1e-7) -> dict[str, Any]:
    a = 1.0 + e
    x = 0.5 * (2.0 * a + np.sqrt(2.0) * (np.sqrt(a**2 + 1.0) + e))
    return {
        "A": np.array([[a, 1.0], [1.0, a]]),
        "B": np.eye(2),
        "Q": e**2 * np.eye(2),
        "X": np.array([[x, x / (x - a)], [x / (x - a), x]]),
    }


def _carex_11(e: float = 0.0) -> dict[str, Any]:
    Q = np.array([[4.0 * e - 11.0, 2.0 * e - 5.0], [2.0 * e - 5.0, 2.0 * e - 2.0]])
    A = np.array([[3.0 - e, 1.0], [4.0, 2.0 - e]])
    return {"A": A, "B": np.ones((2, 1)), "Q": Q, "X": np.array([[2.0, 1.0], [1.0, 1.0]])}


def _carex_12(e: float = 1e6) -> dict[str, Any]:
    x = [e**2 + np.sqrt(e**4 + 1.0), 2.0 * e**2 + np.sqrt(4.0 * e**4 + e), 3.0 * e**2 + e * np.sqrt(9.0 * e**2 + 1.0)]
    A, Q, X = (_TURN @ np.diag(d) @ _TURN for d in ([e, 2.0 * e, 3.0 * e], [1.0 / e, 1.0, e], x))
    return {"A": A, "B": np.eye(3), "Q": Q, "R": e * np.eye(3), "X": X}


def _carex_13(e: float = 1e-6) -> dict[str, Any]:
    A = np.zeros((4, 4))
    A[0, 1], A[1, 2] = 0.4, 0.345
    A[2, 1:], A[3, 3] = np.array([-0.524, -0.465, 0.262]) / e, -1.0 / e
    return {"A": A, "B": np.array([[0.0], [0.0], [0.0], [1.0 / e]]), "C": np.eye(4)[[0, 2]]}


def _carex_14(e: float = 1e-6) -> dict[str, Any]:
    turn = np.array([[0.0, 1.0], [-1.0, 0.0]])
    A = np.kron(np.eye(2), turn) + e * np.diag([-1.0, -1.0, 1.0, 1.0])
    return {"A": A, "B": np.ones((4, 1)), "C": np.ones((1, 4))}


def _carex_15(vehicles: int = 20) -> dict[str, Any]:
    n = 2 * vehicles - 1
    A, B, C = np.zeros((n, n)), np.zeros((n, vehicles)), np.zeros((vehicles - 1, n))
    for i in range(n):
        if i % 2 == 0:
            A[i, i], B[i, i // 2] = -1.0, 1.0
        else:
            A[i, i - 1], A[i, i + 1], C[i // 2, i] = 1.0, -1.0, 1.0
    return {"A": A, "B": B, "C": C, "Q": 10.0 * np.eye(vehicles - 1)}


def _carex_16(n: int = 64) -> dict[str, Any]:
    A = -2.0 * np.eye(n) + np.roll(np.eye(n), 1, axis=0) + np.roll(np.eye(n), -1, axis=0)
    # Circulant: diagonal in the Fourier basis.
    a = -2.0 + 2.0 * np.cos(2.0 * np.pi * np.arange(n) / n)
    first = np.fft.ifft(a + np.sqrt(a**2 + 1.0)).real
    X = np.array([np.roll(first, k) for k in range(n)])
    return {"A": A, "B": np.eye(n), "X": X}


def _carex_17(n: int = 21) -> dict[str, Any]:
    return {"A": np.eye(n, k=1), "B": np.eye(n)[:, [-1]], "C": np.eye(n)[[0]]}


def _carex_18(n: int = 100, a: float = 0.01) -> dict[str, Any]:
    """Heat flow in a rod, linear finite elements; heated and measured between 0.2 and 0.3 of its length."""
    k = n + 1.0
    gram = (4.0 * np.eye(n) + np.eye(n, k=1) + np.eye(n, k=-1)) / (6.0 * k)
    stiffness = a * k * (2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    load = np.zeros(n)
    for i in range(1, n + 1):
        # Of the hat 1 - |x k - i| over the part of its support between the ends.
        for low, high, sign in (((i - 1) / k, i / k, 1.0), (i / k, (i + 1) / k, -1.0)):
            low, high = max(low, 0.2), min(high, 0.3)
            if low < high:
                load[i - 1] += (1.0 - sign * i) * (high - low) + 0.5 * sign * k * (high**2 - low**2)
    B = np.linalg.solve(gram, load)[:, None]
    return {"A": -np.linalg.solve(gram, stiffness), "B": B, "C": load[None, :]}


def _carex_19(masses: int = 30, mass: float = 4.0, damping: float = 4.0, spring: float = 1.0) -> dict[str, Any]:
    k = 2.0 * np.eye(masses) - np.eye(masses, k=1) - np.eye(masses, k=-1)
    k[0, 0] = k[-1, -1] = 1.0
    zero, one = np.zeros((masses, masses)), np.eye(masses)
    B = np.zeros((2 * masses, 2))
    B[masses, 0], B[-1, 1] = 1.0 / mass, -1.0 / mass
    return {"A": np.block([[zero, one], [-spring / mass * k, -damping / mass * one]]), "B": B}


def _carex_20() -> dict[str, Any]:
    """A rotating axle, from the moments of inertia, damping and springs of its parts."""
    mu, delta, gamma, kappa = (_given("carex 20")[name] for name in ("mu", "delta", "gamma", "kappa"))
    n = len(mu)
    A, B, C = np.zeros((2 * n - 1, 2 * n - 1)), np.zeros((2 * n - 1, n)), np.zeros((n, 2 * n - 1))
    A[n:, 1:n] = np.eye(n - 1)
    for of, first in ((gamma, 1), (kappa, n)):
        for i in range(n - 1):
            A[i, first + i] += (1.0 if i else -1.0) * of[i] / mu[i]
            A[i + 1, first + i] -= of[i] / mu[i] + of[i] / mu[i + 1]
            if i + 2 < n:
                A[i + 2, first + i] += of[i] / mu[i + 1]
    # The first two lines of the springs have one neighbour.
    rate = delta / mu
    A[0, 0] -= rate[0]
    for i in range(1, n):
        step = rate[i - 1] - rate[i]
        A[i, 0] -= step
        A[i, i] -= rate[i]
        A[i, 1:i] += step
    for i in range(n):
        B[i, i] = 1.0 / mu[i] if i == 0 else -1.0 / mu[i]
        if i + 1 < n:
            B[i + 1, i] = 1.0 / mu[i]
    C[0, 0] = 1.0
    C[range(1, n), range(1, n)] = gamma
    C[range(1, n), range(n, 2 * n - 1)] = kappa
    return {"A": A, "B": B, "C": C, "Q": np.diag(np.concatenate([[1.0], 1.0 / (gamma**2 + kappa**2)]))}


_CAREX: dict[int, Any] = {
    1: lambda: {
        "A": np.eye(2, k=1),
        "B": np.array([[0.0], [1.0]]),
        "Q": np.diag([1.0, 2.0]),
        "X": np.array([[2.0, 1.0], [1.0, 2.0]]),
    },
    2: lambda: {
        "A": np.array([[4.0, 3.0], [-4.5, -3.5]]),
        "B": np.array([[1.0], [-1.0]]),
        "Q": np.array([[9.0, 6.0], [6.0, 4.0]]),
        "X": (1.0 + np.sqrt(2.0)) * np.array([[9.0, 6.0], [6.0, 4.0]]),
    },
    7: _carex_7,
    8: lambda e=1e-6: {
        "A": np.diag([-0.1, -0.02]),
        "B": np.array([[0.1, 0.0], [0.001, 0.01]]),
        "C": np.array([[10.0, 100.0]]),
        "R": np.ones((2, 2)) + np.diag([e, 0.0]),
    },
    9: lambda e=1e6: {
        "A": np.array([[0.0, e], [0.0, 0.0]]),
        "B": np.array([[0.0], [1.0]]),
        "X": np.array([[np.sqrt(1.0 + 2.0 * e) / e, 1.0], [1.0, np.sqrt(1.0 + 2.0 * e)]]),
    },
    10: _carex_10,
    11: _carex_11,
    12: _carex_12,
    13: _carex_13,
    14: _carex_14,
    15: _carex_15,
    16: _carex_16,
    17: _carex_17,
    18: _carex_18,
    19: _carex_19,
    20: _carex_20,
}


def darex(number: int) -> Example:
    """Return example 1 to 19 of the discrete collection: 1.1 to 1.13, 2.1 to 2.5 and 4.1 in the numbers of 1999."""
    found = dict(_given(f"darex {number}") if number in (5, 6, 7, 8, 10, 11, 13) else {}) | _DAREX[number]()
    A, B = found["A"], found["B"]
    n, m = B.shape
    C = found.get("C", np.eye(n))
    Q = C.T @ found.get("Q", np.eye(len(C))) @ C
    N = found.get("N", np.zeros((n, m)))
    return Example(f"DAREX {number}", A, B, Q, found.get("R", np.eye(m)), N, found.get("X"), True)


def _darex_11() -> dict[str, Any]:
    C = np.zeros((4, 11))
    C[0, 5], C[1, 6:9], C[2, 9], C[3, 10] = 15.0, [7.0, -5.357, -3.943], 1.0, 1.0
    return {"C": C, "Q": np.diag([0.5, 5.0, 0.5, 5.0]), "R": np.diag([400.0, 700.0])}


def _darex_12() -> dict[str, Any]:
    A = np.zeros((13, 13))
    A[:11, :11] = np.eye(11, k=1)
    A[5, 6] = A[7, 8] = 0.0
    A[5, 5], A[7, 6:8], A[10, 10] = 0.7788, [-0.4724, 1.3746], 0.8071
    A[11, 0], A[11, 11] = -3.318, 1.0
    A[12, 0], A[12, 6:9], A[12, 12] = -1.5484, [0.3981, 0.5113, 5.7865], 1.0
    B = np.zeros((13, 2))
    B[5, 0] = B[7, 1] = 1.0
    C = np.zeros((4, 13))
    C[0, 0], C[1, 0], C[1, 6:9], C[2, 11], C[3, 12] = 3.318, 1.5484, [-0.3981, -0.5113, -5.7865], 1.0, 1.0
    return {"A": A, "B": B, "C": C, "Q": np.diag([0.5, 5.0, 0.5, 5.0]), "R": np.diag([400.0, 700.0])}


def _darex_13() -> dict[str, Any]:
    plant = _given("darex 13")
    n, m = plant["B"].shape
    seen = np.zeros((m, n))
    seen[range(m), [1, 3, 11, 13, 15, 17]] = 1.0
    A = np.block([[plant["A"], np.zeros((n, m))], [-seen, np.eye(m)]])
    C = np.block([[seen, np.zeros((m, m))], [np.zeros((m, n)), np.eye(m)]])
    Q = np.diag([0.0] * m + [2.0, 1.0, 3.0, 3.0, 4.0, 1.0])
    B = np.vstack([plant["B"], np.zeros((m, m))])
    return {"A": A, "B": B, "C": C, "Q": Q, "R": np.diag([0.1, 0.1, 10.0, 0.1, 10.0, 1.0])}


def _darex_14(r: float = 1e6) -> dict[str, Any]:
    Q = np.array([[9.0, 6.0], [6.0, 4.0]])
    A, B = np.array([[4.0, 3.0], [-4.5, -3.5]]), np.array([[1.0], [-1.0]])
    return {"A": A, "B": B, "Q": Q, "R": np.array([[r]]), "X": 0.5 * (1.0 + np.sqrt(1.0 + 4.0 * r)) * Q}


def _darex_17(e: float = 1e6) -> dict[str, Any]:
    x = e * np.array([1.0, 0.5 * (1.0 + np.sqrt(5.0)), 0.5 * (9.0 + np.sqrt(85.0))])
    A, X = (_TURN @ np.diag(d) @ _TURN for d in ([0.0, 1.0, 3.0], x))
    return {"A": A, "B": np.eye(3), "Q": e * np.eye(3), "R": e * np.eye(3), "X": X}


def _darex_18(tau: float = 1e8, d: float = 1.0, k: float = 1.0, r: float = 0.25) -> dict[str, Any]:
    a, b = 1.0 - d / tau, k * d / tau
    A = np.eye(4, k=-1)
    A[0, 0] = a
    # (a + 1)(a - 1) without the cancellation in a - 1.
    c = -r * (a + 1.0) * (d / tau) + b**2
    X = np.diag([0.5 * (c + np.sqrt(c**2 + 4.0 * b**2 * r)) / b**2, 1.0, 1.0, 1.0])
    return {"A": A, "B": np.array([[b], [0.0], [0.0], [0.0]]), "C": np.eye(4)[[3]], "R": np.array([[r]]), "X": X}


_DAREX: dict[int, Any] = {
    1: lambda: {
        "A": np.array([[2.0, -1.0], [1.0, 0.0]]),
        "B": np.array([[1.0], [0.0]]),
        "C": np.array([[0.0, 1.0]]),
        "R": np.zeros((1, 1)),
        "X": np.eye(2),
    },
    2: lambda: {
        "A": np.array([[0.0, 1.0], [0.0, -1.0]]),
        "B": np.array([[1.0, 0.0], [2.0, 1.0]]),
        "Q": np.array([[-4.0, -4.0], [-4.0, 7.0]]) / 11.0,
        "R": np.array([[9.0, 3.0], [3.0, 1.0]]),
        "N": np.array([[3.0, 1.0], [-1.0, 7.0]]),
    },
    3: lambda: {
        "A": np.eye(2, k=1),
        "B": np.array([[0.0], [1.0]]),
        "Q": np.array([[1.0, 2.0], [2.0, 4.0]]),
        "X": np.array([[1.0, 2.0], [2.0, 2.0 + np.sqrt(5.0)]]),
    },
    4: lambda: {
        "A": np.diag([0.1, 0.01], 1),
        "B": np.array([[1.0, 0.0], [0.0, 0.0], [0.0, 1.0]]),
        "Q": np.diag([1e5, 1e3, -10.0]),
        "R": np.diag([0.0, 1.0]),
        # The published solution has 0 in place of -9.9, which belongs to Q33 = -0.1.
        "X": np.diag([1e5, 1e3, -9.9]),
    },
    5: lambda: {},
    6: lambda: {"Q": 0.01 * np.eye(4)},
    7: lambda: {
        "C": np.array([[1.0, 1.0, 2.0, 4.0], [0.0, 1.0, 1.0, 2.0], [0.0, 0.0, 1.0, 1.0], [0.0, 0.0, 0.0, 1.0]]),
        "Q": np.array([[2.0, -1.0, 0.0, 0.0], [-1.0, 2.0, -1.0, 0.0], [0.0, -1.0, 2.0, 0.0], [0.0] * 4]),
    },
    8: lambda: {},
    9: lambda: {
        "A": np.kron(np.eye(2), np.eye(3, k=1)),
        "B": np.kron(np.eye(2), np.array([[0.0], [0.0], [1.0]])),
        "C": np.array([[1.0, 1.0, 0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0, -1.0, 0.0]]),
        "R": np.diag([3.0, 1.0]),
        "N": np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 0.0]]),
    },
    10: lambda: {"C": np.eye(9)[[0, 4]], "Q": 50.0 * np.eye(2)},
    11: _darex_11,
    12: _darex_12,
    13: _darex_13,
    14: _darex_14,
    15: lambda e=1e6: {
        "A": np.diag([0.9512, 0.9048]),
        "B": np.array([[4.877, 4.877], [-1.1895, 3.569]]),
        "Q": np.diag([0.005, 0.02]),
        "R": np.diag([1.0 / (3.0 * e), 3.0 * e]),
    },
    16: lambda e=1e6: {
        "A": np.array([[0.0, e], [0.0, 0.0]]),
        "B": np.array([[0.0], [1.0]]),
        "X": np.diag([1.0, 1.0 + e**2]),
    },
    17: _darex_17,
    18: _darex_18,
    19: lambda n=100: {"A": np.eye(n, k=1), "B": np.eye(n)[:, [-1]], "X": np.diag(np.arange(1.0, n + 1.0))},
}
