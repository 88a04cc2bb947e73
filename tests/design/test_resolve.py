"""Readings turned to joint axes: the Jacobian against MuJoCo's, plants, the coupled check, noise, simulation."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import control
import mujoco
import numpy as np
import pytest

from driven_gimbal import RATE_HZ, driven_job, less_base, resolved_job, skew_job
from platform_ctrl import read_job, read_platform
from platform_ctrl.analysis.loop import Loop
from platform_ctrl.analysis.measuring import torque_noise
from platform_ctrl.analysis.response import frequency_response
from platform_ctrl.design.plants import plants_of
from platform_ctrl.design.sections import gain
from platform_ctrl.job.faults import Fault
from platform_ctrl.job.requirements import requirement
from platform_ctrl.job.resolve import resolver
from platform_ctrl.job.scenario import Sine
from platform_ctrl.mechanics.linearisation import linearise
from platform_ctrl.simulation import Scenario, simulate, simulate_batch
from platform_ctrl.verification.coupled import coupled_check
from platform_ctrl.verification.simulated import simulate_manoeuvre

ANGLES = {"Omega": [0.1, 0.1, 0.1], "angles": {"pitch": [-0.5, 1.0, 1.4]}}
READ = ["yaw_resolved_rate", "pitch_resolved_rate"]


def test_a_loop_at_any_elevation_is_that_at_zero_where_the_inner_inertia_is_a_sphere() -> None:
    plants = plants_of(read := read_job(resolved_job(operation=ANGLES)), read.loops[0])
    assert plants.angles == tuple(READ)
    assert plants.limited == ("pitch = 1.4 rad",)
    labels = ("nominal", "pitch = -0.5 rad", "pitch = 1 rad", "pitch = 1.4 rad")
    zero, low, high, beyond = (plants.response[plants.labels.index(label)] for label in labels)
    for one in (low, high):
        np.testing.assert_allclose(one, zero, rtol=0.0, atol=1e-12 * np.abs(zero).max())
    # Beyond the limit of 5 only a part of the cosine is undone: cos² over the limit's.
    np.testing.assert_allclose(beyond[:, 0, 0], 25.0 * np.cos(1.4) ** 2 * zero[:, 0, 0], rtol=1e-9)
    without = plants_of(read := read_job(driven_job(operation=ANGLES)), read.loops[0])
    np.testing.assert_allclose(
        without.response[without.labels.index("pitch = 1 rad")][:, 0, 0], np.cos(1.0) * zero[:, 0, 0], rtol=1e-9
    )


def test_an_encoder_that_reads_too_much_turns_the_readings_too_far() -> None:
    data = resolved_job(operation=ANGLES | {"angles": {"pitch": [1.0]}})
    data["plant"]["pickoff"][1] |= {"bias": 0.1, "scale_error": 0.05}
    plants = plants_of(read := read_job(data), read.loops[0])
    zero = plants_of(read := read_job(resolved_job()), read.loops[0]).response[0, :, 0, 0]
    for label, factor in (("nominal", 1.0 / np.cos(0.1)), ("pitch = 1 rad", np.cos(1.0) / np.cos(1.15))):
        np.testing.assert_allclose(plants.response[plants.labels.index(label), :, 0, 0], factor * zero, rtol=1e-9)


def test_noise_is_turned_like_the_readings() -> None:
    """At a pitch of 60 degrees the yaw gyro's noise counts twice."""
    data = resolved_job(operation=ANGLES | {"angles": {"pitch": [np.pi / 3]}})
    data["plant"]["rate_sensor"][0] |= {"noise_rms": 1e-3, "quantisation": 1e-4}
    data["plant"]["rate_sensor"][1]["noise_rms"] = 3e-3
    plants = plants_of(read := read_job(data), read.loops[0])
    K = gain(-1e-2 * np.eye(2))._replace(dt=1.0 / RATE_HZ)
    assert "; quantisation of gyro not counted" in requirement("torque noise", 1.0).check(plants, K).evidence
    rms = torque_noise(Loop(plants, K))
    np.testing.assert_allclose(rms[plants.labels.index("pitch = 1.0472 rad")] / rms[0], [2.0, 1.0], rtol=1e-9)


def turned(name: str, **changed: Any) -> Any:
    """Return a shipped job without its runs, with turned readings, far from level."""
    job = read_job(Path(f"examples/{name}.toml"))
    spec = dataclasses.replace(job.loops[0], resolve=True)
    return dataclasses.replace(job, loops=(spec,), manoeuvres=(), budget=None, **changed)


