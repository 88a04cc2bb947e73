"""Degenerate platforms get an answer, not numbers: nothing to turn, nothing that spins, nothing that resists."""

import dataclasses
import tomllib

import numpy as np
import pytest

import platform_ctrl as pc
from plant_parts import Gimbal, Rotor
from platform_ctrl import Platform, platform_source, rotor_momenta
from platform_ctrl.errors import InputError, MechanicsError
from platform_ctrl.simulation import rollout
from report_jobs import page_html

X, Y, Z = np.eye(3)


def chain(axes, inertias, rotors=()):
    """Gimbals g0, g1, ... each in the one before."""
    names = ["base", *(f"g{k}" for k in range(len(axes)))]
    return Platform(
        name="chain",
        root_name="base",
        root_inertia=np.eye(3),
        gimbals=tuple(
            Gimbal(name=names[k + 1], parent=names[k], axis=axis, inertia=inertia, angle=f"q{k}")
            for k, (axis, inertia) in enumerate(zip(axes, inertias, strict=True))
        ),
        rotors=rotors,
    )


def wheel(carrier, momentum, axis=Z, control="regulated"):
    return Rotor(
        name="wheel",
        carrier=carrier,
        axis=axis,
        axial_inertia=0.2,
        transverse_inertia=0.1,
        angular_momentum=momentum,
        control=control,
    )


LOCKED = chain([X, Y, Z], [np.zeros((3, 3)), np.zeros((3, 3)), np.eye(3)])
LOCK = [0.0, np.pi / 2, 0.0]


def test_a_locked_suspension_names_what_moves_without_inertia():
    """Massless roll and pitch frames: at 90 degrees of pitch roll and yaw axes fall together."""
    with pytest.raises(MechanicsError, match="q0, q2 can move without moving any inertia"):
        pc.forward_dynamics(LOCKED, LOCK, np.zeros(6), np.zeros(6))
    model = pc.linearise(LOCKED, q=LOCK)
    for call in (lambda: pc.state_space(model), lambda: pc.state_space(model, root="free")):
        with pytest.raises(MechanicsError, match=r"gimbal lock\); choose other angles"):
            call()
    out = rollout(LOCKED, [LOCK], np.ones((1, 6)), steps=1)
    assert not np.isfinite(out.velocity).any()


def test_a_massless_frame_is_refused_in_a_file_with_a_cure_and_needs_what_it_carries_in_python():
    data = {
        "schema": 1,
        "name": "massless",
        "root": {"name": "base", "inertia": [1, 1, 1]},
        "gimbal": [{"name": "frame", "parent": "base", "axis": [1, 0, 0], "inertia": [0, 0, 0]}],
    }
    with pytest.raises(InputError, match=r"got \[0, 0, 0\] \(not positive definite \(for a frame without mass"):
        pc.read_platform(data)
    carrying = chain([X, Y], [np.zeros((3, 3)), np.eye(3)])
    assert pc.state_space(pc.linearise(carrying)).nstates == 4
    empty = chain([X], [np.zeros((3, 3))])
    with pytest.raises(MechanicsError, match="q0 moves no inertia"):
        pc.state_space(pc.linearise(empty))


def test_a_rotor_that_stands_still_is_a_body_and_no_gyro():
    platform = chain([X, Y], [0.1 * np.eye(3)] * 2, (wheel("g1", 0.0),))
    model = pc.linearise(platform)
    assert not model.G.any()
    np.testing.assert_allclose(pc.state_space(model).poles(), 0.0, atol=1e-12)
    assert rotor_momenta(platform, velocity=[0, 0, 1, 0, 0]).p == pytest.approx(0.2)
    slow = pc.precession(model)
    assert not slow.admissible
    assert "no rotor gives it any momentum" in slow.reasons[0]
    with pytest.raises(MechanicsError, match="no rotor gives it any momentum"):
        slow.state_space()


def test_a_loop_around_a_rotor_that_stands_still_is_one_around_two_inertias():
    """No pair, no nutation to go by: each gimbal is controlled for itself, and the report is drawn."""
    plant = tomllib.loads(platform_source("three_gyro_platform"))
    plant["rotor"][2]["angular_momentum"] = 0.0
    loop = {"name": "still", "kind": "caging", "gimbals": ["9", "10"], "use": "one"}
    loop["design"] = [{"name": "one", "method": "classical", "inertial_crossover_hz": 40.0}]
    job = pc.read_job(
        {
            "schema": 2,
            "name": "a gyro at rest",
            "plant": plant,
            "operation": {"Omega": [0.1, 0.1, 0.1]},
            "sampling": {"rate_hz": 2000, "delay": 0.0005},
            "loop": [loop],
        }
    )
    result = pc.verification.check_job(job, pc.design.loops(job))
    assert result.passed
    assert not result.loops[0].closed.controller.C[0] @ result.loops[0].closed.controller.B[:, 1]
    assert "free rotation, no gyro and no restraint acts" in page_html(result)


@pytest.mark.parametrize("rotors", [(), (wheel("base", 3.0),)])
def test_without_gimbals_the_root_is_a_rigid_gyrostat(rotors):
    platform = dataclasses.replace(chain([], []), rotors=rotors)
    h = sum(r.angular_momentum for r in rotors)
    m = pc.matrices(platform, [], [0.0, 0.1, 0.0])
    assert m.A_star.shape == (3, 3)
    velocity = [0.3, 0.1, -0.2]
    torque = pc.inverse_dynamics(platform, [], velocity, [0, 0, 0])
    H = m.A_star @ velocity + np.array([0, 0, h])
    np.testing.assert_allclose(torque, np.cross(velocity, H), atol=1e-14)
    assert pc.subsystems(pc.linearise(platform)) == ()
    free = pc.state_space(pc.linearise(platform), root="free")
    assert (free.nstates, free.ninputs, free.noutputs) == (3, 3, 3)
    nutation = h * len(rotors) / m.A_star[0, 0]
    np.testing.assert_allclose(np.abs(free.poles()).max(), nutation, atol=1e-12)
    assert pc.precession(pc.linearise(platform)).summary() == "no gimbals: nothing precesses"
    assert pc.terms(platform, (1, 1, 1), []).terms == ()
    assert "G_root" in pc.equations(platform)
    carried = pc.state_space(pc.linearise(platform))
    assert (carried.nstates, carried.noutputs) == (0, 0)
    out = rollout(platform, np.zeros((2, 0)), np.tile(velocity, (2, 1)), steps=10)
    spin = out.velocity @ m.A_star + np.array([0, 0, h])
    np.testing.assert_allclose(np.linalg.norm(spin, axis=1), np.linalg.norm(H), rtol=1e-12)
