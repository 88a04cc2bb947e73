"""The files of a controller in integers: C99 that also compiles as C++."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, cast

from platform_ctrl.common.values import value
from platform_ctrl.export.c99.controller_files import ControllerFiles, first_readers
from platform_ctrl.export.c99.file_layout import WIDTH, block, field, remark, signature
from platform_ctrl.export.c99.identifiers import Names
from platform_ctrl.export.fixed_point.c_expressions import (
    counted,
    format_lines,
    integer,
    literal,
    shifted,
    to_count,
    to_value,
    wide,
    within,
)
from platform_ctrl.export.fixed_point.splitting import excess_of
from platform_ctrl.export.fixed_point.values import FixedPoint, FixedSection, Format, IntegerRow, Product


@value
class IntegerFiles(ControllerFiles):
    """The files of a controller in integers."""

    fixed: FixedPoint  # The controller in integers

    readings: ClassVar = "counts"
    includes: ClassVar = ("<stdint.h>",)
    comments: ClassVar = (
        "All states to zero.",
        "One sample: from the counts of this instant to the counts of the outputs; returns the status.",
    )
    statuses: ClassVar = (
        ("CLIPPED", 4, "an input was out of its range and was saturated"),
        ("STOPPED", 8, "an integral is at its limit"),
    )
    job_order: ClassVar = (
        "In this order; an output of one, before its limit, may be an input of another within the same sample, rounded "
        "to the format of that input and saturated at its range:"
    )

    @property
    def numbers(self) -> str:
        """A sentence about the type of all numbers."""
        return "All numbers of a step are integers."

    @property
    def suffix(self) -> str:
        """The number format behind the controller's name."""
        return f" in fixed point, {self.fixed.number}"

    @property
    def state_names(self) -> dict[str, str]:
        """Identifiers of the states by their names."""
        names = Names(40)
        return {row.target: names[row.target] for section in self.fixed.sections for row in section.states}

    def fields(self) -> tuple[list[str], list[str], list[str]]:
        """Return the fields of inputs, outputs and states."""
        fixed, s, shifts = self.fixed, self.scheme, self.shifts
        inputs, outputs = ([self._field(name, "") for name in names] for names in (s.inputs, s.outputs))
        before = "the same before its limit"
        outputs += [field(wide(fixed, name), f"{self.signals[name]}_commanded", before) for name in s.outputs]
        states = []
        for name, identifier in self.state_names.items():
            form = fixed.formats[name]
            if name in shifts:
                states.append(field("int64_t", identifier, f"2^{shifts[name]} times {form.q}, saturating"))
            else:
                states.append(field(integer(form.bits), identifier, form.q))
        return inputs, outputs, states or ["    int32_t none; /* not used */"]

    def _field(self, name: str, label: str) -> str:
        form = self.fixed.formats[name]
        return field(integer(form.bits), self.signals[name], f"{label}{counted(form)}")

    def conversions(self) -> list[str]:
        """Return functions between counts and values."""
        lines = [
            "",
            "/*",
            " * Between counts and values, for tests and slow paths: the step does not use them.",
            " * Values out of range are saturated; NaN becomes zero.",
            " */",
        ]
        for name in self.scheme.inputs:
            lines += [*to_count(f"{self.prefix}_count_{self.signals[name]}", self.fixed.formats[name]), ""]
        for name in self.scheme.outputs:
            form, function = self.fixed.formats[name], f"{self.prefix}_value_{self.signals[name]}"
            lines += [*to_value(function, integer(form.bits), form), ""]
            lines += [*to_value(f"{function}_commanded", wide(self.fixed, name), form), ""]
        return lines[:-1]

    def details(self) -> list[str]:
        """Return the paragraphs of the head about signals, remarks and cost."""
        rows = [row for section in self.fixed.sections for row in (*section.signals, *section.states)]
        products = sum(len(row.products) for row in rows)
        return [
            *(line for paragraph in self.remarks for line in (paragraph, "")),
            *format_lines(self.fixed),
            "",
            *self.fixed.proof,
            "",
            f"A step takes {products} multiplications and {len(rows)} shifts at most, always in the same order; "
            f"{len(self.state_names)} states. No allocation, recursion, loop, global variable or library function. "
            "Pointers are not checked.",
        ]

    @property
    def shifts(self) -> dict[str, int]:
        """Shifts of the integrals by their names."""
        return {
            row.target: row.shift
            for section in self.fixed.sections
            for row in section.states
            if self.fixed.formats[row.target].role == "integral"
        }

    def source(self) -> str:
        """Return the text of the source file."""
        return _Source(self).text()

    def job_field(self, name: str, output: bool) -> str:
        """Return the field of an input or output in the files of the whole job."""
        return self._field(name, f"{name}, ")

    @classmethod
    def job_numbers(cls, units: Sequence[ControllerFiles]) -> tuple[str, str]:
        """Return a sentence about the numbers of all controllers together, and the last paragraphs of the head."""
        return "", "Formats and proofs are in these headers. No allocation, recursion, loop or global variable."

    @classmethod
    def wiring(cls, units: Sequence[ControllerFiles]) -> tuple[list[str], list[tuple[list[str], list[str]]]]:
        """Return helper functions, and the statements before and after the step of each controller."""
        readers = cast("dict[str, IntegerFiles]", first_readers(units))
        given = {name: (f"in->{u.signals[name]}", u.fixed.formats[name].fraction) for name, u in readers.items()}
        helpers: set[str] = set()
        wired = []
        for number, unit in enumerate(cast("Sequence[IntegerFiles]", units), 1):
            formats, before, after = unit.fixed.formats, [], []
            for name in unit.scheme.inputs:
                taken = _rescaled(*given[name], formats[name], helpers)
                before.append(f"    in_{number}.{unit.signals[name]} = {taken};")
            for name in unit.scheme.outputs:
                own = unit.signals[name]
                after.append(f"    out->{own} = out_{number}.{own};")
                given[name] = (f"out_{number}.{own}_commanded", formats[name].fraction)
            wired.append((before, after))
        return [*(shifted(64) if "shifted" in helpers else []), *(within() if "within" in helpers else [])], wired


