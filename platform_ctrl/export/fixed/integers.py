"""Integers in C: their types and constants, functions that cut off and round, and counts into values and back."""

from __future__ import annotations

from platform_ctrl.export.fixed.values import FixedPoint, Format


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
        "/* The count within +- the largest. */",
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
