"""A controller as it is evaluated: named sections in their order, each a few sums of products.

A step takes the inputs of one sample and gives the outputs of that sample:

    for every section:   signals = sums of inputs, earlier signals and states
    then:                states⁺ = sums of inputs, signals and states, all of this step
    and where a limit cut an output off:   states⁺ += excess (limited − commanded)

Code is written from this, in floating point or in integers; `arrays` multiplies it out again, so that what was written
can be compared with what was designed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import field, replace
from typing import Any, Literal, NamedTuple

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError

SectionKind = Literal["mix", "integral", "lag", "lead", "notch", "low-pass", "states"]


@value
class Term:
    """A product in a sum."""

    coefficient: float  # In the unit of the target per unit of the source
    source: str  # Name of an input, of an earlier signal, or of a state
    name: str = ""  # Of the coefficient, for example direct; or empty


@value
class Row:
    """A sum of products: target = Σ coefficient source."""

    target: str  # Name of a signal, or of a state
    terms: tuple[Term, ...]  # None of them: the target is zero

    @property
    def sources(self) -> tuple[str, ...]:
        """Names of the sources."""
        return tuple(term.source for term in self.terms)


@value
class Section:
    """A part of a controller with a meaning."""

    name: str  # For example integral of pair 1, axis 1
    kind: SectionKind  # What it is
    note: str = ""  # Its continuous meaning, for example zero at 7 Hz, pole at 900 Hz; or empty
    signals: tuple[Row, ...] = ()  # Values of this step, in the order in which they are computed
    states: tuple[Row, ...] = ()  # Next values of its states


@value
class Provenance:
    """Where a controller comes from."""

    # job, plant: Titles
    job: str = ""
    plant: str = ""
    # loop, design, method: As in the job file
    loop: str = ""
    design: str = ""
    method: str = ""
    sha256: str = ""  # Of the result file, as hexadecimal digits; empty where there is none
    versions: dict[str, str] = field(default_factory=dict)  # Of platform_ctrl and what designed the controller, by name
    command: str = ""  # The command that wrote the code; or empty


@value
class Scheme:
    """A sampled controller u = K y, written out.

    Names of inputs, signals and states are distinct; every output is a signal of that name.
    """

    name: str  # Of the loop
    # inputs, input_units: Signals that it measures, and their units, for example rad
    inputs: tuple[str, ...]
    input_units: tuple[str, ...]
    # outputs, output_units: Signals that it sets
    outputs: tuple[str, ...]
    output_units: tuple[str, ...]
    sections: tuple[Section, ...]  # In the order in which they are evaluated
    # (outputs,): Largest magnitude of each output, in its unit; inf where there is none
    torque_limits: tuple[float, ...]
    # Anti-windup: what is added to a state's next value, Σ coefficient (limited − commanded); the sources are outputs.
    # Empty: none.
    excess: tuple[Row, ...] = ()
    # period, delay: Sample period; from the sample to the instant at which its outputs act, s
    period: float
    delay: float
    provenance: Provenance = field(default_factory=Provenance)  # Where it comes from

    @property
    def states(self) -> tuple[str, ...]:
        """Names of all states, in the order of the sections."""
        return tuple(row.target for section in self.sections for row in section.states)


@value
class Entry:
    """A controller of a job as it is given: its matrices."""

    # loop, design, method: As in the job file; empty where nothing is known
    loop: str
    design: str = ""
    method: str = ""
    arrays: StateArrays  # x⁺ = A x + B y, u = C x + D y; dt is the sample period, s
    # inputs, outputs: Names of the signals
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    # The method's numbers as finally used, in the units of the job file
    options: dict[str, float] = field(default_factory=dict)
    excess: FloatArray | None = None  # (n, m): E of the anti-windup of the controller, or None


Sum = dict[str, Any]  # Coefficients by their sources; numbers are floats or rational


class Rows(NamedTuple):
    """Rows in order of evaluation: of signals, and of states, as sums of inputs, earlier signals and states."""

    signals: dict[str, Sum]
    states: dict[str, Sum]


def rows_of(sections: Iterable[Section], number: Callable[[float], Any] = float) -> Rows:
    """Return the rows of sections with coefficients as some type of number."""

    def total(row: Row) -> Sum:
        return added((1, {term.source: number(term.coefficient)}) for term in row.terms)

    sections = tuple(sections)
    signals = {row.target: total(row) for section in sections for row in section.signals}
    return Rows(signals, {row.target: total(row) for section in sections for row in section.states})


def added(rows: Iterable[tuple[Any, Mapping[str, Any]]]) -> Sum:
    """Return Σ factor · sum."""
    out: Sum = {}
    for factor, terms in rows:
        for name, coefficient in terms.items():
            out[name] = out.get(name, 0) + factor * coefficient
    return {name: coefficient for name, coefficient in out.items() if coefficient != 0}


def noise_of(row: str) -> str:
    """Return the name of the disturbance of a row."""
    # No name has two lines.
    return f"noise of\n{row}"


def multiplied_out(rows: Rows, free: Iterable[str], states: Iterable[str], one: Any) -> Rows:
    """Return signals and next states as sums of states, free sources and the signals' disturbances.

    States not in `states` are left out; `one` is the number 1.
    """
    states = tuple(states)
    known: dict[str, Sum] = {name: {name: one} for name in (*free, *states)}
    for name, row in rows.signals.items():
        known[name] = added((coefficient, known[source]) for source, coefficient in row.items())
        known[name][noise_of(name)] = one
    following = {
        name: added((coefficient, known[source]) for source, coefficient in rows.states[name].items())
        for name in states
    }
    # A signal's own disturbance is part of it; its effects on others are in their sums.
    return Rows({name: known[name] for name in rows.signals}, following)


def matrix(sums: Mapping[str, Sum], rows: Sequence[str], columns: Sequence[str]) -> FloatArray:
    """Return the coefficients of some sums of floats as a matrix."""
    return np.array([[sums[row].get(name, 0.0) for name in columns] for row in rows]).reshape(len(rows), len(columns))


def arrays(scheme: Scheme, rounded: Callable[[float], float] = float) -> StateArrays:
    """Return the controller that a scheme multiplies out to, without limits, with rounded coefficients."""
    _check(scheme)
    states, inputs, outputs = scheme.states, scheme.inputs, scheme.outputs
    shown, following = multiplied_out(rows_of(scheme.sections, rounded), inputs, states, 1.0)
    A, B = matrix(following, states, states), matrix(following, states, inputs)
    return StateArrays(A, B, matrix(shown, outputs, states), matrix(shown, outputs, inputs), scheme.period)


def _check(scheme: Scheme) -> None:
    where = f"scheme {scheme.name!r}"
    known = {*scheme.states, *scheme.inputs}
    if len(known) != len(scheme.states) + len(scheme.inputs):
        raise ArgumentError(f"{where}: two states or inputs have the same name; rename one")
    for section in scheme.sections:
        for row in (*section.signals, *section.states):
            for term in row.terms:
                if not math.isfinite(term.coefficient):
                    wrong = f"{row.target!r} has the coefficient {term.coefficient}"
                    raise ArgumentError(f"{where}: {wrong}, which must be finite")
                if term.source not in known:
                    raise ArgumentError(
                        f"{where}: {row.target!r} uses {term.source!r}, which must be an input, a state or a signal "
                        "that is computed before it"
                    )
            if row in section.signals:
                if row.target in known:
                    raise ArgumentError(f"{where}: {row.target!r} exists twice; rename one")
                known.add(row.target)
    missing = [name for name in scheme.outputs if name not in known]
    if missing:
        raise ArgumentError(f"{where}: the output {missing[0]!r} has no signal; add one")


def excess_gain(scheme: Scheme) -> FloatArray:
    """Return E of the anti-windup, x⁺ = A x + B y + E (limited u − u)."""
    states, outputs = scheme.states, scheme.outputs
    out = np.zeros((len(states), len(outputs)))
    for row in scheme.excess:
        for term in row.terms:
            if row.target not in states or term.source not in outputs:
                raise ArgumentError(
                    f"scheme {scheme.name!r}: an excess of {term.source!r} into {row.target!r} must lead from an "
                    "output to a state"
                )
            out[states.index(row.target), outputs.index(term.source)] += term.coefficient
    return out


def row(target: str, weights: FloatArray, sources: Sequence[str], names: Sequence[str] = ()) -> Row:
    """Return target = Σ weights sources, without zero terms; `names` are those of the coefficients."""
    terms = (
        Term(coefficient=float(x), source=source, name=label)
        for x, source, label in zip(weights, sources, names or [""] * len(sources), strict=True)
        if x != 0.0
    )
    return Row(target=target, terms=tuple(terms))


def excess_of(output: str) -> str:
    """Return the name under which an output's excess, limited − commanded, is a source."""
    # No name has two lines, so that this is none of a signal.
    return f"excess of\n{output}"


def sections_with_excess(scheme: Scheme) -> tuple[Section, ...]:
    """Return the sections with the excess of the limited outputs among the sources of their states."""
    limited = {name for name, limit in zip(scheme.outputs, scheme.torque_limits, strict=True) if math.isfinite(limit)}
    added = {
        row.target: tuple(replace(term, source=excess_of(term.source)) for term in row.terms if term.source in limited)
        for row in scheme.excess
    }
    return tuple(
        replace(
            section,
            states=tuple(replace(row, terms=(*row.terms, *added.get(row.target, ()))) for row in section.states),
        )
        for section in scheme.sections
    )
