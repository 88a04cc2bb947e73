"""What is not rigid in a platform: modes of its structure. Values only; SI units."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import field
from typing import Annotated

import numpy as np

from platform_ctrl.common.values import FloatArray, input_value
from platform_ctrl.plant import fields
from platform_ctrl.plant.fields import Expected, Unfit, number
from platform_ctrl.plant.tables import Instead


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


_HERTZ = Instead("frequency_hz", fields.POSITIVE, lambda hertz, _: 2.0 * math.pi * hertz)


@input_value
class FlexibleMode:
    """A mode of the structure, mass-normalised: η̈ + 2 ζ ω η̇ + ω² η = Σ φ_j Q_j − Γ·Ω' − Γ_f·f.

    It is a free mode, as a measured response shows it: no torquer works, joints turn freely. It then has no inertia in
    common with the rigid gimbals.

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
        of an angle reads φ η besides, a sensor of a rate φ η̇.
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
    ]
    base: fields.Vector = field(default_factory=fields.zero_vector)
    base_force: fields.Vector = field(default_factory=fields.zero_vector)

    @property
    def rate(self) -> str:
        """Signal name of η̇."""
        return f"{self.name}_rate"

    def of(self, names: list[str]) -> FloatArray:
        """Return the participation of several torquers or sensors, 1/sqrt(kg m²); 0 of those it does not name."""
        return np.array([self.participation.get(name, 0.0) for name in names])
