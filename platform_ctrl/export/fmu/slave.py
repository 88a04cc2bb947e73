"""What the unit does, in the Python of the tool that imports it: PythonFMU3 passes FMI's calls on to here.

No exception may leave: the library would then free the instance while the importer still uses it. Errors are logged and
returned as the status of the next step.
"""

from __future__ import annotations

import atexit
import ctypes
import json
import math
import os
import sys
from collections.abc import Callable
from functools import cache, partial
from hashlib import sha256
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree.ElementTree import Element, SubElement

import numpy as np
from pythonfmu3 import Fmi3Slave
from pythonfmu3.default_experiment import DefaultExperiment
from pythonfmu3.enums import Fmi3Causality, Fmi3Status, Fmi3Variability
from pythonfmu3.fmi3slave import Fmi3StepResult
from pythonfmu3.unit import Unit
from pythonfmu3.variable_types import EnumerationType
from pythonfmu3.variables import Boolean, Enumeration, Float64, Int64

from platform_ctrl import __version__
from platform_ctrl.common.values import FloatArray, replaced
from platform_ctrl.design.cases import with_spins
from platform_ctrl.errors import InputError, PlatformCtrlError, SimulationError
from platform_ctrl.export.fmu.signals import (
    UNITS,
    Signal,
    commands_of,
    inputs_of,
    output_values,
    outputs_of,
    parameters_of,
    runs_of,
)
from platform_ctrl.job.job import Job, manoeuvre_scenario
from platform_ctrl.job.reading import read_job
from platform_ctrl.job.scenario import Command, Mode, Scenario
from platform_ctrl.simulation import Simulator
from platform_ctrl.verification.controllers import read_controllers

# What a getter that fails returns in place of each number.
_NOTHING: dict[str, Any] = {
    "float64": math.nan,
    "int32": 0,
    "int64": 0,
    "uint64": 0,
    "boolean": False,
    "string": "",
}


def error_line(error: BaseException) -> str:
    """Return a line about an error."""
    return str(error) if isinstance(error, PlatformCtrlError) else f"{type(error).__name__}: {error}"


def guarded_setter(kind: str) -> Callable[[Any, list[int], list[Any]], None]:
    """Return the library's setter of a kind; what it raises goes to the instance's `fail`."""

    def put(self: Any, references: list[int], numbers: list[Any]) -> None:
        try:
            getattr(Fmi3Slave, f"set_{kind}")(self, references, numbers)
        except (Exception, KeyboardInterrupt) as error:
            self.fail(f"values that cannot be set: {error_line(error)}")

    return put


def guarded_getter(kind: str) -> Callable[[Any, list[int]], list[Any]]:
    """Return the library's getter of a kind; where it raises, placeholders."""

    def get(self: Any, references: list[int]) -> list[Any]:
        try:
            return list(getattr(Fmi3Slave, f"get_{kind}")(self, references))
        except (Exception, KeyboardInterrupt) as error:
            self.fail(f"values that cannot be read: {error_line(error)}")
            return [_NOTHING[kind]] * len(references)

    return get


_FUNCTION = "finalizePythonInterpreter"
# Program name that the library sets where it has started Python itself; there it also ends Python.
_OWN_PROGRAM = "PythonFMU"


def finalize_before_exit(resources: Path, identifier: str) -> None:
    """Register the end of the unit's library before that of the process."""
    if os.name == "posix" and Path(sys.executable or _OWN_PROGRAM).name != _OWN_PROGRAM:
        for library in sorted(resources.parent.glob(f"binaries/*/{identifier}.so")):
            _at_exit(library)


@cache
def _at_exit(library: Path) -> None:
    try:
        # Not loaded anew: the handle of the one that is there, or none.
        loaded = ctypes.CDLL(str(library), mode=os.RTLD_NOLOAD | os.RTLD_LAZY)
        atexit.register(getattr(loaded, _FUNCTION))
    except (OSError, AttributeError):
        return


JOB, CONTROLLERS, PLANT, ABOUT = "job.toml", "controllers.json", "plant.toml", "about.json"
# How far the length of a step may be from whole periods, and where it begins from a sample, in periods: more than what
# differences and long sums of steps are rounded by.
_NEAR, _DRIFT = 1e-6, 1e-2
# Samples that are recorded at a time: a step of hours is simulated in pieces.
_AT_ONCE = 10_000
# Units that are shown in their place, and how many of them make one.
_SHOWN = {"rad": ("deg", 180.0 / math.pi), "rad/s": ("deg/s", 180.0 / math.pi)}


