"""Controllers that exist already: read from a file, checked, matched to the loops of a job, and measured again.

No claim of a file is trusted.
"""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from platform_ctrl.analysis.interconnection import COMMAND
from platform_ctrl.analysis.system import StateSpace
from platform_ctrl.common.text import unused
from platform_ctrl.design.jobs import in_order, plants_of_designs, problems_of
from platform_ctrl.design.loop import Design, FailedDesign, LoopOutcome, given_design, with_largest_rates
from platform_ctrl.design.method import LoopProblem
from platform_ctrl.design.methods import METHODS
from platform_ctrl.design.sight import beside
from platform_ctrl.errors import InputError, began_with_interrupt
from platform_ctrl.job.job import Job, LoopSpec
from platform_ctrl.job.methods import DesignSpec
from platform_ctrl.job.reading import job_hashes
from platform_ctrl.mechanics.linearisation import LinearModel, linearise
from platform_ctrl.plant import fields
from platform_ctrl.plant.mistakes import given, suggestion
from platform_ctrl.plant.platform import is_rate
from platform_ctrl.plant.source import read_json
from platform_ctrl.verification.result_file import JSONTable, resolve_record

_EXPECTED = "a JSON file with controllers"
_SECONDS = fields.Expected("a finite number, s", fields.finite)


