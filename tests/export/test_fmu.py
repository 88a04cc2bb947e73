"""Plant and controllers as an FMU: its description, and its numbers beside our simulation, to the last bit."""

from __future__ import annotations

import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import control
import fmpy
import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmpy.fmi3 import FMU3Slave
from fmpy.validation import validate_fmu

from commanded_gimbal import commanded_job
from one_gyro_runs import by_numbers, flown, one_gyro
from platform_ctrl.design import loops
from platform_ctrl.errors import ArgumentError, InputError
from platform_ctrl.export import write_fmu
from platform_ctrl.export.fmu.signals import inputs_of, outputs_of, parameters_of, variable_name
from platform_ctrl.job.job import Job, manoeuvre_scenario
from platform_ctrl.job.reading import read_job
from platform_ctrl.simulation import HalfCosine, Scenario, simulate
from platform_ctrl.simulation.closed_loop import Trajectory

COLUMNS = {
    "angle": ("q", "angle_names"),
    "rate": ("rate", "angle_names"),
    "momentum": ("p", "angle_names"),
    "reading": ("reading", "pickoff_names"),
    "command": ("command", "torquer_names"),
    "torque": ("torque", "torquer_names"),
}


@pytest.fixture(scope="module")
def gyro() -> tuple[Job, list[control.StateSpace]]:
    return one_gyro()


@pytest.fixture(scope="module")
def unit(gyro, tmp_path_factory) -> Path:
    return write_fmu(*gyro, tmp_path_factory.mktemp("fmu") / "gyro.fmu")


@pytest.fixture(autouse=True)
def same_path() -> Iterator[None]:
    """A unit leaves Python's path as it was, though the library puts its resources before everything else there."""
    before = list(sys.path)
    yield
    assert sys.path == before


class Instance:
    """One instance of a unit, with FMI's calls by the variables' names."""

    def __init__(self, folder: str, name: str = "one", **parameters: float) -> None:
        described = fmpy.read_model_description(folder)
        self.references = {one.name: one.valueReference for one in described.modelVariables}
        self.messages: list[str] = []
        self.fmu = FMU3Slave(
            instanceName=name,
            guid=described.guid,
            unzipDirectory=folder,
            modelIdentifier=described.coSimulation.modelIdentifier,
        )
        self.fmu.instantiate(logMessage=lambda environment, status, category, text: self.messages.append(text.decode()))
        self.begin(**parameters)

    def begin(self, **parameters: float) -> None:
        for name, number in parameters.items():
            put = self.fmu.setFloat64 if isinstance(number, float) else self.fmu.setInt64
            put([self.references[name.replace("__", ".")]], [number])
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()

    def put(self, name: str, number: float) -> None:
        self.fmu.setFloat64([self.references[name]], [number])

    def get(self, name: str) -> float:
        return self.fmu.getFloat64([self.references[name]])[0]

    def step(self, time: float, length: float) -> None:
        self.fmu.doStep(currentCommunicationPoint=time, communicationStepSize=length)

    def free(self) -> None:
        self.fmu.terminate()
        self.fmu.freeInstance()


@pytest.fixture(scope="module")
def folder(unit, tmp_path_factory) -> str:
    return fmpy.extract(unit, tmp_path_factory.mktemp("unit"))


def differing(found: Any, expected: Trajectory, every: int = 1) -> list[str]:
    """Outputs that are not those of a trajectory to the last bit."""
    wanted = {
        variable_name(group, name): getattr(expected, column)[::every, k]
        for group, (column, names) in COLUMNS.items()
        for k, name in enumerate(getattr(expected, names))
    }
    wanted |= {f"platform.Omega{k + 1}": expected.Omega[::every, k] for k in range(3)}
    wanted |= {f"platform.attitude_{part}": expected.attitude[::every, k] for k, part in enumerate("wxyz")}
    assert len(found["time"]) == len(expected.t[::every])
    return [name for name, numbers in wanted.items() if not np.array_equal(found[name], numbers)]


def test_the_description_is_valid_and_names_every_signal_with_its_unit(gyro, unit):
    job, _ = gyro
    assert validate_fmu(str(unit)) == []
    described = fmpy.read_model_description(unit, validate=True)
    found = {one.name: one for one in described.modelVariables}
    for signal in (*parameters_of(job, 3), *inputs_of(job, ()), *outputs_of(job)):
        one = found[signal.name]
        assert (one.type, one.causality, one.variability) == (signal.kind, signal.causality, signal.variability)
        assert (one.unit or "") == signal.unit
    assert {one.name: len(one.displayUnits) for one in described.unitDefinitions}["rad"] == 1
    assert described.coSimulation.canGetAndSetFMUstate
    assert float(described.coSimulation.fixedInternalStepSize) == job.sampling.period
    assert float(found["spin.'11'"].start) == next(r.spin for r in job.platform.rotors if r.name == "11")
    assert described.defaultExperiment.stepSize == str(job.sampling.period)


