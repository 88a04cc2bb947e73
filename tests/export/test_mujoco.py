"""Plants as MuJoCo models: the same motion there, with controllers too, and back again."""

from __future__ import annotations

import dataclasses
import tempfile
from pathlib import Path
from typing import Any

import control
import numpy as np
import pytest
from hypothesis import strategies as st

import platform_ctrl as pc
from oracle_trees import for_all, sprung, unbalanced
from oracle_trees import motions as motions_drawn
from platform_ctrl import design, read_job, shipped_models, simulation
from platform_ctrl.export import import_robot, write_mjcf
from single_runs import simulated

mujoco = pytest.importorskip("mujoco", reason="MuJoCo (package mujoco) is not installed")

MAIN_JOB = Path(__file__).parents[2] / "examples" / "three_gyro_platform.toml"
MODELS = shipped_models()


class Run:
    """A model that has been written, with rates and angles by the plant's names."""

    def __init__(self, platform: pc.Platform, folder: Path, step: float = 1e-4, root: str = "free") -> None:
        self.platform = platform
        self.notes = write_mjcf(platform, folder / "plant.xml", root=root)
        self.model = mujoco.MjModel.from_xml_path(str(folder / "plant.xml"))
        self.model.opt.timestep = step
        self.data = mujoco.MjData(self.model)
        mujoco.mj_resetDataKeyframe(self.model, self.data, 0)
        hinges = [self.model.joint(name) for name in platform.angle_names]
        self.angles = [int(hinge.qposadr[0]) for hinge in hinges]
        self.rates = [int(hinge.dofadr[0]) for hinge in hinges]

    def begin(self, q: np.ndarray, velocity: np.ndarray) -> None:
        self.data.qpos[self.angles], self.data.qvel[[0, 1, 2, *self.rates]] = q, velocity
        B = pc.matrices(self.platform, q).B @ velocity
        for rotor, carried in zip(self.platform.rotors, B, strict=True):
            if rotor.control == "free":  # its axial momentum, not its rate, is the plant's constant
                self.data.joint(f"spin {rotor.name}").qvel[0] = rotor.spin - carried

    @property
    def state(self) -> np.ndarray:
        q, u = self.data.qpos, self.data.qvel
        return np.concatenate([q[self.angles], u[[0, 1, 2, *self.rates]], q[:4] / np.linalg.norm(q[:4])])


def smooth(platform: pc.Platform) -> pc.Platform:
    """The plant without what MuJoCo has in another form: dry friction, stops, erection; in free fall."""
    return dataclasses.replace(
        platform,
        frictions=tuple(dataclasses.replace(f, coulomb=(0.0, 0.0), breakaway=(0.0, 0.0)) for f in platform.frictions),
        gimbals=tuple(dataclasses.replace(gimbal, stops=None) for gimbal in platform.gimbals),
        erections=(),
        specific_force=np.zeros(3),
    )


def motions(platform: pc.Platform, folder: Path, step: float, duration: float = 0.02) -> tuple[np.ndarray, np.ndarray]:
    """The ends of the same run here, with steps of 1e-5 s, and in MuJoCo: q, Omega, rates, attitude."""
    rng = np.random.default_rng(7)
    n = len(platform.gimbals)
    q, velocity = 0.2 * rng.normal(size=n), 0.3 * rng.normal(size=3 + n)
    force = 3.0 * np.diag(pc.matrices(platform, q).A_star) * rng.normal(size=3 + n)
    out = simulation.rollout(platform, [q], [velocity], step=1e-5, steps=round(duration / 1e-5), force=[force])
    run = Run(platform, folder, step=step)
    run.begin(q, velocity)
    run.data.qfrc_applied[[0, 1, 2, *run.rates]] = force
    mujoco.mj_step(run.model, run.data, round(duration / step))
    return np.concatenate([out.q[0], out.velocity[0], out.attitude[0]]), run.state