def read_controllers(
    source: str | os.PathLike[str] | Mapping[str, Any], job: Job, key: str = "controllers"
) -> list[StateSpace]:
    """Read controllers that exist already and check whether they can be closed around the job's plant.

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
    given_as_dict = isinstance(source, Mapping)
    label, data = ("controllers given as a dict", source) if given_as_dict else read_json(source, _EXPECTED)  # type: ignore[arg-type]
    table = JSONTable(label, data)
    table.value("schema", fields.SCHEMA)
    entries = list(table.tables(key, "controllers")) if key in table.data or key == "controllers" else []
    if not entries and key == "controllers":
        raise table.mistake(f"{key} must be a list of controllers, got []")
    known = [*job.units]
    known += [f"{name}{COMMAND}" for name in known]
    made_by: dict[str, str] = {}
    out = []
    for number, entry in enumerate(entries, 1):
        K = _controller(entry, job, [*known, *made_by])
        for name in K.output_labels if key == "controllers" else ():
            if name in made_by:
                raise InputError(
                    f"{label}: {key} {number}: outputs: {given(name)} is set by {made_by[name]} already; "
                    "give each torque one controller"
                )
            made_by[name] = f"{key} {number}"
        out.append(K)
    return out


def differing_origin(path: Path, job: Job) -> str:
    """Return what is wrong with taking the controllers of a file for those of a job unasked; nothing where all is well.

    A file that does not say what it was made for is taken. `read_controllers` says what else is wrong with it.
    """
    _, data = read_json(path, _EXPECTED)
    if not isinstance(data, Mapping):
        return ""
    for key, same in _origin(data, job).items():
        if same is False:
            return _OTHER[key]
    closed, failed = _designs(data.get("controllers")), _designs(data.get("failed"))
    for spec in job.loops:
        names = [design.name for design in spec.designs]
        if (spec.name, spec.use) in failed and spec.name not in dict(closed):
            return f"has no controller of the loop {given(spec.name)}, whose design {given(spec.use)} failed"
        for name in (name for loop, name in closed if loop == spec.name and name in names and name != spec.use):
            return f"closes the loop {given(spec.name)} with {given(name)}, but the job uses {given(spec.use)}"
    return ""


def is_of_job(path: Path, job: Job) -> bool:
    """Return whether a file says that its controllers are those of this job and its plant."""
    try:
        return all(_origin(read_json(path, _EXPECTED)[1], job).values())
    except InputError:
        return False


_OTHER = {
    "plant": "was made for another plant: the plant has changed since, or it is another job's",
    "design": "was made for another job: loops, limits, sampling or operation have changed since",
}


def _origin(data: object, job: Job) -> dict[str, bool | None]:
    """Return whether a file says that it was made for this plant and these designs; None where it does not say it."""
    hashes, now = (data.get("sha256") if isinstance(data, Mapping) else None), job_hashes(job)
    said = hashes if isinstance(hashes, Mapping) else {}
    return {key: said[key] == now[key] if key in said else None for key in _OTHER}


def _designs(entries: object) -> list[tuple[object, object]]:
    """Return loop and design of the entries of a file, whatever they are."""
    found = entries if isinstance(entries, list) else []
    return [(one.get("name"), one.get("design")) for one in found if isinstance(one, Mapping)]


def _controller(entry: JSONTable, job: Job, known: Sequence[str]) -> StateSpace:
    """Return one controller of a file, its inputs among `known`."""
    name, inputs, outputs = entry.value("name", fields.TEXT), entry.names("inputs"), entry.names("outputs")
    for one in inputs:
        if one not in known and is_rate(one):
            wrong = f"{given(one)} is a rate that no sensor of the plant measures"
            raise entry.mistake(f"inputs: {wrong}; add a [[rate_sensor]] for it to the plant file")
        if one not in known:
            wrong = f"{given(one)} is no pick-off of the plant and no output of a controller before it"
            raise entry.mistake(f"inputs: {wrong}; {suggestion(one, known)}")
    torquers = [t.name for t in job.platform.torquers]
    rates = [spec.read_by(design) for spec in job.loops if spec.kind == "rate" for design in spec.designs]
    commands = {f"{name}{COMMAND}" for spec in rates for name in job.readings_of(spec)}
    for one in outputs:
        if one not in torquers and one not in commands:
            raise entry.mistake(f"outputs: {given(one)} is no torquer of the plant; {suggestion(one, torquers)}")
    period = next(
        (job.period_of(spec) for spec in job.loops if set(outputs) == set(job.channels_of(spec))), job.sampling.period
    )
    whose = "the job's" if period == job.sampling.period else "the loop's"
    for key, words, expected in (
        ("dt", f"{whose} sample period", period),
        ("delay", "the job's delay", job.sampling.delay),
    ):
        found = entry.value(key, _SECONDS)
        if not math.isclose(found, expected, rel_tol=1e-9, abs_tol=0.0 if key == "dt" else 1e-9 * period):
            raise entry.mistake(f"{key}: {found:g} s is not {words}, {expected:g} s")
    # Readings that were turned to joint axes otherwise than the job's are refused.
    own = next((law for law in job.resolvers if not set(law.names).isdisjoint(inputs)), None)
    law_given = entry.data.get("resolve")
    if law_given is not None and law_given != (None if own is None else resolve_record(own)):
        raise entry.mistake("resolve: the job's loop turns its readings otherwise; design it again, or change the loop")
    arrays = entry.arrays(len(inputs), len(outputs), period)
    design = entry.data.get("design")
    title = f"{name}, {design}" if isinstance(design, str) and design else name
    return arrays.to_control(inputs, outputs, name=title)


def outcomes_from(
    job: Job, controllers: Sequence[StateSpace], alternatives: Sequence[StateSpace] = ()
) -> tuple[LoopOutcome, ...]:
    """Return existing controllers as the outcome of the job's loops, measured again."""
    placed: dict[str, list[StateSpace]] = {}
    for K in controllers:
        spec = _loop_of(job, K)
        if spec.name in placed:
            raise InputError(
                f"controllers: {given(placed[spec.name][0].name)} and {given(K.name)} both close the loop "
                f"{given(spec.name)}; give one for each loop"
            )
        placed[spec.name] = [K]
    for spec in job.loops:
        if spec.name not in placed:
            wanted = ", ".join(sorted(job.channels_of(spec)))
            raise InputError(
                f"controllers: none closes the loop {given(spec.name)} of the job; add one with the outputs {wanted}"
            )
    for K in alternatives:
        placed[_loop_of(job, K).name].append(K)
    model, made = linearise(job.platform), dict[str, LoopOutcome]()
    closed = {name: own[0] for name, own in placed.items()}
    # The plants of a tracking loop have the rate loop inside them.
    for spec in sorted(job.loops, key=lambda spec: spec.kind == "tracking"):
        inner = made.get(spec.around or "")
        around = None if inner is None else inner.closed
        made[spec.name] = _outcome(job, spec, model, placed[spec.name], around, closed)
    return in_order(job, [made[name] for name in placed])


