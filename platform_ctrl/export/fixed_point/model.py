"""A controller in integers: formats, rows and proofs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from platform_ctrl.common.text import at_most
from platform_ctrl.common.values import value
from platform_ctrl.export.c99.scheme import Scheme, SectionKind

Number = Literal["q31", "q15"]
Role = Literal["input", "signal", "state", "integral", "output"]


@value
class Format:
    """How a quantity is counted: value = count · 2^−fraction."""

    # name, role: Of the quantity. integral: a state that is not asymptotically stable; it is kept as an accumulator of
    # 64 bits and read as a count of this format.
    name: str
    role: Role
    unit: str  # Of the value; empty between inputs and outputs
    bits: int  # Of the integer that holds a count, with its sign: 16, 32 or 64
    fraction: int  # Binary digits behind the point; it may be negative, or larger than bits
    largest: int  # Largest magnitude of a count: proved, or enforced by saturation where saturates
    saturates: bool = False  # Whether a count beyond largest is saturated: inputs, outputs with a limit, integrals

    @property
    def bit(self) -> float:
        """Value of one count, in `unit`."""
        return float(2.0**-self.fraction)

    @property
    def range(self) -> float:
        """Largest magnitude of the value, in `unit`."""
        return self.largest * self.bit

    @property
    def q(self) -> str:
        """The Q format: integer and fraction digits without the sign, for example ``Q4.27``."""
        return f"Q{self.bits - 1 - self.fraction}.{self.fraction}"


@value
class Product:
    """An integer coefficient times a count."""

    coefficient: int
    # Name of an input, signal, state or integral; or excess of an output: its count after the limit less before
    source: str


@value
class IntegerRow:
    """A sum of products in integers, ⌊(Σ coefficient · count + 2^(shift − 1)) / 2^shift⌋.

    An integral is not shifted when it is stored, but when it is read.
    """

    target: str
    products: tuple[Product, ...]
    shift: int  # Binary digits that are rounded away, half up
    # Whether the state's present count is added behind the shift (delta form): slow poles keep all their digits
    keeps: bool
    accumulator: int  # Bits of the sum: 32 or 64
    # Bound of all partial sums: Σ |coefficient| largest |count|, with the rounding; of an integral with
    # its register
    largest: int

    @property
    def sources(self) -> tuple[str, ...]:
        """Names of the sources."""
        return tuple(product.source for product in self.products)


@value
class FixedSection:
    """A section of the scheme in integers."""

    # name, kind, note: As in the scheme
    name: str
    kind: SectionKind
    note: str
    # signals, states: Its rows, in the order in which they are evaluated
    signals: tuple[IntegerRow, ...]
    states: tuple[IntegerRow, ...]


@value
class FixedPoint:
    """A controller in integers with the proof that nothing overflows."""

    scheme: Scheme  # What was lowered
    number: Number  # "q31": 32-bit counts; "q15": 16-bit signals and 32-bit states
    formats: dict[str, Format]  # Of every input, signal, state and output, by name
    sections: tuple[FixedSection, ...]  # The programme
    commanded: dict[str, int]  # Largest magnitude of an output's count before its limit, by output
    # Where excess is saturated before it enters a state, counts by output; none for an output whose excess enters
    # integrals alone
    excess_limits: dict[str, int]
    # By output, in its unit: largest difference to the controller in real arithmetic with the same counts as inputs and
    # the same integrals, for all inputs in range
    error: dict[str, float]
    conversion: dict[str, float]  # By output, in its unit: largest effect of rounding the inputs to counts
    # By integral, per second in its unit: largest drift from that of the controller in real arithmetic, for all inputs
    # in range
    drift: dict[str, float]
    # Largest magnitude of the poles in z of every asymptotically stable part, as rounded, by the name of its section;
    # dimensionless
    poles: dict[str, float]
    samples: int  # Number of samples over which impulse responses were summed; their tails are bounded
    proof: tuple[str, ...]  # Lines in words

    def wide(self, output: str) -> str:
        """Return the C type of an output before its limit."""
        form = self.formats[output]
        return f"int{form.bits if not form.saturates else 32 if self.commanded[output] < 2**31 else 64}_t"


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
