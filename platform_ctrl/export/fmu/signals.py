"""The variables of the unit: names, units, causality and start values."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Literal

from platform_ctrl.analysis.plant_set import COMMAND
from platform_ctrl.common.values import value
from platform_ctrl.job.job import Job
from platform_ctrl.plant.platform import OMEGA_NAMES, ROOT_TORQUE_NAMES
from platform_ctrl.simulation.closed_loop import Trajectory
from platform_ctrl.simulation.servo_rotors import servo_rotors

if TYPE_CHECKING:
    import control

Kind = Literal["Float64", "Int64", "Boolean", "Enumeration"]
Variability = Literal["fixed", "discrete", "continuous"]

# Runs without a manoeuvre, the first two values of the parameter `manoeuvre`.
CAGED, STABILISED = "caged, no manoeuvre", "stabilised, no manoeuvre"
# Units beside 1: exponents of the base units.
UNITS: dict[str, dict[str, int]] = {
    "s": {"s": 1},
    "rad": {"rad": 1},
    "rad/s": {"rad": 1, "s": -1},
    "rad/s2": {"rad": 1, "s": -2},
    "N.m": {"kg": 1, "m": 2, "s": -2},
    "N.m.s": {"kg": 1, "m": 2, "s": -1},
}


@value
class Signal:
    """A variable of the unit, as in the FMI Specification 3.0, 2022."""

    name: str  # As the importing tool shows it
    # kind, causality, variability: As FMI 3.0 has them
    kind: Kind = "Float64"
    causality: Literal["parameter", "input", "output"] = "output"
    variability: Variability = "continuous"
    unit: str = ""  # A key of UNITS; empty: a number
    description: str  # One line
    start: float | int | bool | None = None  # Start value; None: the unit computes it


def variable_name(*parts: str) -> str:
    """Return parts joined by dots, those that are no identifiers in quotes, as FMI's structured names have them."""
    return ".".join(
        part
        if re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", part)
        else "'" + part.replace("\\", "\\\\").replace("'", "\\'") + "'"
        for part in parts
    )


def runs_of(job: Job) -> tuple[str, ...]:
    """Return what the parameter `manoeuvre` may be: its values count from 1."""
    return (CAGED, STABILISED, *(one.name for one in job.manoeuvres))


def parameters_of(job: Job, run: int) -> tuple[Signal, ...]:
    """Return the parameters; `run` is the manoeuvre to begin with, from 1."""
    platform, begin = job.platform, "at t = 0, added to the manoeuvre's"
    rows: list[tuple[str, float, str, str, Kind]] = [
        ("manoeuvre", run, "", "What is simulated; inputs add to it", "Enumeration"),
        ("seed", job.seed, "", "Seed of the noise", "Int64"),
        ("run", 0, "", "Number of the run: other noise of the same seed", "Int64"),
        ("noise", True, "", "Whether the sensors have noise", "Boolean"),
        ("delay", job.sampling.delay, "s", "From the sample to the torque", "Float64"),
        ("step", 1e-4, "s", "Longest integration step", "Float64"),
    ]
    initial = [(angle, 0.0, "rad", f"Angle {angle} {begin}") for angle in platform.angle_names]
    initial += [(f"{angle}_rate", 0.0, "rad/s", f"Rate of {angle} {begin}") for angle in platform.angle_names]
    initial += [
        (name, 0.0, "rad/s", f"Platform rate about axis {name[-1]} {begin}; stabilised") for name in OMEGA_NAMES
    ]
    initial += [
        (f"attitude_{part}", float(part == "w"), "", f"Attitude quaternion, {part}, at t = 0") for part in "wxyz"
    ]
    rows += [(variable_name("initial", name), start, unit, text, "Float64") for name, start, unit, text in initial]
    for rotor in platform.rotors:
        text = f"Nominal spin of rotor {rotor.name} against its carrier"
        rows.append((variable_name("spin", rotor.name), rotor.spin, "rad/s", text, "Float64"))
    return tuple(
        Signal(
            name=name,
            kind=kind,
            causality="parameter",
            variability="fixed",
            unit=unit,
            description=text,
            start=start,
        )
        for name, start, unit, text, kind in rows
    )


