"""Controllers that exist already: read from a file, judged, matched to the loops of a job, and measured anew.

Nothing that a file claims is believed.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.caging_claims import with_caging_claims
from platform_ctrl.design.jobs import LoopOutcome
from platform_ctrl.design.loop import LoopDesign, remeasured
from platform_ctrl.design.plants import plants_of
from platform_ctrl.errors import InputError
from platform_ctrl.job.job import Job, LoopSpec
from platform_ctrl.plant.fields import finite_number
from platform_ctrl.plant.mistakes import given, one_line, suggestion
from platform_ctrl.plant.platform import is_rate
from platform_ctrl.plant.source import read_json
from platform_ctrl.verification.records import SCHEMA

if TYPE_CHECKING:
    import control


# States of a controller: what is checked of it takes time by their number's cube.
MOST_STATES = 1000


@check_arguments
def read_controllers(
    source: str | os.PathLike[str] | Mapping[str, Any], job: Job, key: str = "controllers"
) -> list[control.StateSpace]:
    """Read controllers that exist already and judge whether they can be closed around the job's plant.

    Parameters
    ----------
    source
        The path of a ``result.json``, or of a file with its keys ``schema`` and ``controllers`` alone; or a dict.
    job
        What they have to fit: names of pick-offs, rate sensors and torquers, sample period and delay.
    key
        ``"controllers"``, or ``"alternatives"``: there the same output may be set twice, and none need be there.

    Returns
    -------
    list
        `control.StateSpace` in the file's order, dt the job's sample period, named ``"name, design"``.

    Raises
    ------
    InputError
        One line: the file, the controller and the key, what was given, what is expected.
    """
    label, data = ("controllers given as a dict", source) if isinstance(source, Mapping) else opened(source)
    if not isinstance(data, Mapping):
        raise InputError(f'{label} must be a table with "schema" and "controllers", got {given(data)}')
    schema = data.get("schema")
    if isinstance(schema, bool) or schema != SCHEMA:
        shown = f"got {given(schema)}" if "schema" in data else "but the key is missing"
        raise InputError(f"{label}: schema must be {SCHEMA}, the format that this version reads, {shown}")
    entries = data.get(key, [] if key != "controllers" else None)
    if not isinstance(entries, list) or (not entries and key == "controllers"):
        shown = f"got {given(entries)}" if key in data else "but the key is missing"
        raise InputError(f"{label}: {key} must be a list of controllers, {shown}")
    known = [s.name for s in job.platform.sensors]
    made_by: dict[str, str] = {}
    out = []
    for number, entry in enumerate(entries, 1):
        K = _Entry(label, key, number, entry).controller(job, [*known, *made_by])
        for name in K.output_labels if key == "controllers" else ():
            if name in made_by:
                raise InputError(
                    f"{label}: {key} {number}: outputs: {given(name)} is set by {made_by[name]} already; "
                    "give each torque one controller"
                )
            made_by[name] = f"{key} {number}"
        out.append(K)
    return out


def opened(source: str | os.PathLike[str]) -> tuple[str, Any]:
    """Return a file's name for messages, and what it holds."""
    return read_json(source, "a JSON file with controllers")


