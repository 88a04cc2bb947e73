"""What of the plant is uncertain, and which faults a design allows for: [uncertainty] and [faults] of a job file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Annotated, Any, get_args

from platform_ctrl.common.values import input_value
from platform_ctrl.plant import fields
from platform_ctrl.plant.fields import Expected
from platform_ctrl.plant.flexible import MODE_NUMBERS
from platform_ctrl.plant.mistakes import Misfit, useless
from platform_ctrl.plant.tables import shape

_SHARE = get_args(fields.Share)[1]


def _shares(item: object) -> float | dict[str, float]:
    """Return a share, or shares by name."""
    return (
        {str(name): _SHARE.judge(one) for name, one in item.items()} if isinstance(item, dict) else _SHARE.judge(item)
    )


_OfModes = Annotated[
    float | Mapping[str, float], Expected("a number from 0 to 0.9, or a table of such numbers by names", _shares)
]


@input_value
class Uncertainty:
    """How far the parameters lie from their nominal values.

    Attributes
    ----------
    inertia, spin
        Relative half-widths: of J about every gimbal axis, of L of every rotor.
    mode_frequency, mode_damping, mode_participation
        Relative half-widths of ω, ζ and φ of modes, and of ω and ζ of drives that give way: of all, or of each by the
        name of the mode or of the drive's gimbal.
    samples
        Number of plants taken from inside this box, beside its corners.
    """

    inertia: fields.Share = 0.0
    spin: fields.Share = 0.0
    mode_frequency: _OfModes = 0.0
    mode_damping: _OfModes = 0.0
    mode_participation: _OfModes = 0.0
    samples: fields.Samples = 0

    @staticmethod
    def _misfits(table: Mapping[str, Any]) -> Iterator[Misfit]:
        if table.get("samples") and not any(table.get(key) for key in shape(Uncertainty).keys if key != "samples"):
            yield useless(table, "samples", "without inertia, spin or another parameter > 0")

    def of_mode(self, name: str) -> dict[str, float]:
        """Return the half-widths of a mode, or of the drive of a gimbal, by what they are of."""
        widths = {what: getattr(self, f"mode_{what}") for what in MODE_NUMBERS}
        return {what: one.get(name, 0.0) if isinstance(one, Mapping) else one for what, one in widths.items()}


@input_value
class Faults:
    """What may fail, one part at a time; None where nothing does.

    Attributes
    ----------
    slow_rotor
        Share of its L that a rotor keeps; 0: it has stopped.
    weak_torquer
        Share of its torque that a torquer keeps.
    """

    slow_rotor: fields.Part | None = None
    weak_torquer: fields.SomePart | None = None
