"""A controller in integers, computed in Python's integers: an oracle of the generated C and of the proofs."""

from collections.abc import Sequence

from platform_ctrl.errors import SimulationError
from platform_ctrl.export.c99.scheme import excess_of
from platform_ctrl.export.fixed_point.model import FixedPoint, IntegerRow


class IntegerMachine:
    """A controller in integers with its states, initially zero.

    `counts` are those of the last step by name: inputs after saturation, signals and outputs before any limit,
    states and integrals at its start. `registers` are the counts of the states and the accumulators of the
    integrals.
    """

    def __init__(self, fixed: FixedPoint) -> None:
        self.fixed = fixed
        self.integrals = {
            row.target: row.shift
            for section in fixed.sections
            for row in section.states
            if fixed.formats[row.target].role == "integral"
        }
        self.registers = {row.target: 0 for section in fixed.sections for row in section.states}
        self.counts: dict[str, int] = {}

    def step(self, inputs: Sequence[int]) -> tuple[int, ...]:
        """Return the counts of the outputs for those of the inputs, which are limited to their ranges."""
        fixed, formats = self.fixed, self.fixed.formats
        counts = {
            name: _within(int(count), formats[name].largest)
            for name, count in zip(fixed.scheme.inputs, inputs, strict=True)
        }
        for name, register in self.registers.items():
            shift = self.integrals.get(name, 0)
            counts[name] = (register + (1 << shift) // 2) >> shift
        for section in fixed.sections:
            for row in section.signals:
                limited = row.target in fixed.commanded and formats[row.target].saturates
                counts[row.target] = self._sum(row, counts, 64 if limited else formats[row.target].bits)
        outputs = []
        for name in fixed.scheme.outputs:
            limited_count = _within(counts[name], formats[name].largest) if formats[name].saturates else counts[name]
            outputs.append(limited_count)
            excess = limited_count - counts[name]
            counts[excess_of(name)] = _within(excess, fixed.excess_limits.get(name, abs(excess)))
        following = {}
        for section in fixed.sections:
            for row in section.states:
                name = row.target
                if name in self.integrals:
                    total = self._accumulated(row, counts, self.registers[name])
                    following[name] = _within(total, formats[name].largest << row.shift)
                else:
                    following[name] = self._sum(row, counts, formats[name].bits)
        self.counts, self.registers = counts, following
        return tuple(outputs)

    def _sum(self, row: IntegerRow, counts: dict[str, int], bits: int) -> int:
        total = self._accumulated(row, counts, 0) >> row.shift
        if row.keeps:
            total += counts[row.target]
        return self._fitting(total, bits, row.target)

    def _accumulated(self, row: IntegerRow, counts: dict[str, int], start: int) -> int:
        total = start
        for product in row.products:
            term = self._fitting(product.coefficient * counts[product.source], row.accumulator, row.target)
            total = self._fitting(total + term, row.accumulator, row.target)
        if row.target in self.integrals:
            return total
        return self._fitting(total + (1 << row.shift) // 2, row.accumulator, row.target)

    def _fitting(self, count: int, bits: int, name: str) -> int:
        if not -(2 ** (bits - 1)) <= count < 2 ** (bits - 1):
            raise SimulationError(
                f"fixed point: {name!r} reaches {count}, which does not fit {bits} bits; give it fewer fraction digits"
            )
        return count


def _within(count: int, largest: int) -> int:
    return min(max(count, -largest), largest)