def servo(job: Any, hz: float) -> control.StateSpace:
    """Return u = −J ω y, each axis by itself, by the inertias at level; of fixed readings y turned as at level."""
    M, spec = np.diag(linearise(job.platform).M), job.loops[0]
    D = -2.0 * np.pi * hz * np.diag(M)
    if not spec.resolve:
        D = D @ resolver(job.platform, spec.gimbals, spec.sensors, 5.0).matrix(np.zeros(3))
    readings, torquers = list(job.readings_of(spec)), list(job.channels_of(spec))
    return control.ss([], [], [], D, job.sampling.period, inputs=readings, outputs=torquers, name="camera, P")


def test_margins_of_yaw_roll_pitch_do_not_depend_on_pitch() -> None:
    """Fixed readings lose the loop straight down, where yaw and roll have changed places."""
    margins: dict[bool, list[float]] = {}
    for resolve in (True, False):
        job = turned("drone_gimbal")
        job = dataclasses.replace(job, loops=(dataclasses.replace(job.loops[0], resolve=resolve),))
        model, K = linearise(job.platform), servo(job, 15.0)
        margins[resolve] = []
        for pitch in (0.0, 0.5236, -0.35, -0.7854, -np.pi / 2):
            found = coupled_check(dataclasses.replace(job, angles={"pitch": (pitch,)}), model, [K])
            margins[resolve].append(next(r.value for r in found.results if r.name == "simultaneous disk margin"))
    level = margins[True][0]
    assert level > 1.0
    np.testing.assert_allclose(margins[True], level, rtol=0.12)
    assert margins[False][0] == pytest.approx(level, rel=1e-6)
    assert margins[False][-1] < 0.1
    assert margins[False][-2] < 0.6 * level


def run_at(job: Any, q: list[float], **more: Any) -> Scenario:
    return dataclasses.replace(job.scenario(job.manoeuvres[0]), q=np.array(q), duration=0.2, **more)


@pytest.mark.parametrize("rate_hz", [None, RATE_HZ / 4])
def test_what_a_loop_reads_in_a_run_is_the_map_of_the_sampled_readings(rate_hz: float | None) -> None:
    """With noise, steps of the encoder and a drift of it: the map knows what the encoder says, nothing else."""
    data = resolved_job()
    if rate_hz:
        data["loop"][0]["rate_hz"] = rate_hz
    data["plant"]["rate_sensor"][0] |= {"noise_rms": 1e-3, "bandwidth_hz": 200.0}
    data["plant"]["pickoff"][1] |= {"quantisation": 1e-2, "noise_rms": 1e-3}
    job = read_job(data)
    n = round(RATE_HZ / rate_hz) if rate_hz else 1
    K = control.ss([], [], [], -0.3 * np.eye(2), n / RATE_HZ, inputs=READ, outputs=["Qouter", "Qinner"])
    drift = Fault(name="slips", kind="pick-off drift", part="pitch", at=0.05, until=0.2, rate=1.0)
    for elevation, faults in ((-1.396, ()), (1.3, (drift,)), (1.55, ())):
        run = simulate(run_at(job, [0.3, elevation], faults=faults), [K], period=1.0 / RATE_HZ)
        columns = [run.pickoff_names.index(name) for name in ("gyro", "pitch_gyro", "pitch")]
        (law,) = job.resolvers
        for k in range(0, len(run.t), n):
            *read, pitch = run.reading[k, columns]
            expected = law.matrix(np.array([0.0, pitch])) @ read
            np.testing.assert_allclose(run.reading[k, -2:], expected, rtol=1e-12, atol=1e-15)
            np.testing.assert_allclose(run.command[k : k + n], np.tile(-0.3 * expected, (n, 1))[: len(run.t) - k])


def test_about_oblique_axes_too() -> None:
    data = skew_job()
    data["plant"]["pickoff"] = [{"gimbal": n, "bias": 0.1, "scale_error": -0.05} for n in "abc"]
    job = read_job(data)
    [law] = job.resolvers
    rows = [name for one in (law.names, law.sensors) for name in one]
    for q in ([0.3, 0.7, -1.2], [-1.0, -2.0, 0.4]):
        run = simulate(
            dataclasses.replace(job.scenario(job.manoeuvres[0]), q=np.array(q), duration=0.05), [], period=1e-3
        )
        resolved, read = np.split(run.reading[:, [run.pickoff_names.index(name) for name in rows]], 2, axis=1)
        expected = [law.matrix(at) @ y for at, y in zip(run.q, read, strict=True)]
        np.testing.assert_allclose(resolved, expected, rtol=0.0, atol=1e-12 * np.abs(expected).max())


