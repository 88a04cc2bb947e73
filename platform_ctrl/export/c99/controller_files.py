"""Header and source file of a controller, and of all controllers of a job: what all number formats share.

A step is the same in every number format: signals section by section, limits, excess, next states. A number format is
a class derived from `ControllerFiles`, for fields and details, and one derived from `Step`, for sums and limits.
"""

from __future__ import annotations

import dataclasses
import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, ClassVar

from platform_ctrl.common.values import value
from platform_ctrl.export.c99.c_text import Names, rendered
from platform_ctrl.export.c99.scheme import Scheme, excess_of

Paragraph = tuple[str, list[str]]  # Title, and lines


@value
class ControllerFiles(ABC):
    """The two files of a controller."""

    scheme: Scheme  # The controller
    prefix: str  # First part of all external names; the names of the files
    signals: dict[str, str]  # Identifiers of inputs and outputs by their names
    remarks: tuple[str, ...] = ()  # Paragraphs for the head of the header: anti-windup, rounding

    template: ClassVar[str]  # Of the source file
    # Bits of the status that a step returns: name, bit, meaning
    statuses: ClassVar[tuple[tuple[str, int, str], ...]] = (
        ("OK", 0, "no limit acted"),
        ("LIMITED", 1, "an output is at its limit"),
    )

    @property
    @abstractmethod
    def numbers(self) -> str:
        """A sentence about the type of all numbers."""

    @abstractmethod
    def fields(self) -> tuple[list[str], list[str], list[str]]:
        """Return the fields of inputs, outputs and states."""

    @abstractmethod
    def details(self) -> list[str]:
        """Return the paragraphs of the head about signals, remarks and cost."""

    @abstractmethod
    def step(self) -> Step:
        """Return the writer of the step."""

    @abstractmethod
    def job_field(self, name: str, output: bool) -> str:
        """Return the field of an input or output in the files of the whole job."""

    @property
    def state_names(self) -> dict[str, str]:
        """Identifiers of the states by their names."""
        names = Names(40, ("last",))
        return {name: names[name] for name in self.scheme.states}

    def header(self) -> str:
        """Return the text of the header file."""
        inputs, outputs, states = self.fields()
        return self._text("controller.h.j2", inputs=inputs, outputs=outputs, states=states)

    def source(self) -> str:
        """Return the text of the source file."""
        step = self.step()
        return self._text(self.template, paragraphs=list(step.paragraphs()), step=step)

    def _text(self, template: str, **words: Any) -> str:
        return rendered(template, unit=self, p=self.prefix, scheme=self.scheme, **words)


class Step(ABC):
    """The statements of a step."""

    indent: ClassVar[str]

    def __init__(self, unit: ControllerFiles, sections: Sequence[Any], limits: Iterable[str], functions: str) -> None:
        p = unit.prefix
        self.unit, self.scheme, self.sections = unit, unit.scheme, sections
        self.states, self.limited = unit.state_names, list(limits)
        # Locals and constants differ from functions and types; fields are read through a pointer.
        ends = ("", "_step", "_reset", "_in", "_out", "_state")
        self.locals = Names(56, (*(f"{p}{end}" for end in ends), *functions.split()))
        self.reads: dict[str, str] = {}  # C expressions of what has been computed
        self.constants: list[str] = []  # Of the current paragraph
        self.sources = {source for one in sections for row in (*one.signals, *one.states) for source in row.sources}
        self.needed = _needed(sections, self.scheme.outputs)
        self.labels = {
            (row.target, term.source): term.name
            for section in self.scheme.sections
            for row in (*section.signals, *section.states)
            for term in row.terms
        }

    @abstractmethod
    def start(self) -> Iterator[Paragraph]:
        """Write what comes before the first section, and set the expressions of inputs and states."""

    @abstractmethod
    def statement(self, local: str, row: Any, section: str) -> str:
        """Return the statement that sets a local to the sum of a row; it may add constants."""

    @abstractmethod
    def limit(self, local: str, name: str) -> str:
        """Return the statement that sets a local to an output within its limit."""

    @abstractmethod
    def excess(self, local: str, limited: str, name: str) -> str:
        """Return the statement that sets a local to limited − commanded."""

    def next_state(self, local: str, row: Any, section: str) -> str:
        """Return the statement that sets a local to the next value of a state."""
        return self.statement(local, row, section)

    def constant(self, kind: str, number: str, target: str, source: str, section: str, meaning: str = "") -> str:
        """Define a constant for the coefficient of a product, and return its name."""
        name = self.labels.get((target, source), "")
        label = self.locals.new(f"k {section} {name}" if name else f"k {target} from {source}")
        self.constants.append(f"{self.indent}static const {kind} {label} = {number};{meaning}")
        return label

    def paragraphs(self) -> Iterator[Paragraph]:
        """Go through the statements between the inputs and the storing of the results."""
        yield from self.start()
        titles = [f"{k}. {one.name}: {one.note or one.kind}" for k, one in enumerate(self.sections, 1)]
        for title, section in zip(titles, self.sections, strict=True):
            rows = [row for row in section.signals if row.target in self.needed]
            lines = []
            for row in rows:
                local = self.locals[row.target]
                lines.append(self.statement(local, row, section.name))
                self.reads[row.target] = local
            yield from self._paragraph(title, lines)
        lines = [self.limit(self.locals["limited", name], name) for name in self.limited]
        yield from self._paragraph("Limits of the torquers", lines)
        lines = []
        for name in self.limited:
            if excess_of(name) in self.sources:
                local = self.reads[excess_of(name)] = self.locals["excess", name]
                lines.append(self.excess(local, self.locals["limited", name], name))
        yield from self._paragraph("Anti-windup: the excess beyond the limits acts on the states", lines)
        for title, section in zip(titles, self.sections, strict=True):
            lines = [self.next_state(self.locals["next", row.target], row, section.name) for row in section.states]
            yield from self._paragraph(f"{title.partition(':')[0]}: next states" if section.signals else title, lines)

    def _paragraph(self, title: str, lines: list[str]) -> Iterator[Paragraph]:
        constants, self.constants = self.constants, []
        if lines:
            yield title, [*constants, *lines]

    @property
    def outputs(self) -> list[tuple[str, str, str]]:
        """Field, expression before the limit and within the limit of every output."""
        return [
            (
                self.unit.signals[name],
                self.reads[name],
                self.locals["limited", name] if name in self.limited else self.reads[name],
            )
            for name in self.scheme.outputs
        ]

    @property
    def next_states(self) -> list[tuple[str, str]]:
        """Field and local of every state's next value."""
        return [(field, self.locals["next", name]) for name, field in self.states.items()]