class _Source:
    """The source file, put together section by section."""

    def __init__(self, unit: IntegerFiles) -> None:
        fixed, p = unit.fixed, unit.prefix
        self.fixed, self.scheme, self.formats = fixed, fixed.scheme, fixed.formats
        self.prefix, self.signals = p, unit.signals
        self.states, self.shifts = unit.state_names, unit.shifts
        own = (p, *(f"{p}_{end}" for end in ("step", "reset", "in", "out", "state")))
        self.locals = Names(56, (*own, "within", "shifted32", "shifted64"))
        self.constants: list[str] = []
        # Which product has which name: another one of the same name is named by target and source.
        self.owners: dict[tuple[str, ...], tuple[str, ...]] = {}
        self.reads: dict[str, str] = {}
        self.limited = [name for name in self.scheme.outputs if self.formats[name].saturates]
        self.needed = _needed(fixed)
        rows = [row for one in fixed.sections for row in one.signals if row.target in self.needed]
        rows += [row for one in fixed.sections for row in one.states]
        self.named = {
            (row.target, term.source): term.name
            for section in self.scheme.sections
            for row in (*section.signals, *section.states)
            for term in row.terms
        }
        # Sources of sums, and which excesses exist.
        self.sources = {product.source for row in rows for product in row.products}
        self.widths = {row.accumulator for row in rows if row.shift and row.target not in self.shifts}
        if any(shift and name in self.sources for name, shift in self.shifts.items()):
            self.widths.add(64)

    def text(self) -> str:
        p, s = self.prefix, self.scheme
        body = self._inputs() + self._integrals()
        # Constants of a section are written together; its states follow when all limits are known.
        constants: dict[int, list[str]] = {}
        for number, section in enumerate(self.fixed.sections, 1):
            self.constants = constants.setdefault(number, [])
            rows = [row for row in section.signals if row.target in self.needed]
            if rows:
                body += ["", *remark(f"{number}. {section.name}: {section.note or section.kind}", "    ")]
            for row in rows:
                body += self._signal(row, section)
        body += self._limits()
        for number, section in enumerate(self.fixed.sections, 1):
            self.constants = constants[number]
            body += self._next(number, section)
        body += self._stored()
        paragraphs = []
        for number, section in enumerate(self.fixed.sections, 1):
            if constants[number]:
                paragraphs += [
                    *remark(f"{number}. {section.name}: {section.note or section.kind}", ""),
                    *constants[number],
                    "",
                ]
        return "\n".join(
            [
                *block([f"{p}.c: the controller {s.name!r}. See {p}.h. Generated; do not edit."]),
                f'#include "{p}.h"',
                "",
                *paragraphs,
                *(line for bits in sorted(self.widths) for line in shifted(bits)),
                *within(),
                f"void {p}_reset({p}_state *state)",
                "{",
                *([f"    state->{name} = 0;" for name in self.states.values()] or ["    state->none = 0;"]),
                "}",
                "",
                *signature(p),
                "{",
                f"    unsigned int status = {p.upper()}_OK;",
                *body,
                "    return status;",
                "}",
                "",
            ]
        )

    def _inputs(self) -> list[str]:
        lines = ["", "    /* Inputs within the ranges for which the bounds hold */"]
        for name in self.scheme.inputs:
            form, local = self.formats[name], self.locals[name]
            kind = integer(form.bits)
            given = f"in->{self.signals[name]}"
            lines.append(f"    const {kind} {local} = ({kind})within({given}, {literal(form.largest, 64)});")
            self.reads[name] = local
        return lines

    def _integrals(self) -> list[str]:
        self.reads |= {name: f"state->{own}" for name, own in self.states.items() if name not in self.shifts}
        read = [name for name in self.shifts if name in self.sources]
        if not read:
            return []
        lines = ["", "    /* Integrals, as counts */"]
        for name in read:
            local, shift, own = self.locals[name], self.shifts[name], f"state->{self.states[name]}"
            kind = integer(self.formats[name].bits)
            half = (1 << shift) // 2
            taken = f"shifted64({own} + {literal(half, 64)}, {shift}U)" if shift else own
            lines.append(f"    const {kind} {local} = ({kind}){taken};")
            self.reads[name] = local
        return lines

    def _signal(self, row: IntegerRow, section: FixedSection) -> list[str]:
        local = self.locals[row.target]
        self.reads[row.target] = local
        form = self.formats[row.target]
        kind = wide(self.fixed, row.target) if row.target in self.limited else integer(form.bits)
        return self._statement(kind, local, row, section)

    def _limits(self) -> list[str]:
        if not self.limited:
            return []
        lines = ["", "    /* Limits of the torquers */"]
        for name in self.limited:
            local, form = self.locals["limited", name], self.formats[name]
            kind = integer(form.bits)
            lines.append(f"    const {kind} {local} = ({kind})within({self.reads[name]}, {literal(form.largest, 64)});")
        cut = [name for name in self.limited if excess_of(name) in self.sources]
        if cut:
            lines += ["", *remark("Anti-windup: the excess beyond the limits acts on the states", "    ")]
        for name in cut:
            local = self.locals[excess_of(name)]
            over = f"(int64_t){self.locals['limited', name]} - {self.reads[name]}"
            if name in self.fixed.excess_limits:
                over = f"within({over}, {literal(self.fixed.excess_limits[name], 64)})"
            lines.append(f"    const int64_t {local} = {over};")
            self.reads[excess_of(name)] = local
        return lines

    def _next(self, number: int, section: FixedSection) -> list[str]:
        if not section.states:
            return []
        lines = ["", *remark(f"{number}. {section.name}: next states", "    ")]
        for row in section.states:
            local = self.locals["next", row.target]
            if row.target in self.shifts:
                largest = self.formats[row.target].largest << row.shift
                first = f"state->{self.states[row.target]}"
                total = " + ".join([first, *(self._product(product, row, section) for product in row.products)])
                lines += _wrapped(f"    const int64_t {local} = within({total}, {literal(largest, 64)});")
            else:
                lines += self._statement(integer(self.formats[row.target].bits), local, row, section)
        return lines

    def _stored(self) -> list[str]:
        lines = [""]
        lines += [f"    state->{own} = {self.locals['next', name]};" for name, own in self.states.items()]
        if not self.states:
            lines.append("    state->none = 0;")
        upper = self.prefix.upper()
        clipped = [(self.locals[name], f"in->{self.signals[name]}") for name in self.scheme.inputs]
        cut = [(self.locals["limited", name], self.reads[name]) for name in self.limited]
        lines += self._flag([f"({a} != {b})" for a, b in cut], f"{upper}_LIMITED")
        lines += self._flag([f"({a} != {b})" for a, b in clipped], f"{upper}_CLIPPED")
        ends = []
        for name, shift in self.shifts.items():
            largest = literal(self.formats[name].largest << shift, 64)
            local = self.locals["next", name]
            ends += [f"({local} == {largest})", f"({local} == -{largest})"]
        lines += self._flag(ends, f"{upper}_STOPPED")
        for name in self.scheme.outputs:
            given = self.locals["limited", name] if name in self.limited else self.reads[name]
            lines.append(f"    out->{self.signals[name]} = {given};")
        return [
            *lines,
            *(f"    out->{self.signals[name]}_commanded = {self.reads[name]};" for name in self.scheme.outputs),
        ]

    def _flag(self, tests: list[str], flag: str) -> list[str]:
        if not tests:
            return []
        head = _wrapped(f"    if ({' || '.join(tests)}) {{", " || ")
        return [*head, f"        status += {flag};", "    }"]

    def _statement(self, kind: str, local: str, row: IntegerRow, section: FixedSection) -> list[str]:
        parts = [self._product(product, row, section) for product in row.products] or [literal(0, row.accumulator)]
        if row.shift:
            total = " + ".join([*parts, literal((1 << row.shift) // 2, row.accumulator)])
            text = f"shifted{row.accumulator}({total}, {row.shift}U)"
        else:
            text = " + ".join(parts)
            text = f"({text})" if len(parts) > 1 or " " in text else text
        if row.keeps:
            # The sum has more digits than the state: it is made small enough by the shift, then added.
            text = f"({self.reads[row.target]} + {text})"
        return _wrapped(f"    const {kind} {local} = ({kind}){text};")

    def _product(self, product: Product, row: IntegerRow, section: FixedSection) -> str:
        taken, kind = self.reads[product.source], integer(row.accumulator)
        if product.coefficient == 1:
            return f"({kind}){taken}"
        name = self.named.get((row.target, product.source), "")
        plain = ("k", row.target, "from", product.source)
        own = ("k", section.name, name)
        key = own if name and self.owners.setdefault(own, plain) == plain else plain
        label = self.locals[key]
        number = literal(product.coefficient, row.accumulator)
        meant = product.coefficient * 2.0 ** (self._fraction(product.source) - self._fraction(row.target) - row.shift)
        paragraphs = f"{1.0 + meant:.9g} - 1" if row.keeps and product.source == row.target else f"{meant:.9g}"
        self.constants.append(f"static const {kind} {label} = {number}; /* {paragraphs} */")
        return f"{label} * {taken}"

    def _fraction(self, name: str) -> int:
        return self.formats[name.removeprefix(excess_of(""))].fraction


def _wrapped(statement: str, between: str = " + ") -> list[str]:
    """Return a statement on several lines where it is too long for one."""
    if len(statement) <= WIDTH:
        return [statement]
    parts = statement.split(between)
    sign = between.strip()
    return [parts[0], *(f"        {sign} {part}" for part in parts[1:])]


def _needed(fixed: FixedPoint) -> set[str]:
    """Return what outputs and states come from: a signal that nothing reads is not computed."""
    out = set(fixed.scheme.outputs)
    out |= {product.source for section in fixed.sections for row in section.states for product in row.products}
    for section in reversed(fixed.sections):
        for row in reversed(section.signals):
            if row.target in out:
                out |= {product.source for product in row.products}
    return out


def _rescaled(taken: str, fraction: int, form: Format, helpers: set[str]) -> str:
    """Return an expression for a count of another format: rounded, and cut off where the word ends."""
    if taken.startswith("in->") and fraction == form.fraction:
        return taken
    helpers.add("within")
    kind, more = integer(form.bits), form.fraction - fraction
    # The step limits the count to its range and reports that.
    most = 2 ** (form.bits - 1) - 1
    largest = literal(most, 64)
    if more < 0:
        helpers.add("shifted")
        half = literal(1 << (-more - 1), 64)
        return f"({kind})within(shifted64({taken} + {half}, {-more}U), {largest})"
    if more == 0:
        return f"({kind})within({taken}, {largest})"
    # Cut off first: what is left can be multiplied.
    least = literal(most >> more, 64)
    return f"({kind})(within({taken}, {least}) * {literal(1 << more, 64)})"
