"""What is to be lowered to integers, and the formats that bounds ask for."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

from platform_ctrl.errors import InfeasibleError, UnscalableError
from platform_ctrl.export.c99.scheme import Scheme
from platform_ctrl.export.fixed_point.exact import Sum, count_of, fraction_for, power_of_two
from platform_ctrl.export.fixed_point.splitting import Parts, excess_of
from platform_ctrl.export.fixed_point.values import Format, Number, Role

# Bits of inputs, signals and outputs, of states, and significant bits of coefficients.
WIDTHS = {"q31": (32, 32, 31), "q15": (16, 32, 15)}
# Most digits before or behind the point.
_FRACTIONS = 200
# An output that stays below this share of its limit needs none.
_OUT_OF_REACH = 0.5


class Task(NamedTuple):
    """A controller with the ranges of its inputs and the limits of its integrals."""

    scheme: Scheme
    parts: Parts
    number: Number
    ranges: dict[str, float]
    limits: dict[str, float]

    @property
    def sizes(self) -> dict[str, float]:
        """Largest magnitudes of inputs and integrals."""
        return self.ranges | self.limits

    @property
    def torque_limits(self) -> dict[str, float]:
        """Limits by output."""
        return dict(zip(self.scheme.outputs, self.scheme.torque_limits, strict=True))

    @property
    def free(self) -> tuple[str, ...]:
        """What drives signals and stable states from outside."""
        excesses = (excess_of(name) for name in self.parts.limited)
        return (*self.scheme.inputs, *self.parts.integrals, *excesses)

    def refused(self, row: str, what: str, more: str = "") -> InfeasibleError:
        """Return the error with the section, what is wrong there, and what to try."""
        cure = "give number = 'q31'" if self.number == "q15" else "export it as double or float"
        where = f"section {self.parts.section[row]!r}" if row in self.parts.section else "inputs"
        return InfeasibleError(f"fixed point, {self.number}: {where}: {what}; {more}{cure}", self.scheme)


def formats_for(task: Task, bounds: Mapping[str, float], given: Mapping[str, int]) -> dict[str, Format]:
    """Return the format of everything that is stored, for bounds in units of the scheme."""
    scheme, (signal_bits, state_bits, _) = task.scheme, WIDTHS[task.number]
    units = dict(zip((*scheme.inputs, *scheme.outputs), (*scheme.input_units, *scheme.output_units), strict=True))
    limits = task.torque_limits
    out: dict[str, Format] = {}

    def place(name: str, role: Role, bits: int, bound: float, saturates: float | None = None) -> None:
        usable = math.isfinite(bound)
        fraction = given.get(name, fraction_for(bound, bits)) if usable else 0
        if not usable or abs(fraction) > _FRACTIONS:
            raise UnscalableError(
                f"fixed point: {name!r} has the bound {bound:.3g}, too small or large for a format; change its unit",
                scheme,
            )
        largest = 2 ** (bits - 1) - 1 if saturates is None else count_of(saturates, fraction)
        if not 0 < largest < 2 ** (bits - 1):
            raise task.refused(name, f"{name!r}, at most {bound:.3g}, does not fit {fraction} digits behind the point")
        out[name] = Format(
            name=name,
            role=role,
            unit=units.get(name, ""),
            bits=bits,
            fraction=fraction,
            largest=largest,
            saturates=saturates is not None,
        )

    for name, size in task.ranges.items():
        place(name, "input", signal_bits, size, size)
    for section in scheme.sections:
        for row in section.signals:
            name, limit = row.target, limits.get(row.target, math.inf)
            if not math.isfinite(limit) or bounds[name] < _OUT_OF_REACH * limit:
                place(name, "output" if name in limits else "signal", signal_bits, bounds[name])
            elif name in task.parts.outputs_read:
                place(name, "output", signal_bits, max(bounds[name], limit), limit)
            else:
                place(name, "output", signal_bits, limit, limit)
        for row in section.states:
            name = task.parts.differences.get(row.target, row.target)
            if name in task.limits:
                place(name, "integral", state_bits, task.limits[name], task.limits[name])
            else:
                place(name, "state", state_bits, bounds[name])
    return out


def scaled(formats: Mapping[str, Format], target: str, row: Sum) -> Sum:
    """Return a row in counts of its target per count of its sources; what is never limited has no excess."""
    fraction = formats[target].fraction
    out = {}
    for name, coefficient in row.items():
        form = formats[name.removeprefix(excess_of(""))]
        if name == form.name or form.saturates:
            out[name] = coefficient * power_of_two(fraction - form.fraction)
    return out
