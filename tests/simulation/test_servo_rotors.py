"""Servo rotors in the kernel: against rotors as bodies under another integrator, and as the limit of ideal control."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from plant_parts import Spring, Unbalance
from platform_ctrl import Platform, element_forces, forward_dynamics, inverse_dynamics, matrices
from platform_ctrl.simulation import HalfCosine, rollout
from rotors_as_gimbals import with_rotors_as_gimbals
from single_runs import simulated
from small_trees import tree
from tree_cases import platforms

C = 0.3
SPRINGS = (Spring(gimbal="outer", stiffness=3.0, rest=0.2),)
UNBALANCES = (Unbalance(body="inner", moment=np.array([0.1, 0.05, 0.0])),)


def gyro_on_a_block(control="servo", **loop) -> Platform:
    """A gyro in two gimbals and a reaction wheel on the root; both rotors run the given speed loop."""
    loop = {"control": control, **loop}
    return tree(
        [4.0, 5.0, 6.0],
        [("outer", "block", 3, [0.9, 0.8, 1.0], "alpha"), ("inner", "outer", [1, 0.3, 0], [0.6, 0.5, 0.7], "beta")],
        [("gyro", "inner", [0, 1, 0.2], C, 0.2, 6.0, loop), ("wheel", "block", [1, 1, 1], C, 0.2, -2.0, loop)],
        base="block",
    )


def proportional(bandwidth):
    return {"speed_gain": bandwidth * C}


def integrating(bandwidth):
    """Both poles at the bandwidth."""
    return {"speed_gain": 2.0 * bandwidth * C, "speed_integral": bandwidth**2 * C}


START = {"q": np.array([0.3, -0.4]), "velocity": np.array([0.2, -0.3, 0.1, 0.5, -0.6])}


def driven_bodies(platform, q, velocity, spins, duration, Omega=None):
    """[q, Omega, rates, spins] at the end, rotors being bodies driven by servo motors or by nothing (free rotors).

    With `Omega`, a function of time that returns the root's rate and its derivative, the root is moved that way.
    """
    bodies = with_rotors_as_gimbals(platform)
    n, N = len(platform.gimbals), len(bodies.gimbals)
    servo = [k for k, r in enumerate(platform.rotors) if r.control == "servo"]
    loops = [platform.rotors[k] for k in servo]
    gain, integral, aim = (
        np.array([getattr(r, name) for r in loops]) for name in ("speed_gain", "speed_integral", "spin")
    )
    columns = np.array([N + 3 + n + k for k in servo], dtype=int)

    def motion(t, y):
        q, u, x = y[:N], y[N : 2 * N + 3].copy(), y[2 * N + 3 :]
        error = y[columns] - aim
        if Omega is not None:
            u[:3], turn = Omega(t)
        force = element_forces(bodies, q, u)
        force[columns - N] -= gain * error + integral * x
        if Omega is None:
            faster = forward_dynamics(bodies, q, u, force)
        else:
            moved = np.concatenate([turn, np.zeros(N)])
            needed = inverse_dynamics(bodies, q, u, moved)
            faster = np.concatenate([turn, np.linalg.solve(matrices(bodies, q).A_star[3:, 3:], (force - needed)[3:])])
        return np.concatenate([u[3:], faster, error])

    y = np.concatenate([q, np.zeros(N - n), velocity, spins, np.zeros(len(servo))])
    end = solve_ivp(motion, (0.0, duration), y, method="DOP853", rtol=1e-11, atol=1e-11).y[:, -1]
    return np.concatenate([end[:n], end[N : N + 3 + n], end[columns]])


@settings(max_examples=6, deadline=None)
@given(platforms(max_gimbals=4, controls=("servo", "free")), st.integers(0, 2**32 - 1))
def test_with_a_free_root_servo_rotors_move_as_bodies_driven_by_their_motors(platform, seed):
    rng = np.random.default_rng(seed)
    rotors = tuple(
        dataclasses.replace(r, speed_gain=rng.uniform(0, 20), speed_integral=rng.uniform(0, 200))
        for r in platform.rotors
    )
    springs = tuple(Spring(gimbal=g, stiffness=2.0) for g in platform.gimbal_names)
    platform = dataclasses.replace(platform, rotors=rotors, springs=springs)
    n = len(platform.gimbals)
    q, velocity = rng.normal(size=n), 0.5 * rng.normal(size=n + 3)
    spins = np.array([r.spin for r in rotors]) + rng.normal(size=len(rotors))
    servo = np.array([r.control == "servo" for r in rotors], dtype=bool)
    # A free rotor's momentum is what the given spin makes it.
    carried = matrices(platform, q).B @ velocity
    platform = dataclasses.replace(
        platform,
        rotors=tuple(
            r if r.control == "servo" else dataclasses.replace(r, angular_momentum=C * (s + w))
            for r, s, w in zip(rotors, spins, carried, strict=True)
        ),
    )
    out = rollout(platform, [q], [velocity], step=2.5e-5, steps=4000, spin=[spins[servo]])
    expected = driven_bodies(platform, q, velocity, spins, 0.1)
    got = np.concatenate([out.q[0], out.velocity[0], out.spin[0]])
    np.testing.assert_allclose(got, expected, rtol=1e-7, atol=1e-7)


def test_with_a_prescribed_rate_servo_rotors_move_as_bodies_driven_by_their_motors():
    platform = dataclasses.replace(
        gyro_on_a_block(**integrating(30.0)),
        springs=SPRINGS,
        unbalances=UNBALANCES,
        specific_force=np.array([0.0, 0.0, 9.81]),
    )
    spins, rise, rate = np.array([21.0, -5.0]), 1.2, 0.9
    profile = HalfCosine(axis=2, rate=rate, rise=rise, hold=0.0)

    def Omega(t):
        angle = np.pi * t / rise
        slope = 0.5 * rate * np.pi / rise * np.sin(angle)
        return np.array([0.0, rate * (0.5 - 0.5 * np.cos(angle)), 0.0]), np.array([0.0, slope, 0.0])

    start = {"q": START["q"], "rate": START["velocity"][3:], "spin": spins, "step": 2e-4}
    out = simulated(platform, [], period=0.05, delay=0.0, duration=1.0, mode="caged", profile=profile, **start)
    velocity = np.concatenate([np.zeros(3), START["velocity"][3:]])
    expected = driven_bodies(platform, START["q"], velocity, spins, 1.0, Omega)
    got = np.concatenate([out.q[-1], out.Omega[-1], out.rate[-1], out.rotor_spin[-1]])
    np.testing.assert_allclose(got, expected, rtol=1e-7, atol=1e-7)
    assert out.rotor_spin[0] == pytest.approx(spins)
    assert out.rotor_names == ("gyro", "wheel")


@pytest.mark.parametrize(("mode", "loop", "order"), [("caged", integrating, 2.0), ("stabilised", proportional, 1.0)])
def test_ideal_speed_control_is_the_limit_of_a_fast_loop(mode, loop, order):
    """The trajectories' difference falls like 1/bandwidth, with an integral part like 1/bandwidth²."""
    elements = {"springs": SPRINGS, "unbalances": UNBALANCES, "specific_force": np.array([0.0, 0.0, 9.81])}

    def run(platform):
        platform = dataclasses.replace(platform, **elements)
        start = {"q": START["q"], "rate": START["velocity"][3:], "step": 4e-4}
        out = simulated(platform, [], period=0.02, delay=0.0, duration=1.0, mode=mode, **start)
        return np.hstack([out.q, out.attitude_angles])

    ideal = run(gyro_on_a_block(control="regulated"))
    bandwidths = np.geomspace(60.0, 1500.0, 4)
    difference = [np.abs(run(gyro_on_a_block(**loop(b))) - ideal).max() for b in bandwidths]
    assert difference[-1] > 1e-9
    slopes = -np.diff(np.log(difference)) / np.diff(np.log(bandwidths))
    assert slopes == pytest.approx(order, abs=0.15)
    assert slopes[-1] == pytest.approx(order, abs=0.05)


