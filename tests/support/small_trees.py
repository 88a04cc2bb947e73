"""Platforms in a few lines: axes by number or vector, inertias by size, principal moments or matrix."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from plant_parts import Gimbal, Rotor
from platform_ctrl import Platform


def along(axis: int | Sequence[float]) -> np.ndarray:
    """Return the unit vector along coordinate axis 1, 2 or 3, or along a vector."""
    vector = np.eye(3)[axis - 1] if isinstance(axis, int) else np.array(axis, dtype=float)
    return vector / np.linalg.norm(vector)


def inertia(size: Any) -> np.ndarray:
    """Return J times the identity, the diagonal of three moments, or the matrix."""
    given = np.asarray(size, dtype=float)
    return given * np.eye(3) if given.ndim == 0 else np.diag(given) if given.ndim == 1 else given


def tree(
    root: Any, gimbals: Sequence[Any] = (), rotors: Sequence[Any] = (), base: str = "base", **more: Any
) -> Platform:
    """Return a platform.

    Gimbals are (name, parent, axis, inertia[, angle[, other fields]]), rotors (name, carrier, axis, axial inertia,
    transverse inertia, angular momentum[, other fields]); `more` are other fields of the platform.
    """

    def gimbal(name: str, parent: str, axis: Any, J: Any, angle: str = "", fields: Any = ()) -> Any:
        return Gimbal(
            name=name, parent=parent, axis=along(axis), inertia=inertia(J), angle=angle or name, **dict(fields)
        )

    def rotor(name: str, carrier: str, axis: Any, C: float, A: float, momentum: float, fields: Any = ()) -> Any:
        return Rotor(
            name=name,
            carrier=carrier,
            axis=along(axis),
            axial_inertia=C,
            transverse_inertia=A,
            angular_momentum=momentum,
            **dict(fields),
        )

    return Platform(
        **{
            "name": "small tree",
            "root_name": base,
            "root_inertia": inertia(root),
            "gimbals": tuple(gimbal(*one) for one in gimbals),
            "rotors": tuple(rotor(*one) for one in rotors),
        }
        | more
    )
