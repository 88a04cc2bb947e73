"""Gimbals at their stops, blows towards them, and dry friction, by momentum, energy and rates."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

import platform_ctrl as pc
from plant_parts import Friction
from platform_ctrl import Platform, simulation
from platform_ctrl.simulation import Scenario
from signal_and_gimbal import PERIOD, J, fault, flown, gain, plant, scenario, within
from small_trees import tree

# Stops.


def bouncing(restitution: float, **more: object) -> Any:
    platform = plant(stops=(-0.05, 0.05), restitution=restitution)
    one = scenario(platform, **({"rate": [0.0, 3.0], "level": 0.0} | more))
    return simulation.simulate(one, [gain()], period=PERIOD)


@pytest.mark.parametrize("restitution", [1.0, 0.7, 0.25, 0.0])
def test_every_bounce_gives_back_its_share_of_the_rate(restitution: float) -> None:
    out = bouncing(restitution, duration=0.2)
    rates = out.rate[:, 1]
    bounces = np.concatenate([[0], np.cumsum(np.abs(np.diff(rates)) > 1e-9)])
    expected = 3.0 * (-restitution) ** bounces
    np.testing.assert_allclose(rates, expected, rtol=1e-12, atol=1e-15)
    assert out.stop_contacts[1] == bounces[-1] == {1.0: 6, 0.7: 3, 0.25: 2, 0.0: 1}[restitution]
    assert np.abs(out.q[:, 1]).max() <= 0.05
    # Between bounces it goes on from the stop, which it has met to a step.
    if restitution == 1.0:
        way = 3.0 * out.t
        folded = np.abs((way - 0.05) % 0.2 - 0.1) - 0.05
        np.testing.assert_allclose(out.q[:, 1], folded, rtol=0, atol=6 * 3.0e-4)


def test_a_pushed_gimbal_bounces_ever_lower_and_comes_to_rest_on_its_stop() -> None:
    # As a ball that falls: heights e², e⁴, ... of the first; at rest after (1 + e)/(1 − e) times the first fall.
    e, push = 0.5, J * 20.0
    out = bouncing(e, level=push, rate=[0.0, 0.0], duration=0.4)
    fall = np.sqrt(2.0 * 0.05 / 20.0)
    alpha = out.q[:, 1]
    at_rest = out.t > fall * (1.0 + 2.0 * e / (1.0 - e)) + 5e-3
    np.testing.assert_array_equal(alpha[at_rest], 0.05)
    np.testing.assert_array_equal(out.rate[at_rest, 1], 0.0)
    first = within(out.t, fall, fall * (1.0 + 2.0 * e))
    assert 0.05 - alpha[first].min() == pytest.approx(e**2 * 0.05, rel=0.02)
    second = within(out.t, fall * (1.0 + 2.0 * e) + 1e-3, fall * (1.0 + 2.0 * e + 2.0 * e**2))
    assert 0.05 - alpha[second].min() == pytest.approx(e**4 * 0.05, rel=0.1)
    assert 5 < out.stop_contacts[1] < 15


def free_gyro(restitution: float, control: str = "regulated") -> Platform:
    """A rotor in two gimbals with stops, on a light platform."""
    stops = {"stops": (np.radians(-10.0), np.radians(8.0)), "restitution": restitution}
    loop = {"control": control} | ({"speed_gain": 1e-3} if control == "servo" else {})
    return tree(
        [[0.010, 0.001, 0.0], [0.001, 0.012, 0.0], [0.0, 0.0, 0.011]],
        [
            ("outer", "case", 3, [6e-4, 5e-4, 7e-4], "q_outer", stops),
            ("inner", "outer", 1, [6e-4, 5e-4, 7e-4], "q_inner", stops),
        ],
        [("R", "inner", [0, 0.6, 0.8], 1.2e-4, 0.7e-4, 1.2e-4 * 200.0, loop)],
        base="case",
    )


def momentum_and_energy(platform: Platform, out: Any) -> tuple[np.ndarray, np.ndarray]:
    """Angular momentum in inertial axes, and the energy that goes with rates: half of v'A*v."""
    rotor = platform.rotors[0]
    apart = dataclasses.replace(platform, rotors=(dataclasses.replace(rotor, control="free"),))
    momentum, energy = [], []
    for k, (q, (w, *axis)) in enumerate(zip(out.q, out.attitude, strict=True)):
        v = np.concatenate([out.Omega[k], out.rate[k]])
        m = pc.matrices(apart, q, v)
        # What the rotor has about its axis: constant if free, else of its spin and its carrier's rate.
        spin = out.rotor_spin[k, 0] if rotor.control == "servo" else rotor.spin
        axial = np.atleast_1d(
            rotor.angular_momentum if rotor.control == "free" else rotor.axial_inertia * (spin + m.B[0] @ v)
        )
        own = (m.A_star @ v + m.B.T @ axial)[:3]
        momentum.append(own + 2.0 * np.cross(axis, np.cross(axis, own) + w * own))
        energy.append(0.5 * v @ pc.matrices(platform, q, v).A_star @ v)
    return np.array(momentum), np.array(energy)


