"""A scheme lowered to integers, with proofs of the result.

Formats come from bounds, bounds from the l1 norms of impulse responses. The norms that prove are those of the rounded
controller, with every rounding of a signal or state as an input of half a count; integrals, which have no finite norm,
stop at a limit and count as inputs as well.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import NamedTuple

import flint
import numpy as np

from platform_ctrl.common.arguments import known_name, known_names, positive
from platform_ctrl.errors import InfeasibleError, UnscalableError
from platform_ctrl.export.c99.scheme import Rows, Scheme, Sum, excess_of
from platform_ctrl.export.fixed_point.bounds import BITS, Responses, SlowError, responses
from platform_ctrl.export.fixed_point.exact import (
    ExactSystem,
    Rational,
    characteristic_polynomial,
    count_of,
    exact_system,
    fraction_for,
    inside_circle,
    integer_row,
    integral_row,
    joined_states,
    largest_root,
    lost,
    power_of_two,
    without_rounding,
)
from platform_ctrl.export.fixed_point.model import (
    FixedPoint,
    FixedSection,
    Format,
    IntegerRow,
    Number,
    Role,
    proof_lines,
)
from platform_ctrl.export.fixed_point.splitting import Parts, integral_limits, split_scheme

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
        """Sources of signals and stable states."""
        excesses = (excess_of(name) for name in self.parts.limited)
        return (*self.scheme.inputs, *self.parts.integrals, *excesses)

    def refused(self, row: str, what: str, more: str = "") -> InfeasibleError:
        """Return the error with the section, what is wrong there, and what to try."""
        cure = "give number = 'q31'" if self.number == "q15" else "export it as double or float"
        where = f"section {self.parts.section[row]!r}" if row in self.parts.section else "inputs"
        return InfeasibleError(f"fixed point, {self.number}: {where}: {what}; {more}{cure}", self.scheme)


def formats_for(task: Task, bounds: Mapping[str, float]) -> dict[str, Format]:
    """Return the format of everything that is stored, for bounds in units of the scheme."""
    scheme, (signal_bits, state_bits, _) = task.scheme, WIDTHS[task.number]
    units = dict(zip((*scheme.inputs, *scheme.outputs), (*scheme.input_units, *scheme.output_units), strict=True))
    limits = task.torque_limits
    out: dict[str, Format] = {}

    def place(name: str, role: Role, bits: int, bound: float, saturates: float | None = None) -> None:
        usable = math.isfinite(bound)
        fraction = fraction_for(bound, bits) if usable else 0
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
    """Return a row in counts of its target per count of its sources; outputs without limit have no excess."""
    fraction = formats[target].fraction
    out = {}
    for name, coefficient in row.items():
        form = formats[name.removeprefix(excess_of(""))]
        if name == form.name or form.saturates:
            out[name] = coefficient * power_of_two(fraction - form.fraction)
    return out


# How often formats whose bound does not fit after rounding lose a digit.
_ROUNDS = 6
# Share of a torque's limit that the bound of the error may take.
ACCURACY = 0.02
_UP = 1.0 + 1e-10


class _Rounded(NamedTuple):
    """Rows in integers, and the same in rational numbers, counts per count."""

    rows: dict[str, IntegerRow]
    exact: Rows


def fixed_point(
    scheme: Scheme,
    ranges: Mapping[str, float],
    *,
    number: Number = "q31",
    limits: Mapping[str, float] | None = None,
    accuracy: float = ACCURACY,
) -> FixedPoint:
    """Return a controller in integers that provably never overflows.

    Parameters
    ----------
    scheme
        The controller.
    ranges
        Largest magnitude of every input, in its unit; see `input_ranges`.
    number
        ``"q31"``: 32-bit counts, coefficients of 31 bits; ``"q15"``: 16-bit inputs, signals and outputs, 32-bit
        states, coefficients of 15 bits.
    limits
        Where integrals stop, by state, in its unit; default twice what they need for all torques within the limits.
    accuracy
        Largest bound of the error as a share of an output's limit.
    """
    known_name("number", number, tuple(WIDTHS))
    accuracy = positive("accuracy", accuracy)
    known_names("ranges", list(ranges), scheme.inputs)
    known = {}
    for name in scheme.inputs:
        known_name("ranges", name, tuple(ranges))
        known[name] = positive(f"ranges[{name!r}]", ranges[name])
    # Overflow of doubles is an error of the bounds.
    with flint.ctx.workprec(BITS), np.errstate(all="ignore"):
        parts = split_scheme(scheme)
        task = Task(scheme, parts, number, known, integral_limits(scheme, parts, limits))
        return _lowered(task, accuracy)


def _lowered(task: Task, accuracy: float) -> FixedPoint:
    parts, rows = task.parts, task.parts.rows
    real = _responses(task, exact_system(rows, task.free, parts.states))
    bounds = real.bounds(task.sizes, {})
    # The excess that enters stable states is limited to its largest value without anti-windup.
    cut = {name: max(bounds[name] - task.torque_limits[name], 0.0) for name in parts.limited}
    bounds = real.bounds(task.sizes | {excess_of(name): size for name, size in cut.items()}, {})
    formats = formats_for(task, bounds)
    excesses: dict[str, int] = {}
    for _ in range(_ROUNDS):
        excesses = {name: count_of(size, formats[name].fraction) for name, size in cut.items()}
        rounded = _rounded(task, formats, excesses)
        system = exact_system(rounded.exact, task.free, parts.states)
        poles = _poles(task, system)
        found = _responses(task, system)
        counts = _counts(task, formats, excesses, rounded, found)
        tight = [
            name
            for name, form in formats.items()
            if name in counts and _stored(task, form) and counts[name] >= 2 ** (form.bits - 1)
        ]
        if not tight:
            break
        for name in tight:
            formats[name] = dataclasses.replace(formats[name], fraction=formats[name].fraction - 1)
    else:
        raise task.refused(tight[0], f"what the roundings add to {tight[0]!r} fits no format")
    lowered = _Lowered(formats, excesses, rounded, counts, poles, found.norms.samples)
    return _proved(task, accuracy, real, lowered)


def _stored(task: Task, form: Format) -> bool:
    """Whether the count before saturation is stored: not where an output is limited at once."""
    return not form.saturates or form.name in task.parts.outputs_read


class _Lowered(NamedTuple):
    """Formats, limits of excesses and rows that fit each other; largest counts, poles, and samples of the norms."""

    formats: dict[str, Format]
    excesses: dict[str, int]
    rounded: _Rounded
    counts: dict[str, int]
    poles: dict[str, float]
    samples: int


def _proved(task: Task, accuracy: float, real: Responses, lowered: _Lowered) -> FixedPoint:
    """Return the result: integrals rounded as well, bounds of every sum, the error."""
    scheme, parts = task.scheme, task.parts
    excesses, rounded, counts = lowered.excesses, lowered.rounded, lowered.counts
    formats = {
        name: form if form.saturates else dataclasses.replace(form, largest=counts[name])
        for name, form in lowered.formats.items()
    }
    largest = {name: form.largest for name, form in formats.items()} | counts
    for name in parts.excesses:
        beyond = max(counts[name] - formats[name].largest, 0)
        excesses.setdefault(name, beyond)
        largest[excess_of(name)] = min(excesses[name], beyond)
    integer_rows = {name: _with_largest(row, largest) for name, row in rounded.rows.items()}
    exact = {**parts.rows.signals, **parts.rows.states}
    made = {**rounded.exact.signals, **rounded.exact.states}
    noise_counts = {
        name: (0.5 if row.shift else 0.0) + _above(lost(scaled(formats, name, exact[name]), made[name], largest))
        for name, row in integer_rows.items()
    }
    integer_rows |= _integral_rows(task, formats, largest)
    noise = {name: count * formats[name].bit for name, count in noise_counts.items()}
    read = {name: 0.5 * formats[name].bit for name in parts.integrals}
    errors = real.bounds(read, noise)
    conversion = real.bounds({name: 0.5 * formats[name].bit for name in scheme.inputs}, {})
    limits = task.torque_limits
    # A limit in counts is a little below the limit.
    cut = {name: limits[name] - formats[name].range if formats[name].saturates else 0.0 for name in scheme.outputs}
    error = {name: _up(errors[name] + cut[name]) for name in scheme.outputs}
    full = {name: limits[name] if math.isfinite(limits[name]) else formats[name].range for name in error}
    _check_accuracy(task, accuracy, {name: (error[name], full[name]) for name in error}, real, noise)
    out = FixedPoint(
        scheme=scheme,
        number=task.number,
        formats=formats,
        sections=tuple(
            FixedSection(
                name=one.name,
                kind=one.kind,
                note=one.note,
                signals=tuple(integer_rows[row.target] for row in one.signals),
                states=tuple(integer_rows[parts.differences.get(row.target, row.target)] for row in one.states),
            )
            for one in scheme.sections
        ),
        commanded={name: counts[name] for name in scheme.outputs},
        excess_limits={name: excesses[name] for name in parts.limited},
        error=error,
        conversion={name: _up(conversion[name]) for name in scheme.outputs},
        drift={
            name: _drift(task, integer_rows[name], scaled(formats, name, increment), formats, largest, errors)
            for name, increment in parts.integrals.items()
        },
        poles=lowered.poles,
        samples=lowered.samples,
        proof=(),
    )
    return dataclasses.replace(out, proof=proof_lines(out, parts.leaks))


def _integral_rows(task: Task, formats: Mapping[str, Format], largest: Mapping[str, int]) -> dict[str, IntegerRow]:
    """Return the rows of the integrals, which never overflow."""
    out = {}
    for name, increment in task.parts.integrals.items():
        counted = scaled(formats, name, increment)
        row = out[name] = integral_row(name, counted, formats[name].largest, largest, WIDTHS[task.number][2])
        if not row.products and increment:
            raise task.refused(name, f"the integral {name!r} gains less in a step than can be counted")
        if row.largest >= 2**63:
            raise task.refused(name, f"what the integral {name!r} may gain in a step does not fit 64 bits")
    return out


def _check_accuracy(
    task: Task, accuracy: float, error: Mapping[str, tuple[float, float]], real: Responses, noise: Mapping[str, float]
) -> None:
    """Refuse an error, given with the largest value by output, that is too large; name the row that adds most to it."""
    for name, (size, full) in error.items():
        if size > accuracy * full:
            worst = max(noise, key=lambda row: real.bounds({}, {row: noise[row]})[name])
            raise task.refused(
                worst,
                f"the error of {name} may reach {size:.3g}, {size / full:.2g} of its largest value, most of it from "
                f"{worst!r}; the limit is {accuracy:g}",
                "give smaller ranges of the inputs, or a larger accuracy; or ",
            )


def _responses(task: Task, system: ExactSystem) -> Responses:
    try:
        return responses(system)
    except SlowError:
        slowest = max(
            joined_states(system.following, system.states),
            key=lambda group: largest_root(characteristic_polynomial(system.following, group)),
        )
        raise task.refused(slowest[0], "it settles too slowly for a finite bound", "give a faster pole; or ") from None


def _rounded(task: Task, formats: Mapping[str, Format], excesses: Mapping[str, int]) -> _Rounded:
    """Return all rows but those of integrals, for any counts that the formats can hold."""
    mantissa = WIDTHS[task.number][2]
    largest = {name: form.largest for name, form in formats.items()}
    # Before its limit the count of an output that others read may be as large as the word.
    largest |= {name: 2 ** (formats[name].bits - 1) - 1 for name in task.parts.outputs_read}
    largest |= {excess_of(name): size for name, size in excesses.items()}
    rows: dict[str, IntegerRow] = {}
    signals: dict[str, Sum] = {}
    states: dict[str, Sum] = {}
    for rational_rows, kept, out in ((task.parts.rows.signals, False, signals), (task.parts.rows.states, True, states)):
        for name, row in rational_rows.items():
            counted = scaled(formats, name, row)
            own = counted.get(name, flint.fmpq(0))
            keeps = kept and flint.fmpq(1, 2) < own < flint.fmpq(3, 2)
            if keeps:
                counted[name] = own - 1
            made = integer_row(name, counted, largest, mantissa, keeps=keeps, narrow=task.number == "q15")
            for product in made.products:
                if abs(product.coefficient) >= 2**63:
                    raise task.refused(name, f"a coefficient of {name!r} is too large")
            if made.largest >= 2 ** (made.accumulator - 1):
                raise task.refused(name, f"the sum of {name!r} does not fit {made.accumulator} bits")
            rows[name] = made
            out[name] = without_rounding(made)
    return _Rounded(rows, Rows(signals, states))


def _poles(task: Task, system: ExactSystem) -> dict[str, float]:
    """Return the largest magnitude of a pole by section, and refuse one that rounding moves out of the circle."""
    out: dict[str, float] = {}
    for group in joined_states(system.following, system.states):
        polynomial = characteristic_polynomial(system.following, group)
        size = largest_root(polynomial)
        if not inside_circle(polynomial):
            raise task.refused(
                group[0],
                f"rounded coefficients move a pole of {', '.join(group)} to magnitude {size:.9g} in z, onto or out of "
                "the unit circle",
                "sample more slowly, or ",
            )
        name = task.parts.section[group[0]]
        out[name] = max(out.get(name, 0.0), size)
    return out


def _counts(
    task: Task, formats: Mapping[str, Format], excesses: Mapping[str, int], rounded: _Rounded, found: Responses
) -> dict[str, int]:
    """Return the largest counts of signals and states, before any limit."""
    sizes = {name: float(formats[name].largest) for name in (*task.ranges, *task.limits)}
    sizes |= {excess_of(name): float(size) for name, size in excesses.items()}
    noise = {name: 0.5 if row.shift else 0.0 for name, row in rounded.rows.items()}
    bounds = found.bounds(sizes, noise)
    return {name: math.floor(bound * _UP) for name, bound in bounds.items()}


def _with_largest(row: IntegerRow, largest: Mapping[str, int]) -> IntegerRow:
    sums = sum(abs(product.coefficient) * largest[product.source] for product in row.products)
    return dataclasses.replace(row, largest=sums + (1 << row.shift) // 2)


def _above(number: Rational) -> float:
    return _up(float(flint.arb(number)))


def _up(number: float) -> float:
    return number * _UP


def _drift(
    task: Task,
    row: IntegerRow,
    increment: Sum,
    formats: Mapping[str, Format],
    largest: Mapping[str, int],
    errors: Mapping[str, float],
) -> float:
    """Return the largest drift of an integral from the real one, per second, while nothing is at a limit."""
    inner = {source: k for source, k in increment.items() if source in formats}
    made = {source: k for source, k in without_rounding(row).items() if source in formats and source != row.target}
    wrong = _above(lost(inner, made, largest))
    for source, coefficient in inner.items():
        if source in errors:
            wrong += abs(_above(abs(coefficient))) * errors[source] / formats[source].bit
    return _up(wrong) * formats[row.target].bit / task.scheme.period
