"""A scheme as one header and one source file in C99 that also compile as C++."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np

from platform_ctrl.export.code.cost import Cost, cost_of
from platform_ctrl.export.code.identifiers import Names, comment
from platform_ctrl.export.code.scheme import Row, Scheme, Term
from platform_ctrl.frozen import value

Number = Literal["double", "float"]

_WIDTH = 100
_LARGEST = {"double": "DBL_MAX", "float": "FLT_MAX"}


@value
class Unit:
    """What the source files of a controller are made from.

    Attributes
    ----------
    scheme
        The controller.
    number
        Type of all numbers.
    prefix
        First part of all external names; the names of the files.
    signals
        Identifiers of inputs and outputs by their names.
    remarks
        Paragraphs for the head of the header: anti-windup, rounding.

    References
    ----------
    See docs/generated-code.md.
    """

    scheme: Scheme
    number: Number
    prefix: str
    signals: dict[str, str]
    remarks: tuple[str, ...] = ()


def literal(x: float, number: Number) -> str:
    """Return a number as a C constant that is read back as it is (a float: the nearest one).

    Parameters
    ----------
    x
        Finite; in its own unit.
    number
        Its type.

    Returns
    -------
    str
        With a point or an exponent, and the suffix of its type.

    Notes
    -----
    The arguments are not judged.

    References
    ----------
    ISO/IEC 9899:1999, 6.4.4.2.
    """
    text = repr(float(x)) if number == "double" else str(np.float32(x))
    text = text if "." in text or "e" in text else f"{text}.0"
    return text if number == "double" else f"{text}F"


def header(unit: Unit) -> str:
    """Return the text of the header file.

    Parameters
    ----------
    unit
        The controller.

    Returns
    -------
    str
        ASCII, ended by a newline.

    Notes
    -----
    The arguments are not judged.

    References
    ----------
    ISO/IEC 9899:1999.
    """
    s, p, kind = unit.scheme, unit.prefix, unit.number
    names = _state_names(unit)
    guard = f"{p.upper()}_H"
    inputs = [_field(kind, unit.signals[name], what) for name, what in zip(s.inputs, s.input_units, strict=True)]
    outputs, commanded = [], []
    for name, what, limit in zip(s.outputs, s.output_units, s.torque_limits, strict=True):
        bound = f"{what}, within +-{limit:.9g}: for the torquer" if np.isfinite(limit) else f"{what}, not limited"
        outputs.append(_field(kind, unit.signals[name], bound))
        commanded.append(_field(kind, f"{unit.signals[name]}_commanded", f"{what}, before the limit"))
    states = [f"    {kind} {names[name]};" for name in s.states]
    return "\n".join(
        [
            *_head(unit),
            f"#ifndef {guard}",
            f"#define {guard}",
            "",
            "#ifdef __cplusplus",
            'extern "C" {',
            "#endif",
            "",
            "/* What a step returns: the sum of what applies. */",
            f"#define {p.upper()}_OK 0U      /* as it should be */",
            f"#define {p.upper()}_LIMITED 1U /* an output is at its limit */",
            f"#define {p.upper()}_HELD 2U    /* an input or a result was not finite: all is as it was */",
            "",
            f"typedef struct {p}_in {{",
            *inputs,
            f"}} {p}_in;",
            "",
            f"typedef struct {p}_out {{",
            *outputs,
            *commanded,
            f"}} {p}_out;",
            "",
            f"typedef struct {p}_state {{",
            *states,
            f"    {p}_out last; /* what the last step gave */",
            f"}} {p}_state;",
            "",
            "/* All states and last outputs to zero. Call it before the first step. */",
            f"void {p}_reset({p}_state *state);",
            "",
            "/* One sample: from the inputs of this instant to the outputs; returns the status. */",
            f"unsigned int {p}_step({p}_state *state, const {p}_in *in, {p}_out *out);",
            "",
            "#ifdef __cplusplus",
            "}",
            "#endif",
            "",
            f"#endif /* {guard} */",
            "",
        ]
    )


def source(unit: Unit) -> str:
    """Return the text of the source file.

    Parameters
    ----------
    unit
        The controller.

    Returns
    -------
    str
        ASCII, ended by a newline.

    Notes
    -----
    The arguments are not judged.

    References
    ----------
    ISO/IEC 9899:1999.
    """
    return _Source(unit).text()


class _Source:
    """The source file, put together section by section."""

    def __init__(self, unit: Unit) -> None:
        self.unit, self.scheme, self.kind = unit, unit.scheme, unit.number
        self.states = _state_names(unit)
        # Locals and constants: apart from the fields of inputs, outputs and states, which stand behind an arrow.
        p = unit.prefix
        self.locals = Names(56, (p, f"{p}_step", f"{p}_reset", f"{p}_in", f"{p}_out", f"{p}_state"))
        self.constants: list[str] = []
        self.body: list[str] = []
        self.reads = {name: f"in->{unit.signals[name]}" for name in self.scheme.inputs}
        self.reads |= {name: f"state->{self.states[name]}" for name in self.scheme.states}

    def text(self) -> str:
        s, p = self.scheme, self.unit.prefix
        for number, section in enumerate(s.sections, 1):
            title = f"{number}. {section.name}: {section.note or section.kind}"
            self._blank(self.constants, title)
            self._blank(self.body, title, "        ")
            label = section.name
            for row in section.signals:
                target = self.locals[row.target]
                self.body += self._sum(target, row, label, "")
                self.reads[row.target] = target
            for row in section.states:
                self.body += self._sum(self._next(row.target), row, label, "")
            if not any(
                abs(term.coefficient) != 1.0 for row in (*section.signals, *section.states) for term in row.terms
            ):
                del self.constants[-2:]
        limited = [name for name, limit in zip(s.outputs, s.torque_limits, strict=True) if np.isfinite(limit)]
        if limited:
            self._limits()
        self._excess(limited)
        results = [self._next(name) for name in s.states] + [self.reads[name] for name in s.outputs]
        lines = [
            *_banner(self.unit),
            f'#include "{p}.h"',
            "",
            "#include <float.h>",
            "",
            "#ifdef __FAST_MATH__",
            '#error "numbers that are not finite could not be told from others: compile without -ffast-math"',
            "#endif",
            *self.constants,
            "",
            "/* Whether a number is finite: no comparison holds for one that is not a number. */",
            f"static int usable({self.kind} value)",
            "{",
            f"    return (value >= -{_LARGEST[self.kind]}) && (value <= {_LARGEST[self.kind]});",
            "}",
            "",
        ]
        if limited:
            lines += [
                "/* The value within +- the limit. */",
                f"static {self.kind} limited({self.kind} value, {self.kind} limit)",
                "{",
                f"    {self.kind} result = value;",
                "    if (value > limit) {",
                "        result = limit;",
                "    } else if (value < -limit) {",
                "        result = -limit;",
                "    } else {",
                "        result = value;",
                "    }",
                "    return result;",
                "}",
                "",
            ]
        zero = literal(0.0, self.kind)
        outputs = [self.unit.signals[name] for name in s.outputs]
        fields = [*outputs, *(f"{name}_commanded" for name in outputs)]
        lines += [
            f"void {p}_reset({p}_state *state)",
            "{",
            *(f"    state->{self.states[name]} = {zero};" for name in s.states),
            *(f"    state->last.{name} = {zero};" for name in fields),
            "}",
            "",
            f"unsigned int {p}_step({p}_state *state, const {p}_in *in, {p}_out *out)",
            "{",
            f"    unsigned int status = {p.upper()}_HELD;",
            "",
            *_condition([f"usable(in->{self.unit.signals[name]})" for name in s.inputs], "    "),
            *self.body,
            "",
            "        /* Taken over only where every result is finite. */",
            *_condition([f"usable({name})" for name in results], "        "),
            f"            status = {p.upper()}_OK;",
        ]
        for name in s.outputs:
            field, command = self.unit.signals[name], self.reads[name]
            given = self._limited(name) if name in limited else command
            lines += [
                f"            state->last.{field} = {given};",
                f"            state->last.{field}_commanded = {command};",
            ]
        lines += [f"            state->{self.states[name]} = {self._next(name)};" for name in s.states]
        for name in limited:
            # The limits are constants: a value that was cut off lies beyond one of them.
            command, bound = self.reads[name], self._limit(name)
            lines += [
                f"            if (({command} > {bound}) || ({command} < -{bound})) {{",
                f"                status = {p.upper()}_LIMITED;",
                "            }",
            ]
        lines += ["        }", "    }", "    *out = state->last;", "    return status;", "}", ""]
        return "\n".join(lines)

    def _blank(self, lines: list[str], title: str, indent: str = "") -> None:
        lines += ["", *_remark(title, indent)] if indent else ["", "\n".join(_remark(title, indent))]

    def _next(self, state: str) -> str:
        return self.locals[f"next {state}"]

    def _limited(self, output: str) -> str:
        return self.locals[f"limited {output}"]

    def _limit(self, output: str) -> str:
        return self.locals[f"limit {output}"]

    def _constant(self, x: float, name: str) -> str:
        label = self.locals.new(f"k {name}")
        self.constants.append(f"static const {self.kind} {label} = {literal(x, self.kind)};")
        return label

    def _sum(self, target: str, row: Row, label: str, first: str) -> list[str]:
        """Return the statement that makes `target` the sum of a row, a product a line."""
        parts = [self._product(term, row, label) for term in row.terms] or [("", literal(0.0, self.kind))]
        sign, text = parts[0]
        lines = [f"        const {self.kind} {target} = {first}{sign}{text}"]
        lines += [f"            {sign or '+'} {text}" for sign, text in parts[1:]]
        lines[-1] += ";"
        joined = " ".join(line.strip() if k else line for k, line in enumerate(lines))
        return [joined] if len(joined) <= _WIDTH else lines

    def _product(self, term: Term, row: Row, label: str) -> tuple[str, str]:
        taken = self.reads[term.source]
        if abs(term.coefficient) == 1.0:
            return ("-" if term.coefficient < 0.0 else "", taken)
        name = f"{label} {term.name}" if term.name else f"{row.target} from {term.source}"
        return "", f"{self._constant(term.coefficient, name)} * {taken}"

    def _limits(self) -> None:
        s = self.scheme
        self._blank(self.constants, "Limits of the torquers")
        self._blank(self.body, "Limits of the torquers", "        ")
        for name, what, limit in zip(s.outputs, s.output_units, s.torque_limits, strict=True):
            if np.isfinite(limit):
                bound = self._limit(name)
                self.constants.append(
                    f"static const {self.kind} {bound} = {literal(limit, self.kind)}; /* {comment(what)} */"
                )
                self.body.append(
                    f"        const {self.kind} {self._limited(name)} = limited({self.reads[name]}, {bound});"
                )

    def _excess(self, limited: Sequence[str]) -> None:
        """Add to the next states what the limits cut off; a state's next value becomes another name."""
        s = self.scheme
        rows = [
            Row(target=row.target, terms=tuple(term for term in row.terms if term.source in limited))
            for row in s.excess
        ]
        rows = [row for row in rows if row.terms]
        if not rows:
            return
        title = "Anti-windup: what the limits cut off goes back into the states"
        self._blank(self.constants, title)
        self._blank(self.body, title, "        ")
        for name in dict.fromkeys(term.source for row in rows for term in row.terms):
            over = self.locals[f"excess {name}"]
            self.body.append(f"        const {self.kind} {over} = {self._limited(name)} - {self.reads[name]};")
            self.reads[f"excess {name}"] = over
        for row in rows:
            before = self._next(row.target)
            target = self.locals[f"next {row.target} without windup"]
            terms = tuple(Term(coefficient=t.coefficient, source=f"excess {t.source}") for t in row.terms)
            back = Row(target=f"{row.target} back", terms=terms)
            self.body += self._sum(target, back, "", f"{before} + ")
            self.locals.rename(f"next {row.target}", f"next {row.target} without windup")


