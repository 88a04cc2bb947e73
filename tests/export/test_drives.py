"""Drives of torquers and turned readings in the generated code: what is simulated is what is delivered."""

from __future__ import annotations

import ctypes
import dataclasses
from pathlib import Path
from typing import Any

import control
import numpy as np
import pytest

from driven_gimbal import FRICTION, RATE_HZ, less_base, resolved_job, skew_job
from generated_c import Machine, compiled
from platform_ctrl import read_job
from platform_ctrl.errors import InputError
from platform_ctrl.export import write_c
from platform_ctrl.simulation import simulate

BOTH = FRICTION | {"sensors": ["base_pitch", "base_oblique"], "friction": 0.027}


def controller() -> control.StateSpace:
    return control.ss(
        np.diag([0.9, 1.0]),
        np.array([[0.1, 0.02], [0.05, 0.0]]),
        [[-0.3, -0.2], [-0.1, 0.0]],
        -np.diag([0.7, 0.5]),
        1.0 / RATE_HZ,
        inputs=["yaw_resolved_rate", "pitch_resolved_rate"],
        outputs=["Qouter", "Qinner"],
        name="loop",
    )


def written(job: Any, folder: Path, **more: Any) -> Any:
    return write_c(job, [controller()], folder, **more)


def machine(folder: Path, number: type) -> Machine:
    library = compiled(sorted(folder.iterdir()), folder / "all.so")
    inputs = ["pitch", "gyro", "pitch_gyro", "base_oblique", "base_pitch"]
    return Machine(library, "driven", inputs, ["Qouter", "Qinner"], number, ["loop_status"])


@pytest.fixture(scope="module")
def job() -> Any:
    return read_job(resolved_job(BOTH))


def test_torques_are_the_simulated_commands(job: Any, tmp_path: Path) -> None:
    notes = written(job, tmp_path).notes
    assert any("what the drives do is in driven_step" in note for note in notes)
    code = machine(tmp_path, ctypes.c_double)
    scenario = dataclasses.replace(job.scenario(job.manoeuvres[0]), q=np.array([0.0, 0.8]))
    run = simulate(scenario, [controller()], period=1.0 / RATE_HZ)
    column = {sensor.name: k for k, sensor in enumerate(job.platform.sensors)}
    names = ["pitch", "gyro", "pitch_gyro", "base_oblique", "base_pitch"]
    torques, statuses = code.run(run.reading[:, [column[name] for name in names]])
    np.testing.assert_allclose(torques, run.command, rtol=1e-13, atol=1e-15)
    assert set(statuses) == {0}


def test_a_reading_that_is_not_finite_leaves_the_command_as_it_is(job: Any, tmp_path: Path) -> None:
    written(job, tmp_path)
    code = machine(tmp_path, ctypes.c_double)
    (plain, _), status = code.step([0.0, 0.1, 0.0, np.nan, 0.0])
    assert plain == pytest.approx(-0.07, rel=1e-12)
    assert status == 2
    # Of an encoder: nothing is known of the readings, and the last outputs go out again.
    (plain, _), status = code.step([np.nan, 0.2, 0.0, 0.0, 0.0])
    assert plain == pytest.approx(-0.07, rel=1e-12)
    assert status == 2


def test_single_precision_is_the_same_to_its_digits(job: Any, tmp_path: Path) -> None:
    written(job, tmp_path, number="float")
    code = machine(tmp_path, ctypes.c_float)
    (torque, _), status = code.step([0.8, 0.1, 0.0, 0.004, 0.0])
    rate = -1.25 * 0.004
    assert torque == pytest.approx(-0.07 / np.cos(0.8) + 0.027 * rate / 0.01, rel=1e-6)
    assert status == 0


@pytest.mark.parametrize("slow", [False, True])
def test_readings_turned_about_oblique_axes_are_the_simulated_ones(tmp_path: Path, slow: bool) -> None:
    """Past the keyhole too; in a loop at a third of the rate less the motion of the base."""
    data = less_base(skew_job(), noise_rms=1e-3) if slow else skew_job()
    data["plant"]["pickoff"] = [{"gimbal": name, "quantisation": 1e-3} for name in "abc"]
    if slow:
        data["loop"][0]["rate_hz"] = RATE_HZ / 3
    job = read_job(data)
    names, torquers = list(job.resolvers[0].names), ["Qb", "Qa", "Qc"]
    D, dt = -0.1 * np.eye(3), (3 if slow else 1) / RATE_HZ
    K = control.ss([], [], [], D, dt, inputs=names, outputs=torquers, name="loop")
    write_c(job, [K], tmp_path)
    library = compiled(sorted(tmp_path.iterdir()), tmp_path / "all.so")
    inputs = [*job.resolvers[0].encoders, *job.resolvers[0].read]
    inputs = [sensor.name for sensor in job.platform.sensors if sensor.name in inputs]
    for q in ([0.3, 0.7, -1.2], [-1.0, -2.0, 0.4]):
        code = Machine(library, "driven", inputs, torquers, ctypes.c_double, ["loop_status"])
        scenario = dataclasses.replace(job.scenario(job.manoeuvres[0]), q=np.array(q), duration=0.2)
        run = simulate(scenario, [K], period=1.0 / RATE_HZ)
        columns = [run.pickoff_names.index(name) for name in inputs]
        torques, _ = code.run(run.reading[:, columns])
        order = [run.torquer_names.index(name) for name in torquers]
        np.testing.assert_allclose(torques, run.command[:, order], rtol=0.0, atol=1e-12 * np.abs(run.command).max())


def test_a_controller_that_does_not_set_the_torquer_is_refused(job: Any, tmp_path: Path) -> None:
    other = control.ss([], [], [], [[-1.0]], 1.0 / RATE_HZ, inputs=["pitch_gyro"], outputs=["Qinner"], name="loop")
    with pytest.raises(InputError, match="drive of 'Qouter': none of these controllers sets this torquer"):
        write_c(job, [other], tmp_path)
