"""Gimbals, the tree that they are, and the rotors in it, on which other parts of a platform are placed; SI units."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import field
from typing import Annotated, Any, Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.common.arguments import known_name
from platform_ctrl.common.values import FloatArray, input_value
from platform_ctrl.plant import fields
from platform_ctrl.plant.fields import NUMBER, STOPS_DEG, Refers, default_angle
from platform_ctrl.plant.mistakes import Misfit, given, missing, useless, wrong
from platform_ctrl.plant.tables import Array, Instead, InTable

# Their equations and matrices are worked out in full.
MOST_GIMBALS = 100

RotorControl = Literal["regulated", "free", "servo"]

_SPIN = Instead("spin", NUMBER, lambda spin, rotor: rotor["axial_inertia"] * spin)
_STOPS_DEG = Instead("stops_deg", STOPS_DEG, lambda stops, _: (math.radians(stops[0]), math.radians(stops[1])))


class Body(NamedTuple):
    """Mass, kg, centre of mass (3,), m, and inertia about it (3, 3), kg m², of a rigid body.

    One of mass 0 has no centre: its inertia acts on its rotation alone.
    """

    mass: float
    centre: FloatArray
    inertia: FloatArray

    def __or__(self, other: Body) -> Body:
        """Return the body that both together are, all in the same axes and from the same point."""
        mass = self.mass + other.mass
        reduced = self.mass * other.mass / mass if mass else 0.0
        centre = (self.mass * self.centre + other.mass * other.centre) / mass if mass else self.centre
        apart = _huygens(reduced, self.centre - other.centre)
        return Body(mass, centre, self.inertia + other.inertia + apart)

    def moved(self, by: FloatArray) -> Body:
        """Return it at another place."""
        return self._replace(centre=self.centre + by)

    @property
    def inertia_about_origin(self) -> FloatArray:
        """The inertia about the point that `centre` counts from, (3, 3), kg m²."""
        return self.inertia + _huygens(self.mass, self.centre)


def _huygens(mass: float, arm: FloatArray) -> FloatArray:
    """Return the inertia of a point mass about a point, `arm` away from it."""
    return np.asarray(mass * (float(arm @ arm) * np.eye(3) - np.outer(arm, arm)))


@input_value
class Gimbal:
    """A body that turns about one axis fixed in its parent.

    Attributes
    ----------
    name, parent
        Names of this gimbal and of the body that carries it (another gimbal or the root).
    axis : (3,)
        Unit vector of the axis in the parent's (and, at zero angle, everybody's) axes; dimensionless.
    inertia : (3, 3)
        The gimbal's own body without rotors, kg m², in its own axes: about its centre of mass where it has a `mass`,
        else about its joint, which is then at the root's origin.
    angle
        Name of the coordinate, for example ``alpha4``; default ``q_`` + name.
    stops
        Lowest and highest angle, rad, or None.
    restitution
        Share of the rate that a stop gives back, 0 to 1; 0: the gimbal stays at its stop.
    mass
        Of the body, kg; 0: not given.
    centre : (3,)
        Its centre of mass from its joint, in its own axes, m.
    origin : (3,)
        Its joint from the parent's joint (or from the root's origin), in the parent's axes, m.

    References
    ----------
    K. Magnus, Ingenieur-Archiv 1976, section 2.

    See docs/reference/plant-file.md.
    """

    name: fields.Text
    parent: Annotated[fields.Text, Refers(root=True)]
    axis: fields.Axis
    inertia: fields.Inertia
    angle: fields.Text = ""
    stops: Annotated[fields.Stops | None, _STOPS_DEG] = None
    restitution: fields.Part = 0.0
    mass: fields.Positive = 0.0
    centre: fields.Vector = field(default_factory=fields.zero_vector)
    origin: fields.Vector = field(default_factory=fields.zero_vector)

    @staticmethod
    def _misfits(table: Mapping[str, Any]) -> Iterator[Misfit]:
        yield from mass_misfits(table, "centre", "its centre of mass from its joint")
        if "restitution" in table and not {"stops", "stops_deg"} & table.keys():
            yield useless(table, "restitution", 'without "stops" or "stops_deg"')

    def __post_init__(self) -> None:
        """Name the angle."""
        if not self.angle:
            object.__setattr__(self, "angle", default_angle(self.name))

    @property
    def body(self) -> Body:
        """What turns with it, without rotors; in its own axes, from its joint."""
        return Body(self.mass, self.centre, self.inertia)


def mass_misfits(table: Mapping[str, Any], key: str, words: str) -> Iterator[Misfit]:
    """Yield a mass without the place `key` where it is, and the place without a mass."""
    if "mass" in table and key not in table:
        yield missing(key, f"a mass needs {words}, m; {key} = [0, 0, 0] where they are the same point")
    if key in table and "mass" not in table:
        yield useless(table, key, 'without "mass"; give both')


@input_value
class Rotor:
    """A rotor that spins in a carrier.

    Attributes
    ----------
    name, carrier
        Names of the rotor and of the gimbal (or root) that it spins in.
    axis : (3,)
        Unit vector of the spin axis in the carrier's axes; dimensionless.
    axial_inertia
        C of the paper, kg m².
    transverse_inertia
        A of the paper, kg m², which is added to the carrier; at least C/2.
    angular_momentum
        L, N m s: C times the spin relative to the carrier, of which a file gives one. For a free rotor its constant
        axial momentum p; for a servo rotor the L that its speed loop aims at.
    control
        ``"regulated"``: relative spin constant, (8)-(15); ``"free"``: cyclic, (4)-(7); ``"servo"``: a degree of freedom
        of its own, whose spin a real loop controls. Matrices and linear models take a servo rotor for regulated, the
        limit of a fast loop; simulations run the loop.
    speed_gain, speed_integral
        Speed loop of a servo rotor, N m s and N m: torque = −speed_gain (φ̇ − spin) − speed_integral ∫(φ̇ − spin) dt.
    torque_limit
        Largest motor torque, N m, or None; the integral does not change while the torque is at its limit.
    mass
        Own mass, kg; 0: that of the carrier contains it.
    origin : (3,)
        Its centre of mass, on the spin axis, from the carrier's joint, in the carrier's axes, m.

    References
    ----------
    K. Magnus, Ingenieur-Archiv 1976, eqs. (4), (8).

    See docs/reference/plant-file.md.
    """

    name: fields.Text
    carrier: Annotated[fields.Text, Refers(root=True)]
    axis: fields.Axis
    axial_inertia: fields.Positive
    transverse_inertia: fields.Positive
    angular_momentum: Annotated[fields.Number, _SPIN]
    control: Annotated[RotorControl, fields.one_of(get_args(RotorControl))] = "regulated"
    speed_gain: fields.Positive = 0.0
    speed_integral: fields.NotNegative = 0.0
    torque_limit: fields.Positive | None = None
    mass: fields.Positive = 0.0
    origin: fields.Vector = field(default_factory=fields.zero_vector)

    @staticmethod
    def _misfits(table: Mapping[str, Any]) -> Iterator[Misfit]:
        yield from mass_misfits(table, "origin", "the rotor's centre from the carrier's origin")
        axial, servo = table["axial_inertia"], table.get("control") == "servo"
        if table["transverse_inertia"] < axial / 2 * (1 - fields.ROUNDING):
            yield wrong(table, "transverse_inertia", f"at least half of axial_inertia = {given(axial)}")
        if servo and "speed_gain" not in table:
            yield "control", 'control = "servo" needs "speed_gain", N m s'
        for key in ("speed_gain", "speed_integral", "torque_limit"):
            if key in table and not servo:
                yield useless(table, key, 'without control = "servo"')

    @property
    def spin(self) -> float:
        """Spin relative to the carrier (for a free rotor: with the carrier at rest), rad/s."""
        return self.angular_momentum / self.axial_inertia

    @property
    def most(self) -> float:
        """The largest torque of its motor, N m; infinite for any."""
        return math.inf if self.torque_limit is None else self.torque_limit

    @property
    def body(self) -> Body:
        """The rotor without its axial inertia, in the carrier's axes, from the carrier's origin."""
        across = np.eye(3) - np.outer(self.axis, self.axis)
        return Body(self.mass, self.origin, self.transverse_inertia * across)


@input_value
class GimbalTree:
    """A root body that carries a tree of gimbals: what parts of a platform are placed on.

    Attributes
    ----------
    name
        Title.
    root_name
        Name of the body whose rate is Omega.
    root_inertia : (3, 3)
        Of that body with everything rigidly attached, kg m²: about its centre of mass where it has a mass, else about
        its origin.
    root_mass, root_centre
        Its mass, kg (0: not given), and its centre of mass from its origin, (3,), m.
    gimbals
        In the file's order, which is that of the coordinates q.
    """

    name: fields.Text
    root_name: Annotated[fields.Text, InTable("root", "name")]
    root_inertia: Annotated[fields.Inertia, InTable("root", "inertia")]
    root_mass: Annotated[fields.Positive, InTable("root", "mass")] = 0.0
    root_centre: Annotated[fields.Vector, InTable("root", "centre")] = field(default_factory=fields.zero_vector)
    gimbals: Annotated[tuple[Gimbal, ...], Array("gimbal", most=MOST_GIMBALS, unique=("name",))] = ()

    @property
    def bodies(self) -> tuple[Body, ...]:
        """The root and the gimbals' bodies without rotors, (1 + n), each in its own axes, from its own origin."""
        return (Body(self.root_mass, self.root_centre, self.root_inertia), *(g.body for g in self.gimbals))

    @property
    def gimbal_names(self) -> tuple[str, ...]:
        """Names of the gimbals, in the order of the coordinates."""
        return tuple(g.name for g in self.gimbals)

    @property
    def angle_names(self) -> tuple[str, ...]:
        """Names of the coordinates q."""
        return tuple(g.angle for g in self.gimbals)

    @property
    def parents(self) -> NDArray[np.intp]:
        """Index of each gimbal's parent, (n,); −1 is the root."""
        return self._indices([g.parent for g in self.gimbals])

    def _indices(self, bodies: list[str]) -> NDArray[np.intp]:
        return np.array([self.body(name) for name in bodies], dtype=np.intp) - 1

    def body(self, name: str) -> int:
        """Return the number of a body: 0 the root, 1 + k that of gimbal k.

        Parameters
        ----------
        name
            Of the root or of a gimbal.

        Returns
        -------
        int
            From 0 to n.

        Raises
        ------
        ArgumentError
            The platform has no such body.
        """
        return known_name(f"body of platform {self.name!r}", name, (self.root_name, *self.gimbal_names))

    def gimbal(self, name: str) -> int:
        """Return the index of the named gimbal.

        Parameters
        ----------
        name
            Of a gimbal.

        Returns
        -------
        int
            From 0 to n − 1.

        Raises
        ------
        ArgumentError
            The platform has no such gimbal.
        """
        return known_name(f"gimbal of platform {self.name!r}", name, self.gimbal_names)
