"""Every rotor as a body of its own: the form that general multi-body programs know."""

from __future__ import annotations

import dataclasses

import numpy as np

from plant_parts import Gimbal
from platform_ctrl import Platform


def with_rotors_as_gimbals(platform: Platform) -> Platform:
    """Return the platform with every rotor as one more gimbal, ``rotor`` + name, that turns about the spin axis by φ.

    A rotor is symmetric, so φ itself does not matter. Nothing drives them: a drive is a torque on the gimbal. This
    shares nothing with (8)-(15) and serves to check them.
    """
    added = []
    for rotor in platform.rotors:
        along = np.outer(rotor.axis, rotor.axis)
        inertia = rotor.transverse_inertia * (np.eye(3) - along) + rotor.axial_inertia * along
        name, angle = f"rotor {rotor.name}", f"phi {rotor.name}"
        added.append(Gimbal(name=name, parent=rotor.carrier, axis=rotor.axis, inertia=inertia, angle=angle))
    return dataclasses.replace(platform, gimbals=(*platform.gimbals, *added), rotors=())