def spin_up(limit):
    """A wheel on a held root that starts far below its nominal spin."""
    platform = dataclasses.replace(gyro_on_a_block(**integrating(20.0), torque_limit=limit), gimbals=())
    platform = dataclasses.replace(platform, rotors=platform.rotors[1:])
    out = simulated(platform, [], period=0.005, delay=0.0, duration=3.0, mode="caged", spin=[5.0])
    return out, platform.rotors[0]


def test_the_motor_never_gives_more_than_its_limit_and_the_integral_does_not_wind_up():
    limit = 1.5
    out, rotor = spin_up(limit)
    torque, error = out.rotor_torque[:, 0], out.rotor_spin[:, 0] - rotor.spin
    limited = np.abs(torque) >= limit
    assert limited.sum() > 100
    assert np.abs(torque).max() == limit
    # All the way down at the limit, nothing but the torque acts ...
    last = int(np.flatnonzero(limited)[-1])
    assert out.rotor_spin[: last + 1, 0] == pytest.approx(5.0 - limit / C * out.t[: last + 1])
    # ... and the integral has stood still: the loop goes on as if it had started at the limit.
    x = -(torque + rotor.speed_gain * error) / rotor.speed_integral
    assert np.abs(x[last + 1]) < 0.01 * np.abs(error[:last].sum() * 0.005)
    unlimited, _ = spin_up(None)
    entering = limit / rotor.speed_gain
    overshoot = -(unlimited.rotor_spin[:, 0] - rotor.spin).min() / (unlimited.rotor_spin[0, 0] - rotor.spin)
    assert -error.min() == pytest.approx(overshoot * entering, rel=0.05)