def _head(unit: Unit) -> list[str]:
    s = unit.scheme
    cost: Cost = cost_of(s)
    rate = 1.0 / s.period
    paragraphs = [
        f"{unit.prefix}.h: the controller {s.name!r}.",
        f"Generated by platform_ctrl; do not edit. Numbers are of type {unit.number}.",
        "",
        *_provenance(unit),
        "",
        f"Call {unit.prefix}_step once for every sample, {rate:.9g} Hz (every {s.period:.9g} s), with the readings "
        f"of that instant. {_acts(s.period, s.delay)}",
        "",
        "Signs: u = K y, with no hidden sign: an output is the torque on its gimbal (or root axis), positive about "
        "the axis in the plant file, as the angles are.",
        "",
        *(
            f"in:  {name} [{what}]" + ("" if unit.signals[name] == name else f", field {unit.signals[name]}")
            for name, what in zip(s.inputs, s.input_units, strict=True)
        ),
        *(
            f"out: {name} [{what}]"
            + ("" if unit.signals[name] == name else f", field {unit.signals[name]}")
            + (f", limited to +-{limit:.9g} {what}" if np.isfinite(limit) else ", not limited")
            for name, what, limit in zip(s.outputs, s.output_units, s.torque_limits, strict=True)
        ),
        "",
        *(line for remark in unit.remarks for line in (remark, "")),
        f"A step takes {cost.multiplications} multiplications, {cost.additions} additions and subtractions, and at "
        f"most {cost.comparisons} comparisons, always in the same order; {len(s.states)} states. No allocation, "
        "recursion, loop, global variable or library function.",
        "",
        "Inputs that are not finite, and states or commands that would not be: the step changes nothing, gives the "
        f"last outputs again and returns {unit.prefix.upper()}_HELD. Pointers are not checked.",
    ]
    return _block(paragraphs)


