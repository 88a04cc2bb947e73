"""The compiled plant with masses, offsets and geared motors: the mechanics' equations, locked joints, conservation."""

from dataclasses import replace

import numpy as np
import pytest

from kernel_entries import derivatives, momenta, state_derivative, whole_state
from mechanics.test_compliance import drive
from offset_trees import MODES, offset_plant, offset_platform, turned
from oracle_trees import rotation
from plant_parts import Erection, Unbalance
from platform_ctrl import element_forces, forward_dynamics, linearise, matrices, read_platform, state_space
from platform_ctrl.mechanics.kinematics import kinematics
from platform_ctrl.mechanics.matrices import derivatives as slopes_of
from platform_ctrl.plant.locking import with_locked
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
def test_a_free_root_accelerates_as_the_equations_say(seed):
    platform, q, u, force, attitude = drawn(seed)
    n = len(q)
    state = np.concatenate([q, u, attitude])
    found = derivatives(platform, state, force)[0]
    f = force_of(platform, attitude)
    elements = element_forces(platform, q, u, f)
    expected = forward_dynamics(platform, q, u, force + elements, specific_force=f)
    np.testing.assert_allclose(found[n : 2 * n + 3], expected, atol=1e-9 * np.abs(expected).max())
    np.testing.assert_allclose(found[:n], u[3:])


@pytest.mark.parametrize("seed", SEEDS)
def test_a_held_root_gives_momenta_their_rates_and_changes(seed):
    """ṗ = Q + ∂T/∂q − (∂S/∂q)ᵀf: neither Omega' nor f' is needed."""
    platform, q, u, force, attitude = drawn(seed)
    n, m = len(q), matrices(platform, q, u)
    whole = m.A_star @ u + m.B.T @ m.L
    np.testing.assert_allclose(momenta(platform, whole_state(q, u))[0], whole, atol=1e-10 * np.abs(whole).max())
    state = np.concatenate([q, u[:3], whole[3:], attitude])
    found = derivatives(platform, state, force, free=False)[0]
    f = force_of(platform, attitude)
    slope, weight = slopes_of(kinematics(platform, q)), m.P[:, 3:].T @ f * (platform.mode != "floating")
    change = 0.5 * np.einsum("a,jab,b->j", u, slope.A_star, u) + np.einsum("jra,r,a->j", slope.B, m.L, u)
    change += force[3:] + element_forces(platform, q, u, f)[3:] - weight
    np.testing.assert_allclose(found[:n], u[3:], atol=1e-8 * np.abs(u).max())
    np.testing.assert_allclose(found[n + 3 : 2 * n + 3], change, atol=1e-9 * np.abs(change).max())


@pytest.mark.parametrize("seed", range(3))
def test_locked_joints_of_bodies_with_offsets_stay(seed):
    rng = np.random.default_rng(seed)
    platform = replace(offset_platform(rng, MODES[seed], 4), gravity=np.zeros(3))
    q, u, force = rng.uniform(-3, 3, 4), rng.normal(size=7), rng.normal(size=7)
    k = int(rng.integers(4))
    u[3 + k], moving = 0.0, np.delete(np.arange(7), 3 + k)
    A = matrices(platform, q).A_star[np.ix_(moving, moving)]
    bias = matrices(platform, q).A_star @ forward_dynamics(platform, q, u, np.zeros(7))
    rates, acceleration = state_derivative(platform, q, u, force, held=[k])
    np.testing.assert_allclose(acceleration[moving], np.linalg.solve(A, (force + bias)[moving]), rtol=1e-7, atol=1e-9)
    assert (rates[k], acceleration[3 + k]) == (0.0, 0.0)
    p = momenta(platform, whole_state(q, u))[0][3:]
    p[k] = 1e3
    rates, _ = state_derivative(platform, q, np.r_[u[:3], p], force, free=False, held=[k])
    np.testing.assert_allclose(rates, u[3:], atol=1e-9)


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


@pytest.mark.parametrize("seed", SEEDS)
def test_a_locked_gimbal_is_a_part_of_its_parent(seed):
    rng = np.random.default_rng(seed)
    platform = offset_platform(rng, MODES[seed % 3], 4)
    locked = rng.choice(platform.gimbal_names)
    rest = with_locked(platform, [locked])
    kept = [k for k, name in enumerate(platform.gimbal_names) if name != locked]
    q = np.zeros(4)
    q[kept] = rng.uniform(-3, 3, 3)
    rows = [0, 1, 2, *(3 + k for k in kept)]
    u = np.zeros(7)
    u[rows] = rng.normal(size=6)
    whole, part = matrices(platform, q, u), matrices(rest, q[kept], u[rows])
    for found, expected in (
        (part.A_star, whole.A_star[np.ix_(rows, rows)]),
        (part.P, whole.P[:, rows]),
        (part.G_A @ u[rows], (whole.G_A @ u)[rows]),
    ):
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11 * np.abs(expected).max(initial=1e-12))
    assert read_platform(rest).to_toml() == rest.to_toml()


def test_a_motor_side_that_is_locked_holds_its_load_by_the_drive():
    platform, J2 = read_platform(drive()), 0.05
    held = with_locked(platform, ["g_motor"])
    assert held.gimbal_names == ("g", "h")
    poles = state_space(linearise(held)).poles()
    assert np.abs(poles).max() == pytest.approx(np.sqrt(300.0 / (J2 + 1e-9)), rel=1e-9)
    assert -2.0 * poles.real.min() * J2 == pytest.approx(0.04, rel=1e-6)
    assert with_locked(platform, ["g", "g_motor"]).gimbal_names == ("h",)
