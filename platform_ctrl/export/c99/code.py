"""A controller as C99 that also compiles as C++: its sections in their order, and the text of its two files.

A step takes the inputs of one sample and gives the outputs of that sample:

    for every section:   signals = C x + D (inputs and earlier signals)
    then:                x⁺ = A x + B (inputs and signals of this step)
    and where a limit cut an output off:   x⁺ += E (limited − commanded)

Sections are those of result.json. A controller without them is one section: its matrices.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np

from platform_ctrl.analysis.system import StateSpace, System
from platform_ctrl.common.arguments import short
from platform_ctrl.common.files import plain_types
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.sections import Section, flattened
from platform_ctrl.errors import ArgumentError
from platform_ctrl.export.c99.c_text import Identifiers, comment, field, joined, rendered
from platform_ctrl.job.job import Job
from platform_ctrl.plant.fields import TEXT, Expected, where
from platform_ctrl.verification.controllers import read_controllers
from platform_ctrl.verification.result_file import SCHEMA, JSONTable, controller_record

# How far what sections multiply out to may be from the matrices of the controller: rounding of a few operations.
_SAME = 1e-11
_NOTE = Expected("a note", where(lambda note: isinstance(note, str) and note.isprintable(), lambda note: note))


@value
class WrittenController:
    """A sampled controller u = K y, written out."""

    # name, design, method: Of the loop and its design, as in the job file; design and method may be empty
    name: str
    design: str
    method: str
    arrays: System  # x⁺ = A x + B y, u = C x + D y; its states are those of the sections
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    sections: tuple[Section, ...]  # In the order in which they are evaluated
    limits: FloatArray  # (outputs,): Largest magnitude of each output, in its unit; inf where there is none
    delay: float  # From the sample to the instant at which its outputs act, s
    note: str = ""  # Why sections of the file are not used; or empty

    @property
    def states(self) -> tuple[str, ...]:
        """Names of all states, in the order of the sections."""
        return tuple(name for section in self.sections for name in section.states)


def controllers_of(job: Job, entries: Sequence[Mapping[str, Any] | StateSpace]) -> tuple[WrittenController, ...]:
    """Return the controllers of a job, checked against it, in order of evaluation.

    Each entry is one of ``controllers`` in ``result.json``, or a `control.StateSpace` with ``dt`` and signal names.
    """
    if isinstance(entries, Mapping | str) or not isinstance(entries, Sequence):
        raise ArgumentError(f"entries: must be a list of controllers, got {short(entries)}")
    records: list[Mapping[str, Any]] = []
    for one in entries:
        if isinstance(one, Mapping):
            records.append(one)
            continue
        loop, _, design = str(one.name).partition(", ")
        records.append(plain_types({"name": loop, "design": design, **controller_record(one, job)}))
    checked = read_controllers({"schema": SCHEMA, "controllers": records}, job)
    limits = {t.name: np.inf if t.limit is None else float(t.limit) for t in job.platform.torquers}
    out = []
    for record, K in zip(records, checked, strict=True):
        arrays = System.of(K, "controller")
        inputs, outputs = tuple(map(str, K.input_labels)), tuple(map(str, K.output_labels))
        sections, note = _sections(record, arrays, inputs, outputs)
        out.append(
            WrittenController(
                name=str(record["name"]),
                design=_text(record, "design"),
                method=_text(record, "method"),
                arrays=arrays,
                inputs=inputs,
                outputs=outputs,
                sections=sections,
                # A command to another loop has no limit.
                limits=np.array([limits.get(name, np.inf) for name in outputs]),
                delay=job.sampling.delay,
                note=note,
            )
        )
    return tuple(out)


def _sections(
    record: Mapping[str, Any], K: System, inputs: tuple[str, ...], outputs: tuple[str, ...]
) -> tuple[tuple[Section, ...], str]:
    """Return the sections of a controller, or its matrices as one, and why."""
    whole = Section("states", "states", "state equations of the controller", K, inputs, outputs)
    if not record.get("sections"):
        return (whole,), ""
    table = JSONTable(f"controller {record['name']!r}", record)
    known, found = set(inputs), list[Section]()
    for one in table.tables("sections", "sections"):
        name, taken, given = one.value("name", TEXT), one.names("inputs"), one.names("outputs")
        for signal in taken:
            if signal not in known:
                raise one.mistake(f"inputs: {signal!r} is neither an input nor an output of a section before it")
        if not known.isdisjoint(given) or name in [other.name for other in found]:
            raise one.mistake("its name, or one of its outputs, exists already; rename it")
        known |= set(given)
        block = one.arrays(len(taken), len(given), K.dt)
        found.append(Section(name, one.value("kind", TEXT), one.value("note", _NOTE), block, taken, given))
    if set(outputs) <= known:
        made = flattened(found, inputs, outputs)
        if made.alike(K, _SAME):
            return tuple(found), ""
    return (whole,), f"{record['name']}: its sections are not its matrices, which are written instead"


def _text(record: Mapping[str, Any], key: str) -> str:
    item = record.get(key)
    return item if isinstance(item, str) else ""


Number = Literal["double", "float"]
Paragraph = tuple[str, list[str]]  # Title, and lines
_INDENT = " " * 8


def literal(x: float, number: Number) -> str:
    """Return a number as a C constant that is read back as it is (a float: the nearest one)."""
    text = repr(float(x)) if number == "double" else str(np.float32(x))
    text = text if "." in text or "e" in text else f"{text}.0"
    return text if number == "double" else f"{text}F"


def total(weights: Iterable[float], operands: Sequence[str], number: Number) -> list[str]:
    """Return the terms of Σ weights operands; zeros have none."""
    out = []
    for weight, operand in zip(weights, operands, strict=True):
        if abs(weight) == 1.0:
            out.append(operand if weight > 0.0 else f"-{operand}")
        elif weight != 0.0:
            out.append(f"({literal(weight, number)} * {operand})")
    return out or [literal(0.0, number)]


@dataclass(frozen=True, kw_only=True)
class Code:
    """The two files of a controller."""

    controller: WrittenController
    excess: FloatArray  # (states, outputs): E of the anti-windup
    number: Number  # Type of all numbers
    prefix: str  # First part of all external names; the names of the files
    signals: dict[str, str]  # Identifiers of inputs and outputs by their names
    units: dict[str, str]  # Units of inputs and outputs by their names
    remarks: tuple[str, ...]  # Paragraphs for the head of the header
    origin: dict[str, str]  # Where it comes from, for the head of the header, by label

    @property
    def period(self) -> float:
        """Sample period, s."""
        return self.controller.arrays.dt

    def text(self, end: str) -> str:
        """Return the text of the header, h, or of the source file, c."""
        return rendered(f"controller.{end}.j2", unit=self, p=self.prefix, kind=self.number)

    @cached_property
    def fields(self) -> dict[str, str]:
        """Identifiers of the states by their names."""
        names = Identifiers(40, ("last",))
        return {name: names[name] for name in self.controller.states}

    def input_field(self, name: str) -> str:
        """Return the field of an input."""
        return field(self.number, self.signals[name], self.units[name])

    def output_field(self, name: str, purpose: str = "") -> str:
        """Return the field of an output."""
        return field(self.number, self.signals[name], f"{self.units[name]}, {self._bound(name, 'within', purpose)}")

    def _bound(self, name: str, word: str, purpose: str = "") -> str:
        limit = self.controller.limits[self.controller.outputs.index(name)]
        return f"{word} +-{limit:.9g}{purpose}" if np.isfinite(limit) else "not limited"

    @property
    def structs(self) -> dict[str, list[str]]:
        """Fields of inputs, outputs and states."""
        K = self.controller
        commands = [
            field(self.number, f"{self.signals[name]}_commanded", f"{self.units[name]}, before the limit")
            for name in K.outputs
        ]
        states = [
            field(self.number, self.fields[name], f"{number}. {section.name}")
            for number, section in enumerate(K.sections, 1)
            for name in section.states
        ]
        return {
            "in": [self.input_field(name) for name in K.inputs],
            "out": [*(self.output_field(name, ": for the torquer") for name in K.outputs), *commands],
            "state": [*states, f"    {self.prefix}_out last; /* outputs of the last step */"],
        }

    @property
    def details(self) -> list[str]:
        """Paragraphs of the head about signals, remarks and operations."""
        K = self.controller
        multiplications, additions, comparisons = self.operations
        return [
            *(f"in:  {self._named(name)}" for name in K.inputs),
            *(
                f"out: {self._named(name)}, {self._bound(name, 'limited to', ' ' + self.units[name])}"
                for name in K.outputs
            ),
            "",
            *(line for paragraph in self.remarks for line in (paragraph, "")),
            f"A step takes {multiplications} multiplications, {additions} additions and subtractions, and at most "
            f"{comparisons} comparisons, always in the same order; {len(K.states)} states. No allocation, recursion, "
            "loop, global variable or library function.",
            "",
            "Inputs that are not finite, and states or commands that would not be: the step changes nothing, repeats "
            f"the last outputs and returns {self.prefix.upper()}_NOT_FINITE. Pointers are not checked.",
        ]

    def _named(self, name: str) -> str:
        own = "" if self.signals[name] == name else f", field {self.signals[name]}"
        return comment(f"{name} [{self.units[name]}]{own}")

    @property
    def operations(self) -> tuple[int, int, int]:
        """Multiplications, additions with subtractions, and comparisons of a step, the last the most there can be."""
        K, code = self.controller, "".join(line for _, lines in self.step.paragraphs for line in lines)
        numbers = len(K.inputs) + len(K.states) + len(K.outputs)
        # Two comparisons for each number that has to be finite; two to limit and two for the status.
        comparisons = 2 * numbers + 4 * int(np.isfinite(K.limits).sum())
        return code.count(" * "), code.count(" + ") + code.count(" - "), comparisons

    @cached_property
    def step(self) -> StepCode:
        """The statements of a step, and expressions of its results."""
        return StepCode(self)


class StepCode:
    """The statements of a step by paragraphs, and what the template of the source needs beside them."""

    def __init__(self, unit: Code) -> None:
        K = self._K = unit.controller
        self._unit, self._kind = unit, unit.number
        ends = ("", "_step", "_reset", "_in", "_out", "_state", "_usable", "_limited")
        # Locals differ from functions and types; fields are read through a pointer.
        self._names = Identifiers(56, tuple(f"{unit.prefix}{end}" for end in ends))
        self._reads = {name: f"in->{unit.signals[name]}" for name in K.inputs}
        self._states = {name: f"state->{field}" for name, field in unit.fields.items()}
        self.readings = self._tests(self._reads.values())
        signals = [*self._signals()]
        # Command and bound of every limited output.
        self.bounds = {
            name: (self._reads[name], literal(limit, self._kind))
            for name, limit in zip(K.outputs, K.limits, strict=True)
            if np.isfinite(limit)
        }
        self._excess = {name: e for name, e in zip(K.outputs, unit.excess.T, strict=True) if e.any()}
        limits = ("Limits of the torquers", [self._limit(name) for name in self.bounds])
        lines = [self._sum(self._names["excess", x], [f"{self._given(x)} - {self._reads[x]}"]) for x in self._excess]
        excess = ("Anti-windup: the excess beyond the limits acts on the states", lines)
        self.paragraphs = [one for one in (*signals, limits, excess, *self._next_states()) if one[1]]
        # Field, command and limited command of every output; field and local of every state's next value.
        self.outputs = [(unit.signals[name], self._reads[name], self._given(name)) for name in K.outputs]
        self.next_states = [(field, self._names["next", name]) for name, field in unit.fields.items()]
        self.results = self._tests([*dict(self.next_states).values(), *(command for _, command, _ in self.outputs)])

    def _tests(self, numbers: Iterable[str]) -> list[str]:
        return [f"{self._unit.prefix}_usable({number})" for number in numbers]

    def _sum(self, local: str, terms: Sequence[str]) -> str:
        terms = [terms[0].strip("()")] if len(terms) == 1 else terms
        return joined(f"{_INDENT}const {self._kind} {local} = ", terms, "+", ";")

    def _signals(self) -> Iterator[Paragraph]:
        needed = _needed(self._K)
        for number, section in enumerate(self._K.sections, 1):
            operands = [self._states[name] for name in section.states] + [self._reads[name] for name in section.inputs]
            lines = []
            for name, weights in zip(section.outputs, np.hstack([section.block.C, section.block.D]), strict=True):
                if name in needed:
                    self._reads[name] = self._names[name]
                    lines.append(self._sum(self._reads[name], total(weights, operands, self._kind)))
            yield f"{number}. {section.name}: {section.note or section.kind}", lines

    def _given(self, name: str) -> str:
        return self._names["limited", name] if name in self.bounds else self._reads[name]

    def _limit(self, name: str) -> str:
        command, bound = self.bounds[name]
        call = f"{self._unit.prefix}_limited({command}, {bound})"
        return f"{_INDENT}const {self._kind} {self._given(name)} = {call}; /* {comment(self._unit.units[name])} */"

    def _next_states(self) -> Iterator[Paragraph]:
        places = {name: k for k, name in enumerate(self._K.states)}
        excesses = [self._names["excess", name] for name in self._excess]
        for number, section in enumerate(self._K.sections, 1):
            operands = [self._states[name] for name in section.states] + [self._reads[name] for name in section.inputs]
            lines = []
            for name, row in zip(section.states, np.hstack([section.block.A, section.block.B]), strict=True):
                weights = [*row, *(E[places[name]] for E in self._excess.values())]
                terms = total(weights, [*operands, *excesses], self._kind)
                lines.append(self._sum(self._names["next", name], terms))
            yield f"{number}. {section.name}: next states", lines


def _needed(K: WrittenController) -> set[str]:
    """Return all signals that outputs and states depend on; no others are computed."""
    out = set(K.outputs)
    for section in reversed(K.sections):
        shown = [weights for name, weights in zip(section.outputs, section.block.D, strict=True) if name in out]
        used = np.any([*shown, *section.block.B], axis=0)
        out |= {name for name, taken in zip(section.inputs, used, strict=True) if taken}
    return out