def _provenance(unit: Unit, whole: bool = False) -> list[str]:
    origin = unit.scheme.provenance
    design = f"{origin.design} (method {origin.method})" if origin.method else origin.design
    said = [
        ("Job", origin.job),
        ("Plant", origin.plant),
        ("Loop", "" if whole else origin.loop),
        ("Design", "" if whole else design),
        ("Controllers", f"sha256 {origin.sha256}" if origin.sha256 else ""),
        ("Versions", ", ".join(f"{name} {number}" for name, number in origin.versions.items())),
        ("Made by", origin.command),
    ]
    return [f"{name + ':':<12} {text}" for name, text in said if text]


def _acts(period: float, delay: float) -> str:
    if delay == 0.0:
        return "The outputs act at the instant of the sample and are held until the next ones act."
    share = delay / period
    when = f", {share:.6g} of a period" if abs(share - 1.0) > 1e-9 else ", with the next sample"
    return (
        f"The outputs act {delay:.9g} s after the sample{when}: not sooner, not later; they are held until the next "
        "ones act."
    )


def _banner(unit: Unit) -> list[str]:
    s = unit.scheme
    return _block([f"{unit.prefix}.c: the controller {s.name!r}. See {unit.prefix}.h. Generated; do not edit."])


def _block(paragraphs: Sequence[str]) -> list[str]:
    lines = ["/*"]
    for paragraph in paragraphs:
        text = comment(paragraph) if paragraph else ""
        # A label's column is kept.
        label, _, rest = paragraph.partition(":")
        if paragraph.startswith(label + ":") and rest[:2] == "  ":
            text = f"{comment(label)}:{' ' * (len(rest) - len(rest.lstrip()))}{comment(rest)}"
        lines += [f" * {line}".rstrip() for line in textwrap.wrap(text, _WIDTH - 3, subsequent_indent="  ") or [""]]
    return [*lines, " */"]


def _remark(text: str, indent: str) -> list[str]:
    lines = textwrap.wrap(comment(text), _WIDTH - len(indent) - 6)
    if len(lines) == 1:
        return [f"{indent}/* {lines[0]} */"]
    return [f"{indent}/* {lines[0]}", *(f"{indent} * {line}" for line in lines[1:-1]), f"{indent} * {lines[-1]} */"]


def _condition(tests: Sequence[str], indent: str) -> list[str]:
    """Return the head of an if statement that all tests have to pass, some of them a line."""
    if not tests:
        return [f"{indent}if (1) {{"]
    lines, line = [], f"{indent}if ("
    for k, test in enumerate(tests):
        part = (" && " if k else "") + test
        if len(line) + len(part) > _WIDTH - 4:
            lines.append(f"{line} &&")
            line = f"{indent}    {test}"
        else:
            line += part
    return [*lines, f"{line}) {{"]


def _field(kind: str, name: str, what: str) -> str:
    return f"    {kind} {name}; /* {comment(what)} */"


def _state_names(unit: Unit) -> Mapping[str, str]:
    names = Names(40, ("last",))
    return {name: names[name] for name in unit.scheme.states}