def _needed(sections: Sequence[Any], outputs: Sequence[str]) -> set[str]:
    """Return all signals that outputs and states depend on; no others are computed."""
    out = set(outputs) | {source for section in sections for row in section.states for source in row.sources}
    for section in reversed(sections):
        for row in reversed(section.signals):
            if row.target in out:
                out |= set(row.sources)
    return out


def samples_apart(unit: ControllerFiles, period: float) -> int:
    """Return at every how many samples of a job a controller is computed."""
    return max(round(unit.scheme.period / period), 1)


def result_of(unit: ControllerFiles, number: int, period: float) -> str:
    """Return the expression for what a controller's last step gave, in the step of the whole job."""
    return f"out_{number}" if samples_apart(unit, period) == 1 else f"state->{unit.prefix}_last"


def job_files(job: str, units: Sequence[ControllerFiles], period: float, **words: Any) -> dict[str, str]:
    """Return the header and the source, by file name, that run all controllers for one sample.

    `job` is a prefix, `period` that of the samples, s.
    """
    first, prefixes = units[0], [unit.prefix for unit in units]
    readers: dict[str, ControllerFiles] = {}  # Signals that no earlier controller computes, by their first reader
    made: dict[str, str] = {}
    steps = []
    for number, unit in enumerate(units, 1):
        taken = []
        for name in unit.scheme.inputs:
            if name not in made:
                readers[name], made[name] = unit, f"in->{unit.signals[name]}"
            taken.append((unit.signals[name], made[name]))
        given = [unit.signals[name] for name in unit.scheme.outputs]
        result = result_of(unit, number, period)
        made |= {name: f"{result}.{unit.signals[name]}_commanded" for name in unit.scheme.outputs}
        steps.append((unit.prefix, taken, given, samples_apart(unit, period), result))
    every = {unit.prefix: samples_apart(unit, period) for unit in units}
    held = [one for one, n in every.items() if n > 1]
    states = [f"    {one}_state {one};" for one in prefixes]
    states += [f"    {one}_out {one}_last; /* held */\n    unsigned int {one}_status;" for one in held]
    states += [f"    unsigned int {job}_sample; /* 0 to {math.lcm(*every.values()) - 1} */"] if held else []
    outputs = [unit.job_field(name, True) for unit in units for name in unit.scheme.outputs]
    words = {"drives": (), "driven": (), "drive_inputs": ()} | words
    words |= {"p": job, "units": units, "prefixes": prefixes}
    words |= {"scheme": dataclasses.replace(first.scheme, period=period), "every": every}
    words |= {"held": held, "cycle": math.lcm(*every.values())}
    header = rendered(
        "job.h.j2",
        **words,
        includes=[f'"{one}.h"' for one in prefixes],
        inputs=[*(unit.job_field(name, False) for name, unit in readers.items()), *words["drive_inputs"]],
        outputs=[*outputs, *(f"    unsigned int {one}_status; /* what {one}_step returned */" for one in prefixes)],
        states=states,
    )
    return {f"{job}.h": header, f"{job}.c": rendered("job.c.j2", **words, steps=steps)}
