"""Header and source that run all controllers of a job for one sample, with the drives of its torquers."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from platform_ctrl.common.values import value
from platform_ctrl.errors import InputError
from platform_ctrl.export.c99.c_text import field, rendered
from platform_ctrl.export.c99.code import Code, Number, literal, total
from platform_ctrl.export.systems import signal_units
from platform_ctrl.job.drive import DriveLaw
from platform_ctrl.job.job import Job


def job_files(job: Job, prefix: str, units: Sequence[Code]) -> dict[str, str]:
    """Return the texts of the two files by their names."""
    readers: dict[str, Code] = {}  # Signals that no earlier controller computes, by their first reader
    made: dict[str, str] = {}
    steps = []
    every = {unit.prefix: max(round(unit.period / job.sampling.period), 1) for unit in units}
    results = {
        unit.prefix: f"out_{k}" if every[unit.prefix] == 1 else f"state->{unit.prefix}_last"
        for k, unit in enumerate(units, 1)
    }
    for unit in units:
        for name in unit.controller.inputs:
            if name not in made:
                readers[name], made[name] = unit, f"in->{unit.signals[name]}"
        taken = [(unit.signals[name], made[name]) for name in unit.controller.inputs]
        given = {name: f"{results[unit.prefix]}.{unit.signals[name]}" for name in unit.controller.outputs}
        made |= {name: f"{result}_commanded" for name, result in given.items()}
        driven = {law.torquer for law in job.drive_laws}
        shown = [(unit.signals[name], result) for name, result in given.items() if name not in driven]
        steps.append((unit.prefix, taken, shown, every[unit.prefix], results[unit.prefix]))
    held = [one for one, n in every.items() if n > 1]
    cycle = math.lcm(*every.values())
    states = [f"    {one}_state {one};" for one in every]
    states += [f"    {one}_out {one}_last; /* held */\n    unsigned int {one}_status;" for one in held]
    states += [f"    unsigned int {prefix}_sample; /* 0 to {cycle - 1} */"] if held else []
    outputs = [unit.output_field(name) for unit in units for name in unit.controller.outputs]
    number, signals, what = units[0].number, units[0].signals, signal_units(job.platform)
    inputs = [unit.input_field(name) for name, unit in readers.items()]
    inputs += [field(number, signals[name], what[name]) for name in drive_inputs(job, list(made))]
    laws = sorted(job.drive_laws, key=lambda law: [t.name for t in job.platform.torquers].index(law.torquer))
    words = {
        "p": prefix,
        "units": units,
        "every": every,
        "held": held,
        "cycle": cycle,
        "period": job.sampling.period,
        "origin": units[0].origin,
        "operations": np.sum([unit.operations for unit in units], axis=0),
        "drives": [_drive(job, prefix, law, units, results) for law in laws],
        "number": number,
        "cosine": "cos" if number == "double" else "cosf",
        "largest": "DBL_MAX" if number == "double" else "FLT_MAX",
        "unity": literal(1.0, number),
        "steps": steps,
        "structs": {
            "in": inputs,
            "out": [*outputs, *(f"    unsigned int {one}_status; /* what {one}_step returned */" for one in every)],
            "state": states,
        },
    }
    return {f"{prefix}.{end}": rendered(f"job.{end}.j2", **words) for end in "hc"}


@value
class Drive:
    """A drive in C: expressions and constants of its statements."""

    torquer: str  # Name of the torquer
    output: str  # Its field
    command: str  # Expression of what the controllers command, before the limit
    limit: str  # Of the torquer; empty: none
    angle: str  # Expression of the angle that the gain follows; empty: none
    secant_limit: str
    friction: str  # Empty: none is fed forward
    per_rate: str  # 1 over the rate from which on all of it acts
    products: tuple[str, ...]  # Terms of the rate
    tests: tuple[str, ...]  # Conditions that all that is read is finite


def drive_inputs(job: Job, named: Sequence[str]) -> list[str]:
    """Return the sensors that the drives of a job read beside what is `named`, in the plant's order."""
    used = {name for law in job.drive_laws for name in (*law.weights, law.secant_of)} - set(named)
    return [sensor.name for sensor in job.platform.sensors if sensor.name in used]


def _drive(job: Job, prefix: str, law: DriveLaw, units: Sequence[Code], results: dict[str, str]) -> Drive:
    number: Number = units[0].number
    own = [unit for unit in units if law.torquer in unit.controller.outputs]
    if not own:
        raise InputError(
            f"drive of {law.torquer!r}: none of these controllers sets this torquer; export them with the one that does"
        )
    unit = own[-1]
    limit = unit.controller.limits[unit.controller.outputs.index(law.torquer)]
    names = [sensor.name for sensor in job.platform.sensors if sensor.name in law.weights]
    reads = [f"in->{unit.signals[name]}" for name in names]
    angle = "" if law.secant_of is None else f"in->{unit.signals[law.secant_of]}"
    return Drive(
        torquer=law.torquer,
        output=unit.signals[law.torquer],
        command=f"{results[unit.prefix]}.{unit.signals[law.torquer]}_commanded",
        limit=literal(limit, number) if np.isfinite(limit) else "",
        angle=angle,
        secant_limit=literal(law.secant_limit, number),
        friction=literal(law.friction, number) if law.friction else "",
        per_rate=literal(1.0 / law.friction_rate, number),
        products=tuple(total([law.weights[name] for name in names], reads, number)),
        tests=tuple(f"{prefix}_usable({one})" for one in dict.fromkeys([*([angle] if angle else []), *reads])),
    )
