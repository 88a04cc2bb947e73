"""Frequency responses against exact arithmetic on the very numbers of the system matrices."""

from __future__ import annotations

import control
import flint
import numpy as np
import pytest

from platform_ctrl import analysis


def exact(system: control.StateSpace, frequency: np.ndarray) -> np.ndarray:
    """Return the response of the matrices as they are stored, right to the last digit, (p, m, N)."""
    n = system.nstates
    with flint.ctx.workprec(600):
        A, B, C, D = (
            flint.acb_mat([[flint.acb(float(x)) for x in row] for row in item])
            for item in (system.A, system.B, system.C, system.D)
        )
        eye = flint.acb_mat([[flint.acb(int(i == j)) for j in range(n)] for i in range(n)])
        out = np.empty((system.noutputs, system.ninputs, len(frequency)), dtype=np.complex128)
        for k, w in enumerate(frequency):
            point = flint.acb(0, float(w))
            z = (point * float(system.dt)).exp() if system.dt else point
            H = C * (eye * z - A).solve(B) + D
            out[:, :, k] = [[complex(H[i, j]) for j in range(H.ncols())] for i in range(H.nrows())]
    return out


def deviation(system: control.StateSpace, frequency: np.ndarray) -> float:
    """Return the largest relative error of an entry that is more than a thousandth of the largest at its frequency."""
    truth = exact(system, frequency)
    size = np.maximum(np.abs(truth), 1e-3 * np.abs(truth).max(axis=(0, 1)))
    return float((np.abs(analysis.frequency_response(system, frequency) - truth) / size).max())


def system_of(A: np.ndarray, m: int, p: int, rng: np.random.Generator, dt: float = 0.0) -> control.StateSpace:
    return control.ss(A, rng.normal(size=(len(A), m)), rng.normal(size=(p, len(A))), rng.normal(size=(p, m)), dt)


def turned(A: np.ndarray, rng: np.random.Generator, spread: float = 0.0) -> np.ndarray:
    """Return A in other states; with `spread` in badly scaled ones."""
    Q = np.linalg.qr(rng.normal(size=A.shape))[0] * 10.0 ** rng.uniform(-spread, spread, len(A))[:, None]
    out: np.ndarray = Q @ A @ np.linalg.inv(Q)
    return out


def modes(frequency: np.ndarray, damping: np.ndarray) -> np.ndarray:
    A = np.zeros((2 * len(frequency), 2 * len(frequency)))
    for k, (w, zeta) in enumerate(zip(frequency, damping, strict=True)):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[0.0, w], [-w, -2.0 * zeta * w]]
    return A


@pytest.mark.parametrize(("n", "m", "p"), [(1, 1, 1), (2, 3, 1), (5, 1, 4), (12, 2, 2), (33, 3, 2)])
@pytest.mark.parametrize("dt", [0.0, 0.01])
def test_random_systems(n: int, m: int, p: int, dt: float) -> None:
    rng = np.random.default_rng(n + m + p)
    A = rng.normal(size=(n, n))
    A = 0.99 * A / np.abs(np.linalg.eigvals(A)).max() if dt else A
    w = np.geomspace(1e-3, 300.0, 45)
    assert deviation(system_of(A, m, p, rng, dt), w) < 1e-9


@pytest.mark.parametrize("zeta", [1e-4, 1e-6, 1e-8])
@pytest.mark.parametrize("dt", [0.0, 2e-3])
def test_points_next_to_lightly_damped_poles(zeta: float, dt: float) -> None:
    rng = np.random.default_rng(3)
    own = np.array([0.7, 20.0, 21.0, 400.0])
    system = system_of(turned(modes(own, np.array([zeta, zeta, 0.3, zeta])), rng), 2, 2, rng)
    if dt:
        system = analysis.sampled(system, dt)
    poles = system.poles()
    near = np.unique(np.abs(np.log(poles.astype(complex)).imag / dt if dt else poles.imag))
    w = np.concatenate([x * (1.0 + zeta * np.linspace(-3.0, 3.0, 7)) for x in near])
    assert deviation(system, w) < 2e-9


def test_a_chain_of_integrators_rolls_off_with_all_its_digits() -> None:
    n = 6
    A, B, C = np.eye(n, k=1), np.eye(n)[:, [-1]], np.eye(n)[[0]]
    w = np.geomspace(1e-4, 1e5, 50)
    np.testing.assert_allclose(
        analysis.frequency_response(control.ss(A, B, C, 0), w)[0, 0], (1j * w) ** -6.0, rtol=1e-13
    )


@pytest.mark.parametrize("seed", range(4))
def test_poles_from_1e_minus_3_to_1e9_in_badly_scaled_states(seed: int) -> None:
    rng = np.random.default_rng(seed)
    own = np.array([1e-3, 0.3, 1e2, 4e4, 1e7, 1e9])
    A = modes(own, 10.0 ** rng.uniform(-3.0, 0.0, 6))
    A += np.triu(rng.normal(size=A.shape), 2) * np.abs(A).max(axis=1)[:, None]
    s = 10.0 ** rng.uniform(-6.0, 6.0, len(A))
    system = system_of(A * s / s[:, None], 2, 2, rng)
    assert deviation(system, np.concatenate([np.geomspace(1e-5, 1e11, 40), own, 1.001 * own])) < 1e-9


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_on_a_pole_the_response_is_infinite(dt: float) -> None:
    A = [[1.0, 0.0], [0.0, 0.5]] if dt else [[0.0, 0.0], [0.0, -0.5]]
    system = control.ss(A, [[1.0], [1.0]], [[1.0, 1.0]], 0, dt)
    H = analysis.frequency_response(system, [0.0, 1.0])[0, 0]
    assert np.isinf(H[0])
    assert np.isfinite(H[1])
    oscillator = control.ss([[0.0, 2.0], [-2.0, 0.0]], [[0.0], [1.0]], [[1.0, 0.0]], 0)
    assert np.isinf(analysis.frequency_response(oscillator, [2.0])[0, 0, 0])


# Many states: a narrow band of states in another order, and matrices without structure.
