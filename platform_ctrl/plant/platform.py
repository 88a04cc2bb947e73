"""A platform: its tree of gimbals, rotors, torquers, and its further parts; SI units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from functools import cache
from itertools import chain
from typing import Annotated, Any, Literal, TypeVar, get_args

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.common.files import toml
from platform_ctrl.common.values import FloatArray, input_value, replaced
from platform_ctrl.errors import ArgumentError
from platform_ctrl.plant import fields
from platform_ctrl.plant.drives import Motor, Servo, Torquer, Winding
from platform_ctrl.plant.fields import stops_written
from platform_ctrl.plant.flexible import Compliance, FlexibleMode, motor_side
from platform_ctrl.plant.force_elements import Cage, Erection, Friction, Spring, Unbalance
from platform_ctrl.plant.gimbals import GimbalTree, Rotor
from platform_ctrl.plant.sensors import (
    LOS_ANGLES,
    LOS_RATES,
    AngleSensor,
    AttitudeSensor,
    LineOfSight,
    PickOff,
    RateSensor,
    Sensor,
    body_rotations,
    gimbal_rate,
)
from platform_ctrl.plant.tables import TABLE, Array, InTable, Shape, shape, written

RootMode = Literal["held", "pivot", "floating"]

# Signals that every plant has: the root's rates, the torques on it, and its specific force.
OMEGA_NAMES = ("Omega1", "Omega2", "Omega3")
FORCE_NAMES = ("f1", "f2", "f3")

# Of each kind but gimbals: their equations and matrices are worked out in full.
MOST_PARTS = 200


@input_value
class Platform(GimbalTree):
    """A root body that carries a tree of gimbals with rotors.

    Coordinates q are in the order of `gimbals`; generalised velocities are [Omega, q̇].
    All bodies without a mass turn about one fixed point, the root's origin, in which their centres of mass lie that no
    unbalance moves elsewhere.

    Attributes
    ----------
    name, source
        Title, and where the numbers come from.
    root_name
        Name of the body whose rate is Omega.
    root_inertia : (3, 3)
        Of that body with everything rigidly attached, kg m².
    gimbals, rotors, torquers, pickoffs, rate_sensors, angle_sensors, attitude_sensors
        What the plant has of each, in the file's order.
    line_of_sight
        The direction in which the payload looks, or None.
    springs, frictions, cages, unbalances, erections
        What acts besides the torquers, in the file's order.
    motors, servos
        Rotors that gears couple to joints, and drives with loops of their own, in the file's order.
    specific_force : (3,)
        f of the root's origin in root axes, m/s²: its acceleration minus that of gravity, what an accelerometer reads
        (at rest it points upward). It turns with the root.
    gravity : (3,)
        Field of gravity, m/s², fixed in space: in root axes at the identity attitude of the root. It adds −gravity,
        turned to root axes, to `specific_force`.
    mode
        ``"held"``: the root's motion is prescribed; ``"pivot"``: free about its origin; ``"floating"``: free in space;
        None: pivot where something torques the root, else held.

    References
    ----------
    K. Magnus, Ingenieur-Archiv 1976, section 2.

    See docs/reference/plant-file.md.
    """

    # The kinds of parts: `Array` names the table of the plant file, whose keys are the fields of the class.
    rotors: Annotated[tuple[Rotor, ...], Array("rotor", most=MOST_PARTS, unique=("name",))] = ()
    torquers: Annotated[tuple[Torquer, ...], Array("torquer", most=MOST_PARTS)] = ()
    pickoffs: Annotated[tuple[PickOff, ...], Array("pickoff", most=MOST_PARTS, unique=("gimbal",))] = ()
    rate_sensors: Annotated[
        tuple[RateSensor, ...], Array("rate_sensor", most=MOST_PARTS, unique=("gimbal", "root_axis"))
    ] = ()
    angle_sensors: Annotated[tuple[AngleSensor, ...], Array("angle_sensor", most=MOST_PARTS)] = ()
    attitude_sensors: Annotated[tuple[AttitudeSensor, ...], Array("attitude_sensor", most=MOST_PARTS)] = ()
    line_of_sight: Annotated[LineOfSight | None, TABLE] = None
    springs: Annotated[tuple[Spring, ...], Array("spring", most=MOST_PARTS)] = ()
    frictions: Annotated[tuple[Friction, ...], Array("friction", most=MOST_PARTS, unique=("gimbal",))] = ()
    cages: Annotated[tuple[Cage, ...], Array("cage", most=MOST_PARTS, unique=("gimbal",))] = ()
    unbalances: Annotated[tuple[Unbalance, ...], Array("unbalance", most=MOST_PARTS)] = ()
    erections: Annotated[tuple[Erection, ...], Array("erection", most=MOST_PARTS)] = ()
    motors: Annotated[tuple[Motor, ...], Array("motor", most=MOST_PARTS)] = ()
    servos: Annotated[tuple[Servo, ...], Array("servo", most=MOST_PARTS, unique=("gimbal",))] = ()
    compliances: Annotated[tuple[Compliance, ...], Array("compliance", most=MOST_PARTS, unique=("gimbal",))] = ()
    modes: Annotated[tuple[FlexibleMode, ...], Array("mode", most=MOST_PARTS, unique=("name",))] = ()
    specific_force: Annotated[fields.Vector, InTable("root", "specific_force")] = field(
        default_factory=fields.zero_vector
    )
    gravity: Annotated[fields.Vector, InTable("root", "gravity")] = field(default_factory=fields.zero_vector)
    mode: Annotated[RootMode | None, fields.one_of(get_args(RootMode)), InTable("root", "mode")] = None
    source: fields.AnyText = ""

    def __post_init__(self) -> None:
        """Add the motor sides of drives that give way, and name sensors after the signals that they measure."""
        own = tuple(one for one in self.torquers if not one.driven)
        drives = [one for motor in self.motors if (one := motor.drive) is not None]
        drives += [one.drive for one in self.servos]
        # Those with currents as states are the last.
        drives.sort(key=lambda one: one.winding is not None)
        object.__setattr__(self, "torquers", (*own, *drives))
        self._add_motor_sides()
        if all(sensor.name for sensor in self.sensors):
            return
        for kind in sensor_tables().values():
            named = (
                sensor if sensor.name else replaced(sensor, {"name": next(iter(sensor.signals(self)))})
                for sensor in getattr(self, kind)
            )
            object.__setattr__(self, kind, tuple(named))

    def _add_motor_sides(self) -> None:
        """Make a gimbal of each motor side, on which torquers and motors work."""
        sides = {one.gimbal: one for one in self.compliances if one.motor_side not in self.gimbal_names}
        if not sides:
            return
        loads = {gimbal.name: gimbal for gimbal in self.gimbals}
        new = [motor_side(loads[name], one) for name, one in sides.items()]
        object.__setattr__(self, "gimbals", (*self.gimbals, *new))
        for kind in ("torquers", "motors", "servos"):
            parts = getattr(self, kind)
            moved = [
                replaced(part, {"gimbal": sides[part.gimbal].motor_side}) if part.gimbal in sides else part
                for part in parts
            ]
            object.__setattr__(self, kind, tuple(moved))

    @property
    def loads(self) -> dict[str, str]:
        """Names of the gimbals that are motor sides of drives that give way, with those of their loads."""
        return {one.motor_side: one.gimbal for one in self.compliances}

    def moves_freely(self, driven: bool) -> bool:
        """Return whether the root moves: as its mode says, without one where torques act on it (`driven`)."""
        return driven if self.mode is None else self.mode != "held"

    @property
    def sides(self) -> tuple[tuple[int, int], ...]:
        """Indices of the gimbals on the load and motor sides of each of the `compliances`."""
        return tuple((self.gimbal(one.gimbal), self.gimbal(one.motor_side)) for one in self.compliances)

    @property
    def added(self) -> tuple[Torquer | PickOff, ...]:
        """Torquers and pick-offs that the device itself does not have."""
        parts: tuple[Torquer | PickOff, ...] = (*self.torquers, *self.pickoffs)
        return tuple(part for part in parts if part.added)

    @property
    def weighs(self) -> bool:
        """Whether a specific force of the root's origin turns any body: one with a mass or an unbalance."""
        heavy = self.mode != "floating" and any(body.mass for body in self.bodies)
        return heavy or bool(self.unbalances)

    @property
    def targets(self) -> tuple[int, ...]:
        """Index into [M, Q] of what each of the `torquers` acts on."""
        on_root = ((t.root_axis, t.gimbal) for t in self.torquers)
        return tuple(3 + self.gimbal(str(gimbal)) if axis is None else axis - 1 for axis, gimbal in on_root)

    @property
    def root_torquers(self) -> tuple[str, ...]:
        """Names of the torquers that act on the root, in the file's order."""
        return tuple(one.name for one in self.torquers if one.root_axis is not None)

    @property
    def root_attitudes(self) -> frozenset[str]:
        """Names of the sensors that show a rotation of the root against inertial space."""
        own = set(body_rotations(self, 0))
        return frozenset(one.name for one in self.sensors if own & one.signals(self).keys())

    @property
    def held_by(self) -> tuple[Spring, ...]:
        """The springs, then what the loops of the servos are to their joints."""
        return (*self.springs, *(one.spring for one in self.servos))

    @property
    def windings(self) -> tuple[tuple[int, Winding], ...]:
        """Index of the gimbal and winding of each of the last torquers, whose currents are states."""
        return tuple((self.gimbal(str(t.gimbal)), t.winding) for t in self.torquers if t.winding is not None)

    @property
    def cogging(self) -> tuple[tuple[int, FloatArray], ...]:
        """Index of the gimbal, and [order per turn of the gimbal, N m on it, phase], of each harmonic of cogging."""
        rows = [(m, row) for m in self.motors if m.cogging is not None for row in m.cogging]
        return tuple((self.gimbal(m.gimbal), row * [m.gear, m.gear, 1.0]) for m, row in rows)

    @property
    def ripples(self) -> tuple[tuple[int, int, FloatArray], ...]:
        """Index of the gimbal and of the winding, and [order per turn of the gimbal, share, phase], of each ripple."""
        wound = [t.name for t in self.torquers if t.winding is not None]
        rows = [(m, row) for m in self.motors if m.ripple is not None for row in m.ripple]
        return tuple((self.gimbal(m.gimbal), wound.index(m.name), row * [m.gear, 1.0, 1.0]) for m, row in rows)

    @property
    def dry_frictions(self) -> tuple[Friction, ...]:
        """Frictions with a dry part, in the file's order."""
        return tuple(one for one in self.frictions if max(one.breakaway) > 0.0)

    def breakaway(self, gimbal: str) -> float:
        """Return the dry friction of a gimbal at the start of sliding, N m, against the worse direction; 0 for none.

        Parameters
        ----------
        gimbal
            Name of the gimbal.

        Returns
        -------
        float
            Not less than that of fast sliding.
        """
        return max((max(one.breakaway) for one in self.frictions if one.gimbal == gimbal), default=0.0)

    @property
    def sensors(self) -> tuple[Sensor, ...]:
        """All that measures, kind by kind in the order of the fields: the pick-offs first."""
        return tuple(chain.from_iterable(getattr(self, kind) for kind in sensor_tables().values()))

    @property
    def outputs(self) -> dict[str, Mapping[str, float]]:
        """What can be observed, by name: the readings of the sensors, then the outputs of the line of sight.

        Each is a sum of signals of the plant, given by their dimensionless weights (see `platform_ctrl.plant.sensors`).
        """
        out = {sensor.name: self.reading(sensor) for sensor in self.sensors}
        if self.line_of_sight is None:
            return out
        sight = self.line_of_sight.signals(self)
        angles = {name: self._swung(name, "rad") for name in LOS_ANGLES}
        rates = {name: self._swung(angle, "rad/s") for name, angle in zip(LOS_RATES, LOS_ANGLES, strict=True)}
        return out | {name: {**signals, **(angles | rates)[name]} for name, signals in sight.items()}

    def reading(self, sensor: Sensor) -> Mapping[str, float]:
        """Return what a sensor reads, its part of the modes included: weights of signals of the plant.

        Parameters
        ----------
        sensor
            One of `sensors`.

        Returns
        -------
        mapping
            Weights, dimensionless; of a mode 1/sqrt(kg m²).
        """
        return {**sensor.signals(self), **self._swung(sensor.name, sensor.unit)}

    def _swung(self, name: str, unit: str) -> dict[str, float]:
        """Return what an angle or a rate has of the modes."""
        shares = {(m.rate if unit == "rad/s" else m.name): m.participation.get(name, 0.0) for m in self.modes}
        return {signal: share for signal, share in shares.items() if share}

    @property
    def carriers(self) -> NDArray[np.intp]:
        """Index of each rotor's carrier, (m,); −1 is the root."""
        return self._indices([r.carrier for r in self.rotors])

    def to_toml(self) -> str:
        """Return the platform as the text of a plant file, every number exact.

        Returns
        -------
        str
            TOML without what a file has by default; `read_platform` makes the same platform of it.

        Raises
        ------
        ArgumentError
            No plant file can say it: a pick-off is not called as its angle.
        """
        return toml(plant_data(self))

    def torquer_on(self, gimbal: str) -> Torquer:
        """Return the torquer that loops on the named gimbal use: its first one.

        Parameters
        ----------
        gimbal
            Name of the gimbal.

        Returns
        -------
        Torquer
            The first one in the file's order.

        Raises
        ------
        ArgumentError
            The gimbal has no torquer.
        """
        return _on(gimbal, self.torquers, "torquer")

    def pickoff_on(self, gimbal: str) -> PickOff:
        """Return the pick-off of the named gimbal.

        Parameters
        ----------
        gimbal
            Name of the gimbal.

        Returns
        -------
        PickOff
            The first one in the file's order.

        Raises
        ------
        ArgumentError
            The gimbal has no pick-off.
        """
        return _on(gimbal, self.pickoffs, "pick-off")


