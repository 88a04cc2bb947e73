"""Dry friction in runs: joints that stick, bristles, and their describing functions against independent integration."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import platform_ctrl as pc
from platform_ctrl import simulation

J = 0.02
COULOMB, BREAKAWAY, STRIBECK = 0.05, 0.08, 0.05


def bearing(**friction):
    """One gimbal on a root that hardly moves."""
    gimbal = {"name": "g", "parent": "base", "axis": [0, 0, 1], "inertia": [0.01, 0.01, J]}
    root = {"name": "base", "inertia": [1e9, 1e9, 1e9]}
    friction = {"gimbal": "g", "coulomb": COULOMB} | friction
    return pc.read_platform({"schema": 1, "name": "bearing", "root": root, "gimbal": [gimbal], "friction": [friction]})


def run(platform, torque, seconds, rate=0.0, step=1e-3, **options):
    force = [[0.0] * 3 + [torque]]
    steps = round(seconds / step)
    return simulation.rollout(platform, [[0.0]], [[0, 0, 0, rate]], step=step, steps=steps, force=force, **options)


@pytest.mark.parametrize("share", [0.25, 0.9, -0.999])
def test_below_breakaway_a_gimbal_does_not_move_in_an_hour(share):
    out = run(bearing(breakaway=BREAKAWAY, stribeck_rate=STRIBECK), share * BREAKAWAY, 3600.0, step=5e-3)
    assert out.q[0, 0] == 0.0
    assert abs(out.velocity[0, 3]) < 1e-12


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_above_breakaway_it_moves_with_the_stribeck_curve(side):
    out = run(bearing(breakaway=BREAKAWAY, stribeck_rate=STRIBECK), side * 1.01 * BREAKAWAY, 2.0, step=1e-4)

    def motion(t, y):
        level = COULOMB + (BREAKAWAY - COULOMB) * math.exp(-((y[1] / STRIBECK) ** 2))
        return [y[1], (1.01 * BREAKAWAY - level) / J]

    truth = solve_ivp(motion, (0.0, 2.0), [0.0, 0.0], rtol=1e-10, atol=1e-12).y[:, -1]
    assert out.q[0, 0] == pytest.approx(side * truth[0], rel=2e-3)
    assert out.velocity[0, 3] == pytest.approx(side * truth[1], rel=2e-3)


def test_two_sides_of_friction_hold_different_loads():
    platform = bearing(coulomb=[0.02, COULOMB])
    assert run(platform, 0.04, 1.0).q[0, 0] == 0.0
    assert run(platform, -0.04, 1.0).q[0, 0] < -0.1


def test_a_gimbal_that_coasts_stops_after_its_energy_is_spent_and_stays():
    out = run(bearing(), 0.0, 2.0, rate=2.0, every=100)
    np.testing.assert_allclose(out.q[0, 0], J * 4.0 / 2.0 / COULOMB, rtol=1e-6)
    stopped = out.t > J * 2.0 / COULOMB + 1e-3
    assert np.ptp(out.q_history[0, stopped, 0]) == 0.0


def test_stuck_joints_carry_each_other_and_momentum_balances():
    # Two bearings on one axis and a light base: what turns the outer one turns all.
    gimbals = [
        {"name": "a", "parent": "base", "axis": [0, 0, 1], "inertia": [0.01, 0.01, 0.02]},
        {"name": "b", "parent": "a", "axis": [0, 0, 1], "inertia": [0.01, 0.01, 0.01]},
    ]
    frictions = [{"gimbal": name, "coulomb": 0.05} for name in "ab"]
    root = {"name": "base", "inertia": [0.03, 0.03, 0.03]}
    platform = pc.read_platform(
        {"schema": 1, "name": "two", "root": root, "gimbal": gimbals, "friction": frictions},
    )
    out = simulation.rollout(platform, [[0.0, 0.0]], [[0.0] * 5], steps=1000, force=[[0, 0, 0.03, 0, 0]])
    np.testing.assert_array_equal(out.q, 0.0)
    np.testing.assert_allclose(out.velocity[0, 2], 0.03 / 0.06, rtol=1e-9)
    # Torques between the bodies are inner ones.
    inner = simulation.rollout(platform, [[0.0, 0.0]], [[0.0] * 5], steps=1000, force=[[0, 0, 0, 0.09, -0.02]])
    rates = inner.velocity[0, 2:]
    momentum = np.array([0.03, 0.02, 0.01]) @ np.cumsum(rates)
    assert abs(momentum) < 1e-12
    assert inner.q[0, 1] == 0.0
    assert inner.q[0, 0] > 0.1


BRISTLES = {"breakaway": BREAKAWAY, "stribeck_rate": STRIBECK, "bristle_stiffness": 200.0, "bristle_damping": 0.2}


def lugre(elastic, torque, seconds, viscous, start=(0.0, 0.0, 0.0)):
    """Integrate LuGre's equations as they stand, by an implicit method."""
    s0, s1 = 200.0, 0.2

    def motion(t, y):
        _, v, z = y
        level = COULOMB + (BREAKAWAY - COULOMB) * math.exp(-((v / STRIBECK) ** 2))
        alpha = 1.0
        if elastic:
            u = min(max((math.copysign(z, v * z) * s0 / level - 0.85) / 0.15, 0.0), 1.0)
            alpha = 0.5 - 0.5 * math.cos(math.pi * u)
        dz = v - alpha * s0 * abs(v) / level * z
        return [v, (torque(t) - s0 * z - s1 * dz - viscous * v) / J, dz]

    return solve_ivp(motion, (0.0, seconds), start, method="Radau", rtol=1e-9, atol=1e-13).y[:, -1]


