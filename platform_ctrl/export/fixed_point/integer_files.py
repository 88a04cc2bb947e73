"""The files of a controller in integers: C99 that also compiles as C++."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

from platform_ctrl.common.values import value
from platform_ctrl.export.c99.c_text import Names, comment, field, joined
from platform_ctrl.export.c99.controller_files import ControllerFiles, Paragraph, Step
from platform_ctrl.export.c99.scheme import excess_of
from platform_ctrl.export.fixed_point.model import FixedPoint, Format, IntegerRow, Product

_ROLES = {"input": "in:", "output": "out:", "signal": "signal:", "state": "state:", "integral": "integral:"}


@value
class IntegerFiles(ControllerFiles):
    """The files of a controller in integers."""

    fixed: FixedPoint  # The controller in integers

    template: ClassVar = "integer.c.j2"
    fixed_point: ClassVar = True
    statuses: ClassVar = (
        *ControllerFiles.statuses,
        ("CLIPPED", 4, "an input was out of its range and was saturated"),
        ("STOPPED", 8, "an integral is at its limit"),
    )

    @property
    def suffix(self) -> str:
        """The number format behind the controller's name."""
        return f" in fixed point, {self.fixed.number}"

    @property
    def numbers(self) -> str:
        """A sentence about the type of all numbers."""
        return "All numbers of a step are integers."

    @property
    def shifts(self) -> dict[str, int]:
        """Shifts of the integrals by their names."""
        rows = [row for section in self.fixed.sections for row in section.states]
        return {row.target: row.shift for row in rows if self.fixed.formats[row.target].role == "integral"}

    @property
    def state_names(self) -> dict[str, str]:
        """Identifiers of the states by their names."""
        names = Names(40)
        return {row.target: names[row.target] for section in self.fixed.sections for row in section.states}

    def fields(self) -> tuple[list[str], list[str], list[str]]:
        """Return the fields of inputs, outputs and states."""
        formats, s, shifts = self.fixed.formats, self.scheme, self.shifts
        inputs, outputs = ([self._field(name, "") for name in names] for names in (s.inputs, s.outputs))
        before = "the same before its limit"
        outputs += [field(self.fixed.wide(name), f"{self.signals[name]}_commanded", before) for name in s.outputs]
        states = [
            field("int64_t", identifier, f"2^{shifts[name]} times {formats[name].q}, saturating")
            if name in shifts
            else field(integer(formats[name].bits), identifier, formats[name].q)
            for name, identifier in self.state_names.items()
        ]
        return inputs, outputs, states or ["    int32_t none; /* not used */"]

    def _field(self, name: str, label: str) -> str:
        form = self.fixed.formats[name]
        unit = f" {form.unit}" if form.unit else ""
        meaning = f"{label}{form.q}: 1 is {form.bit:.17g}{unit}, within +-{form.largest}"
        return field(integer(form.bits), self.signals[name], meaning)

    def to_counts(self) -> Iterator[tuple[str, str, str, int, str]]:
        """Go through the functions from values to counts: name, type, counts per unit, largest count, as a literal."""
        for name in self.scheme.inputs:
            form, function = self.fixed.formats[name], f"{self.prefix}_count_{self.signals[name]}"
            yield function, integer(form.bits), _power(form.fraction), form.largest, literal(form.largest, form.bits)

    def to_values(self) -> Iterator[tuple[str, str, str]]:
        """Go through the functions from counts to values: name, type, unit per count."""
        for name in self.scheme.outputs:
            form, function = self.fixed.formats[name], f"{self.prefix}_value_{self.signals[name]}"
            yield function, integer(form.bits), _power(-form.fraction)
            yield f"{function}_commanded", self.fixed.wide(name), _power(-form.fraction)

    def details(self) -> list[str]:
        """Return the paragraphs of the head about signals, remarks and cost."""
        rows = [row for section in self.fixed.sections for row in (*section.signals, *section.states)]
        products = sum(len(row.products) for row in rows)
        formats = self.fixed.formats.values()
        return [
            *(line for paragraph in self.remarks for line in (paragraph, "")),
            "Scaling: value = count * bit. Qm.n: m digits before the point and n behind it, beside the sign; a "
            "negative m omits digits that are always zero. Signals and states without a unit are "
            "in the controller's, SI.",
            *(f"{what:<10}{_scaling(form)}" for role, what in _ROLES.items() for form in formats if form.role == role),
            "",
            *self.fixed.proof,
            "",
            f"A step takes {products} multiplications and {len(rows)} shifts at most, always in the same order; "
            f"{len(self.state_names)} states. No allocation, recursion, loop, global variable or library function. "
            "Pointers are not checked.",
        ]

    def step(self) -> Step:
        """Return the writer of the step."""
        return _IntegerStep(self)

    def job_field(self, name: str, output: bool) -> str:
        """Return the field of an input or output in the files of the whole job."""
        return self._field(name, f"{name}, ")

    def received(self, expression: str, sender: ControllerFiles, name: str) -> str:
        """Return the expression for an input in its own format: rounded, and saturated where the word ends."""
        assert isinstance(sender, IntegerFiles)
        form, fraction = self.fixed.formats[name], sender.fixed.formats[name].fraction
        if expression.startswith("in->") and fraction == form.fraction:
            return expression
        kind, more = integer(form.bits), form.fraction - fraction
        # The step limits the count to its range and reports that.
        most = 2 ** (form.bits - 1) - 1
        if more > 0:
            # Limited first: what is left can be multiplied.
            return f"({kind})(within({expression}, {literal(most >> more, 64)}) * {literal(1 << more, 64)})"
        if more < 0:
            expression = f"shifted64({expression} + {literal(1 << (-more - 1), 64)}, {-more}U)"
        return f"({kind})within({expression}, {literal(most, 64)})"