class _Entry:
    """One controller of a file, and where it stands, for messages."""

    def __init__(self, label: str, key: str, number: int, data: object) -> None:
        title = given(data["name"]) if isinstance(data, Mapping) and isinstance(data.get("name"), str) else ""
        self.where = f"{label}: {key} {number}{' ' + title if title else ''}"
        if not isinstance(data, Mapping):
            raise InputError(f"{self.where} must be a table with name, dt, A, B, C, D, ..., got {given(data)}")
        self.data = data

    def controller(self, job: Job, known: Sequence[str]) -> control.StateSpace:
        """Return the controller, its inputs among `known`."""
        from platform_ctrl.analysis.arrays import StateArrays, named_system

        name = self._text("name")
        inputs = self._names("inputs")
        outputs = self._names("outputs")
        for one in inputs:
            if one not in known and is_rate(one):
                wrong = f"{given(one)} is a rate that no sensor of the plant measures"
                raise self._mistake("inputs", f"{wrong}; add a [[rate_sensor]] for it to the plant file")
            if one not in known:
                wrong = f"{given(one)} is no pick-off of the plant and no output of a controller before it"
                raise self._mistake("inputs", f"{wrong}; {suggestion(one, known)}")
        torquers = [t.name for t in job.platform.torquers]
        for one in outputs:
            if one not in torquers:
                raise self._mistake("outputs", f"{given(one)} is no torquer of the plant; {suggestion(one, torquers)}")
        period, delay = job.sampling.period, job.sampling.delay
        dt = self._number("dt")
        if not math.isclose(dt, period, rel_tol=1e-9):
            raise self._mistake("dt", f"{dt:g} s is not the job's sample period, {period:g} s")
        waits = self._number("delay")
        if not math.isclose(waits, delay, rel_tol=1e-9, abs_tol=1e-9 * period):
            raise self._mistake("delay", f"{waits:g} s is not the job's delay, {delay:g} s")
        order = self._length("A")
        if order > MOST_STATES:
            raise self._mistake("A", f"has {order} rows; at most {MOST_STATES} states are allowed")
        arrays = StateArrays(
            A=self._matrix("A", order, order),
            B=self._matrix("B", order, len(inputs)),
            C=self._matrix("C", len(outputs), order),
            D=self._matrix("D", len(outputs), len(inputs)),
            dt=period,
        )
        design = self.data.get("design")
        title = f"{name}, {design}" if isinstance(design, str) and design else name
        return named_system(arrays, inputs, outputs, name=title)

    def _mistake(self, key: str, text: str) -> InputError:
        joined = " " if text.startswith("must ") else ": "
        return InputError(one_line(f"{self.where}: {key}{joined}{text}"))

    def _item(self, key: str, expected: str) -> object:
        if key not in self.data:
            raise InputError(f'{self.where}: the key "{key}" is missing; it must be {expected}')
        return self.data[key]

    def _text(self, key: str) -> str:
        item = self._item(key, "a name")
        if not isinstance(item, str) or not item.strip() or not item.isprintable():
            raise self._mistake(key, f"must be a name, got {given(item)}")
        return item

    def _names(self, key: str) -> list[str]:
        item = self._item(key, "a list of signal names")
        if not isinstance(item, list) or not item or not all(isinstance(name, str) for name in item):
            raise self._mistake(key, f"must be a list of signal names, got {given(item)}")
        for k, name in enumerate(item):
            if name in item[:k]:
                raise self._mistake(key, f"{given(name)} is listed twice; leave one of them out")
        return item

    def _number(self, key: str) -> float:
        item = self._item(key, "a number, s")
        number = finite_number(item)
        if number is None:
            raise self._mistake(key, f"must be a finite number, s, got {given(item)}")
        return number

    def _length(self, key: str) -> int:
        item = self._item(key, "a matrix as a list of rows")
        if not isinstance(item, list):
            raise self._mistake(key, f"must be a matrix as a list of rows, got {given(item)}")
        return 0 if item == [[]] else len(item)

    def _matrix(self, key: str, rows: int, columns: int) -> FloatArray:
        self._length(key)
        item = self.data[key]
        shape = f"{rows} x {columns}" + (" (square)" if key == "A" else " (by inputs, outputs and A)")
        if rows * columns == 0 and all(row == [] for row in item):
            return np.zeros((rows, columns))
        if len(item) != rows:
            raise self._mistake(key, f"must be {shape}, has {len(item)} row{'' if len(item) == 1 else 's'}")
        out = np.zeros((rows, columns))
        for i, row in enumerate(item):
            if not isinstance(row, list):
                raise self._mistake(key, f"must be {shape}, row {i + 1} is {given(row)}")
            if len(row) != columns:
                wrong = f"row {i + 1} has {len(row)} element{'' if len(row) == 1 else 's'}"
                raise self._mistake(key, f"must be {shape}, {wrong}")
            for j, entry in enumerate(row):
                number = finite_number(entry)
                if number is None:
                    raise self._mistake(key, f"element ({i + 1}, {j + 1}) must be a finite number, got {given(entry)}")
                out[i, j] = number
        return out


