"""Gimbals and the tree that they are: what sensors and the other parts of a platform are placed on; SI units."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.common.arguments import known_name
from platform_ctrl.common.values import input_value
from platform_ctrl.plant import fields
from platform_ctrl.plant.fields import STOPS_DEG, Refers, default_angle
from platform_ctrl.plant.mistakes import Misfit, useless
from platform_ctrl.plant.tables import Array, Instead, InTable

# Their equations and matrices are worked out in full.
MOST_GIMBALS = 100

_STOPS_DEG = Instead("stops_deg", STOPS_DEG, lambda stops, _: (math.radians(stops[0]), math.radians(stops[1])))


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
        The gimbal's own body without rotors, kg m², in its own axes.
    angle
        Name of the coordinate, for example ``alpha4``; default ``q_`` + name.
    stops
        Lowest and highest angle, rad, or None.
    restitution
        Share of the rate that a stop gives back, 0 to 1; 0: the gimbal stays at its stop.

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

    @staticmethod
    def _misfits(table: Mapping[str, Any]) -> Iterator[Misfit]:
        if "restitution" in table and not {"stops", "stops_deg"} & table.keys():
            yield useless(table, "restitution", 'without "stops" or "stops_deg"')

    def __post_init__(self) -> None:
        """Name the angle."""
        if not self.angle:
            object.__setattr__(self, "angle", default_angle(self.name))


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
        Of that body with everything rigidly attached, kg m².
    gimbals
        In the file's order, which is that of the coordinates q.
    """

    name: fields.Text
    root_name: Annotated[fields.Text, InTable("root", "name")]
    root_inertia: Annotated[fields.Inertia, InTable("root", "inertia")]
    gimbals: Annotated[tuple[Gimbal, ...], Array("gimbal", most=MOST_GIMBALS, unique=("name",))] = ()

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
        number = {name: k for k, name in enumerate((self.root_name, *self.gimbal_names))}
        return np.array([number[name] if name in number else self.body(name) for name in bodies], dtype=np.intp) - 1

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
