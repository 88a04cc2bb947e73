"""The files of a controller in floating point, C99 that also compiles as C++, and what drives add to a job's step."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, ClassVar, Literal

import numpy as np

from platform_ctrl.common.values import value
from platform_ctrl.errors import InputError
from platform_ctrl.export.c99.c_text import comment, field, joined
from platform_ctrl.export.c99.controller_files import ControllerFiles, Paragraph, Step, result_of
from platform_ctrl.export.c99.scheme import Row, Scheme, excess_of, sections_with_excess
from platform_ctrl.export.systems import signal_units
from platform_ctrl.job.drive import DriveLaw
from platform_ctrl.job.job import Job

Number = Literal["double", "float"]


@value
class Cost:
    """Operations of one step."""

    # multiplications, additions, comparisons: Counts; subtractions count as additions, comparisons are the most that
    # there can be
    multiplications: int
    additions: int
    comparisons: int


def cost_of(schemes: Sequence[Scheme]) -> Cost:
    """Return what a step of all controllers costs, limits and anti-windup included."""
    sections = [section for scheme in schemes for section in sections_with_excess(scheme)]
    rows = [row for section in sections for row in (*section.signals, *section.states)]
    sources = {source for row in rows for source in row.sources}
    numbers = sum(len(scheme.inputs) + len(scheme.states) + len(scheme.outputs) for scheme in schemes)
    limited = sum(int(np.isfinite(scheme.torque_limits).sum()) for scheme in schemes)
    return Cost(
        multiplications=sum(abs(term.coefficient) != 1.0 for row in rows for term in row.terms),
        additions=sum(max(len(row.terms) - 1, 0) for row in rows)
        + sum(excess_of(name) in sources for scheme in schemes for name in scheme.outputs),
        # Two for each number that has to be finite; two to limit and two for the status.
        comparisons=2 * numbers + 4 * limited,
    )


def literal(x: float, number: Number) -> str:
    """Return a number as a C constant that is read back as it is (a float: the nearest one)."""
    text = repr(float(x)) if number == "double" else str(np.float32(x))
    text = text if "." in text or "e" in text else f"{text}.0"
    return text if number == "double" else f"{text}F"


@value
class FloatingFiles(ControllerFiles):
    """The files of a controller in double or single precision."""

    number: Number  # Type of all numbers

    template: ClassVar = "floating.c.j2"
    statuses: ClassVar = (
        *ControllerFiles.statuses,
        ("NOT_FINITE", 2, "an input or a result was not finite: nothing is changed"),
    )

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
        s, cost = self.scheme, cost_of([self.scheme])
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
        return comment(f"{name} [{what}]" + ("" if self.signals[name] == name else f", field {self.signals[name]}"))

    def step(self) -> Step:
        """Return the writer of the step."""
        return _FloatingStep(self)

    def job_field(self, name: str, output: bool) -> str:
        """Return the field of an input or output in the files of the whole job."""
        if output:
            return self._output(name)
        return field(self.number, self.signals[name], self.scheme.input_units[self.scheme.inputs.index(name)])


class _FloatingStep(Step):
    """The statements of a step in floating point."""

    indent = " " * 8

    def __init__(self, unit: FloatingFiles) -> None:
        s, p = unit.scheme, unit.prefix
        self.kind, self.limits = unit.number, dict(zip(s.outputs, s.torque_limits, strict=True))
        limited = [name for name, limit in self.limits.items() if np.isfinite(limit)]
        super().__init__(unit, sections_with_excess(s), limited, f"{p}_usable {p}_limited")
        self.readings = [f"in->{unit.signals[name]}" for name in s.inputs]

    def start(self) -> Iterator[Paragraph]:
        self.reads |= dict(zip(self.scheme.inputs, self.readings, strict=True))
        self.reads |= {name: f"state->{field}" for name, field in self.states.items()}
        yield from ()

    def statement(self, local: str, row: Row, section: str) -> str:
        parts = []
        for term in row.terms:
            part = self.reads[term.source]
            if abs(term.coefficient) == 1.0:
                parts.append(f"-{part}" if term.coefficient < 0.0 else part)
                continue
            number = literal(term.coefficient, self.kind)
            part = f"{self.constant(self.kind, number, row.target, term.source, section)} * {part}"
            parts.append(part if len(row.terms) == 1 else f"({part})")
        head = f"{self.indent}const {self.kind} {local} = "
        return joined(head, parts or [literal(0.0, self.kind)], "+", ";")

    def limit(self, local: str, name: str) -> str:
        bound, what = self.locals["limit", name], self.scheme.output_units[self.scheme.outputs.index(name)]
        number = literal(self.limits[name], self.kind)
        self.constants.append(f"{self.indent}static const {self.kind} {bound} = {number}; /* {comment(what)} */")
        return f"{self.indent}const {self.kind} {local} = {self.unit.prefix}_limited({self.reads[name]}, {bound});"

    def excess(self, local: str, limited: str, name: str) -> str:
        return f"{self.indent}const {self.kind} {local} = {limited} - {self.reads[name]};"

    def tests(self, numbers: Sequence[str]) -> list[str]:
        return [f"{self.unit.prefix}_usable({number})" for number in numbers]

    @property
    def results(self) -> list[str]:
        return [local for _, local in self.next_states] + [command for _, command, _ in self.outputs]

    @property
    def bounds(self) -> list[tuple[str, str]]:
        return [(self.reads[name], self.locals["limit", name]) for name in self.limited]


@value
class DriveCode:
    """A drive in C: expressions and constants of its statements."""

    torquer: str  # Name of the torquer
    output: str  # Its field
    command: str  # Expression of what the controllers command, before the limit
    limit: str  # Of the torquer; empty: none
    angle: str  # Expression of the angle that the gain follows; empty: none
    secant_limit: str
    friction: str  # Empty: none is fed forward
    per_rate: str  # 1 over the rate from which on all of it acts
    terms: tuple[tuple[str, str], ...]  # Weight and expression of every reading in the rate

    @property
    def readings(self) -> list[str]:
        """Expressions of all that is read."""
        return list(dict.fromkeys([*([self.angle] if self.angle else []), *(reading for _, reading in self.terms)]))

    @property
    def products(self) -> list[str]:
        """Terms of the rate."""
        return [f"({weight} * {reading})" for weight, reading in self.terms]

    def tests(self, prefix: str) -> list[str]:
        """Return the conditions that all that is read is finite."""
        return [f"{prefix}_usable({reading})" for reading in self.readings]


def drive_inputs(job: Job, named: Sequence[str]) -> list[str]:
    """Return the sensors that the drives of a job read beside what is `named`, in the plant's order."""
    used = {name for law in job.drive_laws for name in (*law.weights, law.secant_of)} - set(named)
    return [sensor.name for sensor in job.platform.sensors if sensor.name in used]