def _outcome(
    job: Job,
    spec: LoopSpec,
    model: LinearModel,
    controllers: Sequence[StateSpace],
    inner: Design | None,
    closed: Mapping[str, StateSpace],
) -> LoopOutcome:
    """Return the controllers of a loop, measured again, the closed one first; `closed` are those of all loops."""
    names: list[str] = []
    for K in controllers:
        names.append(unused(_name_of(spec, K), names, " "))  # `use` finds a design by its name
    read = dataclasses.replace(spec, designs=tuple(_design_of(job, spec, K) for K in controllers))
    plants = [one and beside(one, closed) for one in plants_of_designs(job, read)]
    problems = problems_of(job, read, model, plants, inner)
    found: list[Design | FailedDesign] = []
    for problem, name, K in zip(problems, names, controllers, strict=True):
        try:
            found.append(_measured(problem, name, K, not found))
        except Exception as error:
            # One that is not closed does not end the others.
            if not found or began_with_interrupt(error):
                raise
            found.append(FailedDesign(loop=spec.name, name=name, method="given", error=error))
    designs = tuple(one for one in found if isinstance(one, Design))
    failed = tuple(one for one in found if isinstance(one, FailedDesign))
    return LoopOutcome(spec=spec, designs=designs, use=designs[0].name, failed=failed)


def _measured(problem: LoopProblem, name: str, K: StateSpace, closed: bool) -> Design:
    """Return a controller as a design of a loop, measured again."""
    spec, design, plants = problem.spec, problem.design, problem.plant_set
    if plants is None:
        return Design(loop=spec.name, name=name, method="given", controller=K)
    made = given_design(spec, name, K, plants)
    if design.name == name and design.responses is not None:
        made = METHODS[design.method].judged(problem, made)
    return with_largest_rates(made) if spec.kind == "caging" and closed else made


def _name_of(spec: LoopSpec, K: StateSpace) -> str:
    return str(K.name).removeprefix(f"{spec.name}, ")


def _taken(K: StateSpace) -> set[str]:
    """Return what a controller reads, without commands of what it reads."""
    names = set(K.input_labels)
    return {name for name in names if name.removesuffix(COMMAND) not in names or name.removesuffix(COMMAND) == name}


def _design_of(job: Job, spec: LoopSpec, K: StateSpace) -> DesignSpec:
    """Return the design of the job that reads what a controller reads: the one of its name, if several do."""
    name, taken = _name_of(spec, K), _taken(K)
    fitting = [design for design in spec.designs if {*job.read_in(spec, design)} == taken]
    named = [design for design in fitting if design.name == name]
    bare = DesignSpec(name=name, method=spec.closed.method)
    return next(iter((*named, *fitting)), bare)


def _loop_of(job: Job, K: StateSpace) -> LoopSpec:
    outputs = set(K.output_labels)
    for spec in job.loops:
        if outputs != set(job.channels_of(spec)):
            continue
        every = [{*job.readings_of(spec)}, *({*job.read_in(spec, design)} for design in spec.designs)]
        if every[0] and _taken(K) not in every:
            several = " or ".join(dict.fromkeys(", ".join(sorted(read)) for read in every))
            raise InputError(
                f"controller {given(K.name)}: inputs {', '.join(K.input_labels)}; the loop {given(spec.name)} is "
                f"measured with {several}: give just these"
            )
        return spec
    loops = "; ".join(f"{spec.name}: {', '.join(sorted(job.channels_of(spec)))}" for spec in job.loops)
    raise InputError(
        f"controller {given(K.name)}: its outputs {', '.join(K.output_labels)} are those of no loop of the job; "
        f"they must be those of one loop ({loops})"
    )
