"""A controller in integers as one header and one source file in C99 that also compile as C++."""

from __future__ import annotations

from platform_ctrl.common.values import value
from platform_ctrl.export.c99.file_layout import (
    WIDTH,
    acts,
    block,
    declared,
    field,
    header_file,
    provenance,
    remark,
    signature,
    struct,
)
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
from platform_ctrl.export.fixed_point.values import FixedPoint, FixedSection, IntegerRow, Product


@value
class Unit:
    """What the source files of a controller in integers are made from.

    Attributes
    ----------
    fixed
        The controller in integers.
    prefix
        First part of all external names; the names of the files.
    signals
        Identifiers of inputs and outputs by their names.
    remarks
        Paragraphs for the head of the header: anti-windup.
    """

    fixed: FixedPoint
    prefix: str
    signals: dict[str, str]
    remarks: tuple[str, ...] = ()


def header(unit: Unit) -> str:
    """Return the text of the header file."""
    fixed, signals = unit.fixed, unit.signals
    p, s, upper = unit.prefix, fixed.scheme, unit.prefix.upper()
    states = _state_names(fixed)
    shifts = _shifts(fixed)
    inputs = [field(integer(fixed.formats[k].bits), signals[k], counted(fixed.formats[k])) for k in s.inputs]
    outputs = [field(integer(fixed.formats[k].bits), signals[k], counted(fixed.formats[k])) for k in s.outputs]
    outputs += [field(wide(fixed, k), f"{signals[k]}_commanded", "the same before its limit") for k in s.outputs]
    kept = []
    for name, identifier in states.items():
        form = fixed.formats[name]
        if name in shifts:
            kept.append(field("int64_t", identifier, f"2^{shifts[name]} times {form.q}, saturating"))
        else:
            kept.append(field(integer(form.bits), identifier, form.q))
    body = [
        "/* What a step returns: the sum of what applies. */",
        f"#define {upper}_OK 0U      /* as it should be */",
        f"#define {upper}_LIMITED 1U /* an output is at its limit */",
        f"#define {upper}_CLIPPED 4U /* an input was out of its range and has been cut off */",
        f"#define {upper}_STOPPED 8U /* an integral is at its end */",
        "",
        *struct(f"{p}_in", inputs),
        *struct(f"{p}_out", outputs),
        *struct(f"{p}_state", kept or ["    int32_t none; /* not used */"]),
        *declared(
            p,
            "All states to zero.",
            "One sample: from the counts of this instant to the counts of the outputs; returns the status.",
        ),
        "",
        "/*",
        " * Between counts and values, for tests and slow paths: the step does not use them.",
        " * Out of range is cut off; what is not a number counts as zero.",
        " */",
    ]
    for name in s.inputs:
        body += [*to_count(f"{p}_count_{signals[name]}", fixed.formats[name]), ""]
    for name in s.outputs:
        form = fixed.formats[name]
        body += [*to_value(f"{p}_value_{signals[name]}", integer(form.bits), form), ""]
        body += [*to_value(f"{p}_value_{signals[name]}_commanded", wide(fixed, name), form), ""]
    return header_file(p, _head(unit), ["<stdint.h>"], body[:-1])


def source(unit: Unit) -> str:
    """Return the text of the source file."""
    return _Source(unit).text()


class _Source:
    """The source file, put together section by section."""

    def __init__(self, unit: Unit) -> None:
        fixed, p = unit.fixed, unit.prefix
        self.fixed, self.scheme, self.formats = fixed, fixed.scheme, fixed.formats
        self.prefix, self.signals = p, unit.signals
        self.states, self.shifts = _state_names(fixed), _shifts(fixed)
        own = (p, *(f"{p}_{end}" for end in ("step", "reset", "in", "out", "state")))
        self.locals = Names(56, (*own, "within", "shifted32", "shifted64"))
        self.constants: list[str] = []
        # Which product a name of its own belongs to: another one of that name is named by its ends.
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
        # What a sum takes in, and which excesses are there at all.
        self.sources = {product.source for row in rows for product in row.products}
        self.widths = {row.accumulator for row in rows if row.shift and row.target not in self.shifts}
        if any(shift and name in self.sources for name, shift in self.shifts.items()):
            self.widths.add(64)

    def text(self) -> str:
        p, s = self.prefix, self.scheme
        body = self._inputs() + self._integrals()
        # Constants of a section stand together; its states follow when all limits are known.
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
        told = []
        for number, section in enumerate(self.fixed.sections, 1):
            if constants[number]:
                told += [
                    *remark(f"{number}. {section.name}: {section.note or section.kind}", ""),
                    *constants[number],
                    "",
                ]
        return "\n".join(
            [
                *block([f"{p}.c: the controller {s.name!r}. See {p}.h. Generated; do not edit."]),
                f'#include "{p}.h"',
                "",
                *told,
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
            lines += ["", *remark("Anti-windup: what the limits cut off goes back into the states", "    ")]
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
        told = f"{1.0 + meant:.9g} - 1" if row.keeps and product.source == row.target else f"{meant:.9g}"
        self.constants.append(f"static const {kind} {label} = {number}; /* {told} */")
        return f"{label} * {taken}"

    def _fraction(self, name: str) -> int:
        return self.formats[name.removeprefix(excess_of(""))].fraction


def _head(unit: Unit) -> list[str]:
    fixed, prefix = unit.fixed, unit.prefix
    s = fixed.scheme
    rows = [row for section in fixed.sections for row in (*section.signals, *section.states)]
    products = sum(len(row.products) for row in rows)
    return block(
        [
            f"{prefix}.h: the controller {s.name!r} in fixed point, {fixed.number}.",
            "Generated by platform_ctrl; do not edit. All numbers of a step are integers.",
            "",
            *provenance(s.provenance),
            "",
            f"Call {prefix}_step once for every sample, {1.0 / s.period:.9g} Hz (every {s.period:.9g} s), with the "
            f"counts of that instant. {acts(s.period, s.delay)}",
            "",
            "Signs: u = K y, with no hidden sign: an output is the torque on its gimbal (or root axis), positive about "
            "the axis in the plant file, as the angles are.",
            "",
            *(line for paragraph in unit.remarks for line in (paragraph, "")),
            *format_lines(fixed),
            "",
            *fixed.proof,
            "",
            f"A step takes {products} multiplications and {len(rows)} shifts at most, always in the same order; "
            f"{len(_state_names(fixed))} states. No allocation, recursion, loop, global variable or library function. "
            "Pointers are not checked.",
        ]
    )


def _wrapped(statement: str, between: str = " + ") -> list[str]:
    """Return a statement on several lines where it is too long for one."""
    if len(statement) <= WIDTH:
        return [statement]
    parts = statement.split(between)
    sign = between.strip()
    return [parts[0], *(f"        {sign} {part}" for part in parts[1:])]


def _state_names(fixed: FixedPoint) -> dict[str, str]:
    names = Names(40)
    return {row.target: names[row.target] for section in fixed.sections for row in section.states}


def _needed(fixed: FixedPoint) -> set[str]:
    """Return what outputs and states come from: a signal that nothing reads is not computed."""
    out = set(fixed.scheme.outputs)
    out |= {product.source for section in fixed.sections for row in section.states for product in row.products}
    for section in reversed(fixed.sections):
        for row in reversed(section.signals):
            if row.target in out:
                out |= {product.source for product in row.products}
    return out


def _shifts(fixed: FixedPoint) -> dict[str, int]:
    """Return the shifts of the integrals."""
    return {
        row.target: row.shift
        for section in fixed.sections
        for row in section.states
        if fixed.formats[row.target].role == "integral"
    }
