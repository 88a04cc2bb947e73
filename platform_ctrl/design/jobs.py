"""The loops of a job: every design of every loop, made by its method and certified."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping, Sequence
from typing import Any

from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.common.progress import Local, Progress, shown
from platform_ctrl.common.values import replaced
from platform_ctrl.design.feedforward import design_plants
from platform_ctrl.design.loop import Design, FailedDesign, LoopOutcome, commanded, with_commands
from platform_ctrl.design.loop_signals import loop_channels, loop_signals
from platform_ctrl.design.method import LoopProblem, instability
from platform_ctrl.design.methods import read_job
from platform_ctrl.design.partition import Channels
from platform_ctrl.design.plants import plants_of, tracking_plants
from platform_ctrl.design.side_by_side import made_of
from platform_ctrl.errors import DesignError
from platform_ctrl.job.job import CoupledLimits, Job, LoopSpec
from platform_ctrl.job.methods import DesignSpec
from platform_ctrl.mechanics.linearisation import LinearModel, linearise

# What no design may depend on.
_REMOVED: dict[str, Any] = {
    "name": "",
    "plant": "",
    "coupled": CoupledLimits(),
    "manoeuvres": (),
    "fault_events": (),
    "campaign": None,
    "budget": None,
}
# Of a loop whose plants alone count.
_BARE: dict[str, Any] = {"designs": (), "use": "", "limits": {}, "soft": {}}
_TURNS: dict[str, Any] = _BARE | {"name": "", "kind": "rate", "sensors": (), "around": None, "rate_hz": None}


def loops(
    job: Job | str | os.PathLike[str] | Mapping[str, object],
    progress: Progress | bool | None = None,
) -> tuple[LoopOutcome, ...]:
    """Design every loop of `job` by each of its methods.

    Parameters
    ----------
    job
        The job, or what `read_job` reads: a path or a dict.
    progress
        Called with a line before and during each design; True shows the lines, in a notebook or on a terminal.

    Returns
    -------
    tuple of LoopOutcome
        In the job's order, but a tracking loop before the rate loop that it commands. A design that is not the one that
        its loop uses may fail: `failed` says why.

    Raises
    ------
    InputError
        The job makes no sense, or a loop's gimbals cut through a subsystem.
    DesignError
        A method found no controller for the design that a loop uses, or its closed loop is unstable.
    MechanicsError
        The mass matrix is singular at rest (gimbal lock).
    """
    found = attempted_loops(job, progress)
    for outcome in found:
        if outcome.failure is not None:
            raise outcome.failure.error
    return found


def attempted_loops(
    job: Job | str | os.PathLike[str] | Mapping[str, object],
    progress: Progress | bool | None = None,
    processes: int = 1,
) -> tuple[LoopOutcome, ...]:
    """Return what `loops` returns, though designs that loops use have failed; then a loop may have no design at all.

    Designs are made side by side in up to so many processes.
    """
    job = job if isinstance(job, Job) else read_job(job)
    with shown(progress) as say:
        return _loops(job, say, processes)


def _loops(job: Job, progress: Progress, processes: int) -> tuple[LoopOutcome, ...]:
    model = linearise(job.platform)
    # All plants before the first design: an error in the third loop is raised before the work on the first.
    plants_of_all = {spec.name: _plants_of_designs(plant_job(job, spec), spec) for spec in job.loops}
    specs, made = {spec.name: spec for spec in job.loops}, dict[str, LoopOutcome]()
    # A tracking loop has the rate loop that it commands in its plants.
    for tracking in (False, True):
        problems: dict[str, list[LoopProblem]] = {}
        for name, spec in specs.items():
            inner = made[str(spec.around)] if tracking and spec.kind == "tracking" else None
            if inner is not None and inner.failure is not None:
                made[name] = _without_inner(spec, inner.failure)
            elif (spec.kind == "tracking") is tracking:
                around = None if inner is None else inner.closed
                problems[name] = _problems(job, spec, model, plants_of_all[name], around, progress)
        found = iter(made_of([one for own in problems.values() for one in own], processes, progress))
        for name, own in problems.items():
            made[name] = _outcome(specs[name], [(problem.design, next(found)) for problem in own])
    return in_order(job, list(map(made.__getitem__, specs)))


def _outcome(spec: LoopSpec, found: Sequence[tuple[DesignSpec, Design | Exception]]) -> LoopOutcome:
    """Return the outcome of a loop of what its designs have come to."""
    designs = tuple(one for _, one in found if isinstance(one, Design))
    errors = [(design, instability(one, design.tune) if isinstance(one, Design) else one) for design, one in found]
    failed = tuple(_failed(spec, design, error) for design, error in errors if error is not None)
    names = [one.name for one in designs]
    use = spec.use if spec.use in names or not names else names[0]
    return LoopOutcome(spec=spec, designs=designs, use=use, failed=failed)


def _without_inner(spec: LoopSpec, inner: FailedDesign) -> LoopOutcome:
    """Return the outcome of a tracking loop of which the loop inside has no design to rely on."""
    words = f"the design {inner.name!r} of the loop {inner.loop!r}, which it commands, has failed"
    failed = tuple(
        _failed(spec, design, DesignError(f"{spec.name}, {design.name}: {words}")) for design in spec.designs
    )
    return LoopOutcome(spec=spec, designs=(), use=spec.use, failed=failed)


def _failed(spec: LoopSpec, design: DesignSpec, error: Exception) -> FailedDesign:
    return FailedDesign(loop=spec.name, name=design.name, method=design.method, error=error)


def _problems(
    job: Job,
    spec: LoopSpec,
    model: LinearModel,
    plants: Sequence[PlantSet | None],
    inner: Design | None,
    progress: Progress,
) -> list[LoopProblem]:
    """Return what the methods of a loop's designs are given.

    `inner` is the design of the loop that a tracking loop commands.
    """
    directed: list[tuple[PlantSet | None, Channels | None]] = []
    if inner is not None:
        around = next(one for one in job.loops if one.name == spec.around)
        assert inner.plants is not None, "a rate loop has plants"
        K = with_commands(inner.plants, inner.controller)
        directed += [tracking_plants(plant_job(job, spec, around), spec, around, inner.plants, K)] * len(plants)
    else:
        # Directions once for all designs that read the same, which ask for them again and again.
        of_sensors: dict[tuple[str, ...], Channels] = {}
        for design, own in zip(spec.designs, plants, strict=True):
            read = spec.read_by(design)
            if own is not None and read.sensors not in of_sensors:
                of_sensors[read.sensors] = loop_channels(model, loop_signals(job.platform, read), own.period)
            directed.append((own, None if own is None else of_sensors[read.sensors]))
    out = []
    for design, (plant_set, directions) in zip(spec.designs, directed, strict=True):
        alone = design_job(job, spec, design)
        problem = LoopProblem(job=alone, spec=alone.loops[-1], design=design, model=model, plant_set=plant_set)
        out.append(dataclasses.replace(problem, directions=directions, progress=Local(progress)))
    return out


def _plants_of_designs(job: Job, spec: LoopSpec) -> list[PlantSet | None]:
    """Return the plants of every design of a loop: those of designs that read the same are made once."""
    bare: dict[tuple[str, ...], PlantSet | None] = {}
    out = []
    for design in spec.designs:
        read = spec.read_by(design)
        if read.sensors not in bare:
            bare[read.sensors] = plants_of(job, read)
        out.append(design_plants(job, spec, design, bare[read.sensors]))
    return out


def _commanded(job: Job, design: Design, around: bool) -> Design:
    """Return a design with commands where a loop around it or a manoeuvre commands what it reads."""
    plants = design.plants
    return commanded(design) if plants is not None and (around or job.commanded & set(plants.angles)) else design


def in_order(job: Job, outcomes: Sequence[LoopOutcome]) -> tuple[LoopOutcome, ...]:
    """Return loops in the order in which their controllers are computed: a tracking loop before the one it commands.

    Those that such a loop or a manoeuvre commands take commands then.
    """
    around = {one.spec.around for one in outcomes}
    out = []
    for one in outcomes:
        designs = tuple(_commanded(job, design, one.spec.name in around) for design in one.designs)
        out.append(dataclasses.replace(one, designs=designs))
    for tracking in [one for one in out if one.spec.kind == "tracking"]:
        out.remove(tracking)
        k = next(i for i, one in enumerate(out) if one.spec.name == tracking.spec.around)
        out.insert(k, tracking)
    return tuple(out)


def plant_job(job: Job, *loops: LoopSpec) -> Job:
    """Return what the plants of loops may depend on: neither on their designs nor on their limits."""
    bare = (replaced(spec, _BARE) for spec in loops)
    return _with_loops(job, tuple(bare))


def design_job(job: Job, spec: LoopSpec, design: DesignSpec) -> Job:
    """Return what a design of a loop may depend on: its loop without the other designs comes last.

    ``use`` is empty unless the design is the one that is closed. The loop that a tracking loop commands comes first,
    with the design that is closed.
    """
    use = design.name if design.name == spec.use else ""
    around = (one for one in job.loops if one.name == spec.around)
    inner = (
        replaced(one, _BARE | {"designs": tuple(own for own in one.designs if own.name == one.use)}) for one in around
    )
    return _with_loops(job, (*inner, replaced(spec, {"designs": (design,), "use": use})))


def _with_loops(job: Job, loops: tuple[LoopSpec, ...]) -> Job:
    """Return a job with these loops; of the others with no more than what they turn: that is not passive."""
    own = {spec.name for spec in loops}
    others = (replaced(one, _TURNS) for one in job.loops if one.name not in own and (one.gimbals or one.torquers))
    return replaced(job, _REMOVED | {"loops": (*others, *loops)})
