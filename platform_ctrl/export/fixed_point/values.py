"""A controller in integers: formats, rows, and what is proved of them. Values only."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from platform_ctrl.common.arguments import positive
from platform_ctrl.common.values import value
from platform_ctrl.errors import ArgumentError, InputError
from platform_ctrl.export.c99.scheme import Scheme, SectionKind
from platform_ctrl.job.job import Job
from platform_ctrl.plant.platform import OMEGA_NAMES, Platform

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
    saturates: bool = False  # Whether a count beyond largest is cut off: inputs, outputs with a limit, integrals

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
    shift: int  # Binary digits that are cut off, rounding half up
    # Whether the state's present count is added behind the shift (delta form): slow poles keep all their digits
    keeps: bool
    accumulator: int  # Bits of the sum: 32 or 64
    # What no partial sum exceeds in magnitude: Σ |coefficient| largest |count|, with the rounding; of an integral with
    # its register
    largest: int


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
    # By output, in its unit: how far it is at most from the controller in real arithmetic that is fed with the same
    # counts and whose integrals hold the same values, for all inputs in range
    error: dict[str, float]
    conversion: dict[str, float]  # By output, in its unit: what rounding the inputs to counts may add
    # By integral, per second in its own unit: how fast it may part from that of the controller in real arithmetic, for
    # all inputs in range
    drift: dict[str, float]
    # Largest magnitude of the poles in z of every asymptotically stable part, as rounded, by the name of its section;
    # dimensionless
    poles: dict[str, float]
    samples: int  # Number of samples over which impulse responses were summed; their tails are bounded
    proof: tuple[str, ...]  # Lines in words


# Beyond a stop, a limit or the operating range: noise, elasticity, offsets.
MARGIN = 0.1


def input_ranges(
    inputs: tuple[str, ...], job: Job, ranges: Mapping[str, float] | None = None, margin: float = MARGIN
) -> dict[str, float]:
    """Return the largest magnitude of every input: `ranges` as they are, else that of plant and job with a margin.

    An angle reaches its stops, a torque of another controller its torquer's limit, Omega the job's operating range.
    """
    given, margin = dict(ranges or {}), positive("margin", margin, zero=True)
    known = _known(job.platform) | {
        name: float(rate) for name, rate in zip(OMEGA_NAMES, job.Omega, strict=True) if rate > 0.0
    }
    out = {}
    for name in inputs:
        if name in given:
            out[name] = positive(f"ranges[{name!r}]", given[name])
        elif name in known:
            out[name] = (1.0 + margin) * known[name]
        else:
            raise InputError(
                f"fixed point: no range is known for {name!r}; add stops of its gimbal or a limit of its torquer to "
                f"the plant file, or give its largest magnitude (ranges; on the command line --range {name}=NUMBER)"
            )
    return out


def check_names(what: str, given: Mapping[str, float], known: tuple[str, ...]) -> None:
    """Refuse a name that nothing has."""
    for name in given:
        if name not in known:
            raise ArgumentError(f"{what}: {name!r} is unknown here; it must be one of {', '.join(known) or 'none'}")


def _known(platform: Platform) -> dict[str, float]:
    out = {
        gimbal.angle: max(abs(stop) for stop in gimbal.stops)
        for gimbal in platform.gimbals
        if gimbal.stops is not None and any(gimbal.stops)
    }
    limits = {torquer.name: torquer.limit for torquer in platform.torquers if torquer.limit}
    return out | limits