class _IntegerStep(Step):
    """The statements of a step in integers."""

    indent = " " * 4

    def __init__(self, unit: IntegerFiles) -> None:
        self.fixed, self.formats, self.shifts = unit.fixed, unit.fixed.formats, unit.shifts
        limited = [name for name in unit.scheme.outputs if self.formats[name].saturates]
        super().__init__(unit, unit.fixed.sections, limited, "within shifted32 shifted64")

    @property
    def shift_widths(self) -> list[int]:
        rows = [row for one in self.sections for row in one.signals if row.target in self.needed]
        rows += [row for one in self.sections for row in one.states]
        widths = {row.accumulator for row in rows if row.shift and row.target not in self.shifts}
        integrals = {64 for name, shift in self.shifts.items() if shift and name in self.sources}
        return sorted(widths | integrals)

    def start(self) -> Iterator[Paragraph]:
        lines = []
        for name in self.scheme.inputs:
            local = self.reads[name] = self.locals[name]
            lines.append(self._within(local, name, f"in->{self.unit.signals[name]}"))
        yield "Inputs within the ranges for which the bounds hold", lines
        lines = []
        for name, field_name in self.states.items():
            expression = self.reads[name] = f"state->{field_name}"
            if name in self.shifts and name in self.sources:
                local, shift = self.locals[name], self.shifts[name]
                if shift:
                    expression = f"shifted64({expression} + {literal((1 << shift) // 2, 64)}, {shift}U)"
                kind = integer(self.formats[name].bits)
                lines.append(f"{self.indent}const {kind} {local} = ({kind}){expression};")
                self.reads[name] = local
        if lines:
            yield "Integrals, as counts", lines

    def _within(self, local: str, name: str, expression: str) -> str:
        form = self.formats[name]
        kind, largest = integer(form.bits), literal(form.largest, 64)
        return f"{self.indent}const {kind} {local} = ({kind})within({expression}, {largest});"

    def statement(self, local: str, row: IntegerRow, section: str) -> str:
        bits, shift = row.accumulator, row.shift
        kind = self.fixed.wide(row.target) if row.target in self.limited else integer(self.formats[row.target].bits)
        parts = [self._product(product, row, section) for product in row.products] or [literal(0, bits)]
        head, tail = ("(", ")") if len(parts) > 1 or " " in parts[0] else ("", "")
        if shift:
            parts.append(literal((1 << shift) // 2, bits))
            head, tail = f"shifted{bits}(", f", {shift}U)"
        if row.keeps:
            # The sum has more digits than the state: it is made small enough by the shift, then added.
            head, tail = f"({self.reads[row.target]} + {head}", f"{tail})"
        return joined(f"{self.indent}const {kind} {local} = ({kind}){head}", parts, "+", f"{tail};")

    def next_state(self, local: str, row: IntegerRow, section: str) -> str:
        if row.target not in self.shifts:
            return self.statement(local, row, section)
        parts = [f"state->{self.states[row.target]}", *(self._product(one, row, section) for one in row.products)]
        end = literal(self.formats[row.target].largest << row.shift, 64)
        return joined(f"{self.indent}const int64_t {local} = within(", parts, "+", f", {end});")

    def limit(self, local: str, name: str) -> str:
        return self._within(local, name, self.reads[name])

    def excess(self, local: str, limited: str, name: str) -> str:
        over = f"(int64_t){limited} - {self.reads[name]}"
        if name in self.fixed.excess_limits:
            over = f"within({over}, {literal(self.fixed.excess_limits[name], 64)})"
        return f"{self.indent}const int64_t {local} = {over};"

    def _product(self, product: Product, row: IntegerRow, section: str) -> str:
        taken, kind = self.reads[product.source], integer(row.accumulator)
        if product.coefficient == 1:
            return f"({kind}){taken}"
        source = self.formats[product.source.removeprefix(excess_of(""))]
        meant = product.coefficient * 2.0 ** (source.fraction - self.formats[row.target].fraction - row.shift)
        meaning = f"{1.0 + meant:.9g} - 1" if row.keeps and product.source == row.target else f"{meant:.9g}"
        number = literal(product.coefficient, row.accumulator)
        return f"{self.constant(kind, number, row.target, product.source, section, f' /* {meaning} */')} * {taken}"

    @property
    def flags(self) -> list[tuple[str, list[str]]]:
        ends = []
        for name, shift in self.shifts.items():
            local, largest = self.locals["next", name], literal(self.formats[name].largest << shift, 64)
            ends += [f"({local} == {largest})", f"({local} == -{largest})"]
        return [
            ("LIMITED", [f"({self.locals['limited', name]} != {self.reads[name]})" for name in self.limited]),
            ("CLIPPED", [f"({self.locals[name]} != in->{self.unit.signals[name]})" for name in self.scheme.inputs]),
            ("STOPPED", ends),
        ]


def integer(bits: int) -> str:
    """Return the C type of so many bits."""
    return f"int{bits}_t"


def literal(number: int, bits: int) -> str:
    """Return an integer constant in C of so many bits."""
    return f"INT{bits}_C({number})" if bits != 16 else str(number)


def _scaling(form: Format) -> str:
    unit = f" {form.unit}" if form.unit else ""
    ends = "saturates at" if form.saturates else "at most"
    return comment(
        f"{form.name}  int{form.bits} {form.q}, bit {form.bit:.6g}{unit}, {ends} +-{form.range:.6g}{unit} "
        f"(+-{form.largest})"
    )


def _power(exponent: int) -> str:
    text = repr(2.0**exponent)
    return text if "." in text or "e" in text else f"{text}.0"
