"""Robot descriptions as plants: published kinds of gimbals in URDF, MJCF and SDF, against MuJoCo's mass matrix."""

from __future__ import annotations

import json
import re
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import platform_ctrl as pc
from platform_ctrl.cli import main
from platform_ctrl.errors import InputError
from platform_ctrl.export import import_robot

mujoco = pytest.importorskip("mujoco", reason="MuJoCo (package mujoco) is not installed")

ROBOTS = Path(__file__).parents[1] / "data" / "robots"
# File, root, and the file that MuJoCo reads in its place: it has no reader of SDF.
FILES = [
    ("head.urdf", "chassis", "head.urdf"),
    ("camera.xml", "mount", "camera.xml"),
    ("gimbal.sdf", "mount_link", "gimbal_as_mjcf.xml"),
]


def compiled(file: Path, root: str) -> Any:
    """MuJoCo's model with a root that turns, and without armatures, which have no other effect there."""
    spec = mujoco.MjSpec.from_file(str(file))
    for body in spec.bodies:
        for geom in list(body.geoms) if body.explicitinertial else []:
            spec.delete(geom)
    for mesh in list(spec.meshes):
        spec.delete(mesh)
    for joint in spec.joints:
        joint.armature = 0.0
    spec.compiler.fusestatic = False
    spec.body(root).add_joint(name="root", type=mujoco.mjtJoint.mjJNT_BALL)
    return spec.compile()