def test_names_of_other_alphabets_are_valid_too(gyro, unit, tmp_path):
    job, controllers = gyro
    rotors = [replace(rotor, name=f"Läufer {rotor.name}") for rotor in job.platform.rotors]
    named = replace(job, platform=replace(job.platform, rotors=tuple(rotors)))
    other = write_fmu(named, controllers, tmp_path / "named.fmu")
    assert validate_fmu(str(other)) == []
    conventions = [fmpy.read_model_description(one).variableNamingConvention for one in (unit, other)]
    assert conventions == ["structured", "flat"]


def test_the_file_holds_what_it_is_made_of_and_is_the_same_every_time(gyro, unit, tmp_path):
    job, controllers = gyro
    result = tmp_path / "result.json"
    result.write_text('{"schema": 1}')
    again = write_fmu(job, controllers, tmp_path / "again.fmu")
    assert again.read_bytes() == unit.read_bytes()
    with_result = write_fmu(job, controllers, tmp_path / "other.fmu", manoeuvre="it's a step", result=result)
    with zipfile.ZipFile(with_result) as packed:
        about = packed.read("resources/about.json").decode()
        assert sha256(result.read_bytes()).hexdigest() in about
        assert read_job(tomllib.loads(packed.read("resources/job.toml").decode())).name == job.name
        assert b"three-gyro platform" in packed.read("resources/plant.toml")
        shown = packed.read("documentation/index.html").decode()
        assert "<code>spin.&#39;11&#39;</code>" in shown
        assert "<li>it&#39;s a step</li>" in shown
        assert {entry.date_time for entry in packed.infolist()} == {(1980, 1, 1, 0, 0, 0)}
    assert fmpy.read_model_description(with_result).modelVariables[1].start == "4"


@pytest.mark.parametrize(("name", "number", "every"), [("turn", 3, 1), ("it's a step", 4, 3)])
def test_a_manoeuvre_of_the_unit_is_that_of_the_simulation_to_the_last_bit(gyro, unit, name, number, every):
    job, controllers = gyro
    expected = flown(job, controllers, name)
    found = fmpy.simulate_fmu(
        str(unit),
        stop_time=float(expected.t[-1]),
        output_interval=every * job.sampling.period,
        start_values={"manoeuvre": number},
    )
    write_fmu(job, controllers, unit)  # in a process where it has run
    assert differing(found, expected, every) == []
    assert found["saturated.Q9"][-1] == expected.saturated[expected.torquer_names.index("Q9")]


def test_the_main_plant_with_all_loops_is_that_of_the_simulation(tmp_path):
    job = read_job("examples/three_gyro_platform.toml")
    pairs = [("alpha4", "Q5"), ("beta5", "Q4"), ("beta7", "Q7"), ("alpha9", "Q10"), ("beta10", "Q9")]
    period = job.sampling.period
    servo = control.ss([[1.0]], [[period]], [[0.3]], [[-5.0]], period, inputs=["Q10"], outputs=["M3"], name="servo")
    controllers = [*by_numbers(pairs, period), servo]
    unit = write_fmu(job, controllers, tmp_path / "main.fmu", manoeuvre="0.1 N m step about axis 3")
    expected = flown(job, controllers, "0.1 N m step about axis 3", duration=0.05, seed=5, run=2)
    found = fmpy.simulate_fmu(
        str(unit), stop_time=0.05, output_interval=period, start_values={"seed": 5, "run": 2}, validate=False
    )
    assert np.abs(expected.command[:, expected.torquer_names.index("M3")]).max() > 0.0
    assert differing(found, expected) == []


def test_a_reading_is_commanded_by_an_input(tmp_path):
    job = read_job(commanded_job([{"reading": "gyro", "step": 0.2, "at": 0.0105}], command={"filter_hz": 20.0}))
    controllers = [one.closed.controller for one in loops(job)]
    period = job.sampling.period
    expected = simulate(manoeuvre_scenario(job, job.manoeuvres[0]), controllers, period=period)
    folder = fmpy.extract(write_fmu(job, controllers, tmp_path / "slew.fmu"), tmp_path / "unit")
    one = Instance(folder, manoeuvre=1)  # caged, nothing commanded by itself
    for k in range(30):
        if k == 10:
            one.put("reading_command.gyro", 0.2)
        one.step(k * period, period)
        assert one.get("rate.q_yaw") == expected.rate[k + 1, 0]
    one.free()


