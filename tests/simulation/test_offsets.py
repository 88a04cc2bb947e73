"""The compiled plant with masses, offsets and geared motors: the mechanics' equations, locked joints, conservation."""

from dataclasses import replace

import numpy as np
import pytest

from first_instants import first_slopes
from offset_trees import MODES, offset_plant, offset_platform, turned
from oracle_trees import rotation
from plant_parts import Erection, Friction, Unbalance
from platform_ctrl import (
    element_forces,
    forward_dynamics,
    inverse_dynamics,
    matrices,
    read_platform,
)
from platform_ctrl.simulation import rollout

SEEDS = range(9)


def force_of(platform, attitude):
    return platform.specific_force - rotation(attitude).T @ platform.gravity


def drawn(seed):
    """Return a platform with unbalance and erection besides, a state and forces."""
    rng = np.random.default_rng(100 + seed)
    platform = offset_platform(rng, MODES[seed % 3])
    if platform.mode != "floating" and seed > 4:
        body = str(rng.choice(platform.gimbal_names))
        more = {
            "unbalances": (Unbalance(body=body, moment=rng.normal(size=3)),),
            "erections": (Erection(gimbal=platform.gimbal_names[0], senses=body, axis=[0, 0.6, 0.8], gain=0.3),),
        }
        platform = replace(platform, **more)
    n = len(platform.gimbals)
    return platform, rng.uniform(-3, 3, n), rng.normal(size=3 + n), rng.normal(size=3 + n), turned(rng)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_plant_accelerates_as_the_equations_say(seed):
    platform, q, u, force, attitude = drawn(seed)
    n, f = len(q), force_of(platform, attitude)
    acting = force + element_forces(platform, q, u, f)
    expected = forward_dynamics(platform, q, u, acting, specific_force=f)
    found = first_slopes(platform, q, u, force, attitude=attitude)
    np.testing.assert_allclose(found[n:], expected, atol=1e-9 * np.abs(expected).max())
    # A root whose rate is held: the inertial torques of that motion, and the gimbals' own inertia.
    acting -= inverse_dynamics(platform, q, u, np.zeros(n + 3), specific_force=f)
    expected = np.linalg.solve(matrices(platform, q).A_star[3:, 3:], acting[3:])
    found = first_slopes(platform, q, u, force, free=False, attitude=attitude)
    np.testing.assert_allclose(found[n + 3 :], expected, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("seed", range(3))
def test_stuck_joints_of_bodies_with_offsets_stay(seed):
    rng = np.random.default_rng(seed)
    platform = replace(offset_platform(rng, MODES[seed], 4), gravity=np.zeros(3))
    q, u, force = rng.uniform(-3, 3, 4), rng.normal(size=7), rng.normal(size=7)
    k = int(rng.integers(4))
    u[3 + k] = 0.0
    force_left = force - inverse_dynamics(platform, q, u, np.zeros(7))
    stuck = replace(platform, frictions=(Friction(gimbal=platform.gimbal_names[k], coulomb=(1e6, 1e6)),))
    for free in (True, False):
        moving = np.setdiff1d(np.arange(0 if free else 3, 7), 3 + k)
        A = matrices(platform, q).A_star[np.ix_(moving, moving)]
        found = first_slopes(stuck, q, u, force, free)[4:]
        np.testing.assert_allclose(found[moving], np.linalg.solve(A, force_left[moving]), rtol=1e-7, atol=1e-9)
        assert found[3 + k] == pytest.approx(0.0, abs=1e-9)


def conserved(platform, out, k):
    """Return energy and what is constant of the angular momentum, in space, at record k."""
    q, u, R = out.q_history[0, k], out.velocity_history[0, k], rotation(out.attitude_history[0, k])
    m = matrices(platform, q, u)
    momentum = R @ (m.A_star @ u + m.B.T @ m.L)[:3]
    energy = 0.5 * u @ m.A_star @ u
    if platform.mode == "floating":
        return np.r_[energy, momentum]
    g = platform.gravity
    return np.r_[energy - g @ (R @ m.S), momentum @ g / np.linalg.norm(g)]


@pytest.mark.parametrize("mode", ["pivot", "floating"])
def test_energy_and_momentum_are_constant_over_ten_seconds_of_runge_kutta(mode):
    """A camera gimbal's and a rotor's bodies, 10⁵ steps of 1e-4 s: to 1e-10 of what went to and fro."""
    rng = np.random.default_rng(4)
    plant = offset_plant(rng, mode, 3)
    plant["rotor"] = [one | {"spin": 20.0} for one in plant["rotor"]]
    platform = read_platform(plant)
    n = len(platform.gimbals)
    out = rollout(platform, rng.uniform(-1, 1, (1, n)), 0.3 * rng.normal(size=(1, 3 + n)), 1e-4, 100_000, every=10_000)
    values = np.array([conserved(platform, out, k) for k in range(len(out.t))])
    motions = zip(out.q_history[0], out.velocity_history[0], strict=True)
    most = max(0.5 * u @ matrices(platform, q).A_star @ u for q, u in motions)
    assert np.abs(values[:, 0] - values[0, 0]).max() < 1e-10 * most
    assert np.abs(values[:, 1:] - values[0, 1:]).max() < 1e-10 * np.linalg.norm(values[:, 1:], axis=1).max()


def test_a_pendulum_under_gravity_that_is_fixed_in_space_swings_back():
    """A root that hangs 0.5 m under its pivot: the small-angle frequency, which a turning field would not give."""
    m, length, inertia = 2.0, 0.5, 0.02
    plant = {
        "schema": 1,
        "name": "pendulum",
        "root": {"name": "bob", "mode": "pivot", "mass": m, "centre": [0, 0, -length], "gravity": [0, 0, -9.81]}
        | {"inertia": [inertia] * 3},
    }
    omega = np.sqrt(m * 9.81 * length / (inertia + m * length**2))
    steps = round(2 * np.pi / omega / 1e-3)
    out = rollout(read_platform(plant), np.zeros((1, 0)), [[0.01, 0, 0]], 2 * np.pi / omega / steps, steps, every=1)
    np.testing.assert_allclose(out.velocity[0], [0.01, 0, 0], atol=1e-7)
    assert out.velocity_history[0, steps // 2, 0] == pytest.approx(-0.01, rel=1e-4)