class _Choice(Enumeration):  # type: ignore[misc]
    """One of several names; the library (0.3.4) needs these attributes, which only its other kinds have."""

    dimensions = ()

    def size(self, variables: object) -> int:
        return 1


_KINDS = {"Float64": Float64, "Int64": Int64, "Boolean": Boolean, "Enumeration": _Choice}


class PlatformSlave(Fmi3Slave):  # type: ignore[misc]
    """Non-linear plant and sampled controllers of a job, advanced from sample to sample."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        folder = Path(str(kwargs["resources"]))
        about = json.loads((folder / ABOUT).read_text(encoding="utf-8"))
        # The library, which has a logger, not the builder: it has put the folder there, for each instance anew, and
        # leaves it. What is in it is loaded now.
        if "logger" in kwargs and kwargs["resources"] in sys.path:
            sys.path.remove(kwargs["resources"])
        finalize_before_exit(folder, about["identifier"])
        for name in (JOB, CONTROLLERS):
            if sha256((folder / name).read_bytes()).hexdigest() != about["sha256"][name]:
                raise InputError(f"resources/{name}: is not the file that the FMU was written with")
        self._about = about
        self._job: Job = read_job(folder / JOB)
        self._controllers = read_controllers(folder / CONTROLLERS, self._job)
        self._parameters = parameters_of(self._job, about["manoeuvre"])
        self._commanded = commands_of(self._job, self._controllers)
        self._inputs = inputs_of(self._job, self._commanded)
        self._outputs = outputs_of(self._job)
        self._given: dict[str, Any] = {one.name: one.start for one in (*self._parameters, *self._inputs)}
        self._values: list[float | int] = [math.nan if s.kind == "Float64" else 0 for s in self._outputs]
        self._stepper: Simulator | None = None
        # Between instantiation and the end of initialisation parameters may still change.
        self._begun, self._ended, self._stale = False, False, True
        self._failure = ""
        self._time, self._start = 0.0, math.nan
        if about["platform_ctrl"] != __version__:
            text = f"written by platform_ctrl {about['platform_ctrl']}, run by {__version__}: numbers may differ"
            self.log(text, Fmi3Status.warning)
        self._describe()

    set_float64, get_float64 = guarded_setter("float64"), guarded_getter("float64")
    set_int32, get_int32 = guarded_setter("int32"), guarded_getter("int32")
    set_int64, get_int64 = guarded_setter("int64"), guarded_getter("int64")
    set_uint64, get_uint64 = guarded_setter("uint64"), guarded_getter("uint64")
    set_boolean, get_boolean = guarded_setter("boolean"), guarded_getter("boolean")
    set_string, get_string = guarded_setter("string"), guarded_getter("string")

    def _describe(self) -> None:
        """Register variables, units and all else in modelDescription.xml."""
        self.modelName = self._about["identifier"]
        self.description = self._about["description"]
        self.version = self._about["platform_ctrl"]
        self.guid = self._about["token"]
        period = self._job.sampling.period
        longest = max((one.duration for one in self._job.manoeuvres), default=1.0)
        self.default_experiment = DefaultExperiment(0.0, longest, period)
        self.register_units([Unit(name, **base) for name, base in UNITS.items()])
        time = Float64(
            "time",
            causality=Fmi3Causality.independent,
            variability=Fmi3Variability.continuous,
            unit="s",
            getter=lambda: self._time,
            description="Time of the last communication point",
        )
        self.register_variable(time)
        runs = [SimpleNamespace(name=name, value=k) for k, name in enumerate(runs_of(self._job), 1)]
        for signal in (*self._parameters, *self._inputs):
            kind = EnumerationType("Manoeuvre", runs) if signal.kind == "Enumeration" else None
            self._register(signal, partial(self._given.__getitem__, signal.name), self._setter(signal), kind)
        for k, signal in enumerate(self._outputs):
            self._register(signal, partial(self._output, k), None, None)

    def _register(
        self, signal: Signal, getter: Callable[[], Any], setter: Callable[[Any], None] | None, kind: Any
    ) -> None:
        unit = {"unit": signal.unit} if signal.unit else {}
        variable = _KINDS[signal.kind](
            signal.name,
            causality=Fmi3Causality[signal.causality],
            variability=Fmi3Variability[signal.variability],
            description=signal.description,
            getter=getter,
            setter=setter,
            **unit,
        )
        self.register_variable(variable, nested=False, var_type=kind)

    def _setter(self, signal: Signal) -> Callable[[Any], None]:
        def put(number: Any) -> None:
            if signal.causality == "parameter" and self._begun:
                self.fail(f"{signal.name}: cannot be set while the unit runs; set it before or during initialisation")
                return
            self._given[signal.name] = number
            self._stale = self._stale or not self._begun

        return put

    def to_xml(self, model_options: dict[str, str] | None = None) -> Element:
        """Return modelDescription.xml: the library's, with exact numbers, without the time of writing."""
        root: Element = super().to_xml(model_options or {})
        del root.attrib["generationDateAndTime"]
        root.set("modelName", self._about["name"])
        root.set("generationTool", f"platform_ctrl {__version__}, {root.get('generationTool')}")
        able = ("canGetAndSetFMUState", "canSerializeFMUState", "canHandleVariableCommunicationStepSize")
        about = root.find("CoSimulation")
        assert about is not None
        for name in able:
            about.set(name, "true")
        about.set("fixedInternalStepSize", repr(self._job.sampling.period))
        for unit in root.iter("Unit"):
            if unit.get("name") in _SHOWN:
                name, factor = _SHOWN[str(unit.get("name"))]
                SubElement(unit, "DisplayUnit", {"name": name, "factor": repr(factor)})
        if not all(str(one.get("name")).isascii() for one in root.iterfind("ModelVariables/*")):
            # Structured names are ASCII, even in quotes.
            root.set("variableNamingConvention", "flat")
        starts = {one.name: one.start for one in (*self._parameters, *self._inputs)}
        for variable in root.iter("Float64"):
            if variable.get("name") in starts:
                variable.set("start", repr(float(starts[str(variable.get("name"))] or 0.0)))
        return root

    def exit_initialization_mode(self) -> None:
        """Take sample 0: from here on parameters are fixed."""
        self._current()
        self._begun = True

    def do_step(self, current_time: float, step_size: float) -> Fmi3StepResult:
        """Simulate to the next communication point with the present inputs; times in s."""
        try:
            status = self._step(float(current_time), float(step_size))
        except (Exception, KeyboardInterrupt) as error:
            self.fail(error_line(error))
            status = Fmi3Status.error
        return Fmi3StepResult(status=status)

    def _step(self, time: float, length: float) -> Fmi3Status:
        stepper, period = self._current(), self._job.sampling.period
        if stepper is None:
            self.log(self._failure or "the run has been terminated", Fmi3Status.error)
            return Fmi3Status.error
        if not math.isfinite(self._start):
            self._start = time - stepper.sample * period
        expected = self._start + stepper.sample * period
        if not abs(time - expected) <= _DRIFT * period:
            raise SimulationError(f"the step begins at t = {time:.9g} s, but the last one ended at {expected:.9g} s")
        samples = round(length / period) if math.isfinite(length) else 0
        if samples < 1 or abs(length - samples * period) > _NEAR * period:
            text = f"a step of {length:.9g} s is no whole number of sample periods of {period:.9g} s"
            self.log(text, Fmi3Status.discard)
            return Fmi3Status.discard
        given = self._acting(stepper.scenario.mode)
        while samples > 0 and stepper.going:
            simulated = stepper.advance(min(samples, _AT_ONCE), **given)
            given.pop("Omega", None)  # it goes on from where it is
            samples -= _AT_ONCE
            if len(simulated.t):
                self._values = output_values(simulated)
        self._time = self._start + stepper.sample * period
        if not stepper.going:
            raise SimulationError(f"the run has {simulated.ended}")
        return Fmi3Status.ok

    def _acting(self, mode: Mode) -> dict[str, FloatArray]:
        """The inputs that belong to a mode, as `Simulator.advance` takes them."""
        Omega, slope, moment, joints, command = self._input_values()
        if mode == "caged":
            if moment.any():
                raise InputError("M1 to M3 are inputs of stabilised runs and must be zero in this caged run")
            return {"Omega": Omega, "Omega_rate": slope, "gimbal_torque": joints, "command": command}
        if Omega.any() or slope.any():
            raise InputError("Omega1 to Omega3 are inputs of caged runs and must be zero in this stabilised run")
        return {"torque": moment, "gimbal_torque": joints, "command": command}

    def _input_values(self) -> tuple[FloatArray, ...]:
        numbers = np.array([self._given[one.name] for one in self._inputs], dtype=np.float64)
        if not np.isfinite(numbers).all():
            wrong = self._inputs[int(np.flatnonzero(~np.isfinite(numbers))[0])].name
            raise InputError(f"{wrong}: must be a finite number")
        joints = 9 + len(self._job.platform.gimbals)
        return tuple(np.split(numbers, [3, 6, 9, joints]))

    def terminate(self) -> None:
        """Free the run; the outputs keep their values."""
        self._stepper, self._ended = None, True

    def fail(self, text: str) -> None:
        """Log an error; this step or the next one returns it as its status."""
        self._failure = text
        self.log(text, Fmi3Status.error)

    def _current(self) -> Simulator | None:
        """The run, put at t = 0 anew if a parameter has changed; None where it cannot be simulated or has ended."""
        if self._ended or (self._begun and self._failure):
            return None
        if self._stale and not self._begun:
            self._stale, self._stepper, self._failure = False, None, ""
            try:
                self._stepper = self._at_start()
            except (Exception, KeyboardInterrupt) as error:
                self.fail(error_line(error))
        return self._stepper

    def _output(self, k: int) -> float | int:
        if not self._begun:
            self._current()
        return self._values[k]

    def _at_start(self) -> Simulator:
        scenario = self._scenario()
        Omega = self._input_values()[0]
        caged = scenario.mode == "caged"
        stepper = Simulator(
            scenario,
            self._controllers,
            period=self._job.sampling.period,
            step=self._given["step"],
            noise=bool(self._given["noise"]),
            Omega=Omega if caged else None,
        )
        if not stepper.going:
            raise SimulationError(f"the run has {stepper.now.ended}")
        self._values = output_values(stepper.now)
        return stepper

    def _scenario(self) -> Scenario:
        """The scenario that the parameters describe."""
        job, given = self._job, self._given
        names = runs_of(job)
        chosen = int(given["manoeuvre"])
        if not 1 <= chosen <= len(names):
            raise InputError(f"manoeuvre: must be 1 to {len(names)}, got {chosen}")
        platform = job.platform
        spins = [given[one.name] for one in self._parameters if one.name.startswith("spin.")]
        platform = with_spins(platform, dict(zip((rotor.name for rotor in platform.rotors), spins, strict=True)))
        initial = [given[one.name] for one in self._parameters if one.name.startswith("initial.")]
        n = len(platform.gimbals)
        q, rate, Omega, attitude = (np.array(part) for part in np.split(initial, np.cumsum([n, n, 3])))
        mode: Mode = "caged" if chosen == 1 else "stabilised"
        if chosen > 2:
            own = manoeuvre_scenario(job, job.manoeuvres[chosen - 3])
        else:
            own = Scenario(
                platform=job.platform, mode=mode, duration=0.0, delay=job.sampling.delay, drives=job.drive_laws
            )
        if own.mode == "caged" and Omega.any():
            raise InputError("initial.Omega1 to 3 are parameters of stabilised runs and must be zero in this caged run")
        return replaced(
            own,
            {
                "platform": platform,
                "delay": float(given["delay"]),
                "q": own.q + q,
                "rate": own.rate + rate,
                "Omega": own.Omega + Omega,
                "attitude": attitude,
                # Without numbers: what is commanded is an input.
                "commands": (*own.commands, *(Command(reading=name) for name in self._commanded)),
                "seed": int(given["seed"]),
                "run": int(given["run"]),
            },
        )

    def _get_fmu_state(self) -> dict[str, Any]:
        """All that the instance has come to, in plain types."""
        return {
            "given": dict(self._given),
            "values": list(self._values),
            "times": [self._time, self._start],
            "flags": [self._begun, self._ended, self._stale],
            "failure": self._failure,
            "run": None if self._stepper is None else self._stepper.snapshot().tolist(),
        }

    def _set_fmu_state(self, state: dict[str, Any]) -> None:
        try:
            self._given.update(state["given"])
            self._failure = ""
            self._stepper = None
            if state["run"] is not None:
                self._stepper = self._at_start()
                self._stepper.restore(state["run"])
            self._values = list(state["values"])
            self._time, self._start = state["times"]
            self._begun, self._ended, self._stale = state["flags"]
            self._failure = state["failure"]
        except (Exception, KeyboardInterrupt) as error:
            self.fail(f"the state cannot be set: {error_line(error)}")