def drive_notes(job: Job, prefix: str) -> list[str]:
    """Return what a reader of the files of a job with drives has to know."""
    if not job.drives:
        return []
    return [f"{prefix}.h: what the drives do is in {prefix}_step, not in the steps of single controllers"]


def drive_words(job: Job, given: Sequence[ControllerFiles]) -> dict[str, Any]:
    """Return what the templates of a job's files need for its drives."""
    units = [unit for unit in given if isinstance(unit, FloatingFiles)]
    if not job.drives or not units:
        return {}
    number, signals = units[0].number, units[0].signals
    what = signal_units(job.platform)
    more = drive_inputs(job, [name for unit in units for name in unit.scheme.inputs])
    laws = sorted(job.drive_laws, key=lambda law: [t.name for t in job.platform.torquers].index(law.torquer))
    return {
        "drives": [_code(job, law, units) for law in laws],
        "driven": [signals[law.torquer] for law in laws if law.torquer in signals],
        "number": number,
        "cosine": "cos" if number == "double" else "cosf",
        "largest": "DBL_MAX" if number == "double" else "FLT_MAX",
        "unity": literal(1.0, number),
        "drive_inputs": [field(number, signals[name], what[name]) for name in more],
    }


def _code(job: Job, law: DriveLaw, units: Sequence[FloatingFiles]) -> DriveCode:
    number: Number = units[0].number
    places = [(k, unit) for k, unit in enumerate(units, 1) if law.torquer in unit.scheme.outputs]
    if not places:
        raise InputError(
            f"drive of {law.torquer!r}: none of these controllers sets this torquer; export them with the one that does"
        )
    k, unit = places[-1]
    limit = unit.scheme.torque_limits[unit.scheme.outputs.index(law.torquer)]
    order = [sensor.name for sensor in job.platform.sensors]
    return DriveCode(
        torquer=law.torquer,
        output=unit.signals[law.torquer],
        command=f"{result_of(unit, k, job.sampling.period)}.{unit.signals[law.torquer]}_commanded",
        limit=literal(limit, number) if np.isfinite(limit) else "",
        angle="" if law.secant_of is None else f"in->{unit.signals[law.secant_of]}",
        secant_limit=literal(law.secant_limit, number),
        friction=literal(law.friction, number) if law.friction else "",
        per_rate=literal(1.0 / law.friction_rate, number),
        terms=tuple(
            (literal(law.weights[name], number), f"in->{unit.signals[name]}")
            for name in sorted(law.weights, key=order.index)
        ),
    )
