"""Regulated and free rotors, their momenta, and rotors as bodies of their own."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from platform_ctrl import (
    inverse_dynamics,
    matrices,
    read_platform,
    rotor_momenta,
    with_free_rotors,
    with_regulated_rotors,
)
from rotors_as_gimbals import with_rotors_as_gimbals
from tree_cases import platforms, state

quick = settings(max_examples=15, deadline=None)
seeds = st.integers(0, 2**32 - 1)


def drives(platform):
    """Indices of the rotors' rows when rotors are gimbals."""
    return 3 + len(platform.gimbals) + np.arange(len(platform.rotors))


@quick
@given(platforms(), seeds)
def test_p_is_L_plus_what_the_carrier_adds(platform, seed):
    q, u, _ = state(platform, seed)
    m, now = matrices(platform, q, u), rotor_momenta(platform, q, u)
    C = np.diag(m.A_R)
    np.testing.assert_allclose(now.p, now.L + C * (m.B @ u), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(now.L, C * now.spin)
    np.testing.assert_allclose(now.p, C * now.rate)
    for rotor, L, p in zip(platform.rotors, now.L, now.p, strict=True):
        assert rotor.angular_momentum == pytest.approx(p if rotor.control == "free" else L, rel=1e-12)


@quick
@given(platforms(), seeds)
def test_taking_the_drives_off_and_on_again_changes_nothing_at_that_state(platform, seed):
    q, u, _ = state(platform, seed)
    free = with_free_rotors(platform, q, u)
    again = with_regulated_rotors(free, q, u)
    for one in (free, again):
        np.testing.assert_allclose(rotor_momenta(one, q, u).L, rotor_momenta(platform, q, u).L, atol=1e-11)
    # All momenta of the platform are those of one motion: A u + B' p = A* u + B' L.
    as_free, as_held = matrices(free, q, u), matrices(again, q, u)
    np.testing.assert_allclose(
        as_free.A_star @ u + as_free.B.T @ as_free.L, as_held.A_star @ u + as_held.B.T @ as_held.L, atol=1e-10
    )


@quick
@given(platforms(), seeds)
def test_rotors_as_bodies_need_the_same_torques(platform, seed):
    """(11) and (7) against rotors that are gimbals: no drive torque on free ones, constant spin of regulated ones."""
    q, u, u_dot = state(platform, seed)
    bodies = with_rotors_as_gimbals(platform)
    now = rotor_momenta(platform, q, u)
    m, n = len(platform.rotors), len(platform.gimbals)
    phi, spinning = np.linspace(-2, 2, m), np.concatenate([u, now.spin])
    angles = np.concatenate([q, phi])
    rows = drives(platform)
    free = np.array([r.control == "free" for r in platform.rotors], dtype=bool)
    none = np.zeros(m)
    torque = inverse_dynamics(bodies, angles, spinning, np.concatenate([u_dot, none]))
    mass = matrices(bodies, angles).A_star
    change = none.copy()
    change[free] = -torque[rows][free] / np.diag(mass)[rows][free]
    torque = inverse_dynamics(bodies, angles, spinning, np.concatenate([u_dot, change]))
    np.testing.assert_allclose(torque[rows][free], 0.0, atol=1e-9)
    size = 1 + np.abs(torque).max() + np.abs(now.spin).max(initial=0.0) ** 2
    np.testing.assert_allclose(inverse_dynamics(platform, q, u, u_dot), torque[: 3 + n], atol=1e-12 * size)


def test_a_rotor_that_is_no_servo_any_more_has_no_speed_loop():
    wheel = {"name": "w", "carrier": "base", "axis": [0, 0, 1], "axial_inertia": 1, "transverse_inertia": 1, "spin": 5}
    loop = {"control": "servo", "speed_gain": 1.0, "speed_integral": 2.0, "torque_limit": 3.0}
    data = {"schema": 1, "name": "wheel", "root": {"name": "base", "inertia": [1, 1, 1]}, "rotor": [wheel | loop]}
    for changed in (with_free_rotors, with_regulated_rotors):
        rotor = changed(read_platform(data), velocity=[0, 0, 1]).rotors[0]
        assert (rotor.speed_gain, rotor.speed_integral, rotor.torque_limit) == (0.0, 0.0, None)
        assert rotor.spin == (6.0 if rotor.control == "free" else 5.0)