@pytest.mark.parametrize(("restitution", "control"), [(1.0, "regulated"), (0.6, "free"), (0.0, "servo")])
def test_bounces_keep_the_angular_momentum_of_a_free_platform(restitution: float, control: str) -> None:
    platform = free_gyro(restitution, control)
    one = Scenario(
        platform=platform, mode="stabilised", duration=0.1, delay=0.0, rate=np.array([12.0, -9.0]), Omega=np.ones(3)
    )
    out = simulation.simulate(one, [], period=PERIOD, step=5e-5)
    assert out.stop_contacts.min() >= 1
    momentum, energy = momentum_and_energy(platform, out)
    np.testing.assert_allclose(momentum, np.broadcast_to(momentum[0], momentum.shape), rtol=0, atol=1e-9)
    if control == "servo":  # whose motor works
        return
    if restitution == 1.0:
        np.testing.assert_allclose(energy, energy[0], rtol=0.02)
    else:
        assert energy[-1] < 0.9 * energy[0]
        assert np.diff(energy).max() < 1e-3 * energy[0]


def test_a_blow_falls_once_whenever_it_is_due_and_changes_the_momentum_by_its_impulse() -> None:
    platform = plant(stops=(-1.0, 1.0))
    for k in range(1, 100, 7):
        for at, sample in ((k * PERIOD, k), ((k - 0.3) * PERIOD, k)):
            blow = fault("stop contact", part="g", at=at, until=np.inf, impulse=3e-3)
            out = simulation.simulate(scenario(platform, faults=(blow,)), [], period=PERIOD, step=PERIOD)
            np.testing.assert_array_equal(out.p[:, 1], np.where(np.arange(101) < sample, 0.0, 3e-3))


# Friction.


def test_a_gimbal_sticks_up_to_the_breakaway_torque_and_slips_on_less() -> None:
    coulomb, breakaway, slow, stribeck = 1e-3, 2e-3, 1e-3, 0.01
    friction = Friction(
        gimbal="g", coulomb=(coulomb,) * 2, breakaway=(breakaway,) * 2, coulomb_rate=slow, stribeck_rate=stribeck
    )
    platform = dataclasses.replace(plant(), frictions=(friction,))
    # Between the two levels it creeps where it is, or goes on.
    resting = flown(platform, level=1.5e-3).rate[50:, 1]
    dry = coulomb + (breakaway - coulomb) * np.exp(-((resting / stribeck) ** 2))
    np.testing.assert_allclose(dry * np.tanh(resting / slow), 1.5e-3, rtol=1e-6)
    assert resting.max() < 1.1 * slow
    moving = flown(platform, level=1.5e-3, rate=[0.0, 1.0])
    np.testing.assert_allclose(moving.rate[:, 1], 1.0 + 0.5e-3 / J * moving.t, rtol=1e-9)
    # A torque that rises evenly: it is stuck until that is the breakaway torque, and then ever faster.
    rising = flown(platform, level=0.0, slope=0.1)
    assert np.abs(rising.rate[rising.t < 0.018, 1]).max() < 2.0 * slow
    slipping = rising.t > 0.07
    assert rising.rate[slipping, 1].min() > 5.0 * stribeck
    accelerations = np.diff(rising.rate[slipping, 1]) / PERIOD
    np.testing.assert_allclose(J * accelerations, rising.torque[slipping, 0][:-1] - coulomb, rtol=0, atol=1e-9)


def test_on_a_guided_platform_a_gimbal_stands_still_until_the_torque_reaches_breakaway() -> None:
    friction = Friction(gimbal="g", coulomb=(1e-3,) * 2, breakaway=(2e-3,) * 2, stribeck_rate=0.01)
    platform = dataclasses.replace(plant(), frictions=(friction,))
    resting = flown(platform, level=1.9e-3)
    assert np.ptp(resting.q[:, 1]) == 0.0
    assert np.abs(resting.rate[:, 1]).max() < 1e-12
    # A torque that rises by 0.1 N m/s reaches 2 mN m after 20 ms; then it is left with that of sliding.
    rising = flown(platform, level=0.0, slope=0.1)
    moving = rising.t[np.abs(rising.rate[:, 1]) > 1e-9]
    assert moving[0] == pytest.approx(0.02, abs=2.0 * PERIOD)
    slipping = rising.t > 0.07
    accelerations = np.diff(rising.rate[slipping, 1]) / PERIOD
    np.testing.assert_allclose(J * accelerations, rising.torque[slipping, 0][:-1] - 1e-3, rtol=0, atol=1e-6)


def test_a_gimbal_with_sticking_friction_comes_to_rest_at_its_stop() -> None:
    friction = Friction(gimbal="g", coulomb=(1e-3,) * 2)
    platform = dataclasses.replace(plant(stops=(-0.001, 0.001)), frictions=(friction,))
    out = flown(platform, level=1.5e-3)
    np.testing.assert_allclose(out.q[-1, 1], 0.001, atol=1e-9)
    assert np.abs(out.rate[-10:, 1]).max() < 1e-9