def test_parameters_are_those_of_the_scenario(gyro, unit):
    job, controllers = gyro
    period = job.sampling.period
    rotors = tuple(
        replace(one, angular_momentum=1000.0 * one.axial_inertia) if one.name == "11" else one
        for one in job.platform.rotors
    )
    scenario = replace(
        manoeuvre_scenario(job, job.manoeuvres[0]),
        platform=replace(job.platform, rotors=rotors),
        delay=0.0008,
        q=manoeuvre_scenario(job, job.manoeuvres[0]).q + np.eye(5)[0] * 1e-4,
        rate=np.eye(5)[4] * 1e-3,
    )
    expected = simulate(scenario, controllers, period=period, step=2e-4, noise=False)
    given = {"manoeuvre": 3, "noise": False, "delay": 0.0008, "step": 2e-4, "spin.'11'": 1000.0}
    given |= {"initial.alpha4": 1e-4, "initial.beta10_rate": 1e-3}
    stop = float(expected.t[-1])
    found = fmpy.simulate_fmu(str(unit), stop_time=stop, output_interval=period, start_values=given)
    assert differing(found, expected) == []


def test_a_rate_given_sample_by_sample_comes_close_to_the_same_manoeuvre(gyro, unit):
    job, controllers = gyro
    period = job.sampling.period
    profile = HalfCosine(axis=1, rate=1.0, rise=0.02, hold=0.01)
    scenario = Scenario(platform=job.platform, mode="caged", duration=0.06, delay=job.sampling.delay, profile=profile)
    expected = simulate(scenario, controllers, period=period, noise=False)
    t = period * np.arange(122)
    rate = np.append(expected.Omega[:, 0], 0.0)
    slope = np.append(np.diff(rate), 0.0) / period
    names = [("time", np.float64), ("Omega1", np.float64), ("Omega1_rate", np.float64)]
    largest = np.abs(expected.q).max()
    for slopes, error in ((slope, 3e-3), (0.0 * slope, 0.1)):
        rows = np.array(list(zip(t, rate, slopes, strict=True)), dtype=names)
        found = fmpy.simulate_fmu(
            str(unit),
            stop_time=0.06,
            output_interval=period,
            input=rows,
            start_values={"manoeuvre": 1, "noise": False},
        )
        for k, angle in enumerate(expected.angle_names):
            assert found[f"angle.{angle}"] == pytest.approx(expected.q[:, k], abs=error * largest)


def test_instances_keep_apart_and_reset_begins_anew(gyro, folder):
    job, controllers = gyro
    period = job.sampling.period
    expected = {name: flown(job, controllers, name) for name in ("turn", "it's a step")}
    turn, step = Instance(folder, "turn", manoeuvre=3), Instance(folder, "step", manoeuvre=4)
    for k in range(20):
        for one, name in ((turn, "turn"), (step, "it's a step")):
            assert one.get("angle.alpha9") == expected[name].q[k, 3]
            one.step(k * period, period)
    turn.fmu.reset()
    turn.begin(manoeuvre=4)
    turn.step(0.0, 20 * period)
    assert turn.get("angle.beta10") == step.get("angle.beta10") == expected["it's a step"].q[20, 4]
    kept = step.fmu.getFMUState()
    kept_bytes = step.fmu.serializeFMUState(kept)
    step.step(20 * period, 5 * period)
    step.fmu.setFMUState(step.fmu.deserializeFMUState(kept_bytes))
    step.put("disturbance.alpha9", 0.0)
    step.step(20 * period, 10 * period)
    assert step.get("angle.beta10") == expected["it's a step"].q[30, 4]
    assert step.get("time") == 30 * period
    turn.free()
    step.free()


def test_steps_between_samples_are_discarded_and_the_run_goes_on(gyro, folder):
    job, controllers = gyro
    period = job.sampling.period
    expected = flown(job, controllers, "turn")
    one = Instance(folder, manoeuvre=3)
    for length in (0.5 * period, 1.5 * period, 0.0, -period):
        with pytest.raises(FMICallException, match="status 2"):
            one.step(0.0, length)
        assert "is no whole number of sample periods of 0.0005 s" in one.messages[-1]
    one.step(0.0, 3 * period)
    assert one.get("angle.alpha9") == expected.q[3, 3]
    one.free()


def test_a_variable_that_is_not_there_is_an_error_and_no_crash(folder):
    one = Instance(folder, manoeuvre=3)
    assert np.isnan(one.fmu.getFloat64([9999])[0])
    assert "values that cannot be read: KeyError: 9999" in one.messages[-1]
    one.fmu.setInt64([one.references["angle.alpha4"]], [1])
    assert "values that cannot be set: TypeError" in one.messages[-1]
    with pytest.raises(FMICallException, match="status 3"):
        one.step(0.0, 0.0005)
    one.free()