def test_less_the_motion_of_the_base_they_are_the_rates_of_the_joints() -> None:
    data = less_base(skew_job(), noise_rms=2e-3, scale_error=0.01, bias=0.02)
    data["plant"]["pickoff"] = [{"gimbal": name} for name in "abc"]
    data["manoeuvre"][0]["sine"] = [
        {"kind": "rate", "axis": k, "frequency_hz": 3.0 * k, "amplitude": 0.3} for k in (1, 2, 3)
    ]
    job, q = read_job(data), np.array([0.3, 0.7, -0.2])
    [law] = job.resolvers
    assert not law.limited(q)
    scenario = dataclasses.replace(job.scenario(job.manoeuvres[0]), q=q, duration=0.1)
    run = simulate(scenario, [], period=1.0 / RATE_HZ)
    read, resolved = (
        run.reading[:, [run.pickoff_names.index(one) for one in names]] for names in (law.read, law.names)
    )
    expected = np.array([law.matrix(at) @ y for at, y in zip(run.q, read, strict=True)])
    np.testing.assert_allclose(resolved, expected, rtol=0.0, atol=1e-12)
    exact = [dataclasses.replace(one, noise_rms=0.0, scale_error=0.0, bias=0.0) for one in job.platform.rate_sensors]
    scenario = dataclasses.replace(scenario, platform=dataclasses.replace(job.platform, rate_sensors=tuple(exact)))
    run = simulate(scenario, [], period=1.0 / RATE_HZ)
    assert np.abs(run.Omega).min(axis=0, where=run.t[:, None] > 0.01, initial=1.0).max() < 0.3 < np.abs(run.rate).max()
    rates = run.rate[:, [job.platform.gimbal(name) for name in law.gimbals]]
    np.testing.assert_allclose(run.reading[:, [run.pickoff_names.index(one) for one in law.names]], rates, atol=1e-9)


def test_their_loop_is_that_of_tachometers_with_the_noise_of_the_gyros_of_the_base() -> None:
    data = less_base(resolved_job(operation=ANGLES | {"angles": {"pitch": [-0.5, 1.0]}}), noise_rms=1e-3)
    data["plant"]["rate_sensor"].append({"name": "inner_tacho", "gimbal": "inner"})
    job = read_job(data)
    spec = dataclasses.replace(job.loops[0], resolve=False, resolve_base=(), sensors=("tacho", "inner_tacho"))
    tachos = dataclasses.replace(job, loops=(spec,))
    found, expected = plants_of(job, job.loops[0]), plants_of(tachos, spec)
    size, w = np.abs(expected.response).max(), np.array([1.0, 30.0, 1000.0])
    np.testing.assert_allclose(found.response, expected.response, rtol=0.0, atol=1e-12 * size)
    for one, other in zip(found.disturbed_at(w), expected.disturbed_at(w), strict=True):
        gains = [np.swapaxes(x.conj(), -1, -2) @ x for x in (one, other)]
        np.testing.assert_allclose(gains[0], gains[1], rtol=0.0, atol=1e-10 * np.abs(gains[1]).max())
    of_base = np.linalg.norm(job.resolvers[0].of_base, axis=1)
    np.testing.assert_allclose(found.noise_of(), np.sqrt(0.5) * 1e-3 * of_base[[2, 1]], rtol=1e-9)
    checks = []
    for one in (job, tachos):
        readings = list(one.readings_of(one.loops[0]))
        K = control.ss([], [], [], -0.3 * np.eye(2), 1.0 / RATE_HZ, inputs=readings, outputs=["Qouter", "Qinner"])
        checks.append(coupled_check(one, linearise(one.platform), [K]))
    np.testing.assert_allclose(checks[0].coupled, checks[1].coupled, rtol=1e-9)
    assert checks[0].decoupled == pytest.approx(checks[1].decoupled, rel=1e-9)


def test_noise_of_an_encoder_turns_the_rate_of_the_base_that_is_subtracted() -> None:
    Omega = np.array([0.2, 0.0, 0.5])
    data = less_base(resolved_job(operation={"Omega": Omega.tolist(), "angles": {"pitch": [0.5]}}))
    data["plant"]["pickoff"][1]["noise_rms"] = 1e-3
    plants = plants_of(job := read_job(data), job.loops[0])
    yaw, pitch = plants.noise_input(plants.labels.index("pitch = 0.5 rad"))
    # y = (ω − Ω1 sin q − Ω3 cos q)/cos q, for signs of Ω1 and Ω3 that are not known.
    each = job.platform.pickoffs[1].sampled_noise(1.0 / RATE_HZ) * np.array([Omega[0], Omega[2] * np.tan(0.5)])
    assert np.linalg.norm(yaw) == pytest.approx(np.sqrt(2.0) * np.linalg.norm(each), rel=1e-6)
    assert np.linalg.norm(yaw) > each.sum()
    assert np.linalg.norm(pitch) < 1e-15


