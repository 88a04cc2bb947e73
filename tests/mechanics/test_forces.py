"""Springs, friction, cages, unbalance, erection: torques from energy and statics, slopes from differences."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from body_geometry import directions
from plant_parts import Friction, Unbalance
from platform_ctrl import element_forces, forward_dynamics, inverse_dynamics, linearise, read_platform, state_space
from tree_cases import platforms, slope, with_elements

quick = settings(max_examples=15, deadline=None)
seeds = st.integers(0, 2**32 - 1)


@quick
@given(platforms(max_gimbals=5), seeds)
def test_the_slopes_in_the_linear_model_are_those_of_the_torques(platform, seed):
    rng = np.random.default_rng(seed)
    smooth = with_elements(platform, rng)
    n = len(platform.gimbals)
    q = rng.uniform(-1, 1, n)
    model = linearise(smooth, q=q)
    by_angle = slope(lambda x: element_forces(smooth, x), q)
    np.testing.assert_allclose(model.Q_angle, by_angle[3:], atol=2e-8)
    np.testing.assert_allclose(model.M_angle, by_angle[:3], atol=2e-8)
    by_rate = slope(lambda r: element_forces(smooth, q, np.concatenate([np.zeros(3), r])), np.zeros(n))
    np.testing.assert_allclose(model.Q_rate, by_rate[3:], atol=1e-8)
    by_force = slope(lambda f: element_forces(smooth, q, specific_force=f), smooth.specific_force)
    np.testing.assert_allclose(model.Q_force, by_force[3:], atol=1e-8)
    np.testing.assert_allclose(model.M_force, by_force[:3], atol=1e-8)


@quick
@given(platforms(max_gimbals=5), seeds)
def test_the_trim_torques_balance_the_elements(platform, seed):
    """Q0 of the linear model, with the elements, keeps the gimbals where they are while the root turns."""
    rng = np.random.default_rng(seed)
    platform = with_elements(platform, rng)
    n = len(platform.gimbals)
    q, Omega = rng.uniform(-1, 1, n), rng.normal(size=3)
    model = linearise(platform, Omega=Omega, q=q)
    still = np.concatenate([Omega, np.zeros(n)])
    needed = inverse_dynamics(platform, q, still, np.zeros(3 + n)) - element_forces(platform, q, still)
    np.testing.assert_allclose(model.Q0, needed[3:], atol=1e-10 * (1 + np.abs(needed).max()))


@quick
@given(platforms(max_gimbals=5), seeds)
def test_unbalance_turns_by_the_gradient_of_its_potential(platform, seed):
    """V = f·Σ R m r: the joint torques are −∂V/∂q."""
    rng = np.random.default_rng(seed)
    bodies = (platform.root_name, *platform.gimbal_names)
    moments = rng.normal(size=(len(bodies), 3))
    f = rng.normal(size=3)
    loaded = dataclasses.replace(
        platform,
        unbalances=tuple(Unbalance(body=b, moment=m) for b, m in zip(bodies, moments, strict=True)),
        specific_force=f,
    )

    def potential(q):
        at = directions(platform, q)
        return np.array([f @ np.einsum("bij,bj->i", at.rotations, moments)])

    q = rng.uniform(-3, 3, len(platform.gimbals))
    torque = element_forces(loaded, q)
    np.testing.assert_allclose(torque[3:], -slope(potential, q)[0], atol=1e-8)
    at = directions(platform, q)
    whole = np.einsum("bij,bj->i", at.rotations, moments)
    np.testing.assert_allclose(torque[:3], np.cross(f, whole), atol=1e-12 * (1 + np.abs(whole).max()))


def pendulum(**more):
    """A plate on one axis, its centre of mass hanging below."""
    return read_platform(
        {
            "schema": 1,
            "name": "pendulum",
            "root": {"name": "base", "inertia": [1, 1, 1], "specific_force": [0, 0, 9.81]},
            "gimbal": [{"name": "arm", "parent": "base", "axis": [1, 0, 0], "inertia": [0.02, 0.02, 0.01]}],
            "torquer": [{"gimbal": "arm"}],
            **more,
        }
    )


def test_a_hanging_pendulum_swings_with_the_root_of_m_g_r_over_J():
    platform = pendulum(unbalance=[{"body": "arm", "moment": [0, 0, -0.05]}])
    poles = state_space(linearise(platform)).poles()
    np.testing.assert_allclose(np.abs(poles.imag), np.sqrt(0.05 * 9.81 / 0.02), rtol=1e-12)
    assert forward_dynamics(platform, [0.1], np.zeros(4), element_forces(platform, [0.1]))[3] < 0  # it falls back


def test_horizontal_acceleration_enters_as_specific_force():
    platform = pendulum(unbalance=[{"body": "arm", "moment": [0, 0, -0.05]}])
    sys = state_space(linearise(platform), specific_force=True)
    assert sys.input_labels[-3:] == ["f1", "f2", "f3"]
    # It hangs along the apparent vertical: f2/g to first order, with f pointing up.
    np.testing.assert_allclose(sys["q_arm", "f2"].dcgain(), -1 / 9.81, rtol=1e-12)
    free = state_space(linearise(platform), root="free", specific_force=True)
    assert free.input_labels == ["Qarm", "M1", "M2", "M3", "f1", "f2", "f3"]


def lost_per_squared_rate(friction, amplitude):
    """Mean power that friction takes from an oscillation of that rate, over the mean square of the rate."""
    rates = amplitude * np.cos((np.arange(20000) + 0.5) * 2 * np.pi / 20000)
    lost = np.mean([(friction.viscous * rate + friction.dry(rate)) * rate for rate in rates])
    return lost / np.mean(rates**2)


def test_friction_opposes_and_dry_friction_differs_by_side():
    platform = pendulum(friction=[{"gimbal": "arm", "viscous": 0.5, "coulomb": [0.2, 0.3], "coulomb_rate": 0.01}])
    torque = [element_forces(platform, [0.0], [0, 0, 0, rate])[3] for rate in (-1.0, 0.0, 1.0)]
    np.testing.assert_allclose(torque, [0.7, 0.0, -0.8], rtol=1e-12)
    assert linearise(platform).Q_rate[0, 0] == -0.5
    # An oscillation of amplitude V loses 4 V F per cycle to dry friction of mean F, pi V² d / omega to a viscous one.
    equivalent = linearise(platform, rate_amplitude=[2.0]).Q_rate[0, 0]
    assert equivalent == pytest.approx(-lost_per_squared_rate(platform.frictions[0], 2.0), rel=1e-3)


STRIBECK = {"gimbal": "arm", "coulomb": [0.2, 0.3], "breakaway": [0.5, 0.4], "stribeck_rate": 0.3, "coulomb_rate": 1e-4}


def arm_friction(**numbers):
    """The friction torque as a function of rates, alone on an arm."""
    platform = pendulum(friction=[STRIBECK | numbers])
    return lambda rates: np.array([element_forces(platform, [0.0], [0, 0, 0, r])[3] for r in np.atleast_1d(rates)])


def test_friction_begins_with_breakaway_and_falls_to_coulomb():
    torque = arm_friction()
    begin = 0.3 * 0.01
    np.testing.assert_allclose(torque([-begin, begin]), [0.5, -0.4], rtol=2e-4)
    np.testing.assert_allclose(torque([-30.0, 30.0, -1e300, 1e300]), [0.2, -0.3] * 2, rtol=1e-14)
    # At the Stribeck rate 1/e of the difference is left.
    np.testing.assert_allclose(torque([-0.3, 0.3]), [0.2 + 0.3 / np.e, -0.3 - 0.1 / np.e], rtol=1e-14)


@quick
@given(
    *(st.floats(0, 1e3).map(lambda x: round(x, 9)) for _ in range(4)),
    st.floats(1e-6, 1e3),
    st.floats(1e-6, 1e3),
    st.floats(-1e9, 1e9),
)
def test_friction_always_dissipates_and_never_exceeds_breakaway(low, high, more, viscous, sharp, stribeck, rate):
    friction = Friction(
        gimbal="arm",
        viscous=viscous,
        coulomb=(low, high),
        breakaway=(low + more, high + 2 * more),
        coulomb_rate=sharp,
        stribeck_rate=stribeck,
    )
    dry = friction.dry(rate)
    assert dry * rate >= 0.0
    assert abs(dry) <= friction.breakaway[int(rate >= 0.0)] * (1 + 1e-12)


@pytest.mark.parametrize("amplitude", [1e-9, 0.05, 0.3, 2.0, 50.0])
def test_the_describing_function_takes_what_a_stribeck_curve_takes(amplitude):
    smooth = 1e-6 * amplitude
    platform = pendulum(friction=[STRIBECK | {"viscous": 0.5, "coulomb_rate": smooth}])
    equivalent = linearise(platform, rate_amplitude=[amplitude]).Q_rate[0, 0]
    assert equivalent == pytest.approx(-lost_per_squared_rate(platform.frictions[0], amplitude), rel=1e-6)


def test_a_cage_with_play_pushes_and_never_pulls():
    cage = {"gimbal": "arm", "stiffness": 100.0, "damping": 1.0, "clearance": 0.01, "angle": 0.1}
    platform = pendulum(cage=[cage])
    torque = {q: element_forces(platform, [q])[3] for q in (0.095, 0.105, 0.12, 0.07)}
    assert torque[0.095] == torque[0.105] == 0.0
    assert torque[0.12] == pytest.approx(-1.0)
    assert torque[0.07] == pytest.approx(2.0)
    assert element_forces(platform, [0.12], [0, 0, 0, -5.0])[3] == 0.0  # leaving fast: contact lost, no pull
    assert element_forces(platform, [0.12], [0, 0, 0, 5.0])[3] == pytest.approx(-6.0)
    assert linearise(platform, q=[0.1]).stiffness[0, 0] == 0.0
    assert linearise(platform, q=[0.12]).stiffness[0, 0] == 100.0


def test_an_erection_stops_at_its_limit_and_has_no_slope_there():
    device = {"gimbal": "arm", "senses": "arm", "axis": [0, 1, 0], "gain": 2.0, "limit": 0.1}
    platform = pendulum(erection=[device])
    assert element_forces(platform, [0.01])[3] == pytest.approx(2.0 * np.sin(0.01))
    assert element_forces(platform, [0.5])[3] == 0.1
    assert linearise(platform).Q_angle[0, 0] == pytest.approx(2.0)
    assert linearise(platform, q=[0.5]).Q_angle[0, 0] == 0.0
    assert element_forces(platform, [0.5], specific_force=[0, 0, 0])[3] == 0.0