def commands_of(job: Job, controllers: Sequence[control.StateSpace]) -> tuple[str, ...]:
    """Return the readings whose commands controllers take, in the plant's order."""
    taken = {name for K in controllers for name in K.input_labels}
    return tuple(sensor.name for sensor in job.platform.sensors if f"{sensor.name}{COMMAND}" in taken)


def inputs_of(job: Job, commanded: Sequence[str]) -> tuple[Signal, ...]:
    """Return the inputs: Omega, its slope, the platform's torques, the gimbals', commands of readings."""
    units = {sensor.name: sensor.unit for sensor in job.platform.sensors}
    rows = [(name, "rad/s", f"Caged: platform rate about axis {name[-1]}") for name in OMEGA_NAMES]
    rows += [
        (f"{name}_rate", "rad/s2", f"Caged: slope of {name} until the next communication point") for name in OMEGA_NAMES
    ]
    rows += [(name, "N.m", f"Stabilised: torque on the platform about axis {name[-1]}") for name in ROOT_TORQUE_NAMES]
    rows += [
        (variable_name("disturbance", angle), "N.m", f"Torque at the joint of {angle} beside the torquer's")
        for angle in job.platform.angle_names
    ]
    rows += [
        (variable_name("reading_command", name), units[name], f"What the loop that reads {name} holds it at, besides")
        for name in commanded
    ]
    return tuple(
        Signal(name=name, causality="input", unit=unit, description=text, start=0.0) for name, unit, text in rows
    )


# Group, unit, description and variability of the outputs by the column of a trajectory that they come from; sensors'
# readings have the unit of their sensor.
_OUTPUTS: dict[str, tuple[str, str | None, str, Variability]] = {
    "q": ("angle", "rad", "Gimbal angle {}", "continuous"),
    "rate": ("rate", "rad/s", "Rate of {}", "continuous"),
    "p": ("momentum", "N.m.s", "Joint momentum of {}", "continuous"),
    "Omega": ("platform", "rad/s", "Platform rate {} in its own axes", "continuous"),
    "attitude": ("platform", "", "{}: platform axes to inertial axes", "continuous"),
    "reading": ("reading", None, "Reading of {} at the last sample", "discrete"),
    "command": ("command", "N.m", "Command {} of the last sample, before limiting", "discrete"),
    "torque": ("torque", "N.m", "Torque {} that acts just after the last sample", "continuous"),
    "rotor_spin": ("rotor_spin", "rad/s", "Spin of rotor {} against its carrier", "continuous"),
    "rotor_torque": ("rotor_torque", "N.m", "Torque of the motor of rotor {}", "continuous"),
    "saturated": ("saturated", "", "Samples since t = 0 whose command {} reached the limit", "discrete"),
    "stop_contacts": ("stop_contacts", "", "How often {} has come up against a stop since t = 0", "discrete"),
}
# Columns that count since the start of the run, one number each.
_COUNTS = ("saturated", "stop_contacts")


def outputs_of(job: Job) -> tuple[Signal, ...]:
    """Return the outputs, in the order of `output_values`."""
    platform = job.platform
    angles, torquers = platform.angle_names, [one.name for one in platform.torquers]
    servos = [rotor.name for rotor in servo_rotors(platform)]
    names: dict[str, Iterable[str]] = dict.fromkeys(("q", "rate", "p", "stop_contacts"), angles)
    names |= dict.fromkeys(("command", "torque", "saturated"), torquers)
    names |= dict.fromkeys(("rotor_spin", "rotor_torque"), servos)
    names |= {"Omega": OMEGA_NAMES, "attitude": [f"attitude_{part}" for part in "wxyz"]}
    names["reading"] = [one.name for one in platform.sensors]
    units = {one.name: one.unit for one in platform.sensors}

    def signals() -> Iterator[Signal]:
        for column, (group, unit, text, variability) in _OUTPUTS.items():
            for name in names[column]:
                yield Signal(
                    name=variable_name(group, name),
                    kind="Int64" if column in _COUNTS else "Float64",
                    unit=units[name] if unit is None else unit,
                    description=text.format(name),
                    variability=variability,
                )

    return tuple(signals())


def output_values(sample: Trajectory) -> list[float | int]:
    """Return the last row of a trajectory as the outputs' values."""
    values: list[float | int] = []
    for column in _OUTPUTS:
        numbers = getattr(sample, column)
        values += (numbers if column in _COUNTS else numbers[-1]).tolist()
    return values
