"""What is not rigid in a platform: drives that give way, modes of the structure, and tables of modes. SI units.

A table of a finite-element run is a CSV file beside the plant file, a line a mode.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import field
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import numpy as np

from platform_ctrl.common.arguments import nearest
from platform_ctrl.common.values import FloatArray, input_value, read_only, replaced
from platform_ctrl.errors import ArgumentError, InputError
from platform_ctrl.plant import fields
from platform_ctrl.plant.fields import Expected, Refers, Unfit, number
from platform_ctrl.plant.gimbals import Gimbal
from platform_ctrl.plant.mistakes import Misfit, given, missing, one_line, useless
from platform_ctrl.plant.source import read_text
from platform_ctrl.plant.tables import Instead, either

Interface = Literal["free", "fixed"]
# Numbers of a mode that may be uncertain.
MODE_NUMBERS = ("frequency", "damping", "participation")
_HERTZ = Instead("frequency_hz", fields.POSITIVE, lambda hertz, _: 2.0 * math.pi * hertz)


def _participation(item: object) -> Mapping[str, float]:
    """Return participation by name."""
    if not isinstance(item, Mapping) or not item:
        raise Unfit
    found = {}
    for name, share in item.items():
        try:
            found[str(name)] = number(share)
        except Unfit:
            raise Unfit(f"{name} = {share} is no number") from None
    return found


@input_value
class Compliance:
    """A drive that gives way between its motor side and its load side, both turning about the gimbal's axis.

    The gimbal is the load side. The motor side is a further coordinate, GIMBAL_motor with the angle ANGLE_motor, on
    which torquers and motors of the gimbal work. Between them act stiffness (q_motor − q) + damping (q̇_motor − q̇).
    With play this acts on what q_motor − q is beyond ± play/2, as a push that never pulls; linear models have no play.

    Attributes
    ----------
    gimbal
        Name of the gimbal.
    stiffness
        At the joint, N m/rad.
    damping
        At the joint, N m s.
    frequency
        In place of the stiffness: that of the load with its motor side locked, all angles zero, rad/s; a platform that
        is read has the stiffness that gives it.
    inertia
        Of the motor side about the axis, at the joint, kg m²; a [[motor]] with a rotor adds its own.
    play
        Angle by which the motor side turns from one flank of the teeth to the other, at the joint, rad.
    """

    gimbal: Annotated[fields.Text, Refers()]
    stiffness: fields.Positive | None = None
    frequency: Annotated[fields.Positive | None, _HERTZ] = None
    damping: fields.NotNegative = 0.0
    inertia: fields.NotNegative = 0.0
    play: fields.Play = 0.0

    @staticmethod
    def _misfits(table: Mapping[str, Any]) -> Iterator[Misfit]:
        frequency = bool({"frequency", "frequency_hz"} & table.keys())
        if ("stiffness" in table) == frequency:
            yield (), either("stiffness", "frequency_hz", frequency)

    @property
    def strength(self) -> float:
        """The stiffness, N m/rad."""
        if self.stiffness is None:
            raise ArgumentError(
                f"compliance of gimbal {self.gimbal!r}: give its stiffness, or read the plant from a dict"
            )
        return self.stiffness

    def changed(self, frequency: float = 0.0, damping: float = 0.0) -> Compliance:
        """Return the drive with relative changes of the frequency and damping ratio of its load."""
        faster = 1.0 + frequency
        numbers = {"stiffness": self.strength * faster**2, "damping": self.damping * faster * (1.0 + damping)}
        return replaced(self, numbers)

    @property
    def motor_side(self) -> str:
        """Name of the motor side."""
        return f"{self.gimbal}_motor"


def motor_side(load: Gimbal, drive: Compliance) -> Gimbal:
    """Return the motor side of a drive as a body without mass that turns beside its load, about the same axis."""
    return Gimbal(
        name=drive.motor_side,
        parent=load.parent,
        axis=load.axis,
        inertia=read_only(drive.inertia * np.outer(load.axis, load.axis)),
        angle=f"{load.angle}_motor",
        origin=load.origin,
    )


@input_value
class FlexibleMode:
    """A mode of the structure, mass-normalised: η̈ + 2 ζ ω η̇ + ω² η = Σ φ_j Q_j − Γ·[Ω, q̇]' − Γ_f·f.

    A free mode is as a measured response shows it: no torquer works, joints turn freely. It then has no inertia in
    common with the rigid gimbals. A mode with fixed interface is that of a structure whose joints are locked: torquers
    do not excite it, but the joints' accelerations do, and it reacts on them.

    Attributes
    ----------
    name
        Signal name of η, sqrt(kg m²) rad.
    frequency
        ω, rad/s; a plant file may give it in Hz as ``frequency_hz``.
    damping
        ζ, dimensionless.
    participation
        φ in 1/sqrt(kg m²) by the names of torquers and of sensors: a torque Q_j excites the mode by φ_j Q_j, a sensor
        of an angle reads φ η besides, a sensor of a rate φ η̇. Torques from outside on a gimbal, as of wind, have the φ
        of its first torquer.
    interface
        ``"free"``, or ``"fixed"``: of the structure with its joints locked.
    joints
        Γ of the joints of a mode with fixed interface, sqrt(kg m²), by names of gimbals.
    base
        Γ of the platform's rate about root axes 1 to 3, (3,), sqrt(kg m²).
    base_force
        Γ_f of the specific force of the root's origin, (3,), sqrt(kg).
    """

    name: fields.Text
    frequency: Annotated[fields.Positive, _HERTZ]
    damping: fields.NotNegative
    participation: Annotated[
        Mapping[str, float], Expected("a table of numbers by names of torquers and sensors", _participation)
    ] = field(default_factory=dict)
    interface: Annotated[Interface, fields.one_of(get_args(Interface))] = "free"
    joints: Annotated[Mapping[str, float], Expected("a table of numbers by names of gimbals", _participation)] = field(
        default_factory=dict
    )
    base: fields.Vector = field(default_factory=fields.zero_vector)
    base_force: fields.Vector = field(default_factory=fields.zero_vector)

    @staticmethod
    def _misfits(table: Mapping[str, Any]) -> Iterator[Misfit]:
        fixed = table.get("interface") == "fixed"
        needed, words = ("joints", "a mode whose joints are locked") if fixed else ("participation", "a free mode")
        if needed not in table and not np.any(table.get("base", 0.0)):
            yield missing(needed, f"{words} needs it, or base, to be excited")
        if "joints" in table and not fixed:
            yield useless(table, "joints", 'without interface = "fixed": a free mode has no inertia in common')

    def changed(self, frequency: float = 0.0, damping: float = 0.0, participation: float = 0.0) -> FlexibleMode:
        """Return the mode with relative changes of ω, ζ, and of φ and Γ of the joints."""
        shares, joints = (
            {name: (1.0 + participation) * share for name, share in of.items()}
            for of in (self.participation, self.joints)
        )
        numbers = {"frequency": self.frequency * (1.0 + frequency), "damping": self.damping * (1.0 + damping)}
        return replaced(self, {**numbers, "participation": shares, "joints": joints})

    def inertial(self, gimbals: Sequence[str]) -> FloatArray:
        """Return Γ of the platform's rate and of the joints of gimbals, (3 + n,), sqrt(kg m²)."""
        return np.array([*self.base, *(self.joints.get(name, 0.0) for name in gimbals)])

    def excited(self, torquers: list[str], gimbals: Sequence[str]) -> bool:
        """Return whether torquers, the base, or what turns gimbals excite it."""
        return any(one.any() for one in (self.inertial(gimbals), self.base_force, self.of(torquers)))

    @property
    def rate(self) -> str:
        """Signal name of η̇."""
        return f"{self.name}_rate"

    def of(self, names: list[str]) -> FloatArray:
        """Return the participation of several torquers or sensors, 1/sqrt(kg m²); 0 of those it does not name."""
        return np.array([self.participation.get(name, 0.0) for name in names])