def test_a_run_that_comes_near_the_keyhole_says_so() -> None:
    data = resolved_job()
    data["manoeuvre"][0] |= {"duration": 0.05, "limits": {"gimbal_rate": 9.0}}
    said = []
    for pitch in (0.3, 1.45):
        data["manoeuvre"][0]["initial"] = {"pitch": pitch}
        job = read_job(data)
        K = control.ss([], [], [], -0.3 * np.eye(2), 1.0 / RATE_HZ, inputs=READ, outputs=["Qouter", "Qinner"])
        [result] = simulate_manoeuvre(job, job.manoeuvres[0], [K]).results
        said.append("keyhole: the gain of resolved readings is limited on the way" in result.evidence)
    assert said == [False, True]


def test_many_runs_are_those_of_one_and_errors_of_sensors_are_no_errors_of_following() -> None:
    data = resolved_job()
    data["plant"]["rate_sensor"][0] |= {"bias": 0.05, "scale_error": 0.01}
    data["manoeuvre"][0] |= {"sine": [], "command": [{"reading": "yaw_resolved_rate", "step": 0.1}]}
    job = read_job(data)
    D = np.hstack([-2.0 * np.eye(2), 2.0 * np.eye(2)[:, :1]])
    inputs = [*READ, "yaw_resolved_rate_command"]
    K = control.ss([], [], [], D, 1.0 / RATE_HZ, inputs=inputs, outputs=["Qouter", "Qinner"])
    scenarios = [run_at(job, [0.0, pitch], settle=0.1) for pitch in (0.0, -1.0, 0.9)]
    both = simulate_batch(scenarios, [K], period=1.0 / RATE_HZ)
    alone = [simulate(one, [K], period=1.0 / RATE_HZ) for one in scenarios]
    column = list(alone[0].pickoff_names).index("yaw_resolved_rate") - 2  # behind two angles
    np.testing.assert_array_equal(both.rate_following_error[:, column], [run.following_error[0] for run in alone])
    for run in alone:
        settled = run.t >= 0.1
        true = (run.reading[settled, run.pickoff_names.index("gyro")] - 0.05) / 1.01
        pitch = run.reading[settled, run.pickoff_names.index("pitch")]
        error = np.abs(true / np.cos(pitch) - 0.1).max()
        assert run.following_error[0] == pytest.approx(error, rel=1e-9)


def test_an_encoder_that_fails_is_no_part_of_what_follows_a_command() -> None:
    """Readings are turned by what it says; the error is that of the joint."""
    data = resolved_job()
    data["manoeuvre"][0] |= {"sine": [], "command": [{"reading": "yaw_resolved_rate", "step": 0.1}], "faults": ["dead"]}
    data["fault"] = [{"name": "dead", "kind": "pick-off dead", "part": "pitch", "at": 0.0}]
    job = read_job(data)
    D = np.hstack([-2.0 * np.eye(2), 2.0 * np.eye(2)[:, :1]])
    inputs = [*READ, "yaw_resolved_rate_command"]
    K = control.ss([], [], [], D, 1.0 / RATE_HZ, inputs=inputs, outputs=["Qouter", "Qinner"])
    run = simulate(run_at(job, [0.0, -1.0], settle=0.1), [K], period=1.0 / RATE_HZ, noise=False)
    error = np.abs(run.rate[run.t >= 0.1 - 1e-9, 0] - 0.1).max()
    assert error > 0.05
    assert run.following_error[0] == pytest.approx(error, rel=1e-9)


