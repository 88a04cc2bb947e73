"""The files of a controller in floating point: C99 that also compiles as C++."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, Literal

import numpy as np

from platform_ctrl.common.values import value
from platform_ctrl.export.c99.controller_files import ControllerFiles
from platform_ctrl.export.c99.file_layout import WIDTH, block, field, remark, signature
from platform_ctrl.export.c99.identifiers import Names, comment
from platform_ctrl.export.c99.scheme import Row, Scheme, Section, Term, acting_excess


@value
class Cost:
    """Operations of one step."""

    # multiplications, additions, comparisons: Counts; subtractions count as additions, comparisons are the most that
    # there can be
    multiplications: int
    additions: int
    comparisons: int


def cost_of(scheme: Scheme) -> Cost:
    """Return what a step of a scheme costs, limits and anti-windup included."""
    rows = [row for section in scheme.sections for row in (*section.signals, *section.states)]
    limited = int(np.isfinite(scheme.torque_limits).sum())
    back = acting_excess(scheme)
    cut = {term.source for row in back for term in row.terms}
    return Cost(
        multiplications=sum(abs(term.coefficient) != 1.0 for row in (*rows, *back) for term in row.terms),
        additions=sum(max(len(row.terms) - 1, 0) for row in rows) + sum(len(row.terms) for row in back) + len(cut),
        # Two for each number that has to be finite; two to limit and two for the status.
        comparisons=2 * (len(scheme.inputs) + len(scheme.states) + len(scheme.outputs)) + 4 * limited,
    )


Number = Literal["double", "float"]

# Indentation inside the step's condition.
_INNER = " " * 8
_LARGEST = {"double": "DBL_MAX", "float": "FLT_MAX"}


def literal(x: float, number: Number) -> str:
    """Return a number as a C constant that is read back as it is (a float: the nearest one)."""
    text = repr(float(x)) if number == "double" else str(np.float32(x))
    text = text if "." in text or "e" in text else f"{text}.0"
    return text if number == "double" else f"{text}F"


@value
class FloatingFiles(ControllerFiles):
    """The files of a controller in double or single precision."""

    number: Number  # Type of all numbers

    comments: ClassVar = (
        "All states and last outputs to zero.",
        "One sample: from the inputs of this instant to the outputs; returns the status.",
    )
    statuses: ClassVar = (("NOT_FINITE", 2, "an input or a result was not finite: nothing is changed"),)

    @property
    def numbers(self) -> str:
        """A sentence about the type of all numbers."""
        return f"Numbers are of type {self.number}."

    def fields(self) -> tuple[list[str], list[str], list[str]]:
        """Return the fields of inputs, outputs and states."""
        s, kind = self.scheme, self.number
        inputs = [field(kind, self.signals[name], what) for name, what in zip(s.inputs, s.input_units, strict=True)]
        outputs = [self._output(name, ": for the torquer") for name in s.outputs]
        outputs += [
            field(kind, f"{self.signals[name]}_commanded", f"{what}, before the limit")
            for name, what in zip(s.outputs, s.output_units, strict=True)
        ]
        names = self.state_names
        states = [
            field(kind, names[row.target], f"{number}. {section.name}")
            for number, section in enumerate(s.sections, 1)
            for row in section.states
        ]
        return inputs, outputs, [*states, f"    {self.prefix}_out last; /* outputs of the last step */"]

    def _output(self, name: str, purpose: str = "") -> str:
        k = self.scheme.outputs.index(name)
        what, limit = self.scheme.output_units[k], self.scheme.torque_limits[k]
        bound = f"{what}, within +-{limit:.9g}{purpose}" if np.isfinite(limit) else f"{what}, not limited"
        return field(self.number, self.signals[name], bound)

    def details(self) -> list[str]:
        """Return the paragraphs of the head about signals, remarks and cost."""
        s, cost = self.scheme, cost_of(self.scheme)
        limits = [
            f"limited to +-{x:.9g} {what}" if np.isfinite(x) else "not limited"
            for x, what in zip(s.torque_limits, s.output_units, strict=True)
        ]
        return [
            *(f"in:  {self._named(name, what)}" for name, what in zip(s.inputs, s.input_units, strict=True)),
            *(
                f"out: {self._named(name, what)}, {limit}"
                for name, what, limit in zip(s.outputs, s.output_units, limits, strict=True)
            ),
            "",
            *(line for paragraph in self.remarks for line in (paragraph, "")),
            f"A step takes {cost.multiplications} multiplications, {cost.additions} additions and subtractions, and at "
            f"most {cost.comparisons} comparisons, always in the same order; {len(s.states)} states. No allocation, "
            "recursion, loop, global variable or library function.",
            "",
            "Inputs that are not finite, and states or commands that would not be: the step changes nothing, repeats "
            f"the last outputs and returns {self.prefix.upper()}_NOT_FINITE. Pointers are not checked.",
        ]

    def _named(self, name: str, what: str) -> str:
        return f"{name} [{what}]" + ("" if self.signals[name] == name else f", field {self.signals[name]}")

    def source(self) -> str:
        """Return the text of the source file."""
        return _Source(self).text()

    def job_field(self, name: str, output: bool) -> str:
        """Return the field of an input or output in the files of the whole job."""
        if output:
            return self._output(name)
        return field(self.number, self.signals[name], self.scheme.input_units[self.scheme.inputs.index(name)])

    @classmethod
    def job_numbers(cls, units: Sequence[ControllerFiles]) -> tuple[str, str]:
        """Return a sentence about the numbers of all controllers together, and the last paragraphs of the head."""
        costs = [cost_of(unit.scheme) for unit in units]
        return units[0].numbers, (
            "Signs, limits, anti-windup, and inputs that are not finite: see these headers.\n\n"
            f"A step takes {sum(c.multiplications for c in costs)} multiplications, "
            f"{sum(c.additions for c in costs)} additions and subtractions, and at most "
            f"{sum(c.comparisons for c in costs)} comparisons. No allocation, recursion, loop or global variable."
        )

    @classmethod
    def wiring(cls, units: Sequence[ControllerFiles]) -> tuple[list[str], list[tuple[list[str], list[str]]]]:
        """Return helper functions, and the statements before and after the step of each controller."""
        made: dict[str, str] = {}
        wired = []
        for number, unit in enumerate(units, 1):
            taken = {unit.signals[name]: made.get(name, f"in->{unit.signals[name]}") for name in unit.scheme.inputs}
            given = [unit.signals[name] for name in unit.scheme.outputs]
            made |= {name: f"out_{number}.{unit.signals[name]}_commanded" for name in unit.scheme.outputs}
            before = [f"    in_{number}.{own} = {value};" for own, value in taken.items()]
            wired.append((before, [f"    out->{own} = out_{number}.{own};" for own in given]))
        return [], wired


class _Source:
    """The source file, put together section by section."""

    def __init__(self, unit: FloatingFiles) -> None:
        self.unit, self.scheme, self.kind = unit, unit.scheme, unit.number
        self.states = unit.state_names
        # Locals and constants: apart from the fields of inputs, outputs and states, which are read through a pointer.
        p = unit.prefix
        self.locals = Names(
            56, (p, f"{p}_step", f"{p}_reset", f"{p}_in", f"{p}_out", f"{p}_state", f"{p}_usable", f"{p}_limited")
        )
        self.body: list[str] = []
        self.reads = {name: f"in->{unit.signals[name]}" for name in self.scheme.inputs}
        self.reads |= {name: f"state->{self.states[name]}" for name in self.scheme.states}
        limits = zip(self.scheme.outputs, self.scheme.torque_limits, strict=True)
        self.limits = {name: limit for name, limit in limits if np.isfinite(limit)}

    def text(self) -> str:
        for number, section in enumerate(self.scheme.sections, 1):
            self._paragraph(f"{number}. {section.name}: {section.note or section.kind}", *self._section(section))
        if self.limits:
            self._paragraph("Limits of the torquers", *self._limited())
            excess = self._excess()
            if excess[1]:
                self._paragraph("Anti-windup: the excess beyond the limits acts on the states", *excess)
        return "\n".join([*self._beginning(), *self._reset(), *self._step()])

    def _paragraph(self, title: str, constants: list[str], statements: list[str]) -> None:
        """Add what belongs together to the body: its constants, which nothing else uses, and its statements."""
        self.body += ["", *remark(title, _INNER), *constants, *statements]

    def _section(self, section: Section) -> tuple[list[str], list[str]]:
        constants: list[str] = []
        statements: list[str] = []
        for row in section.signals:
            target = self.locals[row.target]
            statements += self._sum(target, row, section.name, constants)
            self.reads[row.target] = target
        for row in section.states:
            statements += self._sum(self._next(row.target), row, section.name, constants)
        return constants, statements

    def _limited(self) -> tuple[list[str], list[str]]:
        constants, statements = [], []
        for name, what in zip(self.scheme.outputs, self.scheme.output_units, strict=True):
            if name in self.limits:
                bound = self.locals["limit", name]
                number = literal(self.limits[name], self.kind)
                constants.append(f"{_INNER}static const {self.kind} {bound} = {number}; /* {comment(what)} */")
                cut = f"{self.unit.prefix}_limited({self.reads[name]}, {bound})"
                statements.append(f"{_INNER}const {self.kind} {self.locals['limited', name]} = {cut};")
        return constants, statements

    def _excess(self) -> tuple[list[str], list[str]]:
        """Add to the next states what the limits cut off; a state's next value gets another name."""
        constants: list[str] = []
        statements: list[str] = []
        rows = acting_excess(self.scheme)
        for name in dict.fromkeys(term.source for row in rows for term in row.terms):
            over = self.reads[f"excess\n{name}"] = self.locals["excess", name]
            cut = self.locals["limited", name]
            statements.append(f"{_INNER}const {self.kind} {over} = {cut} - {self.reads[name]};")
        for row in rows:
            terms = tuple(Term(coefficient=t.coefficient, source=f"excess\n{t.source}") for t in row.terms)
            back = Row(target=row.target, terms=terms)
            before, after = self._next(row.target), ("unwound", row.target)
            statements += self._sum(self.locals[after], back, "", constants, before)
            self.locals.rename(("next", row.target), after)
        return constants, statements

    def _next(self, state: str) -> str:
        return self.locals["next", state]

    def _sum(self, target: str, row: Row, label: str, constants: list[str], first: str = "") -> list[str]:
        """Return the statement that makes `target` the sum of a row, on one line or a product a line."""
        parts = [("", first)] if first else []
        alone = len(row.terms) == 1 and not first
        parts += [self._product(term, row, label, constants, alone) for term in row.terms]
        parts = parts or [("", literal(0.0, self.kind))]
        sign, text = parts[0]
        lines = [f"{_INNER}const {self.kind} {target} = {sign}{text}"]
        lines += [f"{_INNER}    {sign or '+'} {text}" for sign, text in parts[1:]]
        lines[-1] += ";"
        joined = " ".join(line.strip() if k else line for k, line in enumerate(lines))
        return [joined] if len(joined) <= WIDTH else lines

    def _product(self, term: Term, row: Row, label: str, constants: list[str], alone: bool) -> tuple[str, str]:
        """Return the sign and the text of a product; its coefficient becomes a constant with a name."""
        taken = self.reads[term.source]
        if abs(term.coefficient) == 1.0:
            return "-" if term.coefficient < 0.0 else "", taken
        name = f"{label} {term.name}" if term.name else f"{row.target} from {term.source}"
        constant = self.locals.new(f"k {name}")
        constants.append(f"{_INNER}static const {self.kind} {constant} = {literal(term.coefficient, self.kind)};")
        product = f"{constant} * {taken}"
        return "", product if alone else f"({product})"

    def _beginning(self) -> list[str]:
        lines = [
            *block(
                [
                    f"{self.unit.prefix}.c: the controller {self.scheme.name!r}. See {self.unit.prefix}.h. "
                    "Generated; do not edit."
                ]
            ),
            f'#include "{self.unit.prefix}.h"',
            "",
            "#include <float.h>",
            "",
            "#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && (__FINITE_MATH_ONLY__ > 0))",
            '#error "numbers that are not finite cannot be detected: compile without -ffast-math"',
            "#endif",
            "",
            "/* Whether a number is finite: no comparison holds for one that is not a number. */",
            f"static int {self.unit.prefix}_usable({self.kind} value)",
            "{",
            f"    return (value >= -{_LARGEST[self.kind]}) && (value <= {_LARGEST[self.kind]});",
            "}",
            "",
        ]
        if self.limits:
            lines += [
                "/* The value within +- the limit. */",
                f"static {self.kind} {self.unit.prefix}_limited({self.kind} value, {self.kind} limit)",
                "{",
                f"    {self.kind} result = value;",
                "    if (value > limit) {",
                "        result = limit;",
                "    } else if (value < -limit) {",
                "        result = -limit;",
                "    } else {",
                "        /* within the limit */",
                "    }",
                "    return result;",
                "}",
                "",
            ]
        return lines

    def _reset(self) -> list[str]:
        p, zero = self.unit.prefix, literal(0.0, self.kind)
        outputs = [self.unit.signals[name] for name in self.scheme.outputs]
        fields = [*outputs, *(f"{name}_commanded" for name in outputs)]
        return [
            f"void {p}_reset({p}_state *state)",
            "{",
            *(f"    state->{self.states[name]} = {zero};" for name in self.scheme.states),
            *(f"    state->last.{name} = {zero};" for name in fields),
            "}",
            "",
        ]

    def _step(self) -> list[str]:
        s, p = self.scheme, self.unit.prefix
        results = [self._next(name) for name in s.states] + [self.reads[name] for name in s.outputs]
        lines = [
            *signature(p),
            "{",
            f"    unsigned int status = {p.upper()}_NOT_FINITE;",
            "",
            *_condition([f"{p}_usable(in->{self.unit.signals[name]})" for name in s.inputs], "    "),
            # No empty line behind the brace.
            *self.body[1:],
            "",
            f"{_INNER}/* Stored only if every result is finite. */",
            *_condition([f"{p}_usable({name})" for name in results], _INNER),
            f"{_INNER}    status = {p.upper()}_OK;",
        ]
        for name in s.outputs:
            last, command = f"{_INNER}    state->last.{self.unit.signals[name]}", self.reads[name]
            given = self.locals["limited", name] if name in self.limits else command
            lines += [f"{last} = {given};", f"{last}_commanded = {command};"]
        lines += [f"{_INNER}    state->{self.states[name]} = {self._next(name)};" for name in s.states]
        for name in self.limits:
            command, bound = self.reads[name], self.locals["limit", name]
            lines += [
                f"{_INNER}    if (({command} > {bound}) || ({command} < -{bound})) {{",
                f"{_INNER}        status = {p.upper()}_LIMITED;",
                f"{_INNER}    }}",
            ]
        return [*lines, f"{_INNER}}}", "    }", "    *out = state->last;", "    return status;", "}", ""]


def _condition(tests: Sequence[str], indent: str) -> list[str]:
    """Return the head of an if statement that all tests have to pass, some of them a line."""
    lines, line = [], f"{indent}if ("
    for k, test in enumerate(tests):
        part = (" && " if k else "") + test
        if len(line) + len(part) > WIDTH - 4:
            lines.append(f"{line} &&")
            line = f"{indent}    {test}"
        else:
            line += part
    return [*lines, f"{line}) {{"]