@cache
def sensor_tables() -> dict[str, str]:
    """Return the tables of a plant file that hold sensors, with the fields of a platform that have them."""
    made = (
        (name, key.field, key.holds.make) for name, key in shape(Platform).keys.items() if isinstance(key.holds, Shape)
    )
    return {name: own for name, own, part in made if isinstance(part, type) and issubclass(part, Sensor)}


def is_rate(signal: str) -> bool:
    """Return whether a signal's name is that of a rate, of a body or of a gimbal."""
    return signal.endswith((*OMEGA_NAMES, gimbal_rate("")))


Part = TypeVar("Part", Torquer, PickOff)


def _on(gimbal: str, parts: tuple[Part, ...], kind: str) -> Part:
    for part in parts:
        if part.gimbal == gimbal:
            return part
    raise ArgumentError(f"gimbal {gimbal!r} has no {kind}; add one to the plant")


# Keys of a plant's parts that a file has beside another one alone: the table, that key, these.
_BESIDE = (
    ("gimbal", "stops", ("restitution",)),
    ("friction", "stribeck_rate", ("breakaway",)),
    ("rotor", "speed_gain", ("speed_integral", "torque_limit")),
)


def plant_data(platform: Platform) -> dict[str, Any]:
    """Return the plant as a dict of the plant file's structure, without default values."""
    for pickoff in platform.pickoffs:
        if pickoff.name != (angle := platform.angle_names[platform.gimbal(pickoff.gimbal)]):
            words = f"pick-off {pickoff.name!r} must be called {angle!r}, as its angle, to stand in a plant file"
            raise ArgumentError(f"{words}; leave its name out, or make it an AngleSensor")
    data = {"schema": 1} | written(platform)
    driven = [torquer.driven for torquer in platform.torquers]
    if any(driven):
        data["torquer"] = [one for one, made in zip(data["torquer"], driven, strict=True) if not made]
    loads = platform.loads
    if loads:
        data["gimbal"] = [gimbal for gimbal in data["gimbal"] if gimbal["name"] not in loads]
        for part in (*data.get("torquer", ()), *data.get("motor", ()), *data.get("servo", ())):
            if part.get("gimbal") in loads:
                part["gimbal"] = loads[part["gimbal"]]
    # A mass is not read without its place, which may be the origin.
    for kind, place in (("gimbal", "centre"), ("rotor", "origin")):
        for own in data.get(kind, ()):
            if "mass" in own:
                own.setdefault(place, [0.0, 0.0, 0.0])
    if platform.root_mass:
        data["root"].setdefault("centre", [0.0, 0.0, 0.0])
    for gimbal in data.get("gimbal", ()):
        gimbal |= stops_written(gimbal.pop("stops")) if "stops" in gimbal else {}
    for table, beside, keys in _BESIDE:
        for own in data.get(table, ()):
            for key in keys if not {beside, f"{beside}_deg"} & own.keys() else ():
                own.pop(key, None)
    return data
