"""Plant files: TOML or dict -> Platform."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, get_args

from pydantic import Field

from platform_ctrl.common.values import read_only
from platform_ctrl.plant import fields
from platform_ctrl.plant.checks import default_angle, default_torquer, measured_rate, plant_mistakes
from platform_ctrl.plant.fields import Table, overfull, structure
from platform_ctrl.plant.force_elements import Cage, Erection, Friction, Spring, Unbalance
from platform_ctrl.plant.mistakes import Mistake, given, report
from platform_ctrl.plant.platform import Gimbal, PickOff, Platform, RateSensor, Rotor, RotorControl, Torquer
from platform_ctrl.plant.source import Document, is_shipped_name, open_file, open_mapping, open_shipped, path_of

__all__ = ["read_platform"]

# Gimbals of a plant, and of each other part: their equations and matrices are worked out in full.
MOST_GIMBALS, MOST_PARTS = 100, 200


class RootTable(Table):
    """``[root]``."""

    name: fields.Text
    inertia: fields.Inertia
    specific_force: fields.Vector | None = None


class GimbalTable(Table):
    """``[[gimbal]]``."""

    name: fields.Text
    parent: fields.Text
    axis: fields.Axis
    inertia: fields.Inertia
    angle: fields.Text | None = None
    stops: fields.Stops | None = None
    stops_deg: fields.Stops | None = None
    restitution: fields.Part = 0.0


class RotorTable(Table):
    """``[[rotor]]``."""

    name: fields.Text
    carrier: fields.Text
    axis: fields.Axis
    axial_inertia: fields.Positive
    transverse_inertia: fields.Positive
    spin: fields.Number | None = None
    angular_momentum: fields.Number | None = None
    control: Annotated[RotorControl, fields.one_of(get_args(RotorControl))] = "regulated"
    speed_gain: fields.Positive | None = None
    speed_integral: fields.NotNegative | None = None
    torque_limit: fields.Positive | None = None


class TorquerTable(Table):
    """``[[torquer]]``."""

    name: fields.Text | None = None
    gimbal: fields.Text | None = None
    root_axis: fields.RootAxis | None = None
    limit: fields.Positive | None = None
    lag: fields.NotNegative = 0.0
    rate_limit: fields.Positive | None = None
    added: fields.Truth = False


class PickOffTable(Table):
    """``[[pickoff]]``."""

    gimbal: fields.Text
    noise_rms: fields.NotNegative = 0.0
    noise_bandwidth_hz: fields.Positive = 1000.0
    quantisation: fields.NotNegative = 0.0
    added: fields.Truth = False


class RateSensorTable(Table):
    """``[[rate_sensor]]``."""

    gimbal: fields.Text | None = None
    root_axis: fields.RootAxis | None = None
    noise_rms: fields.NotNegative = 0.0
    noise_bandwidth_hz: fields.Positive = 1000.0
    quantisation: fields.NotNegative = 0.0


class SpringTable(Table):
    """``[[spring]]``."""

    gimbal: fields.Text
    stiffness: fields.NotZero
    rest: fields.Number = 0.0


class FrictionTable(Table):
    """``[[friction]]``."""

    gimbal: fields.Text
    viscous: fields.NotNegative = 0.0
    coulomb: fields.Coulomb = (0.0, 0.0)
    coulomb_rate: fields.Positive = 0.01
    breakaway: fields.Coulomb | None = None
    stribeck_rate: fields.Positive | None = None


class CageTable(Table):
    """``[[cage]]``."""

    gimbal: fields.Text
    stiffness: fields.Positive
    damping: fields.NotNegative = 0.0
    clearance: fields.NotNegative = 0.0
    angle: fields.Number = 0.0


class UnbalanceTable(Table):
    """``[[unbalance]]``."""

    body: fields.Text
    moment: fields.Vector


class ErectionTable(Table):
    """``[[erection]]``."""

    gimbal: fields.Text
    senses: fields.Text
    axis: fields.Axis
    gain: fields.NotZero
    limit: fields.Positive | None = None


class PlantFile(Table):
    """The whole file."""

    schema_: fields.SchemaOne = Field(alias="schema")
    name: fields.Text
    source: fields.AnyText = ""
    root: RootTable
    gimbal: list[GimbalTable] = Field(default_factory=list, max_length=MOST_GIMBALS)
    rotor: list[RotorTable] = Field(default_factory=list, max_length=MOST_PARTS)
    torquer: list[TorquerTable] = Field(default_factory=list, max_length=MOST_PARTS)
    pickoff: list[PickOffTable] = Field(default_factory=list, max_length=MOST_PARTS)
    rate_sensor: list[RateSensorTable] = Field(default_factory=list, max_length=MOST_PARTS)
    spring: list[SpringTable] = Field(default_factory=list, max_length=MOST_PARTS)
    friction: list[FrictionTable] = Field(default_factory=list, max_length=MOST_PARTS)
    cage: list[CageTable] = Field(default_factory=list, max_length=MOST_PARTS)
    unbalance: list[UnbalanceTable] = Field(default_factory=list, max_length=MOST_PARTS)
    erection: list[ErectionTable] = Field(default_factory=list, max_length=MOST_PARTS)


def read_platform(source: str | os.PathLike[str] | Mapping[str, Any]) -> Platform:
    """Read a plant.

    Parameters
    ----------
    source
        The name of a shipped model (no suffix, no path separator), the path of a TOML file, or a dict of the
        same structure, in which tuples and NumPy arrays serve as vectors.

    Returns
    -------
    Platform
        In SI units; axes of unit length; every angular momentum in place of the spin.

    Raises
    ------
    InputError
        One line: which file, table and key, what was given, what is expected.

    Examples
    --------
    >>> import platform_ctrl as pc
    >>> platform = pc.read_platform("three_gyro_platform")
    >>> platform.angle_names
    ('alpha4', 'beta5', 'beta7', 'alpha9', 'beta10')
    """
    document = open_plant(source, Path())
    platform, mistakes = judge_plant(document)
    if platform is None:
        raise report(document.label, document.data, mistakes)
    return platform


def open_plant(source: object, folder: Path) -> Document:
    """Return the document of a plant: a dict, a shipped model, or a file whose path starts from `folder`."""
    if isinstance(source, Mapping):
        return open_mapping(source, "plant given as a dict", folder)
    path = path_of(source, "the name of a shipped model, a path or a dict")
    if isinstance(source, str) and is_shipped_name(source):
        return open_shipped(source)
    return open_file(folder / path)


def judge_plant(document: Document) -> tuple[Platform | None, list[Mistake]]:
    """Return the platform that a document describes, or None and its mistakes."""
    if "root" not in document.data and {"plant", "loop"} <= set(document.data):
        its_plant = given(document.data["plant"])
        return None, [Mistake(("plant",), f"is a job file; expected a plant: its own is {its_plant}")]
    if crowd := list(overfull(PlantFile, document.data)):
        return None, crowd
    file, wrong = structure(PlantFile, document.data)
    mistakes = [*document.mistakes, *plant_mistakes(document.data), *wrong]
    return (None, mistakes) if mistakes or file is None else (_platform(file), [])


def _platform(file: PlantFile) -> Platform:
    gimbals = tuple(_gimbal(table) for table in file.gimbal)
    angle = {gimbal.name: gimbal.angle for gimbal in gimbals}
    return Platform(
        name=file.name,
        source=file.source,
        root_name=file.root.name,
        root_inertia=read_only(file.root.inertia),
        gimbals=gimbals,
        rotors=tuple(_rotor(table) for table in file.rotor),
        torquers=tuple(_torquer(table) for table in file.torquer),
        pickoffs=tuple(
            PickOff(
                name=angle[table.gimbal],
                gimbal=table.gimbal,
                noise_rms=table.noise_rms,
                noise_bandwidth_hz=table.noise_bandwidth_hz,
                quantisation=table.quantisation,
                added=table.added,
            )
            for table in file.pickoff
        ),
        rate_sensors=tuple(
            RateSensor(**table.model_dump(), name=measured_rate(angle.get(table.gimbal or ""), table.root_axis))
            for table in file.rate_sensor
        ),
        springs=tuple(Spring(**table.model_dump()) for table in file.spring),
        frictions=tuple(Friction(**table.model_dump(exclude_none=True)) for table in file.friction),
        cages=tuple(Cage(**table.model_dump()) for table in file.cage),
        unbalances=tuple(Unbalance(**table.model_dump()) for table in file.unbalance),
        erections=tuple(Erection(**table.model_dump()) for table in file.erection),
        specific_force=read_only((0.0, 0.0, 0.0) if file.root.specific_force is None else file.root.specific_force),
    )


def _gimbal(table: GimbalTable) -> Gimbal:
    stops = table.stops
    if table.stops_deg is not None:
        low, high = table.stops_deg
        stops = (math.radians(low), math.radians(high))
    return Gimbal(
        name=table.name,
        parent=table.parent,
        axis=table.axis,
        inertia=table.inertia,
        angle=table.angle or default_angle(table.name),
        stops=stops,
        restitution=table.restitution,
    )


def _rotor(table: RotorTable) -> Rotor:
    momentum = table.angular_momentum
    if momentum is None:
        assert table.spin is not None  # exactly one is given: plant_checks
        momentum = table.axial_inertia * table.spin
    return Rotor(
        name=table.name,
        carrier=table.carrier,
        axis=table.axis,
        axial_inertia=table.axial_inertia,
        transverse_inertia=table.transverse_inertia,
        angular_momentum=momentum,
        control=table.control,
        speed_gain=table.speed_gain or 0.0,
        speed_integral=table.speed_integral or 0.0,
        torque_limit=table.torque_limit,
    )


def _torquer(table: TorquerTable) -> Torquer:
    return Torquer(
        name=table.name or default_torquer(table.gimbal, table.root_axis),
        gimbal=table.gimbal,
        root_axis=table.root_axis,
        limit=table.limit,
        lag=table.lag,
        rate_limit=table.rate_limit,
        added=table.added,
    )