@pytest.mark.parametrize(
    "name", ["three_gyro_platform", "suspended_platform", "momentum_wheel_satellite", "vscmg_pyramid", "ae353_cmg"]
)
def test_a_shipped_plant_moves_as_in_the_simulation(name: str, tmp_path: Path) -> None:
    """Free root, torques at all joints and on the root: rotors as in the plant, and free ones."""
    platform = smooth(pc.read_platform(name))
    for control_ in ("free", *{rotor.control for rotor in platform.rotors}):
        rotors = tuple(dataclasses.replace(rotor, control=control_) for rotor in platform.rotors)
        ours, theirs = motions(dataclasses.replace(platform, rotors=rotors), tmp_path, 1e-5)
        assert np.allclose(theirs, ours, rtol=0.0, atol=1e-10)


@pytest.mark.parametrize("name", ["momentum_wheel_satellite", "quanser_3dof_gyroscope", "suspended_platform"])
def test_a_prescribed_root_turns_as_prescribed_whatever_reacts(name: str, tmp_path: Path) -> None:
    """Its angular acceleration is given at every stage of MuJoCo's integrator; gimbals begin anywhere."""
    platform = smooth(pc.read_platform(name))
    n = len(platform.gimbals)
    q, rate = 0.1 * np.cos(np.arange(n)), 0.2 * np.sin(1.0 + np.arange(n))
    profile = simulation.HalfCosine(axis=2, rate=1.5, rise=0.02, hold=0.01)
    ours = simulated(
        platform,
        [],
        period=1e-4,
        delay=0.0,
        duration=0.0201,
        mode="caged",
        profile=profile,
        q=q,
        rate=rate,
        step=1e-5,
    )
    run = Run(platform, tmp_path, root="prescribed", step=2e-5)
    run.data.qpos[run.angles], run.data.qvel[run.rates] = q, rate
    control_ = run.model.actuator("Omega2_dot").id

    def accelerate(model: Any, data: Any) -> None:
        data.ctrl[control_] = 1.5 * 0.5 * np.pi / 0.02 * np.sin(np.pi * data.time / 0.02)

    mujoco.set_mjcb_control(accelerate)
    try:
        mujoco.mj_step(run.model, run.data, 1000)
    finally:
        mujoco.set_mjcb_control(None)
    assert np.allclose(run.data.qvel[:3], ours.Omega[200], rtol=0.0, atol=1e-8)
    assert np.allclose(run.data.qpos[run.angles], ours.q[200], rtol=0.0, atol=1e-8)
    assert np.allclose(run.data.qvel[run.rates], ours.rate[200], rtol=0.0, atol=1e-6)
    assert np.allclose(run.state[-4:], ours.attitude[200], rtol=0.0, atol=1e-8)


@pytest.fixture(scope="module")
def main_job() -> tuple[Any, list[control.StateSpace]]:
    """The main job with its classical controllers as they stand there."""
    job = read_job(MAIN_JOB)
    chosen = [next(d for d in loop.designs if d.method in ("classical", "platform-servo")) for loop in job.loops]
    loops = tuple(
        dataclasses.replace(loop, designs=(dataclasses.replace(made, tune=False),), use=made.name)
        for loop, made in zip(job.loops, chosen, strict=True)
    )
    job = dataclasses.replace(job, loops=loops)
    return job, [outcome.closed.controller for outcome in design.loops(job)]


