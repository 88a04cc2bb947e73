"""The variables of the unit: what they are called, in which unit, what sets them, and where they begin."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Literal

from platform_ctrl.common.values import value
from platform_ctrl.job.job import Job
from platform_ctrl.plant.platform import OMEGA_NAMES, ROOT_TORQUE_NAMES
from platform_ctrl.simulation.closed_loop import Trajectory
from platform_ctrl.simulation.servo_rotors import servo_rotors

Kind = Literal["Float64", "Int64", "Boolean", "Enumeration"]
Causality = Literal["parameter", "input", "output"]
Variability = Literal["fixed", "discrete", "continuous"]

# Runs without a manoeuvre, the first two values of the parameter `manoeuvre`.
CAGED, STABILISED = "caged, no manoeuvre", "stabilised, no manoeuvre"
QUATERNION = ("w", "x", "y", "z")
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
    causality: Causality = "output"
    variability: Variability = "continuous"
    unit: str = ""  # A key of UNITS; empty: a number
    description: str  # One line
    start: float | int | bool | None = None  # Value before anybody sets it; None: the unit computes it


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
    platform = job.platform

    def parameter(name: str, start: float | bool, unit: str, description: str, kind: Kind = "Float64") -> Signal:
        return Signal(
            name=name,
            kind=kind,
            causality="parameter",
            variability="fixed",
            unit=unit,
            description=description,
            start=start,
        )

    out = [
        parameter("manoeuvre", run, "", "What is simulated; inputs add to it", "Enumeration"),
        parameter("seed", job.seed, "", "What the noise is drawn from", "Int64"),
        parameter("run", 0, "", "Number of the run: other noise of the same seed", "Int64"),
        parameter("noise", True, "", "Whether the sensors' noise is there", "Boolean"),
        parameter("delay", job.sampling.delay, "s", "From the sample to the torque"),
        parameter("step", 1e-4, "s", "Longest integration step"),
    ]
    begin = "at t = 0, added to the manoeuvre's"
    for angle in platform.angle_names:
        out.append(parameter(variable_name("initial", angle), 0.0, "rad", f"Angle {angle} {begin}"))
    for angle in platform.angle_names:
        out.append(parameter(variable_name("initial", f"{angle}_rate"), 0.0, "rad/s", f"Rate of {angle} {begin}"))
    for name in OMEGA_NAMES:
        text = f"Platform rate about axis {name[-1]} {begin}; stabilised"
        out.append(parameter(variable_name("initial", name), 0.0, "rad/s", text))
    for k, part in enumerate(QUATERNION):
        text = f"Attitude quaternion, {part}, at t = 0"
        out.append(parameter(variable_name("initial", f"attitude_{part}"), 0.0 if k else 1.0, "", text))
    for rotor in platform.rotors:
        text = f"Nominal spin of rotor {rotor.name} against its carrier"
        out.append(parameter(variable_name("spin", rotor.name), rotor.spin, "rad/s", text))
    return tuple(out)


def inputs_of(job: Job) -> tuple[Signal, ...]:
    """Return the inputs: Omega, its slope, the platform's torques, the gimbals'."""

    def given(name: str, unit: str, description: str) -> Signal:
        return Signal(name=name, causality="input", unit=unit, description=description, start=0.0)

    return (
        *(given(name, "rad/s", f"Caged: platform rate about axis {name[-1]}") for name in OMEGA_NAMES),
        *(
            given(f"{name}_rate", "rad/s2", f"Caged: slope of {name} until the next communication point")
            for name in OMEGA_NAMES
        ),
        *(
            given(name, "N.m", f"Stabilised: torque on the platform about axis {name[-1]}")
            for name in ROOT_TORQUE_NAMES
        ),
        *(
            given(variable_name("disturbance", angle), "N.m", f"Torque at the joint of {angle} beside the torquer's")
            for angle in job.platform.angle_names
        ),
    )


def outputs_of(job: Job) -> tuple[Signal, ...]:
    """Return the outputs, in the order of `output_values`."""
    platform = job.platform

    def several(group: str, names: Sequence[str], unit: str, text: str, variability: Variability) -> list[Signal]:
        return [
            Signal(name=variable_name(group, name), unit=unit, description=text.format(name), variability=variability)
            for name in names
        ]

    def counts(group: str, names: Sequence[str], text: str) -> list[Signal]:
        return [
            Signal(name=variable_name(group, name), kind="Int64", description=text.format(name), variability="discrete")
            for name in names
        ]

    angles, torquers = platform.angle_names, [one.name for one in platform.torquers]
    rates = {one.name for one in platform.rate_sensors}
    servos = [rotor.name for rotor in servo_rotors(platform)]
    readings = [
        signal
        for one in platform.sensors
        for signal in several(
            "reading",
            [one.name],
            "rad/s" if one.name in rates else "rad",
            "Reading of {} at the last sample",
            "discrete",
        )
    ]
    return (
        *several("angle", angles, "rad", "Gimbal angle {}", "continuous"),
        *several("rate", angles, "rad/s", "Rate of {}", "continuous"),
        *several("momentum", angles, "N.m.s", "Joint momentum of {}", "continuous"),
        *several("platform", OMEGA_NAMES, "rad/s", "Platform rate {} in its own axes", "continuous"),
        *several(
            "platform", [f"attitude_{k}" for k in QUATERNION], "", "{}: platform axes to inertial axes", "continuous"
        ),
        *readings,
        *several("command", torquers, "N.m", "Command {} of the last sample, before limiting", "discrete"),
        *several("torque", torquers, "N.m", "Torque {} that acts just after the last sample", "continuous"),
        *several("rotor_spin", servos, "rad/s", "Spin of rotor {} against its carrier", "continuous"),
        *several("rotor_torque", servos, "N.m", "Torque of the motor of rotor {}", "continuous"),
        *counts("saturated", torquers, "Samples since t = 0 whose command {} reached the limit"),
        *counts("stop_contacts", angles, "How often {} has come up against a stop since t = 0"),
    )


def output_values(sample: Trajectory) -> list[float | int]:
    """Return the last row of a trajectory as the outputs' values."""
    columns = ("q", "rate", "p", "Omega", "attitude", "reading", "command", "torque", "rotor_spin", "rotor_torque")
    values: list[float | int] = []
    for name in columns:
        values += getattr(sample, name)[-1].tolist()
    return [*values, *sample.saturated.tolist(), *sample.stop_contacts.tolist()]