# Columns that are no participation: of what a mode needs, one of each line.
_NEEDED = (("name",), ("frequency_hz", "frequency"), ("damping",))
_VECTORS = ("base", "base_force")
_JOINT = "joint."


def with_mode_table(data: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Return a plant whose ``modes`` are a file with the modes of that file as ``mode`` tables behind its own."""
    out = dict(data)
    name = out.get("modes")
    if not isinstance(name, str):
        return out
    del out["modes"]
    own = out.get("mode", [])
    return out | ({"mode": [*own, *_modes(folder / name)]} if isinstance(own, list) else {})


def _modes(path: Path) -> list[dict[str, Any]]:
    """Return the tables of the modes in a file."""
    label = one_line(str(path))
    text = read_text(path, "a CSV table of modes").splitlines()
    lines = [(k, line) for k, line in enumerate(text, 1) if line.strip() and not line.lstrip().startswith("#")]
    cells = [[cell.strip() for cell in row] for row in csv.reader(line for _, line in lines)]
    header = cells[0] if cells else []
    for one in _NEEDED:
        if not set(one) & set(header):
            close = nearest(one[0], header)
            hint = "" if close is None else f"; is {given(close)} meant?"
            raise InputError(f"{label}: there is no column {given(one[0])}{hint}")
    if twice := next((name for name in header if header.count(name) > 1), None):
        raise InputError(f"{label}: column {given(twice)} is there twice; leave one of them out")
    return [_mode(f"{label}, line {k}", header, row) for (k, _), row in zip(lines[1:], cells[1:], strict=True)]


def _mode(label: str, header: list[str], row: list[str]) -> dict[str, Any]:
    """Return the table of the mode in a line; cells without a number are left out."""
    if len(row) != len(header):
        raise InputError(f"{label}: has {len(row)} cells, and the header {len(header)} columns")
    out: dict[str, Any] = {"name": row[header.index("name")], "participation": {}, "joints": {}}
    for column, cell in zip(header, row, strict=True):
        if column == "name" or not cell:
            continue
        try:
            number = float(cell)
        except ValueError:
            raise InputError(f"{label}: {column} must be a number, got {given(cell)}") from None
        key, axis = column[:-1], column[-1:]
        if column.startswith(_JOINT):
            out["joints"][column.removeprefix(_JOINT)] = number
        elif key in _VECTORS and axis in ("1", "2", "3"):
            out.setdefault(key, [0.0, 0.0, 0.0])[int(axis) - 1] = number
        elif any(column in one for one in _NEEDED):
            out[column] = number
        elif number:
            out["participation"][column] = number
    fixed = any(column.startswith(_JOINT) for column in header)
    left = ("participation", "joints") if fixed else ("joints",)
    return {key: one for key, one in out.items() if one or key not in left} | ({"interface": "fixed"} if fixed else {})