def closed_loop(
    run: Run, controllers: list[control.StateSpace], period: float, samples: int, rate: Any = None, torque: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Sampled controllers on MuJoCo's plant: angles and commands at every sample; a command acts one period later."""
    model, data = run.model, run.data
    states = [np.zeros(K.nstates) for K in controllers]
    controls = {model.actuator(k).name: k for k in range(model.nu)}
    steps = round(period / model.opt.timestep)
    angles, commands, waiting = [], [], np.zeros(model.nu)
    for k in range(samples):
        signals = dict(zip(run.platform.angle_names, data.qpos[run.angles], strict=True))
        angles.append(data.qpos[run.angles].copy())
        command = np.zeros(model.nu)
        for j, K in enumerate(controllers):
            y = np.array([signals[name] for name in K.input_labels])
            u = K.C @ states[j] + K.D @ y
            states[j] = K.A @ states[j] + K.B @ y
            signals |= dict(zip(K.output_labels, u, strict=True))
            for name, number in zip(K.output_labels, u, strict=True):
                if name in controls:
                    command[controls[name]] = number
        commands.append(command)
        data.ctrl[:] = waiting  # MuJoCo limits it
        data.qfrc_applied[0] = torque
        for step in range(steps):
            if rate is not None:
                t, h = k * period + step * model.opt.timestep, model.opt.timestep
                data.ctrl[controls["Omega1_dot"]] = (rate(t + h) - rate(t)) / h
            mujoco.mj_step(model, data)
        waiting = command
    return np.array(angles), np.array(commands)


def test_caging_controllers_run_on_mujocos_plant_as_on_ours(
    main_job: tuple[Any, list[control.StateSpace]], tmp_path: Path
) -> None:
    """1 rad/s about axis 1 through the root's angular acceleration; the difference goes with the square of the step."""
    job, controllers = main_job
    caging = [K for K in controllers if not {"M1", "M2", "M3"} & set(K.output_labels)]
    assert len(caging) == 2
    scenario = dataclasses.replace(job.scenario(job.manoeuvres[0]), duration=0.1)
    ours = simulation.simulate(scenario, caging, period=job.sampling.period, step=1e-5, noise=False)
    profile = scenario.profile
    assert profile is not None

    def rate(t: float) -> float:
        return float(profile.rate * 0.5 * (1.0 - np.cos(np.pi * min(t / profile.rise, 1.0))))

    assert rate(0.02) == pytest.approx(ours.Omega[40, 0])
    differ = []
    for step in (1e-4, 5e-5):
        run = Run(job.platform, tmp_path, root="prescribed", step=step)
        angles, commands = closed_loop(run, caging, job.sampling.period, len(ours.t), rate)
        assert np.abs(run.data.qvel[:3] - [rate(0.1005), 0.0, 0.0]).max() < 1e-6
        differ.append(np.abs(angles - ours.q).max() / np.abs(ours.q).max())
        torquers = [run.model.actuator(name).id for name in ("Q4", "Q5", "Q7", "Q9", "Q10")]
        assert np.allclose(commands[:, torquers], ours.command[:, :5], atol=1e-5 * np.abs(ours.command).max())
    assert differ[0] < 1e-6
    assert 3.5 < differ[0] / differ[1] < 4.5


def test_stops_stop_and_friction_brakes(tmp_path: Path) -> None:
    platform = pc.read_platform("three_gyro_platform")
    run = Run(platform, tmp_path, root="fixed", step=5e-5)
    run.data.ctrl[run.model.actuator("Q9").id] = 1.0  # its limit is 0.25 N m
    mujoco.mj_step(run.model, run.data, 2000)
    assert 0.008 < np.abs(run.data.qpos[run.angles[3:]]).max() < 0.0095
    assert run.data.actuator_force[run.model.actuator("Q9").id] == pytest.approx(0.25)
    table = {"gimbal": [{"name": "g", "parent": "r", "axis": [0, 0, 1], "inertia": [1e-3] * 3}]}
    plain = {"schema": 1, "name": "x", "root": {"name": "r", "inertia": [1, 1, 1]}} | table
    slowed = pc.read_platform(plain | {"friction": [{"gimbal": "g", "coulomb": 1e-3, "viscous": 1e-3}]})
    run = Run(slowed, tmp_path, root="fixed")
    run.data.qvel[0] = 2.0
    mujoco.mj_step(run.model, run.data, 5000)
    assert run.data.qvel[0] == pytest.approx(3.0 * np.exp(-0.5) - 1.0, abs=1e-4)  # ω' = −ω − 1


def scaled_error(platform: pc.Platform, q: np.ndarray, found: np.ndarray, expected: np.ndarray) -> float:
    """Difference of accelerations by their energy in A*, over what is expected and the matrix's condition."""
    A_star = pc.matrices(platform, q).A_star
    scale = np.sqrt(np.diag(A_star))
    size = np.linalg.norm(expected * scale) * np.linalg.cond(A_star / np.outer(scale, scale))
    return float(np.linalg.norm((found - expected) * scale) / max(size, 1e-9))


@for_all(st.tuples(motions_drawn(min_size=1e-3), st.booleans()), 12)
def test_any_tree_accelerates_as_its_plant_there_and_when_it_is_back(drawn):
    """Springs, dampers, unbalance; regulated and free rotors; chains and bushes drawn together or apart."""
    motion, heavy = drawn
    platform = sprung(motion).platform
    q, u = motion.q, motion.velocity
    if heavy:
        platform = unbalanced(dataclasses.replace(motion, platform=platform))[0]
        platform = dataclasses.replace(platform, specific_force=np.array([1.0, 2.0, 9.0]))
    ours = pc.forward_dynamics(platform, q, u, pc.element_forces(platform, q, u))
    with tempfile.TemporaryDirectory() as folder:
        run = Run(platform, Path(folder))
        run.begin(q, u)
        mujoco.mj_forward(run.model, run.data)
        back = import_robot(Path(folder) / "plant.xml").platform
    assert scaled_error(platform, q, run.data.qacc[[0, 1, 2, *run.rates]], ours) < 1e-8
    order = [back.gimbal_names.index(name) for name in platform.gimbal_names]
    q_back, places = np.empty_like(q), [0, 1, 2, *(3 + k for k in order)]
    u_back = np.empty_like(u)
    q_back[order], u_back[places] = q, u
    again = pc.forward_dynamics(back, q_back, u_back, pc.element_forces(back, q_back, u_back))[places]
    assert scaled_error(platform, q, again, ours) < 1e-11


@pytest.mark.parametrize("root", ["free", "prescribed", "fixed"])
def test_every_shipped_plant_comes_back(root: Any, tmp_path: Path) -> None:
    for name in MODELS:
        platform = pc.read_platform(name)
        # An armature is not all of a geared rotor; a floating root has its own test.
        if platform.motors or platform.mode == "floating":
            continue
        write_mjcf(platform, tmp_path / "plant.xml", root=root)
        made = import_robot(tmp_path / "plant.xml")
        back = made.platform
        assert back.name == platform.name
        assert back.mode == {"free": "pivot", "prescribed": "held", "fixed": "held"}[root]
        assert np.allclose(back.gravity, -platform.specific_force)
        order = [back.gimbal_names.index(gimbal) for gimbal in platform.gimbal_names]
        for q in np.random.default_rng(4).normal(size=(3, len(order))):
            q_back, places = np.empty_like(q), [0, 1, 2, *(3 + k for k in order)]
            q_back[order] = q
            expected = pc.matrices(platform, q).A_star
            found = pc.matrices(back, q_back).A_star[np.ix_(places, places)]
            if root != "fixed":  # of a root that does not move MuJoCo has no inertia
                assert np.abs(found - expected).max() < 1e-12 * np.abs(expected).max()
            assert np.abs(found - expected)[3:, 3:].max() < 1e-12 * np.abs(expected[3:, 3:]).max()
        for field, keys in (
            ("gimbals", ("parent", "axis", "angle", "stops", "restitution")),
            ("rotors", ("carrier", "axis", "axial_inertia", "transverse_inertia", "angular_momentum", "control")),
            ("rotors", ("speed_gain", "speed_integral")),
            ("pickoffs", ("gimbal", "noise_rms")),
        ):
            known = {part.name: part for part in getattr(back, field)}
            for part in getattr(platform, field):
                for key in keys:
                    given, found = getattr(part, key), getattr(known[part.name], key)
                    if given is None or isinstance(given, str):
                        assert found == given
                    else:
                        assert np.allclose(found, given, rtol=1e-12, atol=1e-12), (name, part.name, key)
        for torquer in platform.torquers if root == "free" else ():
            left_out = any(note.startswith(f'actuator "{torquer.name}" acts on no hinge') for note in made.notes)
            assert left_out == (torquer.gimbal is None)
        kept = [t for t in platform.torquers if t.gimbal is not None]
        assert [(t.name, t.limit, t.lag) for t in back.torquers] == [(t.name, t.limit, t.lag) for t in kept]
        assert [(s.gimbal, s.stiffness, s.rest) for s in back.springs] == [
            (s.gimbal, s.stiffness, s.rest) for s in platform.springs
        ]
        assert {f.gimbal: f.viscous for f in back.frictions} == {f.gimbal: f.viscous for f in platform.frictions}
        bodies = dict(zip((back.root_name, *back.gimbal_names), back.bodies, strict=True))
        for unbalance in platform.unbalances:
            mass, centre, _ = bodies[unbalance.body]
            assert np.allclose(mass * centre, unbalance.moment, rtol=1e-12, atol=1e-14)


def test_play_of_a_drive_is_the_slack_of_its_tendon(tmp_path: Path) -> None:
    turned = {"name": "g", "parent": "base", "axis": [0, 0, 1], "inertia": [0.05] * 3, "angle": "q"}
    drive = {"gimbal": "g", "stiffness": 300.0, "inertia": 0.02, "play": 2e-3}
    root = {"name": "base", "inertia": [1e6] * 3}
    platform = pc.read_platform({"schema": 1, "name": "drive", "root": root, "gimbal": [turned], "compliance": [drive]})
    # Twenty times from one flank of the teeth to the other and back.
    q, steps = [0.0, 1.5e-3], 20_000
    out = simulation.rollout(platform, [q], [np.zeros(5)], step=5e-5, steps=steps)
    run = Run(platform, tmp_path, step=5e-5)
    run.begin(np.array(q), np.zeros(5))
    mujoco.mj_step(run.model, run.data, steps)
    np.testing.assert_allclose(run.state[:2], out.q[0], rtol=0, atol=2e-6)


@pytest.mark.parametrize("name", [name for name in MODELS if pc.read_platform(name).motors])
def test_geared_drives_that_give_way_accelerate_as_in_the_simulation(name: str, tmp_path: Path) -> None:
    platform = pc.read_platform(name)
    notes = write_mjcf(platform, tmp_path / "plant.xml", root="fixed")
    for what, parts in (("mode of the structure", platform.modes), ("drive of", platform.compliances)):
        assert any(note.startswith(what) for note in notes) == bool(parts)
    if not platform.compliances:
        return
    # The axis of the elevation's motor is normal to that of the azimuth: its armature lacks nothing.
    bare = dataclasses.replace(smooth(platform), modes=(), gravity=platform.gravity)
    run = Run(bare, tmp_path, step=1e-5, root="fixed")
    n = len(platform.gimbals)
    q, rates = 0.2 * np.random.default_rng(3).normal(size=(2, n))
    for one in platform.compliances:  # not wound up by much
        q[platform.gimbal(one.motor_side)] = q[platform.gimbal(one.gimbal)] + 1e-3
    run.data.qpos[run.angles], run.data.qvel[run.rates] = q, rates
    mujoco.mj_forward(run.model, run.data)
    u, still = np.r_[np.zeros(3), rates], np.zeros(3 + n)
    forces = pc.element_forces(bare, q, u) - pc.inverse_dynamics(bare, q, u, still)
    expected = np.linalg.solve(pc.matrices(bare, q).A_star[3:, 3:], forces[3:])
    assert np.allclose(run.data.qacc[run.rates], expected, rtol=1e-9)