@check_arguments
def outcomes_from(
    job: Job, controllers: Sequence[control.StateSpace], alternatives: Sequence[control.StateSpace] = ()
) -> tuple[LoopOutcome, ...]:
    """Return existing controllers as the outcome of the job's loops, measured anew."""
    placed: dict[str, control.StateSpace] = {}
    for K in controllers:
        spec = _loop_of(job, K)
        if spec.name in placed:
            raise InputError(
                f"controllers: {given(placed[spec.name].name)} and {given(K.name)} both close the loop "
                f"{given(spec.name)}; give one for each loop"
            )
        placed[spec.name] = K
    for spec in job.loops:
        if spec.name not in placed:
            wanted = ", ".join(sorted(_torques(job, spec)))
            raise InputError(
                f"controllers: none closes the loop {given(spec.name)} of the job; add one with the outputs {wanted}"
            )
    specs = {spec.name: spec for spec in job.loops}
    others: dict[str, list[control.StateSpace]] = {name: [] for name in placed}
    for K in alternatives:
        others[_loop_of(job, K).name].append(K)
    return tuple(_outcome(job, specs[name], K, others[name]) for name, K in placed.items())


def _outcome(job: Job, spec: LoopSpec, closed: control.StateSpace, others: Sequence[control.StateSpace]) -> LoopOutcome:
    plants = plants_of(job, spec)
    designs: list[LoopDesign] = []
    for K in (closed, *others):
        name = _free_name(str(K.name).removeprefix(f"{spec.name}, "), [design.name for design in designs])
        if plants is None:
            designs.append(LoopDesign(loop=spec.name, name=name, method="given", controller=K))
        else:
            designs.append(with_caging_claims(job, remeasured(spec, name, K, plants), closed=not designs))
    return LoopOutcome(spec=spec, designs=tuple(designs), use=designs[0].name)


def _free_name(name: str, taken: Sequence[str]) -> str:
    """Number a name that is taken: `use` finds a design by its name."""
    new, count = name, 1
    while new in taken:
        count += 1
        new = f"{name} {count}"
    return new


def _torques(job: Job, spec: LoopSpec) -> set[str]:
    """Return the torquers of a loop: of a caging loop the first on every gimbal, as it is designed."""
    if spec.kind == "stabilisation":
        return {t.name for t in job.platform.torquers if t.root_axis is not None}
    return {job.platform.torquer_on(gimbal).name for gimbal in spec.gimbals}


def _loop_of(job: Job, K: control.StateSpace) -> LoopSpec:
    outputs = set(K.output_labels)
    for spec in job.loops:
        if outputs != _torques(job, spec):
            continue
        pickoffs = {job.platform.pickoff_on(gimbal).name for gimbal in spec.gimbals}
        if pickoffs and set(K.input_labels) != pickoffs:
            raise InputError(
                f"controller {given(K.name)}: inputs {', '.join(K.input_labels)}; the loop {given(spec.name)} is "
                f"measured with {', '.join(sorted(pickoffs))}: give just these"
            )
        return spec
    loops = "; ".join(f"{spec.name}: {', '.join(sorted(_torques(job, spec)))}" for spec in job.loops)
    raise InputError(
        f"controller {given(K.name)}: its outputs {', '.join(K.output_labels)} are those of no loop of the job; "
        f"they must be those of one loop ({loops})"
    )