@pytest.mark.parametrize("elastic", [False, True])
@pytest.mark.parametrize("load", [0.4, 0.9, 1.3])
def test_bristles_move_as_their_equations_say(elastic, load):
    platform = bearing(viscous=0.3, elastoplastic=elastic, **BRISTLES)
    out = run(platform, load * BREAKAWAY, 1.0, step=1e-4)
    truth = lugre(elastic, lambda t: load * BREAKAWAY, 1.0, 0.3)
    np.testing.assert_allclose([out.q[0, 0], out.velocity[0, 3]], truth[:2], rtol=2e-4, atol=1e-9)


def test_bristles_allow_any_rate_in_a_step():
    # An explicit step of the bristles explodes above 2.8 times coulomb/(stiffness step) = 0.7 rad/s.
    out = run(bearing(viscous=0.0, **BRISTLES), 0.0, 1.0, rate=20.0)
    np.testing.assert_allclose(out.velocity[0, 3], 20.0 - COULOMB / J, rtol=1e-3)


def test_elastoplastic_bristles_stand_under_a_load_below_their_limit_and_lugre_walks():
    # Creep from one hour to the next, after the first has brought the bristles to rest.
    for elastic, moved in ((True, 0.0), (False, 1e-4)):
        platform = bearing(viscous=0.3, elastoplastic=elastic, **BRISTLES)
        out = run(platform, 0.4 * BREAKAWAY, 20.0, every=1000)
        late = out.q_history[0, out.t >= 10.0, 0]
        assert np.ptp(late) <= moved + 1e-12
        if elastic:
            np.testing.assert_allclose(late[-1], 0.4 * BREAKAWAY / 200.0, rtol=1e-9)


def test_before_sliding_a_body_swings_on_its_bristles():
    # sqrt(sigma0/J) = 100 rad/s, hardly damped by a small sigma1.
    weak = BRISTLES | {"bristle_damping": 1e-3}
    out = run(bearing(elastoplastic=True, **weak), 0.02 * BREAKAWAY, 2.0, step=1e-4, every=1)
    q = out.q_history[0, :, 0] - 0.02 * BREAKAWAY / 200.0
    crossings = out.t[1:][(q[1:] >= 0) & (q[:-1] < 0)]
    period = np.diff(crossings).mean()
    assert 2.0 * math.pi / period == pytest.approx(100.0, rel=1e-3)


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"bristle_damping": 0.1}, "bristle_damping = 0.1 has no effect without"),
        ({"elastoplastic": True}, "elastoplastic = true has no effect without"),
        ({"bristle_stiffness": 10.0, "coulomb_rate": 0.1}, "coulomb_rate = 0.1 has no effect with"),
        ({"bristle_stiffness": 10.0, "coulomb": [0.0, 0.1]}, "coulomb must be > 0 to either side"),
    ],
)
def test_a_friction_with_keys_that_do_not_fit_is_refused(keys, words):
    with pytest.raises(pc.PlatformCtrlError, match=words):
        bearing(**keys)
