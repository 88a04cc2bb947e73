"""The kernel as such: its elementary functions, its random numbers, and runs that stand beside each other."""

from __future__ import annotations

import mpmath
import numba
import numpy as np
import pytest

from platform_ctrl import Platform
from platform_ctrl.analysis import interconnection
from platform_ctrl.analysis.interconnection import BackCalculation, back_calculation
from platform_ctrl.analysis.system import System
from platform_ctrl.common.simd import LANES, choose, load, store
from platform_ctrl.simulation import rollout
from platform_ctrl.simulation.kernel import arithmetic
from platform_ctrl.simulation.kernel.devices import philox
from simulation.test_closed_loop import PERIOD, J, controller, one_gimbal, run
from simulation.test_forces import furnished
from small_trees import tree


@numba.njit
def _each(x, y):
    for i in range(len(x)):
        a = load(x, i)
        c, s = arithmetic.cosine_and_sine(a)
        store(y, i, c)
        store(y, len(x) + i, s)
        store(y, 2 * len(x) + i, arithmetic.exponential(a))
        store(y, 3 * len(x) + i, arithmetic.hyperbolic_tangent(a))
        store(y, 4 * len(x) + i, arithmetic.logarithm(choose(a < 0.0, -a, a) + 1e-300))


def test_elementary_functions_are_those_of_mpmath_in_the_last_places():
    rng = np.random.default_rng(1)
    beside = 0.5 * np.pi * rng.integers(-60000, 60000, 200)
    x = np.concatenate([rng.uniform(-10.0, 10.0, 500), beside, np.nextafter(beside, 0.0), rng.uniform(-700, 700, 500)])
    x = x[: len(x) // LANES * LANES]
    found = np.empty((5 * len(x) // LANES, LANES))
    _each(x.reshape(-1, LANES), found)
    exact = (mpmath.cos, mpmath.sin, mpmath.exp, mpmath.tanh, lambda a: mpmath.log(abs(a) + mpmath.mpf(1e-300)))
    for row, function in zip(found.reshape(5, -1), exact, strict=True):
        small = np.abs(x) < 700.0 if function is mpmath.exp else np.full(len(x), True)
        with mpmath.workdps(50):
            true = [function(mpmath.mpf(a)) for a in x[small]]
            away = np.array([float(abs(mpmath.mpf(g) - t)) for g, t in zip(row[small], true, strict=True)])
        last_place = np.spacing(np.maximum(np.abs([float(t) for t in true]), 1.0 if function is mpmath.tanh else 0.0))
        assert (away / last_place).max() <= 2.0


def test_philox_gives_the_published_words() -> None:
    @numba.njit
    def words(c, k):  # type: ignore[no-untyped-def]
        return philox(c[0], c[1], c[2], c[3], k[0], k[1])

    for counter, key, expected in (
        ("00000000 " * 4, "00000000 " * 2, "6627e8d5 e169c58d bc57ac4c 9b00dbd8"),
        ("ffffffff " * 4, "ffffffff " * 2, "408f276d 41c83b0e a20bc7c6 6d5451fd"),
        ("243f6a88 85a308d3 13198a2e 03707344", "a4093822 299f31d0", "d16cfe09 94fdcceb 5001e420 24126ea1"),
    ):
        c, k = (np.array([int(word, 16) for word in text.split()], dtype=np.uint64) for text in (counter, key))
        assert " ".join(f"{word:08x}" for word in words(c, k)) == expected


THREE = tree(
    [3.0, 4.0, 5.0],
    [(f"g{k + 1}", f"g{k}" if k else "base", k % 3 + 1, [0.5, 0.6, 0.7]) for k in range(3)],
)


def a_start(platform: Platform, runs: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    n = len(platform.gimbals)
    return 0.3 * rng.normal(size=(runs, n)), 0.3 * rng.normal(size=(runs, n + 3)), rng.normal(size=(runs, n + 3))


def ends(platform: Platform, q, velocity, force, **options) -> np.ndarray:
    out = rollout(platform, q, velocity, force=force, **{"steps": 30} | options)
    return np.hstack([out.q, out.velocity, out.attitude, out.spin])


def test_a_run_is_the_same_to_the_bit_whichever_stand_beside_it_and_wherever():
    platform = furnished(THREE, 3)
    q, velocity, force = a_start(platform, 21)
    together = ends(platform, q, velocity, force, threads=1)
    assert np.isfinite(together).all()
    for runs in (1, 7, 8, 9, 17):
        np.testing.assert_array_equal(ends(platform, q[:runs], velocity[:runs], force[:runs]), together[:runs])
    order = np.random.default_rng(1).permutation(21)
    np.testing.assert_array_equal(ends(platform, q[order], velocity[order], force[order]), together[order])
    for threads in (2, 3, 100):
        np.testing.assert_array_equal(ends(platform, q, velocity, force, threads=threads), together)
    np.testing.assert_array_equal(ends(platform, q, velocity, force, every=4), together)


@pytest.mark.parametrize("every", [1, 2])
def test_an_integral_follows_a_limited_torque(every, monkeypatch):
    # A PID with three poles at 20 rad/s; its states are the integral and the last reading.
    w, limit, T = 20.0, 0.1, every * PERIOD
    kp, ki, kd = 3.0 * w**2 * J, w**3 * J, 3.0 * w * J
    K = controller(-kp - kd / T, A=[[1.0, 0.0], [0.0, 0.0]], B=[[1.0], [1.0]], C=[[-ki * T, kd / T]], dt=every * PERIOD)
    E = back_calculation(System.of(K, "K"), [True]).gain

    def flown():
        return run(one_gimbal(limit=limit), [K], duration=2.0, q=[0.5])

    with_it = flown()
    x, expected = np.zeros(2), []
    for k, y in enumerate(with_it.reading):
        if k % every == 0:
            u = K.C @ x + K.D @ y
            x = K.A @ x + K.B @ y + E @ (np.clip(u, -limit, limit) - u)
        expected.append(u[0])
    assert 100 < with_it.saturated[0] < len(with_it.t)
    assert with_it.command[:, 0] == pytest.approx(np.array(expected), rel=0.0, abs=1e-12 * np.abs(expected).max())
    # The same without it, through the same kernel.
    monkeypatch.setattr(
        interconnection, "back_calculation", lambda K, limited: BackCalculation(gain=np.zeros((len(K.A), len(limited))))
    )
    without = flown()
    settled = [one.t[np.abs(one.q[:, 0]) > 0.005].max() for one in (with_it, without)]
    assert settled[0] < 0.5 * settled[1]
    assert np.array_equal(flown().q, without.q)
