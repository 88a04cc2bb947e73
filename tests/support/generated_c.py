"""Generated C in tests: controllers by numbers, compiled with every warning on, run by ctypes."""

from __future__ import annotations

import ctypes
import dataclasses
import json
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import control
import numpy as np
import pytest

from platform_ctrl import linearise
from platform_ctrl.common.files import json_text
from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.cases import rows_of
from platform_ctrl.design.loop_signals import channels
from platform_ctrl.design.method import LoopProblem, designed
from platform_ctrl.design.methods.classical import Classical
from platform_ctrl.design.methods.structured import pid_structure
from platform_ctrl.design.plants import plants_of
from platform_ctrl.job.job import Job

WARNINGS = [
    "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wsign-conversion", "-Wshadow", "-Wdouble-promotion",
    "-Wfloat-conversion", "-Wcast-qual", "-Wstrict-prototypes", "-Wundef", "-Werror",
]  # fmt: skip
LANGUAGES = {"gcc": "-std=c99", "g++": "-std=c++11", "clang": "-std=c99"}

CLASSICAL = {
    ("4", "5", "7"): {
        "crossover_hz": 46.0, "integral_hz": 2.0, "damping_hz": 49.0, "damping2_hz": 75.0, "lead_hz": 5.0,
        "rolloff_hz": 880.0, "inertial_crossover_hz": 70.0, "inertial_lead_hz": 30.0, "inertial_rolloff_hz": 836.0,
        "lag_hz": 4.0, "lag_ratio": 1.5,
    },
    ("9", "10"): {
        "crossover_hz": 70.0, "integral_hz": 2.0, "damping_hz": 78.0, "damping2_hz": 92.0, "lead_hz": 7.0,
        "rolloff_hz": 900.0, "notch_hz": 200.0, "notch_depth": 0.7, "notch_width": 0.15,
    },
}  # fmt: skip


def designed_entry(job: Job, number: int, **options: float) -> dict[str, Any]:
    """The first design of a loop of the job, with these options, as it stands in result.json."""
    spec = job.loops[number]
    own = dataclasses.replace(spec.designs[0], tune=False, options=options or spec.designs[0].options)
    plants = plants_of(job, spec) if spec.has_plants else None
    model = linearise(job.platform)
    made = designed(LoopProblem(job=job, spec=spec, design=own, model=model, plant_set=plants))
    K = made.controller
    out: dict[str, Any] = json.loads(
        json_text(
            {
                "name": spec.name, "design": made.name, "method": made.method, "dt": K.dt,
                **{name: getattr(K, name) for name in "ABCD"}, "inputs": K.input_labels, "outputs": K.output_labels,
                "delay": job.sampling.delay, "sections": [section.record() for section in made.sections],
            }
        )
    )  # fmt: skip
    return out


def classical_entry(job: Job, gimbals: tuple[str, ...], **other: float) -> dict[str, Any]:
    """A classical caging loop."""
    return designed_entry(job, list(CLASSICAL).index(gimbals), **CLASSICAL[gimbals] | other)


def pid_entry(job: Job, gimbals: tuple[str, ...]) -> dict[str, Any]:
    """A matrix PID as the structured design makes it: no sections."""
    channel = channels(model := linearise(job.platform), rows_of(model, gimbals))
    like = Classical().of_directions(CLASSICAL[gimbals], channel, job.sampling.period)
    family = pid_structure(like, channel, job.sampling.period, 500.0, 12.6, 5000.0)
    return entry(job, f"caging {'-'.join(gimbals)}", family.block(family.start), gimbals) | {"design": "structured"}


def entry(job: Job, name: str, block: Sequence[FloatArray], gimbals: tuple[str, ...]) -> dict[str, Any]:
    """A controller of some gimbals from its matrices."""
    return {
        "name": name, "dt": job.sampling.period, "delay": job.sampling.delay,
        **{key: np.asarray(item).tolist() for key, item in zip("ABCD", block[:4], strict=True)},
        "inputs": [job.platform.pickoff_on(g).name for g in gimbals],
        "outputs": [job.platform.torquer_on(g).name for g in gimbals],
    }  # fmt: skip


def compiler(name: str = "gcc") -> str:
    """Path of a compiler; the test is skipped where there is none."""
    found = shutil.which(name)
    if found is None:
        pytest.skip(f"no {name} on this machine: generated C cannot be compiled")
    return found


def compiled(files: Sequence[Path], out: Path, name: str = "gcc", *more: str) -> Path:
    """All sources of `files` as one shared library (or what `more` says), without a warning."""
    warnings = [w for w in WARNINGS if name != "g++" or w != "-Wstrict-prototypes"]
    language = ["-x", "c++"] if name == "g++" else []
    sources = [str(file) for file in files if file.suffix == ".c"]
    flags = more or ("-shared", "-fPIC", "-O1")
    command = [compiler(name), *language, LANGUAGES[name], *warnings, *flags, "-o", str(out), *sources]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    return out


class Machine:
    """A compiled controller (or all of a job), stepped from here."""

    def __init__(
        self,
        library: Path,
        prefix: str,
        inputs: Sequence[str],
        outputs: Sequence[str],
        number: type,
        statuses: Sequence[str] = (),
    ) -> None:
        self._in = type("In", (ctypes.Structure,), {"_fields_": [(name, number) for name in inputs]})()
        fields = [*((name, number) for name in outputs), *((name, ctypes.c_uint) for name in statuses)]
        self._out = type("Out", (ctypes.Structure,), {"_fields_": fields})()
        self._inputs, self._outputs = list(inputs), list(outputs)
        # Larger than any state here: its fields are the code's own business.
        self._state = ctypes.create_string_buffer(1 << 14)
        loaded = ctypes.CDLL(str(library))
        self._step, self._reset = getattr(loaded, f"{prefix}_step"), getattr(loaded, f"{prefix}_reset")
        self._step.restype, self._reset.restype = ctypes.c_uint, None
        self.reset()

    def reset(self) -> None:
        self._reset(self._state)

    def step(self, values: Sequence[float]) -> tuple[list[float], int]:
        for name, x in zip(self._inputs, values, strict=True):
            setattr(self._in, name, x)
        status = self._step(self._state, ctypes.byref(self._in), ctypes.byref(self._out))
        return [getattr(self._out, name) for name in self._outputs], int(status)

    def run(self, readings: FloatArray) -> tuple[FloatArray, list[int]]:
        """Outputs (N, outputs) and status of every sample."""
        steps = [self.step(row) for row in np.asarray(readings).tolist()]
        return np.array([values for values, _ in steps]), [status for _, status in steps]


def gyro_entry(job: Job, A: object, B: object, C: object, D: object) -> dict[str, Any]:
    """A controller of gimbals 9 and 10."""
    n = len(np.asarray(A))
    block = [
        np.asarray(item, float).reshape(shape)
        for item, shape in zip((A, B, C, D), ((n, n), (n, 2), (2, n), (2, 2)), strict=True)
    ]
    return entry(job, "caging 9-10", block, ("9", "10"))


def state_space(entry: dict[str, Any]) -> control.StateSpace:
    """The controller of an entry."""
    matrices = (np.array(entry[key]) for key in "ABCD")
    return control.StateSpace(*matrices, entry["dt"], inputs=entry["inputs"], outputs=entry["outputs"])


def flat(path: Path) -> str:
    """The text of a header on one line, without comment marks."""
    return " ".join(path.read_text().replace("*", " ").split())