def mujocos(model: Any, platform: pc.Platform, q: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """MuJoCo's mass matrix, and the torques of rates and gravity, in the plant's coordinates."""
    data = mujoco.MjData(model)
    at = int(model.joint("root").dofadr[0])
    rows = [at, at + 1, at + 2]
    for name, angle in zip(platform.angle_names, q, strict=True):
        joint = model.joint(name)
        data.qpos[joint.qposadr[0]] += angle
        rows.append(int(joint.dofadr[0]))
    data.qvel[rows] = u
    mujoco.mj_forward(model, data)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    return full[np.ix_(rows, rows)], data.qfrc_bias[rows]


def without_motors(platform: pc.Platform) -> pc.Platform:
    return pc.read_platform({k: v for k, v in tomllib.loads(platform.to_toml()).items() if k != "motor"})


@pytest.mark.parametrize(("file", "root", "theirs"), FILES)
def test_the_mass_matrix_and_the_torques_of_rates_and_gravity_are_mujocos(file: str, root: str, theirs: str) -> None:
    platform = without_motors(import_robot(ROBOTS / file).platform)
    assert platform.root_name == root
    model = compiled(ROBOTS / theirs, root)
    rng = np.random.default_rng(1)
    for q in rng.normal(size=(5, len(platform.gimbals))):
        u = rng.normal(size=3 + len(q))
        expected, torques = mujocos(model, platform, q, u)
        assert np.abs(pc.matrices(platform, q).A_star - expected).max() < 1e-12 * np.abs(expected).max()
        found = pc.inverse_dynamics(platform, q, u, np.zeros(len(u)))
        assert np.abs(found - torques).max() < 1e-12 * np.abs(torques).max()


@pytest.mark.parametrize(("file", "root", "theirs"), FILES)
def test_joints_beyond_the_tip_are_held_at_zero(file: str, root: str, theirs: str) -> None:
    whole = import_robot(ROBOTS / file).platform
    tip = whole.gimbal_names[0]
    made = import_robot(ROBOTS / file, tip=tip)
    assert made.platform.gimbal_names == (tip,)
    for name in whole.gimbal_names[1:]:
        assert any("held at zero" in note and f'"{name}" is part of "{tip}"' in note for note in made.notes)
    model = compiled(ROBOTS / theirs, root)
    q = np.array([0.7, *np.zeros(len(whole.gimbals) - 1)])
    expected = mujocos(model, whole, q, np.zeros(3 + len(q)))[0][:4, :4]
    found = pc.matrices(without_motors(made.platform), [0.7]).A_star
    assert np.abs(found - expected).max() < 1e-12 * np.abs(expected).max()


def test_what_carries_the_root_is_cut_off_and_axes_are_those_of_the_root() -> None:
    whole, made = import_robot(ROBOTS / "gimbal.sdf").platform, import_robot(ROBOTS / "gimbal.sdf", root="roll_link")
    assert made.platform.root_name == "roll_link"
    assert any('links "mount_link", "yaw_link", "bracket_link": not carried by the root' in one for one in made.notes)
    [pitch] = made.platform.gimbals
    assert np.allclose(pitch.axis, [0.0, -1.0, 0.0], atol=1e-14)  # the link's axes are the model's
    assert np.allclose(pitch.origin, [0.036, 0.0, -0.008], atol=1e-14)
    assert np.isclose(whole.gimbals[2].mass, pitch.mass)
    assert made.platform.mode is None


def test_a_static_model_is_held(tmp_path: Path) -> None:
    path = tmp_path / "gimbal.sdf"
    text = (ROBOTS / "gimbal.sdf").read_text(encoding="utf-8")
    path.write_text(text.replace("<self_collide>", "<static>true</static><self_collide>"))
    platform = import_robot(path).platform
    assert (platform.root_name, platform.mode) == ("mount_link", "held")


def test_speed_loops_of_rotors_are_theirs_and_servos_of_angles_are_not(tmp_path: Path) -> None:
    path = tmp_path / "wheel.xml"
    loops = '<velocity joint="turn" kv="2"/><intvelocity joint="turn" kp="3" actrange="-1 1"/><motor joint="turn"/>'
    for actuators, control in ((loops, "servo"), ('<position joint="turn" kp="2"/>', "free")):
        path.write_text(PENDULUM.replace("<keyframe>", f"<actuator>{actuators}</actuator><keyframe>"))
        made = import_robot(path)
        [wheel] = made.platform.rotors
        assert wheel.control == control
        assert sum("torquer on" in note for note in made.notes) == 1  # the motor; the servo of the angle
    assert (wheel.speed_gain, wheel.speed_integral) == (0.0, 0.0)


def test_parts_of_a_joint_have_their_numbers() -> None:
    head, camera, gimbal = (import_robot(ROBOTS / file).platform for file, _, _ in FILES)
    assert [one.stops for one in head.gimbals] == [None, (-0.7, 0.4), None]
    assert [(one.gimbal, one.viscous, one.coulomb[0]) for one in head.frictions] == [
        ("yaw", 0.02, 0.09),
        ("pitch", 0.01, 0.05),
    ]
    assert [(one.name, one.limit) for one in head.torquers] == [("Qyaw", 1.3), ("Qpitch", 0.9), ("Qloader", 4.0)]
    assert [one.gimbal for one in head.pickoffs] == ["yaw", "pitch", "loader"]
    assert [(one.name, one.limit) for one in camera.torquers] == [
        ("yaw_drive", 0.6),
        ("roll_servo", 0.4),
        ("pitch_drive", 0.3),
    ]
    model = compiled(ROBOTS / "camera.xml", "mount")
    for gimbal_, axis in zip(camera.gimbals, ("yaw", "roll", "pitch"), strict=True):
        joint = model.joint(axis)  # its zero is the drawn position
        assert gimbal_.stops == pytest.approx(tuple(joint.range - model.qpos0[joint.qposadr]))
    rest = float(model.joint("pitch").qpos_spring[0])
    assert [(one.gimbal, one.stiffness, one.rest) for one in camera.springs] == [("pitch", 0.04, pytest.approx(rest))]
    assert [(one.gimbal, one.gear, one.rotor_inertia * one.gear**2) for one in camera.motors] == [
        ("yaw", 3.0, pytest.approx(2e-4)),
        ("roll", 1.0, pytest.approx(2e-4)),
        ("pitch", 1.0, pytest.approx(2e-4)),
    ]
    assert camera.pickoffs[0].noise_rms == 1e-4
    assert (camera.mode, head.mode, gimbal.mode) == ("held", None, None)
    assert [(one.gimbal, one.stiffness) for one in gimbal.springs] == [("camera_link", 0.02)]
    assert [one.stops for one in gimbal.gimbals] == [None, (-0.785398, 0.785398), (-2.35619, 0.7854)]


def test_gyros_measure_about_the_axes_that_they_have_in_the_file() -> None:
    head, camera, gimbal = (import_robot(ROBOTS / file).platform for file, _, _ in FILES)
    for platform, file, root, name in (
        (camera, "camera.xml", "mount", "imu_gyro"),
        (gimbal, "gimbal_as_mjcf.xml", "mount_link", "camera_imu"),
    ):
        model = compiled(ROBOTS / file, root)
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        expected = data.body(root).xmat.reshape(3, 3).T @ data.site("imu").xmat.reshape(3, 3)
        found = [one for one in platform.rate_sensors if one.name.startswith(name)]
        assert [one.name for one in found] == [f"{name}{k}" for k in (1, 2, 3)]
        assert np.allclose(np.array([one.axis for one in found]).T, expected, atol=1e-13)
    assert [one.noise_rms for one in camera.rate_sensors] == [2e-4] * 3
    assert [(one.body, one.noise_rms, one.noise_bandwidth_hz) for one in head.rate_sensors] == [
        ("pitch", 3e-4, 500.0),
        ("pitch", 4e-4, 500.0),
        ("pitch", 5e-4, 500.0),
    ]
    # Turned over by pi about its first axis.
    assert np.allclose(head.rate_sensors[0].axis, [1.0, 0.0, 0.0], atol=1e-13)
    assert head.rate_sensors[2].axis[2] == pytest.approx(-np.cos(0.05))


NOTES = {
    "head.urdf": [
        r'joint "yaw_joint": velocity limit 12\.5 rad/s',
        r'transmission "yaw_trans" of "yaw_joint": gear -19\.2: .*\[\[motor\]\]',
        r'joint "pitch_joint": <safety_controller> .*k_position 100',
        r"<plugin> .*librm_gazebo\.so.*: no counterpart in a plant file; controllers are designed in a job",
        r"gravity: not in the file",
        r'root "chassis": .*add mode = "held"',
        r'"yaw", "pitch", "loader": .*ideal pick-offs are assumed',
    ],
    "camera.xml": [
        r'actuator "yaw_drive": gear 3: its torquer acts at the joint',
        r'actuator "roll_servo": a servo, gain 5, bias \[0\.0, -5\.0, -0\.1\]',
        r'actuator "roll_servo": its limits differ',
        r'body "target": mocap = "true"',
        r'body "lens": gravcomp = "1"',
        r"<accelerometer> name imu_acc",
        r'links "target": not carried by the root',
        r'joint "yaw": armature 0\.0002 kg m2 .*gear of 3',
        r'camera "eye": .*\[line_of_sight\] with body = "pitch" and direction = \[0\.96592582628907, 0\.0, -0\.2588',
    ],
    "gimbal.sdf": [
        r"<dynamic_bias_stddev> 3\.8e-05",
        r"<linear_acceleration>",
        r'sensor "position" of "camera_link": navsat',
        r'link "camera_link": <gravity> false: .*take gravity out of \[root\]',
        r"<plugin> .*joint_name pitch_joint, p_gain 0\.8, cmd_max 0\.3",
        r'camera "imager": .*\[line_of_sight\] with body = "camera_link"',
    ],
}


@pytest.mark.parametrize("file", NOTES)
def test_what_has_no_counterpart_is_a_comment_of_the_file(file: str) -> None:
    made = import_robot(ROBOTS / file)
    for pattern in NOTES[file]:
        assert len([note for note in made.notes if re.search(pattern, note)]) == 1, pattern
    comments = " ".join(line.strip("# ") for line in made.text.splitlines() if line.startswith("#"))
    assert all(" ".join(note.split()) in " ".join(comments.split()) for note in made.notes)
    assert not any("visual" in note or "collision" in note for note in made.notes)


def test_the_command_writes_a_plant_that_the_others_take(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    file = str(ROBOTS / "gimbal.sdf")
    assert main(["import", file, "-o", "plant.toml", "--tip", "roll_link"]) == 0
    assert "gimbals yaw_link, roll_link" in capsys.readouterr().out
    assert pc.read_platform("plant.toml").gimbal_names == ("yaw_link", "roll_link")
    assert main(["import", file, "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["gimbals"] == ["yaw_link", "roll_link", "camera_link"]
    assert pc.read_platform(tomllib.loads(printed["text"])).gimbal_names == tuple(printed["gimbals"])
    assert main(["import", file]) == 0
    assert capsys.readouterr().out == printed["text"]
    assert [one.name for one in tmp_path.iterdir()] == ["plant.toml"]  # MuJoCo keeps no log


@pytest.mark.parametrize("command", ["equations", "design", "check"])
@pytest.mark.parametrize("file", NOTES)
def test_a_description_in_place_of_a_plant_is_answered_by_import(
    command: str, file: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([command, str(ROBOTS / file)]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.count("\n") == 1
    assert f"by platform-ctrl import {ROBOTS / file} -o plant.toml" in printed.err


def test_without_mujoco_only_sdf_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(InputError, match=r"head\.urdf: URDF .*not installed: pip install platform_ctrl\[import\]"):
        import_robot(ROBOTS / "head.urdf")
    assert len(import_robot(ROBOTS / "gimbal.sdf").platform.gimbals) == 3


PENDULUM = """
<mujoco>
  <worldbody>
    <body name="arm" pos="0 0 1">
      <joint name="swing" axis="0 1 0" pos="0 0 0.1"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.02"/>
      <body name="wheel" pos="0 0 -0.4">
        <joint name="turn" axis="0 1 0"/>
        <geom type="cylinder" size="0.05 0.01" euler="90 0 0"/>
      </body>
    </body>
  </worldbody>
  <keyframe><key qvel="0 300"/></keyframe>
</mujoco>
"""


def test_what_turns_in_the_keyframe_is_a_rotor_and_the_world_may_be_the_root(tmp_path: Path) -> None:
    path = tmp_path / "pendulum.xml"
    path.write_text(PENDULUM)
    made = import_robot(path)
    [arm], [wheel] = made.platform.gimbals, made.platform.rotors
    assert (made.platform.root_name, made.platform.mode, wheel.carrier) == ("world", "held", "arm")
    mass = 1000.0 * np.pi * 0.05**2 * 0.02
    assert wheel.axial_inertia == pytest.approx(0.5 * mass * 0.05**2)
    assert (wheel.control, wheel.spin, wheel.mass) == ("free", pytest.approx(300.0), pytest.approx(mass))
    assert np.allclose(wheel.origin, [0.0, 0.0, -0.5])  # from the joint
    assert np.allclose(arm.origin, [0.0, 0.0, 1.1])
    assert any("its inertia is assumed" in note for note in made.notes)


@pytest.mark.parametrize(
    ("joint", "mode", "origin"),
    [('<joint type="ball" pos="0 0 0.3"/>', "pivot", 0.3), ("<freejoint/>", "floating", 0.0)],
)
def test_a_root_that_moves_says_how(joint: str, mode: str, origin: float, tmp_path: Path) -> None:
    path = tmp_path / "moving.xml"
    base = f'<body name="base">{joint}<inertial pos="0 0 0" mass="2" diaginertia="1 1 1"/><body name="arm" pos="0 0 1">'
    path.write_text(
        PENDULUM.replace('<body name="arm" pos="0 0 1">', base).replace("</worldbody>", "</body></worldbody>")
    )
    platform = import_robot(path).platform
    assert platform.mode == mode
    assert np.allclose(platform.root_centre, [0.0, 0.0, -origin])  # a pivot is the root's origin
    assert np.allclose(platform.gimbals[0].origin, [0.0, 0.0, 1.1 - origin])


WRONG = [
    ("head.urdf", 'type="continuous"', 'type="prismatic"', r'"loader_joint" of "loader" is prismatic.*--tip'),
    ("head.urdf", 'type="continuous"', 'type="floating"', r'"loader_joint" of "loader" is free.*--tip'),
    ("head.urdf", 'type="continuous"', 'type="planar"', r"one of 3 joints of a body"),
    ("head.urdf", '<child link="loader"/>', '<child link="pitch"/>', r'"pitch" hangs on two joints.*closed loop'),
    ("head.urdf", '<parent link="chassis"/>', '<parent link="loader"/>', r"carries itself: a closed loop"),
    ("head.urdf", '<parent link="chassis"/>', '<parent link="chasis"/>', r'no link "chasis"; did you mean "chassis"'),
    ("head.urdf", '<child link="loader"/>', "", r'"loader_joint" has no name, no parent or no child'),
    ("head.urdf", '<joint name="loader_joint" ', "<joint ", r"joint None has no name"),
    ("head.urdf", "</robot>", "", r"is not XML: .*give a robot description"),
    ("head.urdf", 'xyz="0 2 0"', 'xyz="0 0 0"', r'"pitch_joint": its axis has no direction'),
    ("head.urdf", 'xyz="0 2 0"', 'xyz="0 two 0"', r"is refused by MuJoCo: .*'xyz'.*line 42"),
    ("head.urdf", '<mass value="1.87"/>', '<mass value="nan"/>', r'link "yaw" has a .*no number'),
    ("head.urdf", 'ixx="0.0098"', 'ixx="0.98"', r'"pitch": inertia must be .*no body has it'),
    ("head.urdf", 'velocity="20"/>', 'velocity="20"/><mimic joint="yaw_joint"/>', r'"loader_joint" mimics "yaw_joint"'),
    ("head.urdf", 'name="turret head">', 'name="${name}">', r"xacro .* > robot\.urdf"),
    ("camera.xml", "</actuator>", '</actuator><equality><joint joint1="roll"/></equality>', r'constraint on "roll"'),
    ("camera.xml", "</actuator>", '</actuator><equality><weld body1="lens"/></equality>', r'constraint on "lens"'),
    (
        "camera.xml",
        '<joint name="roll"',
        '<joint name="two"/><joint name="roll"',
        r'"two" of "roll" is one of 2 joints',
    ),
    ("camera.xml", 'name="pitch" axis', 'name="pitch" type="slide" axis', r'"pitch" of "pitch" is prismatic'),
    ("camera.xml", 'type="capsule" size="0.006"', 'type="mesh" mesh="shell"', r'bodies "roll" have no inertial'),
    ("camera.xml", 'site="imu" noise', 'site="imo" noise', r'"imu_gyro": there is no site "imo"'),
    ("camera.xml", "</worldbody>", "</world>", r"is not XML"),
    ("gimbal.sdf", 'type="fixed"', 'type="universal"', r'"bracket_joint" of "bracket_link" is universal'),
    ("gimbal.sdf", 'type="fixed"', 'type="ball"', r'"bracket_joint" of "bracket_link" is ball'),
    ("gimbal.sdf", 'relative_to="hub"', 'relative_to="hob"', r'frame "hob" is not in this file'),
    ("gimbal.sdf", 'attached_to="mount_link"', 'attached_to="hub"', r'frame "hub" is defined by itself'),
    ("gimbal.sdf", "<mass>0.18</mass>", "", r'link "camera_link": its inertial has no mass'),
    ("gimbal.sdf", "<mass>0.18</mass>", "<mass>heavy</mass>", r'mass must be 1 number, got "heavy"'),
    ("gimbal.sdf", "0.05 0.003 -0.13 0 0 0", "0.05 0.003", r'pose of "camera_link" must be 6 numbers'),
    ("gimbal.sdf", "<parent>mount_link</parent>", "", r'"yaw_joint" has no parent'),
    ("gimbal.sdf", "<parent>mount_link</parent>", "<parent>drone::base</parent>", r'no link "drone::base"'),
    ("gimbal.sdf", "<xyz>0 -1 0</xyz>", "<xyz>0 0 0</xyz>", r'"pitch_joint": its axis has no direction'),
]


@pytest.mark.parametrize(("file", "old", "new", "words"), WRONG)
def test_a_wrong_file_is_one_sentence(file: str, old: str, new: str, words: str, tmp_path: Path) -> None:
    text = (ROBOTS / file).read_text(encoding="utf-8")
    assert old in text
    path = tmp_path / file
    path.write_text(text.replace(old, new))
    with pytest.raises(InputError, match=words) as caught:
        import_robot(path)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(f"{path}: ")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('<robot name="r"><link name="a"/></robot>', "has no joint that turns"),
        ("<mujoco><worldbody/></mujoco>", "has no joint that turns"),
        ("<svg/>", "has the element <svg> on top"),
        (
            '<sdf version="1.9"><model name="d"><include><uri>model://gimbal</uri></include></model></sdf>',
            "import these: model://gimbal",
        ),
        (
            '<sdf version="1.9"><model name="d"><link name="a"/><link name="b"/><joint name="j" type="revolute">'
            "<parent>a</parent><child>b</child></joint></model></sdf>",
            'link "b" moves, but has no inertia',
        ),
        (
            '<sdf version="1.9"><world name="w"><model name="one"><link name="a"/><link name="b"/>'
            '<joint name="j" type="revolute"><parent>a</parent><child>b</child></joint></model><model name="two">'
            '<link name="a"/><link name="b"/><joint name="j" type="revolute"><parent>a</parent><child>b</child></joint>'
            "</model></world></sdf>",
            'several bases, "one::a", "two::a"; choose one by --root',
        ),
    ],
)
def test_a_file_without_a_tree_is_one_sentence(text: str, words: str, tmp_path: Path) -> None:
    path = tmp_path / "robot.xml"
    path.write_text(text)
    with pytest.raises(InputError, match=re.escape(words)):
        import_robot(path)


@pytest.mark.parametrize(
    ("root", "tip", "words"),
    [
        ("chasis", None, '--root: there is no link "chasis"; did you mean "chassis"?'),
        (None, "ptch", '--tip: there is no link "ptch"; did you mean "pitch"?'),
        ("pitch", "yaw", '--tip: "pitch" does not carry "yaw"'),
        (None, "chassis", "has no joint that turns between root and tip"),
    ],
)
def test_a_wrong_root_or_tip_is_one_sentence(root: str | None, tip: str | None, words: str) -> None:
    with pytest.raises(InputError, match=re.escape(words)):
        import_robot(ROBOTS / "head.urdf", root=root, tip=tip)


def test_what_is_held_may_slide_or_follow(tmp_path: Path) -> None:
    path = tmp_path / "head.urdf"
    text = (ROBOTS / "head.urdf").read_text(encoding="utf-8")
    for old, new in (
        ('type="continuous"', 'type="prismatic"'),
        ('velocity="20"/>', 'velocity="20"/><mimic joint="yaw_joint"/>'),
    ):
        path.write_text(text.replace(old, new))
        made = import_robot(path, tip="imu_link")
        assert made.platform.gimbal_names == ("yaw", "pitch")
        assert any('joint "loader_joint": not on the way to --tip' in note for note in made.notes)


def test_models_within_models_have_their_poses(tmp_path: Path) -> None:
    """A joint to a model by its name, a pose in degrees and one as a quaternion, axes in the frame of the model."""
    path = tmp_path / "drone.sdf"
    inertial = "<inertial><mass>1</mass><inertia><ixx>1</ixx><iyy>1</iyy><izz>1</izz></inertia></inertial>"
    path.write_text(
        f"""<sdf version="1.10"><world name="w"><gravity>0 0 -3.7</gravity><model name="drone"><pose>0 0 5 0 0 0</pose>
        <link name="base">{inertial}</link>
        <model name="gimbal"><pose degrees="true">0.1 0 0 0 0 90</pose>
          <link name="yaw"><pose rotation_format="quat_xyzw">0.2 0 0 0 0 0.7071067811865476 0.7071067811865476</pose>
            {inertial}</link>
          <link name="cam"><pose relative_to="yaw">0.3 0 0 0 0 0</pose>{inertial}</link>
          <joint name="pitch" type="revolute"><parent>yaw</parent><child>cam</child><axis>
            <xyz expressed_in="__model__">0 1 0</xyz><limit><lower>0</lower><upper>20</upper></limit></axis></joint>
        </model>
        <joint name="yaw" type="continuous"><parent>base</parent><child>gimbal</child>
          <axis><xyz>1 0 0</xyz></axis></joint>
        <joint name="lock" type="revolute"><parent>base</parent><child>leg</child><axis><xyz>0 0 1</xyz>
          <limit><lower>0</lower><upper>0</upper></limit></axis></joint>
        <link name="leg">{inertial}</link></model></world></sdf>"""
    )
    made = import_robot(path)
    platform = made.platform
    assert (platform.gimbal_names, platform.angle_names) == (("gimbal::yaw", "gimbal::cam"), ("yaw", "gimbal::pitch"))
    assert np.allclose(platform.gimbals[0].origin, [0.1, 0.0, 0.0], atol=1e-14)  # the frame that the joint names
    assert np.allclose(platform.gimbals[0].axis, [0.0, 1.0, 0.0], atol=1e-14)
    assert np.allclose(platform.gimbals[0].centre, [0.0, 0.2, 0.0], atol=1e-14)
    assert np.allclose(platform.gimbals[1].origin, [-0.3, 0.2, 0.0], atol=1e-14)  # turned by 90 degrees twice
    assert np.allclose(platform.gimbals[1].axis, [-1.0, 0.0, 0.0], atol=1e-14)
    assert platform.gimbals[1].stops == pytest.approx((0.0, 20.0))  # more than a turn
    assert platform.root_mass == 2.0  # with what is locked
    assert np.allclose(platform.gravity, [0.0, 0.0, -3.7])
    assert any("both 0 rad: it is taken as fixed" in note for note in made.notes)
