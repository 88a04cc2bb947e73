"""The kernel as such: its elementary functions, its lanes, its compilation."""

from __future__ import annotations

import mpmath
import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kernel_entries import derivatives, entries, momenta, whole_state
from platform_ctrl.common.simd import LANES, choose, load, store
from platform_ctrl.plant.platform import Platform
from platform_ctrl.simulation import rollout
from platform_ctrl.simulation.kernel import arithmetic
from platform_ctrl.simulation.packing import pack
from simulation.test_forces import a_state, along_coordinates, furnished
from small_trees import tree
from tree_cases import platforms


@numba.njit
def _each(x, lane, y):
    for i in range(x.shape[0]):
        a = load(x, i, lane)
        positive = choose(a < 0.0, -a, a) + 1e-300
        c, s = arithmetic.cosine_and_sine(a)
        store(y, 5 * i, lane, c)
        store(y, 5 * i + 1, lane, s)
        store(y, 5 * i + 2, lane, arithmetic.exponential(a))
        store(y, 5 * i + 3, lane, arithmetic.logarithm(positive))
        store(y, 5 * i + 4, lane, arithmetic.hyperbolic_tangent(a))


def elementary(x: np.ndarray, lane: int | None = None) -> np.ndarray:
    """Cosine, sine, exponential, logarithm (of |x| + 1e-300) and hyperbolic tangent of x, (5, size of x)."""
    rows = np.concatenate([x, np.ones(-len(x) % LANES)]).reshape(-1, LANES)
    out = np.empty((5 * len(rows), LANES))
    for column in [None] if lane is None else range(lane):
        _each(rows, column, out)
    return out.reshape(-1, 5, LANES).transpose(1, 0, 2).reshape(5, -1)[:, : len(x)]


def ulps(got: np.ndarray, x: np.ndarray, exact) -> np.ndarray:
    """How far `got` is from the exact function of x, in units of the last place of that."""
    with mpmath.workdps(50):
        true = [exact(mpmath.mpf(a)) for a in x]
        away = [float(abs(mpmath.mpf(g) - t)) for g, t in zip(got, true, strict=True)]
        return np.array(away) / np.spacing(np.abs(np.array([float(t) for t in true])))


def some_angles() -> np.ndarray:
    rng = np.random.default_rng(1)
    beside = 0.5 * np.pi * rng.integers(-60000, 60000, 300)
    return np.concatenate(
        [
            rng.uniform(-10.0, 10.0, 1500),
            rng.uniform(-1e5, 1e5, 1000),
            beside,
            np.nextafter(beside, 0.0),
            beside + rng.normal(size=300) * 10.0 ** rng.uniform(-15, 0, 300),
            rng.normal(size=300) * 10.0 ** rng.uniform(-300, 0, 300),
            [0.0, 0.25 * np.pi, -0.25 * np.pi, 0.75 * np.pi],
        ]
    )


def test_cosine_and_sine_are_those_of_mpmath_to_two_ulps_up_to_1e5_rad():
    x = some_angles()
    cosine, sine, *_ = elementary(x)
    assert ulps(cosine, x, mpmath.cos).max() <= 2.0
    assert ulps(sine, x, mpmath.sin).max() <= 2.0


def test_exponential_is_that_of_mpmath_to_two_ulps_and_held_at_the_ends():
    rng = np.random.default_rng(2)
    x = np.concatenate([rng.uniform(-700, 700, 1500), rng.uniform(-1, 1, 1500), [0.0, 700.0, -700.0, 1e-300]])
    assert ulps(elementary(x)[2], x, mpmath.exp).max() <= 2.0
    ends = elementary(np.array([701.0, np.inf, -701.0, -np.inf]))[2]
    assert ends == pytest.approx(np.exp([700.0, 700.0, -700.0, -700.0]), rel=1e-15)


def test_logarithm_is_that_of_mpmath_to_two_ulps():
    rng = np.random.default_rng(3)
    x = np.concatenate([10.0 ** rng.uniform(-280, 308, 1500), rng.uniform(0.5, 2.0, 1500), 1 + 1e-15 * np.arange(9)])
    assert ulps(elementary(x)[3], x, mpmath.log).max() <= 2.0


