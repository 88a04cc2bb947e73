"""A controller as it is written in C: sections in their order, each with named signals, limits and anti-windup.

A step takes the inputs of one sample and gives the outputs of that sample:

    for every section:   signals = C x + D (inputs and earlier signals)
    then:                x⁺ = A x + B (inputs and signals of this step)
    and where a limit cut an output off:   x⁺ += E (limited − commanded)

Sections stand in result.json. A controller without them is one section: its matrices.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from platform_ctrl.analysis.system import System
from platform_ctrl.common.arguments import short
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.sections import Section, flattened
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.job import Job
from platform_ctrl.verification.controllers import read_controllers
from platform_ctrl.verification.result_file import SCHEMA, JSONTable

if TYPE_CHECKING:
    import control

# How far what sections multiply out to may be from the matrices of the controller: rounding of a few operations.
_SAME = 1e-11


@value
class Controller:
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


def controllers_of(job: Job, entries: Sequence[Mapping[str, Any] | control.StateSpace]) -> tuple[Controller, ...]:
    """Return the controllers of a job, checked against it, in order of evaluation.

    Each entry is one of ``controllers`` in ``result.json``, or a `control.StateSpace` with ``dt`` and signal names.
    """
    if isinstance(entries, Mapping | str) or not isinstance(entries, Sequence):
        raise ArgumentError(f"entries: must be a list of controllers, got {short(entries)}")
    records = [one if isinstance(one, Mapping) else _record(one, job) for one in entries]
    checked = read_controllers({"schema": SCHEMA, "controllers": records}, job)
    limits = {t.name: np.inf if t.limit is None else float(t.limit) for t in job.platform.torquers}
    out = []
    for record, K in zip(records, checked, strict=True):
        arrays = System.of(K, "controller")
        inputs, outputs = tuple(map(str, K.input_labels)), tuple(map(str, K.output_labels))
        sections, note = _sections(record, arrays, inputs, outputs)
        out.append(
            Controller(
                name=str(record["name"]),
                design=_text(record, "design"),
                method=_text(record, "method"),
                arrays=arrays,
                inputs=inputs,
                outputs=outputs,
                sections=sections,
                # What commands another loop has no limit.
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
    for one in table.tables("sections", "a list of sections"):
        name, taken, given = one.text("name", "a name"), one.names("inputs"), one.names("outputs")
        for signal in taken:
            if signal not in known:
                raise one.mistake(f"inputs: {signal!r} is neither an input nor an output of a section before it")
        if not known.isdisjoint(given) or name in [other.name for other in found]:
            raise one.mistake("its name, or one of its outputs, exists already; rename it")
        known |= set(given)
        block = one.arrays(len(taken), len(given), K.dt)
        found.append(
            Section(name, one.text("kind", "a kind"), one.text("note", "a note", empty=True), block, taken, given)
        )
    if set(outputs) <= known:
        made = flattened(found, inputs, outputs)
        if all(
            a.shape == b.shape and np.all(np.abs(a - b) <= _SAME * np.abs(b).max(initial=0.0))
            for a, b in zip(made[:4], K[:4], strict=True)
        ):
            return tuple(found), ""
    return (whole,), f"{record['name']}: its sections are not its matrices, which are written instead"


def _record(K: control.StateSpace, job: Job) -> dict[str, Any]:
    arrays = System.of(K, "controller")
    loop, _, design = str(K.name).partition(", ")
    matrices = {name: item.tolist() for name, item in zip("ABCD", arrays[:4], strict=True)}
    signals = {"inputs": list(K.input_labels), "outputs": list(K.output_labels)}
    return {"name": loop, "design": design, "dt": arrays.dt, "delay": job.sampling.delay, **matrices, **signals}


def _text(record: Mapping[str, Any], key: str) -> str:
    item = record.get(key)
    return item if isinstance(item, str) else ""
