"""Plants with masses and offsets as MuJoCo models that are written: the same motion there."""

import dataclasses

import numpy as np
import pytest

from offset_trees import offset_platform, turned
from platform_ctrl import forward_dynamics, matrices
from platform_ctrl.errors import ArgumentError
from platform_ctrl.export import import_robot, write_mjcf

mujoco = pytest.importorskip("mujoco", reason="MuJoCo (package mujoco) is not installed")


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("mode", ["pivot", "floating"])
def test_bodies_accelerate_in_mujoco_as_here(mode, seed, tmp_path):
    rng = np.random.default_rng(300 + seed)
    platform = dataclasses.replace(offset_platform(rng, mode), motors=())
    n = len(platform.gimbals)
    assert write_mjcf(platform, tmp_path / "plant.xml") == ()
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "plant.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    q, u, attitude = rng.uniform(-3, 3, n), rng.normal(size=3 + n), turned(rng)
    root, joints = model.joint("root"), [model.joint(name) for name in platform.angle_names]
    moves = 3 if mode == "floating" else 0
    first = int(root.dofadr[0]) + moves
    places = [first, first + 1, first + 2, *(int(joint.dofadr[0]) for joint in joints)]
    data.qpos[int(root.qposadr[0]) + moves :][:4] = attitude
    data.qpos[[int(joint.qposadr[0]) for joint in joints]] = q
    data.qvel[places] = u
    B = matrices(platform, q).B @ u
    for rotor, carried in zip(platform.rotors, B, strict=True):
        if rotor.control == "free":
            data.joint(f"spin {rotor.name}").qvel[0] = rotor.spin - carried
    mujoco.mj_forward(model, data)
    expected = forward_dynamics(platform, q, u, np.zeros(3 + n), attitude=attitude)
    assert np.abs(data.qacc[places] - expected).max() < 1e-8 * np.abs(expected).max()


def test_a_held_root_does_not_move_and_a_floating_one_is_not_prescribed(tmp_path):
    held = offset_platform(np.random.default_rng(5), "held", 2)
    notes = write_mjcf(held, tmp_path / "held.xml")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "held.xml"))
    assert model.nv == len(held.gimbals) + len(held.rotors)
    np.testing.assert_allclose(model.opt.gravity, held.gravity)
    assert bool(held.motors) == any("armature" in note for note in notes)
    with pytest.raises(ArgumentError, match="a floating root is free or fixed"):
        write_mjcf(dataclasses.replace(held, mode="floating"), tmp_path / "no.xml", root="prescribed")


def test_what_is_written_of_masses_and_joints_is_read_back(tmp_path):
    platform = dataclasses.replace(offset_platform(np.random.default_rng(8), "floating", 3), motors=(), rotors=())
    write_mjcf(platform, tmp_path / "plant.xml")
    back = import_robot(tmp_path / "plant.xml").platform
    for gimbal in platform.gimbals:
        [same] = [one for one in back.gimbals if one.name == gimbal.name]
        np.testing.assert_allclose(
            [same.mass, *same.centre, *same.origin], [gimbal.mass, *gimbal.centre, *gimbal.origin]
        )
        np.testing.assert_allclose(same.inertia, gimbal.inertia, atol=1e-12)