def test_hyperbolic_tangent_is_that_of_mpmath_to_the_last_place_of_one():
    rng = np.random.default_rng(4)
    x = np.concatenate([rng.uniform(-25, 25, 1500), 10.0 ** rng.uniform(-300, 0, 500), [0.0, 1e300, -np.inf]])
    away = elementary(x)[4] - np.array([float(mpmath.tanh(mpmath.mpf(a))) for a in x])
    assert np.abs(away).max() <= 2.0 * np.finfo(float).eps


def test_numbers_that_are_none_go_through():
    assert np.isnan(elementary(np.array([np.nan]))[[0, 1, 2, 4]]).all()
    assert np.isnan(elementary(np.array([np.inf]))[:2]).all()


def test_elementary_functions_are_the_same_to_the_bit_in_a_lane_and_alone():
    x = some_angles()
    x = x[: len(x) // LANES * LANES]
    np.testing.assert_array_equal(elementary(x, LANES), elementary(x))


def same(one: np.ndarray, other: np.ndarray) -> None:
    """Equal but for which of two products goes unrounded into a sum: that is the compiler's choice in either code."""
    np.testing.assert_allclose(one, other, rtol=1e-11, atol=1e-13 * np.abs(other).max())


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@given(
    st.builds(along_coordinates, platforms(controls=("regulated", "free", "servo")), st.integers(0, 99)), st.booleans()
)
def test_derivatives_are_the_same_to_rounding_in_a_lane_and_alone(platform, free):
    platform = furnished(platform, 8)
    m = 2 * pack(platform).at.servos
    rows = [a_state(platform, seed) for seed in range(LANES)]
    extra = np.random.default_rng(5).normal(size=(LANES, m))
    states = np.array([whole_state(platform, q, v, x) for (q, v, _), x in zip(rows, extra, strict=True)])
    force = np.array([f for _, _, f in rows])
    for held in ([], [0]):
        together = derivatives(platform, states, force, free=free, held=held)
        same(derivatives(platform, states, force, free=free, held=held, lane=LANES), together)
    same(momenta(platform, states, lane=LANES), momenta(platform, states))


def chain(n: int, rotors: tuple[str, ...] = ()) -> Platform:
    names = ["base", *(f"g{k}" for k in range(n))]
    servo = {"control": "servo", "speed_gain": 1.0}
    return tree(
        [3.0, 4.0, 5.0],
        [(names[k + 1], names[k], k % 3 + 1, [0.5, 0.6, 0.7]) for k in range(n)],
        [(name, "g0", [0.6, 0.0, 0.8], 0.2, 0.15, 3.0, servo) for name in rotors],
    )


THREE = chain(3)


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


def test_a_run_that_diverges_leaves_those_beside_it_and_after_it_alone():
    q, velocity, force = a_start(THREE, 24)
    together = ends(THREE, q, velocity, force)
    wild = velocity.copy()
    wild[[2, 9]] = 1e200
    beside = ends(THREE, q, wild, force, threads=1)
    assert np.isnan(beside[[2, 9]]).all()
    others = np.delete(np.arange(24), [2, 9])
    np.testing.assert_array_equal(beside[others], together[others])


def test_one_compilation_does_for_every_plant():
    from platform_ctrl.simulation.kernel.advance import advance, carrier_rates

    plants = [chain(n) for n in (0, 1, 5)]
    plants += [along_coordinates(chain(2), 0), furnished(chain(3), 3), furnished(chain(4), 4)]
    plants += [chain(2, ("w0", "w1", "w2")), furnished(chain(1, ("w0",)), 5)]
    for plant in plants:
        assert np.isfinite(ends(plant, *a_start(plant, 3), steps=2)).all()
    assert len(advance.signatures) == 1
    assert len(carrier_rates.signatures) == 1
    assert all(len(entry.signatures) <= 2 for entry in entries())  # a lane, and one column