def test_at_80_degrees_down_the_linear_loop_is_what_the_simulation_does() -> None:
    """The base yaws a little at 5 Hz: what the loop reads, by the linear plants and in the non-linear run."""
    w, size, q = 10.0 * np.pi, 1e-3, np.array([0.0, 0.0, -1.396])
    job = turned("multirotor_gimbal", angles={"pitch": (q[2],)})
    platform = dataclasses.replace(job.platform, frictions=(), unbalances=())
    job = dataclasses.replace(job, platform=platform)
    K = servo(job, 15.0)
    sine = Sine(kind="rate", axis=3, frequency_hz=5.0, amplitude=size)
    more = {"q": q, "start": "equilibrium", "resolvers": job.resolvers, "sines": (sine,)}
    scenario = Scenario(platform=platform, mode="caged", duration=0.8, delay=job.sampling.delay, **more)
    run = simulate(scenario, [K], period=job.sampling.period, noise=False)
    settled = run.t >= 0.4 - 1e-9
    settled[-1] = False
    turning = np.exp(-1j * w * run.t[settled])
    found = 2.0 * np.mean(run.reading[settled][:, -3:] * turning[:, None], axis=0) * 1j / size
    plants = plants_of(job, job.loops[0])
    whole = plants.whole.at(plants.labels.index("pitch = -1.396 rad"))
    closed = whole.feedback(gain(K.D), range(3), range(3))  # the torques are its first outputs
    expected = frequency_response(closed.part(slice(3, 6), [5]), np.array([w]), -3)[0, :, 0]
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=0.01 * np.abs(expected).max())
    assert abs(expected[0]) > 10.0 * abs(expected[2])  # the base yaws: the yaw joint feels it


def unit(rng: np.random.Generator) -> list[float]:
    axis = rng.normal(size=3)
    return (axis / np.linalg.norm(axis)).tolist()


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("order", [(0, 1, 2), (2, 0, 1), (3, 1)])
def test_the_jacobian_is_mujocos_for_axes_in_any_direction_and_order(seed: int, order: tuple[int, ...]) -> None:
    rng = np.random.default_rng(seed)
    axes, sensing = [unit(rng) for _ in range(4)], [unit(rng) for _ in order]
    bodies = [f"g{rng.integers(max(order), 4)}", *("g3" for _ in order[1:])]
    tree = ""
    for k in reversed(range(4)):
        joint = f'<joint type="hinge" axis="{" ".join(map(str, axes[k]))}"/><geom size=".1"/>'
        tree = f'<body name="g{k}">{joint}{tree}</body>'
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{tree}</worldbody></mujoco>")
    data = mujoco.MjData(model)
    q = data.qpos[:] = rng.uniform(-2.0, 2.0, 4)
    mujoco.mj_forward(model, data)
    expected = []
    for body, axis in zip(bodies, sensing, strict=True):
        rate = np.zeros((3, 4))
        mujoco.mj_jacBody(model, data, None, rate, model.body(body).id)
        expected.append(data.body(body).xmat.reshape(3, 3) @ axis @ rate)
    platform = read_platform(
        {
            "schema": 1,
            "name": "tree",
            "root": {"name": "base", "inertia": [1, 1, 1]},
            "gimbal": [
                {"name": f"g{k}", "parent": f"g{k - 1}" if k else "base", "axis": axes[k], "inertia": [1, 1, 1]}
                for k in range(4)
            ],
            "pickoff": [{"gimbal": f"g{k}"} for k in range(4)],
            "rate_sensor": [
                {"name": f"s{i}", "body": body, "axis": axis}
                for i, (body, axis) in enumerate(zip(bodies, sensing, strict=True))
            ],
        }
    )
    law = resolver(platform, [f"g{k}" for k in order], [f"s{i}" for i in range(len(order))], 1e6)
    np.testing.assert_allclose(np.linalg.inv(law.matrix(q)), np.array(expected)[:, order], rtol=0.0, atol=1e-9)


def two_axes() -> Any:
    (law,) = read_job(resolved_job()).resolvers
    return law


def test_of_two_axes_it_is_the_secant() -> None:
    law = two_axes()
    assert (law.names, law.encoders) == (("yaw_resolved_rate", "pitch_resolved_rate"), ("pitch",))
    for elevation in (-1.3, -0.5, 0.0, 1.0, 1.36):
        q = np.array([0.7, elevation])
        np.testing.assert_allclose(law.matrix(q), np.diag([1.0 / np.cos(elevation), 1.0]), rtol=1e-13)
        assert not law.limited(q)


def test_near_the_keyhole_the_gain_is_limited_and_changes_its_sign_at_it() -> None:
    law = two_axes()
    elevations = np.linspace(-np.pi, np.pi, 2001)
    gains = np.array([law.matrix(np.array([0.0, one])) for one in elevations])
    azimuth, elevation = gains[:, 0, 0], gains[:, 1, 1]
    assert 4.98 < np.abs(azimuth).max() <= 5.0
    assert np.abs(np.diff(azimuth)).max() < 0.2  # no jump
    assert np.all(azimuth * np.cos(elevations) >= 0.0)
    assert elevation.min() >= 0.96
    assert law.matrix(np.array([0.0, np.pi / 2]))[0, 0] == pytest.approx(0.0, abs=1e-9)
    assert law.limited(np.array([0.0, 1.4]))
