"""Real devices: every model reads and works, and published equations are met."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import platform_ctrl as pc
from platform_ctrl import platform_source
from rotors_as_gimbals import with_rotors_as_gimbals


def plant_of(name: str) -> dict:
    return tomllib.loads(platform_source(name))


# ECP 750


def test_the_inertias_of_the_ecp_add_up_to_the_published_sums() -> None:
    model = pc.linearise(pc.read_platform("ecp_750"))
    assert model.gimbal_names == ("A", "B", "C")
    assert np.diag(model.M) == pytest.approx([0.1335, 0.0178 + 0.0230 + 0.0273, 0.0240])
    L = 0.0273 * 400.0 * np.pi / 30.0
    assert np.abs(model.G) == pytest.approx(np.array([[0, 0, L], [0, 0, 0], [L, 0, 0]]))
    assert np.diag(model.Q_rate) == pytest.approx([-0.0027, -0.0027, -0.0118])


def test_the_misprinted_inertia_of_ring_b_is_refused() -> None:
    plant = plant_of("ecp_750")
    assert plant["gimbal"][1]["name"] == "B"
    plant["gimbal"][1]["inertia"] = [0.0119, 0.012, 0.0297]
    with pytest.raises(pc.PlatformCtrlError, match="no body has it"):
        pc.read_platform(plant)


def test_dry_friction_of_axis_2_is_stronger_against_positive_rates() -> None:
    ecp = pc.read_platform("ecp_750")
    forward, back = (pc.element_forces(ecp, velocity=[0, 0, 0, 0, 0, rate])[5] for rate in (0.5, -0.5))
    assert forward == pytest.approx(-0.0472 - 0.0118 * 0.5)
    assert back == pytest.approx(0.01351 + 0.0118 * 0.5)


# Quanser 3-DOF gyroscope


@pytest.mark.parametrize(("q2", "q3"), [(0.0, 0.0), (0.7, 0.0), (-0.4, 1.1), (2.0, -0.9)])
def test_the_letters_of_the_quanser_gyroscope_stand_where_the_published_mass_matrix_has_them(
    q2: float, q3: float
) -> None:
    Ka, Kb, Kc, Ib, Ic, Id = 0.0375, 0.0213, 0.0027, 0.0037, 0.0010, 0.0028
    Jb, Jc, Jd, w1 = 0.0179, 0.0018, 0.0056, 750.0 * np.pi / 30.0
    p1, p2, p3, p4 = np.cos(q2), np.sin(q2), np.cos(q3), np.sin(q3)
    I1, I2, I3, I4, I5 = Ic + Id, Jb + Jc + Jd, Id + Ka + Kb + Kc, Id - Jc - Jd + Kc, Ib + Ic - Kb - Kc
    published = np.array(  # rows and columns: disk, blue, red, silver
        [
            [Jd, 0.0, Jd * p1, Jd * p2 * p3],
            [0.0, I1, 0.0, -I1 * p4],
            [Jd * p1, 0.0, I4 * p2**2 + I2, -I4 * p1 * p2 * p3],
            [Jd * p2 * p3, -I1 * p4, -I4 * p1 * p2 * p3, I4 * p2**2 * p4**2 - I4 * p2**2 + I5 * p4**2 + I3],
        ]
    )
    gyro = pc.read_platform("quanser_3dof_gyroscope")
    order = [3 + 3, 3 + 2, 3 + 1, 3 + 0]
    A = pc.matrices(with_rotors_as_gimbals(gyro), [0.3, q3, q2, 0.0]).A
    assert A[np.ix_(order, order)] == pytest.approx(published, abs=1e-15)
    # The published Coriolis matrix at rest, but for the disk: what this package calls G.
    blue_red, blue_silver, red_silver = Jd * p2 * w1, -Jd * p1 * p3 * w1, Jd * p2 * p4 * w1
    expected = np.array([[0, blue_red, blue_silver], [-blue_red, 0, red_silver], [-blue_silver, -red_silver, 0]])
    G = pc.linearise(gyro, q=[0.3, q3, q2]).G[::-1, ::-1]
    assert pytest.approx(expected, abs=1e-15) == G


def test_the_disk_leaves_the_frame_alone_that_it_spins_about() -> None:
    gyro = pc.read_platform("quanser_3dof_gyroscope")
    for q2, left_alone in ((0.0, "b"), (np.pi / 2, "a")):
        model = pc.linearise(gyro, q=[0.0, 0.0, q2])
        k = model.gimbal_names.index(left_alone)
        assert np.abs(np.delete(model.M[k], k)).max() < 1e-15
        assert np.abs(model.G[k]).max() < 1e-15


# Four-VSCMG pyramid


def test_the_published_inertias_of_the_vscmg_belong_to_no_body() -> None:
    thin = plant_of("vscmg_pyramid")
    thin["rotor"][0]["transverse_inertia"] = 0.04
    with pytest.raises(pc.PlatformCtrlError, match="must be at least half of axial_inertia"):
        pc.read_platform(thin)
    whole = plant_of("vscmg_pyramid")
    whole["gimbal"][0]["inertia"] = [0.04, 0.13, 0.03]
    with pytest.raises(pc.PlatformCtrlError, match="no body has it"):
        pc.read_platform(whole)


def test_a_vscmg_keeps_what_is_published_and_possible() -> None:
    satellite = pc.read_platform("vscmg_pyramid")
    assert np.diag(satellite.root_inertia) == pytest.approx([86.0, 85.0, 113.0])
    for gimbal, wheel in zip(satellite.gimbals, satellite.rotors, strict=True):
        assert wheel.carrier == gimbal.name
        assert wheel.angular_momentum == pytest.approx(1.44)
        assert wheel.axis @ gimbal.inertia @ wheel.axis + wheel.axial_inertia == pytest.approx(0.13)
        assert np.arcsin(gimbal.axis[2]) == pytest.approx(np.radians(54.75), abs=1e-6)
        assert abs(gimbal.axis @ wheel.axis) < 1e-15
    # At zero angles the momenta cancel.
    assert np.abs(pc.matrices(satellite).B[:, :3].sum(axis=0)).max() < 1e-15


def test_the_gimbal_motors_follow_the_published_equation() -> None:
    # u = Jg (g'' + g.w') - (Js - Jt) ws wt - h wt, with the inertias of gimbal and wheel together.
    satellite = pc.read_platform("vscmg_pyramid")
    rng = np.random.default_rng(3)
    q, velocity, acceleration = rng.uniform(-2.0, 2.0, 4), rng.normal(size=7), rng.normal(size=7)
    motors = pc.inverse_dynamics(satellite, q, velocity, acceleration)[3:]
    for k, (gimbal, wheel) in enumerate(zip(satellite.gimbals, satellite.rotors, strict=True)):
        g, s0 = gimbal.axis, wheel.axis
        s = s0 * np.cos(q[k]) + np.cross(g, s0) * np.sin(q[k])
        ws, wt = velocity[:3] @ s, velocity[:3] @ np.cross(g, s)
        u = 0.065 * (acceleration[3 + k] + g @ acceleration[:3]) - (0.13 - 0.065) * ws * wt - 1.44 * wt
        assert motors[k] == pytest.approx(u, rel=1e-9)


def test_no_gimbal_rate_turns_the_satellite_about_axis_1_in_the_internal_singularity() -> None:
    satellite = pc.read_platform("vscmg_pyramid")
    q = np.radians([-90.0, 90.0, 0.0, 0.0])
    for k in range(4):
        velocity = np.zeros(7)
        velocity[3 + k] = 1.0
        force = pc.inverse_dynamics(satellite, q, velocity, np.zeros(7))
        assert abs(force[0]) < 1e-14
        assert np.linalg.norm(force[:3]) == pytest.approx(1.44)
    # It lies within what the pyramid can store along that axis.
    stored = pc.matrices(satellite, q).B[:, :3].sum(axis=0)
    assert np.linalg.norm(stored) == pytest.approx(stored[0])
    assert stored[0] < 0.5 * (2.0 + 2.0 * np.sin(np.radians(54.75)))


# AE353


def test_the_equations_of_the_course_are_those_of_a_free_rotor() -> None:
    cmg = pc.read_platform("ae353_cmg")
    J1z, J2z, J2x, J3, m, r, g, speed = 0.5, 0.001, 0.001, 0.01, 1.0, 2.0, 9.81, 1000.0
    rng = np.random.default_rng(5)
    for q1, q2, v1, v2, torque in rng.uniform(-1.5, 1.5, (8, 5)):
        a1 = J3 * np.sin(2 * q2) * v1 * v2 + 2 * J3 * np.cos(q2) * v2 * speed - 2 * g * m * r * np.sin(q1)
        a1 /= 2 * (J1z + J2z + m * r**2) + 2 * J3 * np.cos(q2) ** 2
        a2 = (torque - J3 * np.cos(q2) * v1 * speed) / (J2x + J3)
        velocity = np.array([0.0, 0.0, 0.0, v1, v2])
        force = pc.element_forces(cmg, [q1, q2], velocity) + np.array([0.0, 0.0, 0.0, 0.0, torque])
        found = pc.forward_dynamics(pc.with_free_rotors(cmg, [q1, q2], velocity), [q1, q2], velocity, force)
        assert found[3:] == pytest.approx([a1, a2], rel=1e-6)


def test_the_saturating_loop_agrees_with_the_rotor_as_a_body_of_its_own() -> None:
    cmg = pc.read_platform("ae353_cmg")
    bodies = with_rotors_as_gimbals(cmg)
    seen: list[float] = []

    def slope(_: float, x: np.ndarray) -> np.ndarray:
        q, velocity = x[:3], np.concatenate([np.zeros(3), x[3:]])
        motor = np.clip(-1.0 * (x[5] - 1000.0), -5.0, 5.0)
        seen.append(abs(motor))
        force = pc.element_forces(bodies, q, velocity) + np.array([0, 0, 0, 0, 0, motor])
        return np.concatenate([x[3:], pc.forward_dynamics(bodies, q, velocity, force)[3:]])

    start, end = [0.1, 0.4, 0.0, 0.0, 5.0, 960.0], 0.1
    exact = solve_ivp(slope, (0.0, end), start, rtol=1e-8, atol=1e-9, max_step=5e-3).y[:, -1]
    run = pc.simulation.rollout(cmg, [[0.1, 0.4]], [[0.0, 0.0, 0.0, 0.0, 5.0]], step=2.5e-4, steps=400, spin=[[960.0]])
    assert max(seen) == 5.0
    assert run.spin[0, 0] == pytest.approx(exact[5], abs=1e-3)
    assert [*run.q[0], *run.velocity[0, 3:]] == pytest.approx([*exact[:2], *exact[3:5]], abs=1e-5)


# Large double-gimbal control moment gyro


def test_the_large_gyro_has_the_published_momentum_speed_and_torque() -> None:
    cmg = pc.read_platform("double_gimbal_cmg")
    [rotor] = cmg.rotors
    assert rotor.angular_momentum == pytest.approx(4760.0)
    assert rotor.spin == pytest.approx(691.0)
    assert all(gimbal.stops is None for gimbal in cmg.gimbals)
    made = pc.inverse_dynamics(cmg, [0.4, 0.0], [0.0, 0.0, 0.0, 258.0 / 4760.0, 0.0], np.zeros(5))
    assert np.linalg.norm(made[:3]) == pytest.approx(258.0)


@pytest.mark.parametrize("alpha", [0.0, 1.0, 2.5])
def test_in_gimbal_lock_the_outer_gimbal_is_powerless(alpha: float) -> None:
    cmg = pc.read_platform("double_gimbal_cmg")
    gain = pc.matrices(cmg, [alpha, np.pi / 2]).G_R[:3, 3:]
    assert np.linalg.norm(gain[:, 0]) < 1e-9
    assert np.linalg.norm(gain[:, 1]) == pytest.approx(4760.0)
    # Neither gimbal nutates with the other there.
    assert np.abs(pc.linearise(cmg, q=[alpha, np.pi / 2]).G).max() < 1e-9
