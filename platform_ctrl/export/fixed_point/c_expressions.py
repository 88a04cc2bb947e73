"""Formats and proof in words, and integers in C: for the generated code."""

from __future__ import annotations

from collections.abc import Mapping

from platform_ctrl.common.text import at_most
from platform_ctrl.export.fixed_point.values import FixedPoint, Format


def format_lines(fixed: FixedPoint) -> tuple[str, ...]:
    """Return a line for every input, output, signal, state and integral: format, unit, value of one bit, range."""
    lines = [
        "Scaling: value = count * bit. Qm.n: m digits before the point and n behind it, beside the sign; a negative m "
        "omits digits that are always zero. Signals and states without a unit are in the controller's, SI.",
    ]
    for role, what in (
        ("input", "in"),
        ("output", "out"),
        ("signal", "signal"),
        ("state", "state"),
        ("integral", "integral"),
    ):
        lines += [f"{what + ':':<10}{_line(form)}" for form in fixed.formats.values() if form.role == role]
    return tuple(lines)


def _line(form: Format) -> str:
    unit = f" {form.unit}" if form.unit else ""
    ends = "saturates at" if form.saturates else "at most"
    return (
        f"{form.name}  int{form.bits} {form.q}, bit {form.bit:.6g}{unit}, {ends} +-{form.range:.6g}{unit} "
        f"(+-{form.largest})"
    )


def proof_lines(fixed: FixedPoint, leaks: Mapping[str, float]) -> tuple[str, ...]:
    """Return the proof in words."""
    rows = [row for section in fixed.sections for row in (*section.signals, *section.states)]
    wide = max(rows, key=lambda row: row.largest / 2.0**row.accumulator)
    stored = [
        form for form in fixed.formats.values() if not form.saturates and form.role in ("signal", "state", "output")
    ]
    lines = [
        "No overflow: every input is saturated at its range, so that the following holds for all inputs. A signal or "
        "state is at most the sum, over its sources (inputs, integrals at their limits, half a bit for the rounding "
        "of every other signal and state), of its size times the l1 norm of the impulse response of the rounded "
        f"coefficients. Norms: summed over {fixed.samples} samples, tail and floating-point rounding bounded above.",
    ]
    if stored:
        form = max(stored, key=lambda one: one.largest / 2.0**one.bits)
        lines.append(
            f"Counts: the fullest is {form.name}, {form.largest} of {2 ** (form.bits - 1) - 1}. Sums: partial sums are "
            "at most the sum over |coefficient| times the largest |count|, with the rounding; the fullest is "
            f"{wide.target}, {wide.largest} of {2 ** (wide.accumulator - 1) - 1}."
        )
    for name, size in fixed.poles.items():
        largest = at_most(size, 9)
        lines.append(f"Poles: {name}  at most {largest} in z as rounded, inside the unit circle (exact arithmetic).")
    for name in leaks:
        form = fixed.formats[name]
        # Bounds of what is zero are no smaller than the smallest numbers.
        drift = max(fixed.drift[name], 1e-30)
        lines.append(
            f"Integral: {name}  not asymptotically stable; kept in 64 bits, so that no increment is lost, and "
            f"limited to +-{form.range:.6g}; while no limit acts it drifts from that of the controller in real "
            f"arithmetic by at most {at_most(drift, 2)} in a second, {at_most(drift / form.range, 1)} of its limit."
            + (f" Its pole, given {leaks[name]:.1e} from 1, is 1." if leaks[name] else "")
        )
    for name, unit in zip(fixed.scheme.outputs, fixed.scheme.output_units, strict=True):
        error, conversion = (f"{at_most(bound[name], 3)} {unit}" for bound in (fixed.error, fixed.conversion))
        lines.append(
            f"Error: {name}  at most {error} from the same controller in real arithmetic with the same counts as "
            f"inputs and equal integrals; rounding the inputs adds at most {conversion}. Before its limit it is at "
            f"most {fixed.commanded[name]} counts."
        )
    if fixed.excess_limits:
        lines.append(
            "The error holds while no output is at its limit: excess enters stable states, limited by its own bound."
        )
    return tuple(lines)


def integer(bits: int) -> str:
    """Return the C type of so many bits."""
    return f"int{bits}_t"


def wide(fixed: FixedPoint, output: str) -> str:
    """Return the C type of an output before its limit."""
    bits = fixed.formats[output].bits
    return integer(bits if not fixed.formats[output].saturates else 32 if fixed.commanded[output] < 2**31 else 64)


def literal(number: int, bits: int) -> str:
    """Return an integer constant in C of so many bits."""
    return f"INT{bits}_C({number})" if bits != 16 else str(number)


def counted(form: Format) -> str:
    """Return what a count of a format means."""
    return f"{form.q}: 1 is {form.bit:.17g} {form.unit}, within +-{form.largest}".replace("  ", " ")


def shifted(bits: int) -> list[str]:
    """Return a C function that shifts sums of so many bits."""
    kind = integer(bits)
    return [
        "/* The sum over 2^digits, rounded down: defined for negative sums too, unlike a shift of one. */",
        f"static {kind} shifted{bits}({kind} sum, unsigned int digits)",
        "{",
        f"    {kind} result = 0;",
        "    if (sum >= 0) {",
        "        result = sum >> digits;",
        "    } else {",
        "        result = -((-(sum + 1)) >> digits) - 1;",
        "    }",
        "    return result;",
        "}",
        "",
    ]


def within() -> list[str]:
    """Return a C function that cuts off a count."""
    return [
        "/* The count, limited to +- the largest. */",
        "static int64_t within(int64_t count, int64_t largest)",
        "{",
        "    int64_t result = count;",
        "    if (count > largest) {",
        "        result = largest;",
        "    } else if (count < -largest) {",
        "        result = -largest;",
        "    } else {",
        "        /* within */",
        "    }",
        "    return result;",
        "}",
        "",
    ]


def to_count(name: str, form: Format) -> list[str]:
    """Return a C function that turns a value into the nearest count of a format."""
    kind = integer(form.bits)
    largest = f"{form.largest}.0"
    return [
        f"static inline {kind} {name}(double value)",
        "{",
        f"    const double scaled = value * {_power(form.fraction)};",
        f"    {kind} count = 0;",
        f"    if (scaled >= {largest}) {{",
        f"        count = {literal(form.largest, form.bits)};",
        f"    }} else if (scaled <= -{largest}) {{",
        f"        count = -{literal(form.largest, form.bits)};",
        "    } else if (scaled >= 0.0) {",
        f"        count = ({kind})(scaled + 0.5);",
        "    } else if (scaled < 0.0) {",
        f"        count = ({kind})(scaled - 0.5);",
        "    } else {",
        "        count = 0;",
        "    }",
        "    return count;",
        "}",
    ]


def to_value(name: str, kind: str, form: Format) -> list[str]:
    """Return a C function that turns a count, of some type, into its value."""
    return [
        f"static inline double {name}({kind} count)",
        "{",
        f"    return (double)count * {_power(-form.fraction)};",
        "}",
    ]


def _power(exponent: int) -> str:
    text = repr(2.0**exponent)
    return text if "." in text or "e" in text else f"{text}.0"