def test_what_goes_wrong_is_logged_and_an_error_of_the_step(folder):
    def refused(text: str, inputs: dict[str, float], time: float = 0.0, **parameters: float) -> None:
        one = Instance(folder, **parameters)
        if time > 0.0:
            one.step(0.0, 0.0005)
        for name, number in inputs.items():
            one.put(name, number)
        with pytest.raises(FMICallException, match="status 3"):
            one.step(time, 0.0005)
        assert text in one.messages[-1], one.messages
        with pytest.raises(FMICallException, match="status 3"):  # nor later
            one.step(0.0005, 0.0005)
        one.fmu.reset()
        one.begin(manoeuvre=3)
        one.step(0.0, 0.0005)
        one.free()

    refused("M1 to M3 are inputs of stabilised runs", {"M2": 1.0}, manoeuvre=1)
    refused("Omega1 to Omega3 are inputs of caged runs", {"Omega1": 1.0}, manoeuvre=2)
    refused("Omega1: must be a finite number", {"Omega1": float("nan")}, manoeuvre=1)
    refused("manoeuvre: must be 1 to 4, got 9", {}, manoeuvre=9)
    refused("delay must be a finite number >= 0, got -1.0", {}, manoeuvre=1, delay=-1.0)
    refused("initial.Omega1 to 3 are parameters of stabilised runs", {}, manoeuvre=1, initial__Omega1=1.0)
    refused("the last one ended at 0.0005 s", {}, time=0.1, manoeuvre=1)
    refused("spin.'11': cannot be set while the unit runs", {"spin.'11'": 5.0}, manoeuvre=1)
    refused("values that cannot be set", {"angle.alpha4": 1.0}, manoeuvre=1)
    refused("diverged at t", {"disturbance.alpha9": 1e300}, manoeuvre=1)


def test_the_unit_runs_elsewhere_and_from_another_process(gyro, unit, tmp_path):
    job, controllers = gyro
    moved = tmp_path / "another place" / "gyro moved.fmu"
    moved.parent.mkdir()
    moved.write_bytes(unit.read_bytes())
    program = (
        "import sys, fmpy; "
        f"r = fmpy.simulate_fmu({str(moved)!r}, stop_time=0.01, output_interval=0.0005); "
        "print(r['angle.alpha9'][-1].hex())"
    )
    ran = subprocess.run(
        [sys.executable, "-c", program],
        cwd=tmp_path,
        env={"PYTHONPATH": str(Path.cwd()), "PATH": "", "OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert ran.returncode == 0, ran.stderr
    assert ran.stdout.split()[-1] == float(flown(job, controllers, "turn").q[20, 3]).hex()


def test_what_cannot_be_written_is_refused_in_one_line(gyro, tmp_path, monkeypatch):
    job, controllers = gyro
    with pytest.raises(ArgumentError, match=r"manoeuvre must be one of .* got 'roll'"):
        write_fmu(job, controllers, tmp_path / "x.fmu", manoeuvre="roll")
    with pytest.raises(ArgumentError, match=r"seed must .*got 9223372036854775808"):
        write_fmu(replace(job, seed=2**63), controllers, tmp_path / "x.fmu")
    with pytest.raises(InputError, match="cannot be written"):
        write_fmu(job, controllers, tmp_path / "no folder" / "x.fmu")
    with pytest.raises(InputError, match=r"no result\.json: cannot be read"):
        write_fmu(job, controllers, tmp_path / "x.fmu", result=tmp_path / "no result.json")
    wrong = control.ss([], [], [], [[1.0]], job.sampling.period, inputs=["alpha9"], outputs=["Q99"])
    with pytest.raises(ArgumentError, match="Q99"):
        write_fmu(job, [wrong], tmp_path / "x.fmu")
    between = control.ss([], [], [], [[1.0]], job.sampling.period, inputs=["alpha9"], outputs=["between"], name="K")
    then = control.ss([], [], [], [[1.0]], job.sampling.period, inputs=["between"], outputs=["Q9"], name="then")
    with pytest.raises(InputError, match='"between" is no torquer'):
        write_fmu(job, [between, then], tmp_path / "x.fmu")
    with pytest.raises(ArgumentError, match="the list is empty"):
        write_fmu(job, [], tmp_path / "x.fmu")
    monkeypatch.setitem(sys.modules, "pythonfmu3.builder", None)
    with pytest.raises(InputError, match=r"not installed: pip install 'platform_ctrl\[fmu\]'"):
        write_fmu(job, controllers, tmp_path / "x.fmu")
    assert list(tmp_path.iterdir()) == []


def test_changed_resources_are_not_run(unit, tmp_path):
    folder = fmpy.extract(unit, tmp_path)
    file = tmp_path / "resources" / "controllers.json"
    file.write_text(file.read_text().replace("-60.0", "-61.0"))
    with pytest.raises(Exception, match="Failed to instantiate"):
        Instance(folder)
