"""What drives of torquers add in the step of all controllers of a job, in floating point."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from platform_ctrl.common.values import value
from platform_ctrl.errors import InputError
from platform_ctrl.export.c99.c_text import field
from platform_ctrl.export.c99.controller_files import ControllerFiles, result_of
from platform_ctrl.export.c99.floating_files import FloatingFiles, Number, literal
from platform_ctrl.export.systems import signal_units
from platform_ctrl.job.drive import DriveLaw
from platform_ctrl.job.job import Job


@value
class DriveCode:
    """A drive in C: expressions and constants of its statements."""

    torquer: str  # Name of the torquer
    output: str  # Its field
    command: str  # Expression of what the controllers command, before the limit
    limit: str  # Of the torquer; empty: none
    angle: str  # Expression of the angle that the gain follows; empty: none
    secant_limit: str
    friction: str  # Empty: none is fed forward
    per_rate: str  # 1 over the rate from which on all of it acts
    terms: tuple[tuple[str, str], ...]  # Weight and expression of every reading in the rate

    @property
    def readings(self) -> list[str]:
        """Expressions of all that is read."""
        return list(dict.fromkeys([*([self.angle] if self.angle else []), *(reading for _, reading in self.terms)]))

    @property
    def products(self) -> list[str]:
        """Terms of the rate."""
        return [f"({weight} * {reading})" for weight, reading in self.terms]

    def tests(self, prefix: str) -> list[str]:
        """Return the conditions that all that is read is finite."""
        return [f"{prefix}_usable({reading})" for reading in self.readings]


def drive_inputs(job: Job, named: Sequence[str], number: str) -> list[str]:
    """Return the sensors that the drives of a job read beside what is `named`, in the plant's order."""
    if job.drives and number not in ("double", "float"):
        raise InputError(
            f"number: {number} has no drives of torquers, and [[drive]] of {job.drives[0].torquer!r} would be left "
            "out; use double or float"
        )
    used = {name for law in job.drive_laws for name in (*law.weights, law.secant_of)} - set(named)
    return [sensor.name for sensor in job.platform.sensors if sensor.name in used]


def drive_notes(job: Job, prefix: str) -> list[str]:
    """Return what a reader of the files of a job with drives has to know."""
    if not job.drives:
        return []
    return [f"{prefix}.h: what the drives do is in {prefix}_step, not in the steps of single controllers"]


def drive_words(job: Job, given: Sequence[ControllerFiles]) -> dict[str, Any]:
    """Return what the templates of a job's files need for its drives."""
    units = [unit for unit in given if isinstance(unit, FloatingFiles)]
    if not job.drives or not units:
        return {}
    number, signals = units[0].number, units[0].signals
    what = signal_units(job.platform)
    more = drive_inputs(job, [name for unit in units for name in unit.scheme.inputs], number)
    laws = sorted(job.drive_laws, key=lambda law: [t.name for t in job.platform.torquers].index(law.torquer))
    return {
        "drives": [_code(job, law, units) for law in laws],
        "driven": [signals[law.torquer] for law in laws if law.torquer in signals],
        "number": number,
        "cosine": "cos" if number == "double" else "cosf",
        "largest": "DBL_MAX" if number == "double" else "FLT_MAX",
        "unity": literal(1.0, number),
        "drive_inputs": [field(number, signals[name], what[name]) for name in more],
    }


def _code(job: Job, law: DriveLaw, units: Sequence[FloatingFiles]) -> DriveCode:
    number: Number = units[0].number
    places = [(k, unit) for k, unit in enumerate(units, 1) if law.torquer in unit.scheme.outputs]
    if not places:
        raise InputError(
            f"drive of {law.torquer!r}: none of these controllers sets this torquer; export them with the one that does"
        )
    k, unit = places[-1]
    limit = unit.scheme.torque_limits[unit.scheme.outputs.index(law.torquer)]
    order = [sensor.name for sensor in job.platform.sensors]
    return DriveCode(
        torquer=law.torquer,
        output=unit.signals[law.torquer],
        command=f"{result_of(unit, k, job.sampling.period)}.{unit.signals[law.torquer]}_commanded",
        limit=literal(limit, number) if np.isfinite(limit) else "",
        angle="" if law.secant_of is None else f"in->{unit.signals[law.secant_of]}",
        secant_limit=literal(law.secant_limit, number),
        friction=literal(law.friction, number) if law.friction else "",
        per_rate=literal(1.0 / law.friction_rate, number),
        terms=tuple(
            (literal(law.weights[name], number), f"in->{unit.signals[name]}")
            for name in sorted(law.weights, key=order.index)
        ),
    )
